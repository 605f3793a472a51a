//! Cameras of a dataset: INRIA `cameras.json` and nerfstudio `transforms.json`.
//!
//! Both become cameras in the coordinates of the file, with OpenCV axes (x right, y down, z forward). Names are
//! made fit for file names and unique, so that each camera can name its picture.

mod inria;
mod names;
mod nerfstudio;

use std::path::Path;

use decouplegs_scene::{Camera, Pose};
use glam::{DMat3, DQuat, DVec3};

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

/// Reads the cameras of `path`; an array is INRIA's form, an object nerfstudio's.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Cameras`].
pub fn read_cameras(path: &Path) -> Result<Vec<Camera>, AssetError> {
    decode(&read_bytes(path)?).map_err(|source| AssetError::Cameras { path: path.to_owned(), source })
}

/// Reads cameras from the bytes of a file.
///
/// # Errors
/// A [`DecodeError`] that names the line or the camera at fault.
pub fn decode(bytes: &[u8]) -> Result<Vec<Camera>, DecodeError> {
    let cameras = match bytes.iter().find(|byte| !byte.is_ascii_whitespace()) {
        Some(b'[') => inria::decode(bytes)?,
        Some(b'{') => nerfstudio::decode(bytes)?,
        _ => {
            return Err(DecodeError::Malformed(
                "expected JSON: an array (INRIA cameras.json) or an object (nerfstudio transforms.json)".into(),
            ));
        }
    };
    if cameras.is_empty() {
        return Err(DecodeError::Malformed("the file lists no camera".into()));
    }
    for camera in &cameras {
        camera.intrinsics.check().map_err(|reason| DecodeError::Malformed(format!("camera '{}': {reason}", camera.name)))?;
    }
    Ok(names::made_unique(cameras))
}

/// JSON that is not what it should be, with its line.
fn json_error(error: &serde_json::Error) -> DecodeError {
    DecodeError::Malformed(format!("not a camera file: {error}"))
}

/// Largest departure of a rotation matrix from orthonormality that is taken for rounding.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// A camera's place from its axes, the columns of world from camera, and its centre.
fn pose_of(axes: DMat3, centre: DVec3, name: &str) -> Result<Pose, DecodeError> {
    let gram = axes.transpose() * axes;
    if !centre.is_finite() || !gram.abs_diff_eq(DMat3::IDENTITY, ORTHONORMAL_TOLERANCE) || axes.determinant() < 0.0 {
        return Err(DecodeError::Malformed(format!(
            "camera '{name}': its pose is no rigid motion (rotation rows must be orthonormal and right-handed, without scale)"
        )));
    }
    Ok(Pose::new(DQuat::from_mat3(&axes), centre))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_camera_file_is_said() {
        for (text, part) in
            [("", "expected JSON"), ("ply", "expected JSON"), ("[]", "no camera"), ("[1]", "line 1"), ("{}", "frames")]
        {
            let error = decode(text.as_bytes()).unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
        let deep = "[".repeat(100_000);
        assert!(decode(deep.as_bytes()).is_err());
    }
}
