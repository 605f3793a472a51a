//! Projection of a Gaussian through a lens, in f64: the unscented transform (Wu et al., 3DGUT,
//! 2025).
//!
//! Seven points stand for the Gaussian: its mean, and its mean plus and minus each column of a
//! factor of its covariance times `SIGMA_SPREAD`. The factor is the triangular one in the camera's
//! axes: it follows from the covariance alone, whichever factor a splat is stored by, and one
//! column is depth. The lens takes each to the image, and the footprint is the Gaussian with their
//! weighted mean and covariance (alpha 1, beta 2 and kappa 0: the middle one has no weight in the
//! mean and twice a whole one in the covariance).

use decouplegs_scene::RayMap;
use glam::{DMat3, DVec2, DVec3};

/// Distance of the sigma points from the mean, in standard deviations: the square root of three
/// dimensions.
pub const SIGMA_SPREAD: f64 = 1.732_050_807_568_877_2;

/// A Gaussian in the image, before it is dilated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Mean, pixels.
    pub mean_px: DVec2,
    /// Variance along x, square pixels.
    pub xx: f64,
    /// Covariance of x and y.
    pub xy: f64,
    /// Variance along y.
    pub yy: f64,
    /// The determinant of the covariance, from a sum of squares: no difference of nearly equal
    /// numbers.
    pub det: f64,
}

/// The lower triangular factor of `axes` times its transpose, found by turning columns into each
/// other: nothing is squared, so thin splats keep their digits.
#[must_use]
pub fn triangular(axes: &DMat3) -> DMat3 {
    let mut columns = [axes.x_axis, axes.y_axis, axes.z_axis];
    for (row, first, second) in [(0, 0, 1), (0, 0, 2), (1, 1, 2)] {
        let (a, b) = (columns[first], columns[second]);
        let length = a[row].hypot(b[row]);
        if length > 0.0 {
            let (c, s) = (a[row] / length, b[row] / length);
            columns[first] = c * a + s * b;
            columns[second] = c * b - s * a;
        }
    }
    DMat3::from_cols(columns[0], columns[1], columns[2])
}

/// The image of the Gaussian with mean `t` and covariance `axes` times its transpose, both in
/// camera axes. `None` where the lens shows none of the seven points.
#[must_use]
pub fn unscented(lens: &RayMap, t: DVec3, axes: &DMat3) -> Option<Spread> {
    let axes = triangular(axes);
    let offsets = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis * SIGMA_SPREAD);
    let around = offsets
        .into_iter()
        .flat_map(|offset| [t + offset, t - offset]);
    if !lens.shows(t) && !around.clone().any(|point| lens.shows(point)) {
        return None;
    }
    let middle = lens.project_extended(t);
    let mut rows = [DVec2::ZERO; 7];
    for (row, point) in rows[1..].iter_mut().zip(around) {
        *row = lens.project_extended(point) - middle;
    }
    let shift = rows[1..].iter().sum::<DVec2>() / 6.0;
    rows[0] = -shift * 2f64.sqrt();
    for row in &mut rows[1..] {
        *row = (*row - shift) / 6f64.sqrt();
    }
    let gram = |f: fn(&DVec2) -> f64| rows.iter().map(f).sum::<f64>();
    // Lagrange's identity: the Gram determinant of two vectors is the sum of the squares of all
    // their minors.
    let minors = (0..7).flat_map(|i| (0..i).map(move |j| (i, j)));
    Some(Spread {
        mean_px: middle + shift,
        xx: gram(|row| row.x * row.x),
        xy: gram(|row| row.x * row.y),
        yy: gram(|row| row.y * row.y),
        det: minors.map(|(i, j)| rows[i].perp_dot(rows[j]).powi(2)).sum(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    #[test]
    fn the_triangular_factor_is_that_of_the_covariance_alone() {
        let turn = DMat3::from_quat(DQuat::from_xyzw(0.3, -0.5, 0.7, 0.2).normalize());
        let axes = turn * DMat3::from_diagonal(DVec3::new(0.3, 0.02, 1e-5));
        let factor = triangular(&axes);
        assert!((factor * factor.transpose()).abs_diff_eq(axes * axes.transpose(), 1e-15));
        assert!(
            factor
                .y_axis
                .x
                .abs()
                .max(factor.z_axis.x.abs())
                .max(factor.z_axis.y.abs())
                < 1e-16
        );
        let other =
            axes * DMat3::from_quat(DQuat::from_rotation_y(1.1) * DQuat::from_rotation_x(-0.4));
        let magnitudes = |m: DMat3| m.to_cols_array().map(f64::abs);
        for (a, b) in magnitudes(factor)
            .into_iter()
            .zip(magnitudes(triangular(&other)))
        {
            assert!((a - b).abs() < 1e-11, "{a} and {b}");
        }
    }
}
