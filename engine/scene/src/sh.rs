//! Real spherical harmonics to degree 3, with the basis signs of the original 3DGS (Kerbl et al.,
//! 2023).
//!
//! Coefficient 0 is the direct (DC) term. Band `l` holds `2l + 1` coefficients. A splat's color is
//! `max(0, 0.5 + sum_k c_k Y_k(d))` with `d` the unit vector from the camera center to the splat's
//! mean.

use std::sync::LazyLock;

use glam::{DQuat, DVec3};

/// Highest degree stored or evaluated.
pub const DEGREE_MAX: u8 = 3;

/// Y of the DC term, 1 / (2 sqrt(pi)).
pub const Y0: f64 = 0.282_094_791_773_878_14;

/// Difference between a plain expansion and the DC term of a splat's color, as colors are 0.5 + Y0
/// dc + ...: a plain expansion has dc + 0.5 / Y0.
pub const DC_SHIFT: f64 = 0.5 / Y0;

/// Coefficients up to and including `degree`, DC included.
#[must_use]
pub const fn coefficient_count(degree: u8) -> usize {
    (degree as usize + 1) * (degree as usize + 1)
}

/// The 16 basis values at the unit vector `d`.
#[must_use]
pub fn basis(d: DVec3) -> [f64; 16] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        Y0,
        -0.488_602_511_902_919_9 * y,
        0.488_602_511_902_919_9 * z,
        -0.488_602_511_902_919_9 * x,
        1.092_548_430_592_079_2 * x * y,
        -1.092_548_430_592_079_2 * y * z,
        0.315_391_565_252_520_05 * (2.0 * zz - xx - yy),
        -1.092_548_430_592_079_2 * x * z,
        0.546_274_215_296_039_6 * (xx - yy),
        -0.590_043_589_926_643_5 * y * (3.0 * xx - yy),
        2.890_611_442_640_554 * x * y * z,
        -0.457_045_799_464_465_8 * y * (4.0 * zz - xx - yy),
        0.373_176_332_590_115_4 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.457_045_799_464_465_8 * x * (4.0 * zz - xx - yy),
        1.445_305_721_320_277 * z * (xx - yy),
        -0.590_043_589_926_643_5 * x * (xx - 3.0 * yy),
    ]
}

/// Turns coefficients with the object they belong to.
///
/// After `c' = rotate(c)`, `sum c'_k Y_k(R d) = sum c_k Y_k(d)` for every `d`. Bands do not mix, so
/// this is one small matrix a band: the basis at fixed directions that were turned, times its
/// pseudo-inverse at these directions.
#[derive(Clone, Debug)]
pub struct ShRotation {
    /// Row-major square matrices of bands 1, 2 and 3 in the upper left `2l + 1` of each.
    bands: [[[f64; 7]; 7]; 3],
}

impl ShRotation {
    /// The rotation of coefficients that goes with `rotation` of the object.
    #[must_use]
    pub fn new(rotation: DQuat) -> Self {
        let mut bands = [[[0.0; 7]; 7]; 3];
        let samples = &*ROTATION_SAMPLES;
        for (sample, d) in samples.directions.iter().enumerate() {
            let turned = basis(rotation * *d);
            for (index, matrix) in bands.iter_mut().enumerate() {
                let (count, first) = (2 * index + 3, (index + 1) * (index + 1));
                for (row, values) in matrix.iter_mut().enumerate().take(count) {
                    for (value, inverse) in values[..count]
                        .iter_mut()
                        .zip(&samples.inverses[index][sample])
                    {
                        *value += turned[first + row] * inverse;
                    }
                }
            }
        }
        Self { bands }
    }

    /// Turns `rest`, the coefficients after DC as `[coefficient][rgb]`, in place. Its length tells
    /// the degree.
    pub fn rotate(&self, rest: &mut [[f32; 3]]) {
        let mut first = 0;
        for (index, matrix) in self.bands.iter().enumerate() {
            let count = 2 * index + 3;
            if first + count > rest.len() {
                break;
            }
            let band = &mut rest[first..first + count];
            let mut turned = [[0.0f64; 3]; 7];
            for (row, out) in turned.iter_mut().enumerate().take(count) {
                for (column, coefficient) in band.iter().enumerate() {
                    for channel in 0..3 {
                        out[channel] += matrix[row][column] * f64::from(coefficient[channel]);
                    }
                }
            }
            for (coefficient, out) in band.iter_mut().zip(turned) {
                *coefficient = out.map(|value| value as f32);
            }
            first += count;
        }
    }
}

/// Directions at which the basis is evaluated to find a rotation of its coefficients.
const SAMPLES: usize = 24;

/// Data that is independent of the rotation: the directions, and per band the pseudo-inverse of the
/// basis there.
struct RotationSamples {
    directions: [DVec3; SAMPLES],
    /// `[band - 1][sample][column]`.
    inverses: [[[f64; 7]; SAMPLES]; 3],
}

static ROTATION_SAMPLES: LazyLock<RotationSamples> = LazyLock::new(|| {
    let directions = std::array::from_fn(|sample| {
        let z = 1.0 - (2.0 * sample as f64 + 1.0) / SAMPLES as f64;
        let azimuth = sample as f64 * 2.399_963_229_728_653;
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z)
    });
    RotationSamples {
        directions,
        inverses: std::array::from_fn(|index| inverse_basis(index + 1, &directions)),
    }
});

/// (A^T A)^-1 A^T by columns, A the basis of band `l` at `directions`. Well conditioned: A^T A is
/// near a multiple of I.
fn inverse_basis(l: usize, directions: &[DVec3; SAMPLES]) -> [[f64; 7]; SAMPLES] {
    let (count, first) = (2 * l + 1, l * l);
    let mut normal = [[0.0f64; 7]; 7];
    let mut identity = [[0.0f64; 7]; 7];
    for row in 0..count {
        identity[row][row] = 1.0;
        for d in directions {
            let y = basis(*d);
            for column in 0..count {
                normal[row][column] += y[first + row] * y[first + column];
            }
        }
    }
    let inverse = solve(normal, identity, count);
    directions.map(|d| {
        let y = basis(d);
        std::array::from_fn(|row| {
            (0..count)
                .map(|column| inverse[row][column] * y[first + column])
                .sum()
        })
    })
}

/// Gaussian elimination with partial pivoting on the upper left `count` rows.
fn solve(mut a: [[f64; 7]; 7], mut b: [[f64; 7]; 7], count: usize) -> [[f64; 7]; 7] {
    for pivot in 0..count {
        let best = (pivot..count)
            .max_by(|&i, &j| a[i][pivot].abs().total_cmp(&a[j][pivot].abs()))
            .unwrap_or(pivot);
        a.swap(pivot, best);
        b.swap(pivot, best);
        for row in 0..count {
            if row != pivot {
                let factor = a[row][pivot] / a[pivot][pivot];
                for column in 0..count {
                    a[row][column] -= factor * a[pivot][column];
                    b[row][column] -= factor * b[pivot][column];
                }
            }
        }
    }
    for (row, values) in b.iter_mut().enumerate().take(count) {
        for value in &mut values[..count] {
            *value /= a[row][row];
        }
    }
    b
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directions() -> impl Iterator<Item = DVec3> {
        (0..50).map(|i| {
            let (a, b) = (f64::from(i) * 0.7, f64::from(i) * 1.3);
            DVec3::new(a.cos() * b.sin(), a.sin() * b.sin(), b.cos())
        })
    }

    #[test]
    fn the_basis_is_orthonormal() {
        // Midpoint rule over the sphere.
        let mut gram = [[0.0f64; 16]; 16];
        let (rows, columns) = (400, 200);
        for i in 0..rows {
            let z = -1.0 + 2.0 * (f64::from(i) + 0.5) / f64::from(rows);
            for j in 0..columns {
                let azimuth = std::f64::consts::TAU * f64::from(j) / f64::from(columns);
                let radius = (1.0 - z * z).sqrt();
                let y = basis(DVec3::new(
                    radius * azimuth.cos(),
                    radius * azimuth.sin(),
                    z,
                ));
                for k in 0..16 {
                    for m in 0..16 {
                        gram[k][m] +=
                            y[k] * y[m] * 4.0 * std::f64::consts::PI / f64::from(rows * columns);
                    }
                }
            }
        }
        for (k, row) in gram.iter().enumerate() {
            for (m, value) in row.iter().enumerate() {
                assert!(
                    (value - f64::from(u8::from(k == m))).abs() < 1e-4,
                    "gram[{k}][{m}] = {value}"
                );
            }
        }
    }

    #[test]
    fn rotated_coefficients_give_the_same_color_in_the_rotated_direction() {
        let rotation = DQuat::from_euler(glam::EulerRot::ZYX, 0.7, -1.1, 2.3);
        let rest: Vec<[f32; 3]> = (0..15)
            .map(|k| [0.1 * k as f32 - 0.6, (k as f32).sin(), 0.3])
            .collect();
        let mut turned = rest.clone();
        ShRotation::new(rotation).rotate(&mut turned);
        for d in directions() {
            let value = |rest: &[[f32; 3]], d| -> f64 {
                rest.iter()
                    .zip(&basis(d)[1..])
                    .map(|(c, y)| f64::from(c[1]) * y)
                    .sum()
            };
            assert!((value(&rest, d) - value(&turned, rotation * d)).abs() < 1e-6);
        }
        // It must be seen to do something: the unturned coefficients differ.
        let differs = directions().any(|d| {
            let y = basis(rotation * d);
            let plain: f64 = rest
                .iter()
                .zip(&y[1..])
                .map(|(c, y)| f64::from(c[1]) * y)
                .sum();
            let original: f64 = rest
                .iter()
                .zip(&basis(d)[1..])
                .map(|(c, y)| f64::from(c[1]) * y)
                .sum();
            (plain - original).abs() > 0.1
        });
        assert!(differs);
    }
}
