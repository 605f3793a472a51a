//! Poses as 4x4 matrices.

use decouplegs::scene::Pose;
use glam::{DMat3, DMat4, DQuat, DVec3};
use pyo3::prelude::*;

use crate::array::{matrix, shaped};
use crate::error::value_error;

/// Largest departure of a rotation from orthonormal: what is left of rounding to f32 in files and
/// after a few products.
const ORTHONORMAL_WITHIN: f64 = 1e-6;

/// The pose that a matrix `[[R, t], [0, 1]]` says.
pub fn pose_of(what: &str, value: &Bound<'_, PyAny>) -> PyResult<Pose> {
    let rows = matrix::<4, 4>(what, value)?;
    if rows[3] != [0.0, 0.0, 0.0, 1.0] {
        return Err(value_error(format!(
            "{what}: expected the last row [0, 0, 0, 1], found {:?}",
            rows[3]
        )));
    }
    let rotation = DMat3::from_cols_array_2d(
        &[0, 1, 2].map(|column| [0, 1, 2].map(|row: usize| rows[row][column])),
    );
    let off = (rotation.transpose() * rotation - DMat3::IDENTITY)
        .to_cols_array()
        .into_iter()
        .fold(0.0, |a: f64, b| a.max(b.abs()));
    if off > ORTHONORMAL_WITHIN {
        return Err(value_error(format!(
            "{what}: the upper left 3x3 is no rotation: its columns are orthonormal within {off:.1e}, expected {ORTHONORMAL_WITHIN:.0e}"
        )));
    }
    if rotation.determinant() < 0.0 {
        return Err(value_error(format!(
            "{what}: the upper left 3x3 mirrors (determinant -1), expected a rotation"
        )));
    }
    Ok(Pose::new(
        DQuat::from_mat3(&rotation),
        DVec3::new(rows[0][3], rows[1][3], rows[2][3]),
    ))
}

/// A pose as a matrix, float64 [4, 4].
pub fn to_matrix<'py>(py: Python<'py>, pose: &Pose) -> PyResult<Bound<'py, PyAny>> {
    let columns = DMat4::from_rotation_translation(pose.rotation, pose.translation);
    shaped(py, columns.transpose().to_cols_array().to_vec(), &[4, 4])
}
