//! `decouplegs pack`: a scene as one USDZ package.

mod ground;

use std::fs;
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::maps::{MapFormat, open_drive};
use decouplegs::asset::packed_scene::{
    PackOptions, PackedScene, ground_mesh_ply, is_package, pack, packed_scene_id,
};
use decouplegs::asset::{SceneFile, UnfinishedFolder, read_bytes, read_map};
use decouplegs::scene::VehicleSize;
use glam::DVec3;

use crate::arguments::{print, three_numbers};
use crate::outputs::Force;

/// Pack a scene into one USDZ that AlpaSim's runtime and CARLA's NuRec scripts read
///
/// In the package are the ego's way, the cameras, the agents and the ground as these programs want
/// them, and the scene itself with all its splats, so that the package is opened wherever a scene
/// is. Others see the world from the scene's origin.
#[derive(clap::Args)]
pub struct Arguments {
    /// The scene (.toml), or a package of one (.usdz, also of NuRec), which is packed again
    scene: PathBuf,
    /// The package to write
    #[arg(long, value_name = "OUT.usdz", value_parser = package_path)]
    usdz: PathBuf,
    /// Id of the scene for clients (default: that of the package, or the name of the scene's
    /// folder)
    #[arg(long, value_name = "ID")]
    scene_id: Option<String>,
    /// Map of the scene's world: OpenDRIVE as it is; OpenDRIVE is written of Lanelet2, Argoverse 2,
    /// CommonRoad and lane JSON (default: that of the package, if it is one)
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Length, width and height of the ego vehicle, meters
    #[arg(long, value_name = "L,W,H", default_value = "4.5,1.8,1.5")]
    vehicle: Triple,
    /// Origin of the clients' rig, meters forward, left and up from the center of the vehicle's box
    /// (default: 1.35 m behind it, on the ground that is found below the ego's way, else at the
    /// bottom of the box)
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true)]
    rig_origin: Option<Triple>,
    /// Another name of a camera in the package, such as front=camera_front_wide_120fov; may be
    /// repeated
    #[arg(long, value_name = "NAME=NEW", value_parser = new_name)]
    camera: Vec<(String, String)>,
    /// Write the splats as NuRec's volume.nurec, for 3dgrut's importer and others that read that
    /// form: numbers of 16 bits, at some loss
    #[arg(long)]
    nurec: bool,
    /// Omit the ground, whose search takes seconds
    #[arg(long)]
    no_ground: bool,
    #[command(flatten)]
    force: Force,
}

/// Farthest that the ground may be from the bottom of the vehicle's box, meters, for the rig to be
/// put on it.
const RIG_SHIFT_MAX_M: f64 = 0.5;

/// Three numbers, written `4.5,1.8,1.5`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Triple([f64; 3]);

/// Vehicles and their rigs are smaller.
const METERS_MAX: f64 = 1e6;

impl FromStr for Triple {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parsed = three_numbers(text, METERS_MAX).map(Self);
        parsed.ok_or_else(|| {
            format!("expected three numbers of meters, like 4.5,1.8,1.5, found {text:?}")
        })
    }
}

/// A name and what it becomes, written `front=camera_front`.
fn new_name(text: &str) -> Result<(String, String), String> {
    text.split_once('=')
        .filter(|(from, to)| !from.is_empty() && !to.is_empty())
        .map(|(from, to)| (from.to_owned(), to.to_owned()))
        .ok_or_else(|| {
            format!("expected a camera and its new name, like front=camera_front_wide_120fov, found {text:?}")
        })
}

fn package_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let is_package = path
        .extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("usdz"));
    if is_package {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .usdz, found {text:?}"
        ))
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut inputs = vec![arguments.scene.as_path()];
    inputs.extend(arguments.map.as_deref());
    arguments.force.outputs(&inputs).file(&arguments.usdz)?;
    let unpacked = is_package(&arguments.scene)
        .then(|| Unpacked::new(&arguments.scene, &arguments.usdz))
        .transpose()?;
    let (scene, directory) = match &unpacked {
        Some(unpacked) => (unpacked.scene.clone(), unpacked.folder.path()),
        None => (
            SceneFile::read(&arguments.scene)?,
            arguments.scene.parent().unwrap_or(Path::new("")),
        ),
    };
    let own_map = unpacked.as_ref().and_then(Unpacked::map);
    let Triple(dims_m) = arguments.vehicle;
    ensure!(
        dims_m.iter().all(|&side_m| side_m > 0.0),
        "--vehicle {dims_m:?}: sides are above 0"
    );
    let mut options = PackOptions::new(scene_id(arguments)?);
    options.vehicle = VehicleSize::from_array(dims_m);
    let below = DVec3::new(options.rig_origin_m.x, 0.0, -0.5 * dims_m[2]);
    let asked = arguments.rig_origin;
    options.rig_origin_m = asked.map_or(below, |Triple(origin)| DVec3::from_array(origin));
    options.camera_names.clone_from(&arguments.camera);
    options.as_nurec = arguments.nurec;
    let mut notes = Vec::new();
    if let Some(map) = arguments.map.as_ref().or(own_map.as_ref()) {
        // Read as a map too: an empty or wrong file would only be found by those who open the
        // package.
        let lanes = read_map(map)?;
        let bytes = read_bytes(map)?;
        options.map = Some(match MapFormat::detect(&bytes) {
            Ok(MapFormat::OpenDrive) => bytes,
            _ => {
                notes.push(format!(
                    "OpenDRIVE is written of {}: {} lanes, those beside each other on one road, without signals, at latitude and longitude 0",
                    arguments.map.as_ref().unwrap_or(&arguments.scene).display(),
                    lanes.lanes.len()
                ));
                open_drive::encode(&lanes)
                    .with_context(|| format!("{} cannot be written as OpenDRIVE", map.display()))?
            }
        });
    }
    if !arguments.no_ground {
        notes.extend(add_ground(
            &scene,
            directory,
            asked.is_none(),
            &mut options,
        )?);
    }
    let summary = pack(&scene, directory, &options, &arguments.usdz)?;
    if options.map.is_some() && !summary.is_georeferenced {
        notes.push("the map has no geoReference with +lat_0 and +lon_0: AlpaSim cannot lay it under the scene".to_owned());
    }
    if let Some(step_m) = summary.position_step_m {
        notes.push(format!(
            "positions of splats are numbers of 16 bits: {:.1} cm apart at the edge of the scene",
            100.0 * step_m
        ));
    }
    let (start_s, end_s) = summary.span_s;
    if summary.offset_s != 0.0 {
        notes.push(format!(
            "times of the package are those of the scene plus {:.0} s",
            summary.offset_s
        ));
    }
    let bytes = fs::metadata(&arguments.usdz)
        .with_context(|| format!("cannot read {}", arguments.usdz.display()))?
        .len();
    let mut text = format!(
        "{}: scene '{}', {start_s:.3} to {end_s:.3} s, {} cameras, {} agents, {} entries, {bytes} bytes\n",
        arguments.usdz.display(),
        options.scene_id,
        scene.rig.sensors.len(),
        scene.agents.len(),
        summary.entries.len()
    );
    notes
        .iter()
        .for_each(|note| text.push_str(&format!("  {note}\n")));
    print(&text)
}

/// Adds the ground to `options`, and puts the rig's origin on it where `moves_rig` says so: notes
/// on what was found.
fn add_ground(
    scene: &SceneFile,
    directory: &Path,
    moves_rig: bool,
    options: &mut PackOptions,
) -> Result<Vec<String>> {
    let height_m = options.vehicle.height_m;
    let found = ground::ground_about(scene, directory, height_m, options.rig_origin_m.x)?;
    let mesh = found.mesh;
    if mesh.triangles.is_empty() {
        return Ok(vec![
            "no ground was found along the ego's way: the package has no mesh_ground.ply"
                .to_owned(),
        ]);
    }
    let mut notes = vec![format!(
        "ground: {} vertices, {} triangles, {} m apart",
        mesh.vertices.len(),
        mesh.triangles.len(),
        mesh.step_m
    )];
    options.ground_mesh = Some(ground_mesh_ply(&mesh.vertices, &mesh.triangles));
    if let Some(ego_height_m) = found.ego_height_m.filter(|_| moves_rig) {
        if (ego_height_m - 0.5 * height_m).abs() <= RIG_SHIFT_MAX_M {
            options.rig_origin_m.z = -ego_height_m;
            notes.push(format!(
                "the rig's origin is on the ground, {ego_height_m:.3} m below the middle of the vehicle"
            ));
        } else {
            notes.push(format!(
                "the ground is {ego_height_m:.3} m below the middle of the vehicle, whose box is {height_m} m high: the rig's origin \
                 stays at the bottom of the box; give --vehicle or --rig-origin"
            ));
        }
    }
    Ok(notes)
}

/// A package that is packed again: its scene, in a folder beside the new package for as long as
/// this lives. That of a killed run is removed by the next one.
struct Unpacked {
    folder: UnfinishedFolder,
    scene: SceneFile,
}

impl Unpacked {
    fn new(package: &Path, out: &Path) -> Result<Self> {
        let folder = UnfinishedFolder::begin(out)?;
        let scene = PackedScene::open(package)?.write(folder.path())?;
        Ok(Self { folder, scene })
    }

    /// The map of the package, if it has one.
    fn map(&self) -> Option<PathBuf> {
        let files = ["map.xodr", "lanes.json"].map(|name| self.folder.path().join(name));
        files.into_iter().find(|file| file.is_file())
    }
}

/// The id asked for, that of a package, or the name of the folder that the scene is in.
fn scene_id(arguments: &Arguments) -> Result<String> {
    let id = arguments.scene_id.clone();
    if let Some(id) = id.or_else(|| packed_scene_id(&arguments.scene)) {
        return Ok(id);
    }
    let scene = arguments
        .scene
        .canonicalize()
        .with_context(|| format!("cannot read {}", arguments.scene.display()))?;
    let folder = scene
        .parent()
        .and_then(Path::file_name)
        .map(|name| name.to_string_lossy().into_owned());
    folder.with_context(|| {
        format!(
            "{} is in no folder that could name the scene; give --scene-id",
            arguments.scene.display()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_numbers_are_read_and_nonsense_is_refused() {
        assert_eq!("4.5, 1.8,-1".parse(), Ok(Triple([4.5, 1.8, -1.0])));
        for nonsense in [
            "",
            "1,2",
            "1e308,0,0",
            "1,2,3,4",
            "1,2,x",
            "1,2,inf",
            "1,2,3,x",
        ] {
            assert!(
                nonsense
                    .parse::<Triple>()
                    .unwrap_err()
                    .contains(&format!("{nonsense:?}")),
                "{nonsense}"
            );
        }
    }
}
