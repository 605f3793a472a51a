//! Cameras of a dataset: INRIA `cameras.json`, nerfstudio and NeRF-synthetic `transforms.json`,
//! COLMAP models.
//!
//! All become cameras in the coordinates of the file, with OpenCV axes (x right, y down, z
//! forward). Names are made fit for file names and unique, so that each camera can name its image.

mod colmap;
mod dataparser;
mod inria;
mod names;
mod nerfstudio;
mod transforms;

pub use names::file_safe;
pub use transforms::transforms;

use std::path::Path;

use decouplegs_scene::{Camera, Pose};
use glam::{DMat3, DQuat, DVec3};

use crate::error::read_bytes;
use crate::xml::excerpt;
use crate::{AssetError, DecodeError};

/// Positions farther from the origin are no cameras', meters.
const POSITION_MAX_M: f64 = 1e9;

/// Facts about cameras that stand beside their file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraOptions<'a> {
    /// Width and height of the images, pixels, where the file does not say (NeRF-synthetic). None:
    /// those of the first image beside it.
    pub size_px: Option<[u32; 2]>,
    /// nerfstudio's `dataparser_transforms.json`: cameras become those of the trained scene, as
    /// `ns-export` writes it.
    pub dataparser: Option<&'a Path>,
}

/// Reads the cameras of `path`: a file, where an array is INRIA's form and an object nerfstudio's,
/// or a folder with a COLMAP model.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Cameras`].
pub fn read_cameras(path: &Path, options: &CameraOptions<'_>) -> Result<Vec<Camera>, AssetError> {
    let cameras_error = |source| AssetError::Cameras {
        path: path.to_owned(),
        source,
    };
    if path.is_dir() {
        if options.dataparser.is_some() {
            let reason = "a dataparser_transforms.json belongs to the transforms.json that it was made from, and this is a folder";
            return Err(cameras_error(DecodeError::Malformed(reason.into())));
        }
        return checked(colmap::read_folder(path)?).map_err(cameras_error);
    }
    let bytes = read_bytes(path)?;
    let beside = || nerfstudio::size_of_first_image(&bytes, path.parent().unwrap_or(Path::new("")));
    let mut cameras = decode(&bytes, options.size_px.or_else(beside)).map_err(cameras_error)?;
    if let Some(path) = options.dataparser {
        let applied = nerfstudio::applied(&bytes).map_err(cameras_error)?;
        let dataparser = dataparser::Dataparser::decode(&read_bytes(path)?, &applied);
        let dataparser = dataparser.map_err(|source| AssetError::Cameras {
            path: path.to_owned(),
            source,
        })?;
        cameras
            .iter_mut()
            .for_each(|camera| dataparser.apply(camera));
    }
    Ok(cameras)
}

/// Reads cameras from the bytes of a file. `size_px` is the size of images for which the file has
/// none.
///
/// # Errors
/// A [`DecodeError`] that names the line or the camera at fault.
pub fn decode(bytes: &[u8], size_px: Option<[u32; 2]>) -> Result<Vec<Camera>, DecodeError> {
    // A mark of the encoding, as some editors write it.
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let cameras = match bytes.iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'[') => inria::decode(bytes)?,
        Some(b'{') => match inria::decode_wrapped(bytes) {
            Some(cameras) => cameras?,
            None => nerfstudio::decode(bytes, size_px)?,
        },
        _ => {
            return Err(DecodeError::Malformed(
                "expected JSON: an array (INRIA cameras.json) or an object (nerfstudio transforms.json)".into(),
            ));
        }
    };
    checked(cameras)
}

/// Reads a COLMAP model from the bytes of its `cameras` and `images` files.
///
/// # Errors
/// A [`DecodeError`] that names the line, image or camera at fault.
pub fn decode_colmap(
    cameras: &[u8],
    images: &[u8],
    is_binary: bool,
) -> Result<Vec<Camera>, DecodeError> {
    checked(colmap::decode(cameras, images, is_binary)?)
}

/// Cameras that make images, with names that files can have.
fn checked(cameras: Vec<Camera>) -> Result<Vec<Camera>, DecodeError> {
    if cameras.is_empty() {
        return Err(DecodeError::Malformed("the file lists no camera".into()));
    }
    for camera in &cameras {
        let of_camera = |reason: String| {
            DecodeError::Malformed(format!("camera '{}': {reason}", excerpt(&camera.name)))
        };
        camera
            .intrinsics
            .check()
            .map_err(|reason| of_camera(reason.to_string()))?;
        let position_m = camera.world_from_camera.translation;
        if position_m.abs().max_element() > POSITION_MAX_M {
            return Err(of_camera(format!(
                "it stands at {position_m} m, which is no place on Earth"
            )));
        }
    }
    Ok(names::made_unique(cameras))
}

/// JSON that is not what it should be, with its line.
fn json_error(error: &serde_json::Error) -> DecodeError {
    DecodeError::Malformed(format!("not a camera file: {error}"))
}

/// Largest departure of a rotation matrix from orthonormality that is taken for rounding.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// A camera's position from its axes, the columns of world from camera, and its center.
fn pose_of(axes: DMat3, center: DVec3, name: &str) -> Result<Pose, DecodeError> {
    let gram = axes.transpose() * axes;
    if !center.is_finite()
        || !gram.abs_diff_eq(DMat3::IDENTITY, ORTHONORMAL_TOLERANCE)
        || axes.determinant() < 0.0
    {
        return Err(DecodeError::Malformed(format!(
            "camera '{name}': its pose is no rigid motion (rotation rows must be orthonormal and right-handed, without scale)"
        )));
    }
    Ok(Pose::new(DQuat::from_mat3(&axes), center))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_file_is_said() {
        for (text, part) in [
            ("", "expected JSON"),
            ("ply", "expected JSON"),
            ("[]", "no camera"),
            ("[1]", "line 1"),
            ("{}", "frames"),
        ] {
            let error = decode(text.as_bytes(), None).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
        let deep = "[".repeat(100_000);
        assert!(decode(deep.as_bytes(), None).is_err());
    }
}
