//! Conversion of primitives to splats.

use decouplegs_scene::{SplatCloud, sh};

use super::accessor::{rows, view_bytes};
use super::document::{Document, Primitive};
use super::nodes::shown_meshes;
use super::place::place;
use super::{EXTENSION, HALF_TURN};
use crate::DecodeError;
use crate::activation::{normalized, scale_of_log};
use crate::memory::{DECODED_BYTES_PER_FILE_BYTE, cloud_bytes};
use crate::spz::{self, flip};

/// A primitive's splats in its own frame. Scales are as stored.
struct Stored {
    cloud: SplatCloud,
    /// Part of the file's limit that it takes, bytes.
    charged_bytes: u64,
    /// True if scales may turn out to be logarithms: those of an SPZ are known.
    undecided: bool,
}

/// All splats that the scene shows. Nodes may show the same splats many times; decoded they take at
/// most `bytes_max`.
pub(super) fn gather(
    document: &Document,
    binary: &[u8],
    bytes_max: u64,
) -> Result<SplatCloud, DecodeError> {
    let mut placed = Vec::new();
    let (mut bytes_left, mut found) = (bytes_max, false);
    for (mesh, world) in shown_meshes(document)? {
        let mesh = document
            .meshes
            .get(mesh)
            .ok_or_else(|| DecodeError::Malformed(format!("there is no mesh {mesh}")))?;
        for primitive in mesh
            .primitives
            .iter()
            .filter(|primitive| primitive.splats().is_some())
        {
            let stored = read(document, binary, primitive, bytes_left)?;
            found = true;
            bytes_left = bytes_left.saturating_sub(stored.charged_bytes);
            placed.push((stored, world));
        }
    }
    if !found {
        return Err(DecodeError::Malformed(format!(
            "the scene shows nothing with the extension {EXTENSION}, only meshes or nothing"
        )));
    }
    let mut undecided = placed.iter().filter(|(stored, _)| stored.undecided);
    let is_logarithmic = undecided.any(|(stored, _)| {
        stored
            .cloud
            .scales
            .as_flattened()
            .iter()
            .any(|&scale| scale < 0.0)
    });
    let mut all = SplatCloud::default();
    for (mut stored, world) in placed {
        if is_logarithmic && stored.undecided {
            stored
                .cloud
                .scales
                .iter_mut()
                .for_each(|scales| *scales = scales.map(scale_of_log));
        }
        place(&mut stored.cloud, &world);
        all.append(&stored.cloud);
    }
    flip(&mut all, HALF_TURN);
    Ok(all)
}

/// The splats of a primitive, which take at most `bytes_max`.
fn read(
    document: &Document,
    binary: &[u8],
    primitive: &Primitive,
    bytes_max: u64,
) -> Result<Stored, DecodeError> {
    let charge = |bytes: u64| {
        let message = || {
            format!(
                "its splats take more memory than is believed of a file of this size ({bytes} bytes, {bytes_max} left)"
            )
        };
        if bytes <= bytes_max {
            Ok(bytes)
        } else {
            Err(DecodeError::Malformed(message()))
        }
    };
    if let Some(spz) = primitive
        .splats()
        .and_then(|splats| splats.extensions.spz.as_ref())
    {
        let (bytes, _) =
            view_bytes(document, binary, spz.buffer_view).map_err(DecodeError::Malformed)?;
        // Right, up, back are glTF's axes.
        // By its size: an SPZ bounds what it unpacks to, but many nodes may show it.
        let charged_bytes = charge(bytes.len() as u64 * DECODED_BYTES_PER_FILE_BYTE)?;
        return Ok(Stored {
            cloud: spz::decode_as_stored(bytes)?,
            charged_bytes,
            undecided: false,
        });
    }
    read_attributes(document, binary, primitive, charge)
}

/// The splats of a primitive whose attributes are accessors. `charge` refuses more bytes than the
/// primitive may take.
fn read_attributes(
    document: &Document,
    binary: &[u8],
    primitive: &Primitive,
    charge: impl Fn(u64) -> Result<u64, DecodeError>,
) -> Result<Stored, DecodeError> {
    let index = |name: &str| {
        primitive.attributes.get(name).copied().ok_or_else(|| {
            let there: Vec<&str> = primitive
                .attributes
                .keys()
                .take(12)
                .map(String::as_str)
                .collect();
            DecodeError::Malformed(format!(
                "a primitive has no attribute '{name}', only: {}",
                there.join(", ")
            ))
        })
    };
    let named = |name: &str| format!("{EXTENSION}:{name}");
    let count = document
        .accessors
        .get(index("POSITION")?)
        .map_or(0, |accessor| accessor.count);
    let has_degree = |l: &u8| {
        primitive
            .attributes
            .contains_key(&named(&format!("SH_DEGREE_{l}_COEF_0")))
    };
    let sh_degree = (1..=sh::DEGREE_MAX).rev().find(has_degree).unwrap_or(0);
    let charged_bytes = charge(cloud_bytes(count, sh_degree))?;
    let means = rows::<3>(document, binary, index("POSITION")?, "POSITION")?;
    let triples = |name: &str| {
        counted(
            rows::<3>(document, binary, index(name)?, name)?,
            count,
            name,
        )
    };
    let [rotation, opacity] = [named("ROTATION"), named("OPACITY")];
    let rotations = counted(
        rows::<4>(document, binary, index(&rotation)?, &rotation)?,
        count,
        &rotation,
    )?;
    let opacities = counted(
        rows::<1>(document, binary, index(&opacity)?, &opacity)?,
        count,
        &opacity,
    )?;
    let stride = sh::coefficient_count(sh_degree) - 1;
    let mut sh_rest = vec![[0.0; 3]; count as usize * stride];
    let coefficients = (1..=sh_degree).flat_map(|l| (0..2 * l + 1).map(move |n| (l, n)));
    for (k, (l, n)) in coefficients.enumerate() {
        let values = triples(&named(&format!("SH_DEGREE_{l}_COEF_{n}")))?;
        values
            .into_iter()
            .enumerate()
            .for_each(|(splat, value)| sh_rest[splat * stride + k] = value);
    }
    let cloud = SplatCloud {
        means,
        scales: triples(&named("SCALE"))?,
        rotations: rotations
            .into_iter()
            .map(|[x, y, z, w]| normalized([w, x, y, z]))
            .collect(),
        opacities: opacities.into_iter().map(|[opacity]| opacity).collect(),
        sh_degree,
        sh_dc: triples(&named("SH_DEGREE_0_COEF_0"))?,
        sh_rest,
    };
    Ok(Stored {
        cloud,
        charged_bytes,
        undecided: true,
    })
}

fn counted<const N: usize>(
    rows: Vec<[f32; N]>,
    count: u64,
    what: &str,
) -> Result<Vec<[f32; N]>, DecodeError> {
    if rows.len() as u64 == count {
        return Ok(rows);
    }
    Err(DecodeError::Malformed(format!(
        "attribute '{what}' has {} rows for {count} splats",
        rows.len()
    )))
}
