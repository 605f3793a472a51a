//! Shapes of splats: covariances by their triangular factors.
//!
//! A covariance is never formed: of a needle 1 : 1e5 its squares would be 1e10 apart, more than an
//! f32 holds, while its factor is exact to the last digits.

use glam::{DMat3, DQuat, DVec3};

/// A shape by its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PrincipalAxes {
    /// Standard deviations along the axes.
    pub scales: [f32; 3],
    /// World from splat axes, a unit quaternion w, x, y, z.
    pub rotation: [f32; 4],
}

/// The lower triangle L by rows (xx, yx, yy, zx, zy, zz), diagonal not negative, with L L^T the
/// covariance of `axes`.
#[must_use]
pub fn triangular_factor(axes: &PrincipalAxes) -> [f64; 6] {
    let [w, x, y, z] = axes.rotation.map(f64::from);
    let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
    let scaled = rotation * DMat3::from_diagonal(DVec3::from_array(axes.scales.map(f64::from)));
    // L Q = R S: orthonormal rows q_i with row_i = sum over j <= i of l_ij q_j.
    let rows = scaled.transpose();
    let rows = [rows.x_axis, rows.y_axis, rows.z_axis];
    let mut q: [DVec3; 3] = [DVec3::ZERO; 3];
    let mut factor = [0.0; 6];
    for (i, &row) in rows.iter().enumerate() {
        let mut left = row;
        // Twice: what is left of a nearly parallel row has lost its digits the first time.
        for _ in 0..2 {
            for j in 0..i {
                let along = left.dot(q[j]);
                factor[i * (i + 1) / 2 + j] += along;
                left -= along * q[j];
            }
        }
        let length = left.length();
        let vanished = length <= 1e-14 * row.length();
        factor[i * (i + 1) / 2 + i] = if vanished { 0.0 } else { length };
        q[i] = if vanished {
            orthogonal_to(&q[..i])
        } else {
            left / length
        };
    }
    factor
}

/// A unit vector orthogonal to at most two orthonormal ones.
fn orthogonal_to(others: &[DVec3]) -> DVec3 {
    let candidates = [DVec3::X, DVec3::Y, DVec3::Z];
    let lefts = candidates.map(|axis| others.iter().fold(axis, |left, q| left - left.dot(*q) * *q));
    let best = lefts
        .into_iter()
        .max_by(|a, b| a.length().total_cmp(&b.length()))
        .unwrap_or(DVec3::X);
    best.normalize()
}

/// The axes of the covariance L L^T with `factor` = L by rows.
#[must_use]
pub fn principal_axes(factor: &[f32; 6]) -> PrincipalAxes {
    let [xx, yx, yy, zx, zy, zz] = factor.map(f64::from);
    principal_axes_of([
        DVec3::new(xx, yx, zx),
        DVec3::new(0.0, yy, zy),
        DVec3::new(0.0, 0.0, zz),
    ])
}

/// The axes of the covariance M M^T with `columns` those of M: one-sided Jacobi rotations
/// (Hestenes, Inversion of Matrices by Biorthogonalization, 1958), which keep the digits of the
/// smallest axis.
#[must_use]
pub fn principal_axes_of(mut columns: [DVec3; 3]) -> PrincipalAxes {
    // Rotating pairs of columns leaves M M^T as it is, and orthogonal columns are the scaled axes.
    for _sweep in 0..30 {
        let mut turned = false;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (columns[i], columns[j]);
            let product = a.dot(b);
            if product.abs() <= 1e-15 * a.length() * b.length() {
                continue;
            }
            turned = true;
            let half = (b.length_squared() - a.length_squared()) / (2.0 * product);
            let tangent = half.signum() / (half.abs() + (1.0 + half * half).sqrt());
            let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
            let sine = cosine * tangent;
            columns[i] = cosine * a - sine * b;
            columns[j] = sine * a + cosine * b;
        }
        if !turned {
            break;
        }
    }
    axes_of(columns)
}

fn axes_of(mut columns: [DVec3; 3]) -> PrincipalAxes {
    columns.sort_by(|a, b| b.length().total_cmp(&a.length()));
    let scales = columns.map(|column| column.length());
    let mut axes = [DVec3::ZERO; 3];
    for i in 0..3 {
        let known = scales[i] > 1e-300 && scales[i] > 1e-15 * scales[0];
        axes[i] = if known {
            columns[i] / scales[i]
        } else {
            orthogonal_to(&axes[..i])
        };
    }
    if axes[0].cross(axes[1]).dot(axes[2]) < 0.0 {
        axes[2] = -axes[2];
    }
    let q = DQuat::from_mat3(&DMat3::from_cols(axes[0], axes[1], axes[2])).normalize();
    PrincipalAxes {
        scales: scales.map(|scale| scale as f32),
        rotation: [q.w, q.x, q.y, q.z].map(|x| x as f32),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn covariance(factor: &[f64; 6]) -> DMat3 {
        let [xx, yx, yy, zx, zy, zz] = *factor;
        let lower = DMat3::from_cols(
            DVec3::new(xx, yx, zx),
            DVec3::new(0.0, yy, zy),
            DVec3::new(0.0, 0.0, zz),
        );
        lower * lower.transpose()
    }

    fn covariance_of(axes: &PrincipalAxes) -> DMat3 {
        let [w, x, y, z] = axes.rotation.map(f64::from);
        let scaled = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize())
            * DMat3::from_diagonal(DVec3::from_array(axes.scales.map(f64::from)));
        scaled * scaled.transpose()
    }

    fn assert_close(a: DMat3, b: DMat3, relative: f64) {
        let largest = a
            .to_cols_array()
            .iter()
            .fold(0.0f64, |largest, x| largest.max(x.abs()));
        for (x, y) in a.to_cols_array().iter().zip(b.to_cols_array()) {
            assert!((x - y).abs() <= relative * largest, "{a:?} against {b:?}");
        }
    }

    proptest! {
        #[test]
        fn a_factor_is_its_covariance_and_gives_the_axes_back(
            scales in prop::array::uniform3(-8.0f64..3.0), q in prop::array::uniform4(-1.0f32..1.0),
        ) {
            prop_assume!(q.iter().map(|x| x * x).sum::<f32>() > 0.01);
            let norm = q.iter().map(|x| x * x).sum::<f32>().sqrt();
            let axes = PrincipalAxes { scales: scales.map(|s| s.exp2() as f32), rotation: q.map(|x| x / norm) };
            let factor = triangular_factor(&axes);
            assert_close(covariance_of(&axes), covariance(&factor), 1e-12);
            assert_close(covariance_of(&axes), covariance_of(&principal_axes(&factor.map(|x| x as f32))), 1e-6);
        }
    }

    #[test]
    fn needles_and_discs_keep_their_thin_axis() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        for scales in [
            [1.0, 1e-5, 1e-5],
            [1.0, 1.0, 1e-5],
            [1.0, 0.5, 0.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
        ] {
            let axes = PrincipalAxes {
                scales,
                rotation: [half, 0.5, 0.5, 0.0],
            };
            let back = principal_axes(&triangular_factor(&axes).map(|x| x as f32));
            for (scale, expected) in back.scales.iter().zip(scales) {
                assert!(
                    (scale - expected).abs() <= 1e-6 * scales[0],
                    "{back:?} from {axes:?}"
                );
            }
            assert!(back.rotation.iter().all(|x| x.is_finite()));
        }
    }
}
