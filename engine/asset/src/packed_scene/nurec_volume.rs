//! Splats of a scene as the `volume.nurec` of a package: MessagePack in gzip, numbers of 16 bits,
//! as 3dgrut's `threedgrut/export/importers/nurec_usd.py` at a37ef72 reads them.

use std::io::{self, Write};
use std::path::Path;

use decouplegs_scene::SplatCloud;
use flate2::Compression;
use flate2::write::GzEncoder;
use glam::{DMat3, DVec3};
use half::f16;
use rmp::encode as pack;

use crate::activation::{log_of_scale, logit};
use crate::error::read_bytes;
use crate::{
    AssetError, SceneFile, coded_asset, read_coded, read_placed_splats, read_splats, sky_file,
};

/// Entry of the volume.
pub(super) const VOLUME: &str = "volume.nurec";
/// Entry of the stage that has the volume.
pub(super) const VOLUME_STAGE: &str = "volume.usda";
/// Numbers of a splat's spherical harmonics of degrees 1 to 3.
const SPECULAR: usize = 45;
/// Texels along a side of the sky of a scene with one color.
const SKY_TEXELS: usize = 2;
/// Largest number of 16 bits.
const HALF_MAX: f32 = 65_504.0;

/// A volume, and what was lost.
pub(super) struct Volume {
    /// Bytes of the entry.
    pub(super) bytes: Vec<u8>,
    /// Box about the splats' means, local frame, meters.
    pub(super) bounds_m: [[f32; 3]; 2],
    /// Largest step between two positions of 16 bits, meters.
    pub(super) step_m: f32,
}

/// A value of a state dictionary.
enum Item {
    Bytes(Vec<u8>),
    Shape(Vec<usize>),
}

/// The splats of `scene`, whose paths are relative to `directory`: the background in the local
/// frame, agents called `tracks` in the frames of their boxes, and the sky.
///
/// # Errors
/// [`AssetError`] of the file at fault.
pub(super) fn volume(
    scene: &SceneFile,
    directory: &Path,
    tracks: &[String],
) -> Result<Volume, AssetError> {
    let placed = read_placed_splats(&directory.join(&scene.background))?;
    let (mut background, placed_at) = (placed.cloud, placed.origin);
    for mean in &mut background.means {
        *mean = (glam::Vec3::from_array(*mean).as_dvec3() + placed_at)
            .as_vec3()
            .to_array();
    }
    let mut state = Vec::new();
    put_layer(&mut state, "background", &background);
    let mut agents: Option<SplatCloud> = None;
    let mut owners: Vec<u8> = Vec::new();
    for (index, track) in tracks.iter().enumerate() {
        let Some(agent) = scene.agents.iter().find(|agent| agent.name == *track) else {
            continue;
        };
        let path = directory.join(&agent.asset);
        let own = if coded_asset::has_extension(&path) {
            read_coded(&path)?.cloud.decoded(0)
        } else {
            read_splats(&path)?
        };
        owners.extend((index as i32).to_le_bytes().repeat(own.len()));
        match &mut agents {
            Some(agents) => agents.append(&own),
            None => agents = Some(own),
        }
    }
    if let Some(agents) = &agents {
        put_layer(&mut state, "dynamic_rigids", agents);
        let name = ".gaussians_nodes.dynamic_rigids.gaussian_cuboid_ids";
        put(&mut state, name, vec![agents.len()], owners);
    }
    let (side, sky) = sky_of(scene, directory)?;
    let name = ".background.textures";
    put(&mut state, name, vec![1, 6, side, side, 3], halves(sky));
    let bounds = background.bounds();
    let (low, high) = (bounds.min, bounds.max);
    let farthest = low
        .iter()
        .chain(&high)
        .fold(0f32, |far, at| far.max(at.abs()));
    let bytes = written(&state, agents.as_ref().map_or(&[], |_| tracks))
        .expect("memory takes what is written");
    Ok(Volume {
        bytes,
        bounds_m: [low, high],
        // Eleven bits of a number between one power of two and the next.
        step_m: farthest.log2().floor().exp2() / 1024.0,
    })
}

/// The stage of a package, which shows [`VOLUME_STAGE`].
pub(super) const STAGE: &str = "#usda 1.0\n(\n    defaultPrim = \"World\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Xform \"World\"\n{\n    \
     def \"splats\" (\n        prepend references = @./volume.usda@\n    )\n    {\n    }\n}\n";

/// The stage of the volume: its transform is the identity, and its extent `bounds_m`.
pub(super) fn stage([low, high]: [[f32; 3]; 2]) -> String {
    let point = |[x, y, z]: [f32; 3]| format!("({x}, {y}, {z})");
    let field = |name: &str, kind: &str| {
        format!(
            "    def OmniNuRecFieldAsset \"{name}_field\"\n    {{\n        \
             token fieldDataType = \"{kind}\"\n        token fieldName = \"{name}\"\n        \
             token fieldRole = \"{name}\"\n        asset filePath = @./{VOLUME}@\n    }}\n"
        )
    };
    format!(
        "#usda 1.0\n(\n    defaultPrim = \"splats\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\ndef Volume \"splats\"\n{{\n    \
         custom bool omni:nurec:isNuRecVolume = 1\n    custom bool omni:nurec:useProxyTransform = 0\n    \
         float3[] extent = [{}, {}]\n    rel field:density = </splats/density_field>\n    \
         rel field:emissiveColor = </splats/emissiveColor_field>\n\n{}\n{}}}\n",
        point(low),
        point(high),
        field("density", "float"),
        field("emissiveColor", "float3"),
    )
}

fn put(state: &mut Vec<(String, Item)>, name: &str, shape: Vec<usize>, bytes: Vec<u8>) {
    state.push((name.to_owned(), Item::Bytes(bytes)));
    state.push((format!("{name}.shape"), Item::Shape(shape)));
}

fn halves(values: impl IntoIterator<Item = f32>) -> Vec<u8> {
    let half = |value: f32| f16::from_f32(value.clamp(-HALF_MAX, HALF_MAX)).to_le_bytes();
    values.into_iter().flat_map(half).collect()
}

fn put_layer(state: &mut Vec<(String, Item)>, layer: &str, splats: &SplatCloud) {
    let n = splats.len();
    let mut put_halves = |array: &str, shape: Vec<usize>, bytes: Vec<u8>| {
        put(
            state,
            &format!(".gaussians_nodes.{layer}.{array}"),
            shape,
            bytes,
        );
    };
    let flat = |rows: &[[f32; 3]]| halves(rows.as_flattened().iter().copied());
    put_halves("positions", vec![n, 3], flat(&splats.means));
    let rotations = splats.rotations.as_flattened().iter().copied();
    put_halves("rotations", vec![n, 4], halves(rotations));
    let scales = splats.scales.as_flattened().iter().copied();
    put_halves("scales", vec![n, 3], halves(scales.map(log_of_scale)));
    let densities = splats.opacities.iter().copied().map(logit);
    put_halves("densities", vec![n, 1], halves(densities));
    put_halves("features_albedo", vec![n, 3], flat(&splats.sh_dc));
    let specular = (0..n).flat_map(|splat| {
        let rest = splats.rest_of(splat).as_flattened();
        let padding = std::iter::repeat_n(0.0, SPECULAR - rest.len());
        rest.iter().copied().chain(padding)
    });
    put_halves("features_specular", vec![n, SPECULAR], halves(specular));
    put_halves("extra_signal", vec![n, 0], Vec::new());
    let degree = i64::from(splats.sh_degree).to_le_bytes().to_vec();
    put_halves("n_active_features", Vec::new(), degree);
}

/// Texels along a side of a face of the sky, and all of them, in OpenGL's order.
fn sky_of(scene: &SceneFile, directory: &Path) -> Result<(usize, Vec<f32>), AssetError> {
    let Some(sky) = &scene.sky_map else {
        return Ok((SKY_TEXELS, scene.sky.repeat(6 * SKY_TEXELS * SKY_TEXELS)));
    };
    let path = directory.join(&sky.file);
    let map = sky_file::decode_sky(&read_bytes(&path)?, sky).map(|decoded| decoded.sky);
    let map = map.map_err(|source| AssetError::Decode {
        path,
        format: "sky",
        source,
    })?;
    let gl_from_world = DMat3::from_cols(-DVec3::Z, -DVec3::X, DVec3::Y);
    let side = map.face_texels();
    let texels = map.texels_in_frame(side, gl_from_world);
    Ok((side, texels.as_flattened().to_vec()))
}

/// The dictionary as a file. `tracks` names the agents of the layer of agents.
fn written(state: &[(String, Item)], tracks: &[String]) -> io::Result<Vec<u8>> {
    let mut out = GzEncoder::new(Vec::new(), Compression::fast());
    let layers: Vec<&str> = state
        .iter()
        .filter_map(|(name, _)| {
            name.strip_prefix(".gaussians_nodes.")?
                .strip_suffix(".positions")
        })
        .collect();
    pack::write_map_len(&mut out, 1)?;
    pack::write_str(&mut out, "nre_data")?;
    pack::write_map_len(&mut out, 4)?;
    for (key, value) in [("version", "0.2.576"), ("model", "nre")] {
        pack::write_str(&mut out, key)?;
        pack::write_str(&mut out, value)?;
    }
    pack::write_str(&mut out, "config")?;
    pack::write_map_len(&mut out, 1)?;
    pack::write_str(&mut out, "layers")?;
    pack::write_map_len(&mut out, layers.len() as u32)?;
    for layer in &layers {
        write_settings(&mut out, layer)?;
    }
    pack::write_str(&mut out, "state_dict")?;
    pack::write_map_len(&mut out, state.len() as u32 + 1)?;
    for (name, item) in state {
        pack::write_str(&mut out, name)?;
        match item {
            Item::Bytes(bytes) => pack::write_bin(&mut out, bytes)?,
            Item::Shape(shape) => {
                pack::write_array_len(&mut out, shape.len() as u32)?;
                for &size in shape {
                    pack::write_uint(&mut out, size as u64)?;
                }
            }
        }
    }
    pack::write_str(&mut out, "._extra_state")?;
    pack::write_map_len(&mut out, 1)?;
    pack::write_str(&mut out, "obj_track_ids")?;
    pack::write_map_len(&mut out, layers.len() as u32)?;
    for layer in &layers {
        let own = if *layer == "background" { &[] } else { tracks };
        pack::write_str(&mut out, layer)?;
        pack::write_array_len(&mut out, own.len() as u32)?;
        for track in own {
            pack::write_str(&mut out, track)?;
        }
    }
    out.finish()
}

/// The functions that turn the numbers of a layer into splats.
fn write_settings(out: &mut impl Write, layer: &str) -> io::Result<()> {
    pack::write_str(out, layer)?;
    pack::write_map_len(out, 4)?;
    for (key, value) in [
        ("name", "sh-gaussians"),
        ("density_activation", "sigmoid"),
        ("scale_activation", "exp"),
        ("rotation_activation", "normalize"),
    ] {
        pack::write_str(out, key)?;
        pack::write_str(out, value)?;
    }
    Ok(())
}
