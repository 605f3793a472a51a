//! Symmetric 3 by 3 matrices: as six numbers, and by their own axes.

use glam::{DMat3, DQuat, DVec3};

/// A symmetric matrix by its own axes: eigenvalues and the rotation whose columns are the
/// eigenvectors.
#[derive(Clone, Copy, Debug)]
pub struct OwnAxes {
    /// Eigenvalues, in no order.
    pub values: DVec3,
    /// Unit eigenvectors, one per column.
    pub axes: DMat3,
}

impl OwnAxes {
    /// Computes the eigenvalues and eigenvectors of a matrix by Jacobi rotations: exact to the last
    /// digits of the largest value, for any finite input.
    #[must_use]
    pub fn from_matrix(matrix: &DMat3) -> Self {
        let (mut m, mut axes) = (*matrix, DMat3::IDENTITY);
        for _sweep in 0..30 {
            let off = m.y_axis.x.abs() + m.z_axis.x.abs() + m.z_axis.y.abs();
            let scale = m.x_axis.x.abs() + m.y_axis.y.abs() + m.z_axis.z.abs();
            if off <= 1e-16 * scale || off == 0.0 {
                break;
            }
            for (i, j) in [(0, 1), (0, 2), (1, 2)] {
                let turn = rotation_that_clears(&m, i, j);
                m = turn.transpose() * m * turn;
                axes *= turn;
            }
        }
        Self {
            values: DVec3::new(m.x_axis.x, m.y_axis.y, m.z_axis.z),
            axes,
        }
    }

    /// The matrix.
    #[must_use]
    pub fn matrix(&self) -> DMat3 {
        self.axes * DMat3::from_diagonal(self.values) * self.axes.transpose()
    }

    /// The rotation as a unit quaternion w, x, y, z; a mirrored axis is turned round, which no
    /// covariance sees.
    #[must_use]
    pub fn rotation_wxyz(&self) -> [f32; 4] {
        let mut axes = self.axes;
        if axes.determinant() < 0.0 {
            axes.z_axis = -axes.z_axis;
        }
        let q = DQuat::from_mat3(&axes).normalize();
        [q.w, q.x, q.y, q.z].map(|x| x as f32)
    }
}

/// The rotation in the plane of axes i < j after which `m` has nothing at (i, j).
fn rotation_that_clears(m: &DMat3, i: usize, j: usize) -> DMat3 {
    let (ii, jj, ij) = (m.col(i)[i], m.col(j)[j], m.col(j)[i]);
    if ij == 0.0 {
        return DMat3::IDENTITY;
    }
    let half = (jj - ii) / (2.0 * ij);
    let tangent = if half.is_finite() {
        half.signum() / (half.abs() + (1.0 + half * half).sqrt())
    } else {
        0.0
    };
    let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
    let mut turn = DMat3::IDENTITY;
    turn.col_mut(i)[i] = cosine;
    turn.col_mut(j)[j] = cosine;
    turn.col_mut(j)[i] = cosine * tangent;
    turn.col_mut(i)[j] = -cosine * tangent;
    turn
}

/// The six numbers whose L2 distance is the Frobenius distance of the matrices: off-diagonals by
/// sqrt 2.
#[must_use]
pub fn to_six(m: &DMat3) -> [f64; 6] {
    let root = std::f64::consts::SQRT_2;
    [
        m.x_axis.x,
        m.y_axis.y,
        m.z_axis.z,
        root * m.y_axis.x,
        root * m.z_axis.x,
        root * m.z_axis.y,
    ]
}

/// Back from [`to_six`].
#[must_use]
pub fn from_six(six: &[f64; 6]) -> DMat3 {
    let [xx, yy, zz, xy, xz, yz] = *six;
    let [xy, xz, yz] = [xy, xz, yz].map(|value| value * std::f64::consts::FRAC_1_SQRT_2);
    DMat3::from_cols(
        DVec3::new(xx, xy, xz),
        DVec3::new(xy, yy, yz),
        DVec3::new(xz, yz, zz),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn own_axes_give_the_matrix_back(six in prop::array::uniform6(-5.0f64..5.0), exponent in -60i32..60) {
            let matrix = from_six(&six.map(|x| x * f64::from(exponent).exp2()));
            let own = OwnAxes::from_matrix(&matrix);
            let size = to_six(&matrix).iter().map(|x| x.abs()).fold(0.0, f64::max);
            for (a, b) in to_six(&own.matrix()).iter().zip(to_six(&matrix)) {
                prop_assert!((a - b).abs() <= 1e-13 * size, "{own:?} of {matrix:?}");
            }
            let product = own.axes.transpose() * own.axes;
            prop_assert!((product - DMat3::IDENTITY).to_cols_array().iter().all(|x| x.abs() < 1e-13));
            prop_assert!(own.rotation_wxyz().iter().all(|x| x.is_finite()));
        }
    }

    #[test]
    fn six_numbers_keep_the_distance() {
        let (a, b) = (
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
            [0.5, 0.0, -1.0, 2.0, 2.5, 1.0],
        );
        let frobenius = (from_six(&a) - from_six(&b))
            .to_cols_array()
            .iter()
            .map(|x| x * x)
            .sum::<f64>();
        let six: f64 = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum();
        assert!((frobenius - six).abs() < 1e-12);
        assert_eq!(OwnAxes::from_matrix(&DMat3::ZERO).values, DVec3::ZERO);
    }
}
