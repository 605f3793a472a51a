//! Poses from matrices of files.

use decouplegs_scene::Pose;
use glam::{DMat3, DQuat, DVec3};

/// Largest difference from a rotation that the rounding of a file explains.
const ROTATION_ERROR_MAX: f64 = 1e-3;

/// The pose of `rotation` and `translation`; `None` where these are no rotation, or not finite.
pub(crate) fn rigid_pose(rotation: DMat3, translation: DVec3) -> Option<Pose> {
    let error = (rotation * rotation.transpose() - DMat3::IDENTITY).to_cols_array();
    let is_pose = error.iter().all(|value| value.abs() <= ROTATION_ERROR_MAX)
        && rotation.determinant() > 0.0
        && translation.is_finite();
    is_pose.then(|| Pose::new(DQuat::from_mat3(&rotation).normalize(), translation))
}

/// The pose in the rows of a matrix whose last column is the translation.
pub(crate) fn pose_of_rows(rows: &[[f64; 4]; 4]) -> Option<Pose> {
    let [x, y, z, _] = rows.map(|[a, b, c, _]| DVec3::new(a, b, c));
    let translation = DVec3::new(rows[0][3], rows[1][3], rows[2][3]);
    rigid_pose(DMat3::from_cols(x, y, z).transpose(), translation)
}
