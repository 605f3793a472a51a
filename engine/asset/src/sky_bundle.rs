//! Skies of Instant NuRec: `X.sky.npz` beside `X.ply`.
//!
//! After the public writer (NVIDIA/instant-nurec at 850f6b5). Entries that are read:
//!
//! | entry | shape | what is read |
//! |---|---|---|
//! | `sky_cubemap` | 6 x S x S x 3 | faces +x, -x, -y, +y, +z, -z, each interpolated by itself |
//! | `affine_matrix`, `affine_sensor_ids` | C x 3 x 4, C | rows of factors and an offset that a camera's image goes through after the sky was added |
//! | `format_version`, `face_axes`, `uv_convention` | | refused where they are others |

use decouplegs_scene::{Photometry, SkyMap};
use glam::{DMat3, DVec3};

use crate::DecodeError;
use crate::memory::decoded_bytes_max;
use crate::npy::NpyArray;
use crate::zip::Archive;

/// Name of the files behind that of the splats.
pub(crate) const EXTENSION: &str = "sky.npz";
/// Version that is read.
const VERSION: f64 = 1.0;
/// Axes of the faces that are read.
const FACE_AXES: [&str; 6] = ["+X", "-X", "-Y", "+Y", "+Z", "-Z"];
/// Directions of the columns and rows of faces that are read.
const UV: &str = "u_left_to_right_v_top_to_bottom";

/// A sky, and calibrations of cameras by name.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SkyBundle {
    pub(crate) sky: SkyMap,
    pub(crate) cameras: Vec<(String, Photometry)>,
}

impl SkyBundle {
    /// A sky without calibrations.
    pub(crate) fn of_sky(sky: SkyMap) -> Self {
        Self {
            sky,
            cameras: Vec::new(),
        }
    }
}

/// Reads a bundle's sky.
pub(crate) fn decode(bytes: &[u8], world_from_sky: DMat3) -> Result<SkyBundle, DecodeError> {
    let archive = Archive::parse(bytes)?;
    let most = decoded_bytes_max(bytes.len());
    let content = |name: &str| archive.checked(&format!("{name}.npy"), most);
    check_texts(&content("face_axes")?, "face_axes", &FACE_AXES)?;
    check_texts(&content("uv_convention")?, "uv_convention", &[UV])?;
    let version = content("format_version")?;
    let version = NpyArray::parse(&version, "format_version")?.numbers();
    if version != [VERSION] {
        return Err(DecodeError::Unsupported(format!(
            "'format_version' is {version:?}; {VERSION} is read"
        )));
    }
    let cube = content("sky_cubemap")?;
    let cube = NpyArray::parse(&cube, "sky_cubemap")?;
    let &[6, side, columns, 3] = cube.shape() else {
        return Err(wrong_shape("sky_cubemap", &cube, "[6, S, S, 3]"));
    };
    if side != columns {
        return Err(wrong_shape("sky_cubemap", &cube, "[6, S, S, 3]"));
    }
    let numbers: Vec<f32> = cube.numbers().iter().map(|value| *value as f32).collect();
    // Their y goes down where OpenGL's goes up, in the same faces.
    let world_from_cube = world_from_sky * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0));
    let sky = SkyMap::new(side, numbers.as_chunks::<3>().0, world_from_cube)
        .map_err(|reason| DecodeError::Malformed(format!("'sky_cubemap': {reason}")))?;
    let cameras = match archive.has("affine_matrix.npy") {
        true => affines(&content("affine_matrix")?, &content("affine_sensor_ids")?)?,
        false => Vec::new(),
    };
    Ok(SkyBundle {
        sky: sky.with_clamped_edges(),
        cameras,
    })
}

fn affines(matrices: &[u8], names: &[u8]) -> Result<Vec<(String, Photometry)>, DecodeError> {
    let matrices = NpyArray::parse(matrices, "affine_matrix")?;
    let names = NpyArray::parse(names, "affine_sensor_ids")?.texts();
    if *matrices.shape() != [names.len(), 3, 4] {
        let expected = format!("[{}, 3, 4], one for each of its sensors", names.len());
        return Err(wrong_shape("affine_matrix", &matrices, &expected));
    }
    let numbers = matrices.numbers();
    let calibration = |(name, numbers): (String, &[f64])| {
        let (rows, _) = numbers.as_chunks::<4>();
        let matrix = std::array::from_fn(|row| rows[row]);
        let photometry = Photometry {
            matrix,
            ..Photometry::IDENTITY
        };
        photometry.check().map_err(|reason| {
            DecodeError::Malformed(format!("the affine of '{name}': {reason}"))
        })?;
        Ok((name, photometry))
    };
    let pairs = names.into_iter().zip(numbers.chunks_exact(12));
    pairs.map(calibration).collect()
}

fn check_texts(bytes: &[u8], name: &str, expected: &[&str]) -> Result<(), DecodeError> {
    let found = NpyArray::parse(bytes, name)?.texts();
    if found == expected {
        return Ok(());
    }
    Err(DecodeError::Unsupported(format!(
        "'{name}' is {found:?}; {expected:?} is read"
    )))
}

fn wrong_shape(name: &str, array: &NpyArray<'_>, expected: &str) -> DecodeError {
    DecodeError::Malformed(format!(
        "'{name}' has the shape {:?}, expected {expected}",
        array.shape()
    ))
}
