//! nerfstudio's `dataparser_transforms.json`: from the coordinates of a dataset to those that a
//! scene was trained in.

use decouplegs_scene::Camera;
use glam::{DMat3, DVec3};
use serde::Deserialize;

use super::{json_error, pose_of};
use crate::DecodeError;

/// A motion of the dataset that was made before its cameras were written.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Applied {
    pub(super) axes: DMat3,
    pub(super) offset: DVec3,
    pub(super) scale: f64,
}

impl Applied {
    pub(super) const NONE: Self = Self {
        axes: DMat3::IDENTITY,
        offset: DVec3::ZERO,
        scale: 1.0,
    };
}

#[derive(Deserialize)]
struct File {
    transform: Vec<[f64; 4]>,
    scale: f64,
}

/// A rigid motion and a scale: `x' = scale (axes x + offset)`.
pub(super) struct Dataparser {
    axes: DMat3,
    offset: DVec3,
    scale: f64,
}

impl Dataparser {
    /// Reads the file, for cameras to which `applied` was done before.
    pub(super) fn decode(bytes: &[u8], applied: &Applied) -> Result<Self, DecodeError> {
        let file: File = serde_json::from_slice(bytes).map_err(|error| json_error(&error))?;
        let [x, y, z, ..] = file.transform.as_slice() else {
            return Err(DecodeError::Malformed(format!(
                "'transform' has {} rows, expected 3",
                file.transform.len()
            )));
        };
        let column = |axis: usize| DVec3::new(x[axis], y[axis], z[axis]);
        let axes = DMat3::from_cols(column(0), column(1), column(2));
        // The file's transform is of the original coordinates: what was applied before is taken
        // off.
        let axes = axes * applied.axes.inverse();
        let offset = column(3) - axes * applied.offset;
        let scale = file.scale / applied.scale;
        pose_of(axes, offset, "the transform")?;
        if !(scale.is_finite() && scale > 0.0) {
            return Err(DecodeError::Malformed(format!(
                "'scale' is {}, expected a number above 0",
                file.scale
            )));
        }
        Ok(Self {
            axes,
            offset,
            scale,
        })
    }

    pub(super) fn apply(&self, camera: &mut Camera) {
        let pose = &mut camera.world_from_camera;
        pose.rotation = (glam::DQuat::from_mat3(&self.axes) * pose.rotation).normalize();
        pose.translation = self.scale * (self.axes * pose.translation + self.offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::{Intrinsics, Motion, Pose};

    #[test]
    fn cameras_follow_the_scene() {
        let text = br#"{"transform": [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3]], "scale": 0.5}"#;
        let mut camera = Camera {
            name: "a".into(),
            intrinsics: Intrinsics::from_horizontal_fov(4, 4, 1.0),
            world_from_camera: Pose {
                translation: DVec3::new(10.0, 0.0, 0.0),
                ..Pose::IDENTITY
            },
            motion: Motion::REST,
        };
        Dataparser::decode(text, &Applied::NONE)
            .unwrap()
            .apply(&mut camera);
        assert!(
            (camera.world_from_camera.translation - DVec3::new(0.5, 6.0, 1.5)).length() < 1e-12
        );
        assert!((camera.world_from_camera.rotation * DVec3::X - DVec3::Y).length() < 1e-12);
        // The same point, given in coordinates that were turned and scaled before.
        let applied = Applied {
            axes: DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y),
            offset: DVec3::Z,
            scale: 1.0,
        };
        camera.world_from_camera = Pose {
            translation: applied.axes * DVec3::new(10.0, 0.0, 0.0) + applied.offset,
            ..Pose::IDENTITY
        };
        Dataparser::decode(text, &applied)
            .unwrap()
            .apply(&mut camera);
        assert!(
            (camera.world_from_camera.translation - DVec3::new(0.5, 6.0, 1.5)).length() < 1e-12
        );
        for (from, to) in [
            ("0.5", "0"),
            ("[0, -1, 0, 1]", "[0, -2, 0, 1]"),
            (", [0, 0, 1, 3]", ""),
        ] {
            let broken = std::str::from_utf8(text).unwrap().replacen(from, to, 1);
            assert!(
                Dataparser::decode(broken.as_bytes(), &Applied::NONE).is_err(),
                "{to}"
            );
        }
    }
}
