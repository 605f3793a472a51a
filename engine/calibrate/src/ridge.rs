//! The ridge fit of Theta to moments, in closed form.
//!
//! Unknown are, per channel, the 2K x 28 weights of x(L) = Theta (L, 1). With A = mean over lights
//! of (L, 1)(L, 1)' the normal equations are `B Theta A + ridge (Theta - prior) = R`: B and A are
//! diagonalized once, and each ridge costs two products.

use decouplegs_scene::{AmbientDescriptor, LightTransfer};
use nalgebra::DMatrix;

use super::moments::{LightMoments, Moments};
use super::standard::Standard;

/// Numbers of a descriptor and the constant behind them.
pub(super) const COLUMNS: usize = AmbientDescriptor::LEN + 1;

/// Share of all lights' weight that the neutral one has: it pins where assets look as they are.
const NEUTRAL_SHARE: f64 = 0.1;

/// Least ratio of the design's smallest singular value to its largest. Descriptors are f32, so what
/// linear dependence leaves is below 1e-6; eight outdoor and indoor probes gave 4e-3.
const RANK_TOLERANCE: f64 = 1e-5;

/// W_T and w_0 over W_B and b_0, 2K x 28 for each channel.
#[derive(Clone, Debug)]
pub(super) struct Theta(pub [DMatrix<f64>; 3]);

impl Theta {
    /// T(L) and b(L) of each channel.
    pub(super) fn at(&self, descriptor: &[f64; AmbientDescriptor::LEN]) -> [Vec<f64>; 3] {
        let value = |rows: &DMatrix<f64>, row: usize| {
            let linear: f64 = descriptor
                .iter()
                .enumerate()
                .map(|(column, l)| rows[(row, column)] * l)
                .sum();
            linear + rows[(row, AmbientDescriptor::LEN)]
        };
        std::array::from_fn(|channel| {
            (0..self.0[channel].nrows())
                .map(|row| value(&self.0[channel], row))
                .collect()
        })
    }

    /// Converts to the stored form.
    pub(super) fn to_transfer(&self, sh_degree: u8, neutral: AmbientDescriptor) -> LightTransfer {
        let coefficients = self.0[0].nrows() / 2;
        let rows = |first: usize| {
            let row = |index: usize| {
                let theta = &self.0[index % 3];
                let value = |column| theta[(first + index / 3, column)] as f32;
                (std::array::from_fn(value), value(AmbientDescriptor::LEN))
            };
            (0..3 * coefficients).map(row).collect()
        };
        LightTransfer {
            sh_degree,
            gain: rows(0),
            offset: rows(coefficients),
            neutral,
            confidence: None,
        }
    }
}

/// The smallest over the largest singular value of the lights' standardized descriptors, constant
/// included, and how many are not negligible.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Rank {
    pub rank: usize,
    pub smallest_over_largest: f64,
}

/// The normal equations of some lights, diagonalized.
pub(super) struct Ridge {
    standard: Standard,
    channels: [Channel; 3],
    /// Eigenvalues and eigenvectors of A.
    lights: (Vec<f64>, DMatrix<f64>),
}

struct Channel {
    /// Square roots of B's diagonal.
    scales: Vec<f64>,
    /// Eigenvalues and eigenvectors of B, scaled to a diagonal of 1.
    eigen: (Vec<f64>, DMatrix<f64>),
    /// R, scaled.
    cross: DMatrix<f64>,
}

fn eigen(matrix: DMatrix<f64>) -> (Vec<f64>, DMatrix<f64>) {
    let eigen = matrix.symmetric_eigen();
    // Rounding leaves eigenvalues of a positive matrix slightly below 0.
    let values = eigen.eigenvalues.iter().map(|value| value.max(0.0));
    (values.collect(), eigen.eigenvectors)
}

pub(super) fn standard_of(lights: &[&LightMoments]) -> Standard {
    Standard::from_rows(lights.iter().map(|light| light.descriptor.as_slice()))
}

/// Weight of each light; they sum to 1.
pub(super) fn weights_of(lights: &[&LightMoments]) -> Vec<f64> {
    let probes = lights.iter().filter(|light| light.probe.is_some()).count();
    let neutrals = lights.len() - probes;
    let weight = |light: &&LightMoments| match light.probe {
        _ if probes == 0 || neutrals == 0 => 1.0 / lights.len() as f64,
        None => NEUTRAL_SHARE / neutrals as f64,
        Some(_) => (1.0 - NEUTRAL_SHARE) / probes as f64,
    };
    lights.iter().map(weight).collect()
}

impl Ridge {
    /// The equations of `lights`, of which there must be some, in `moments`.
    pub(super) fn new(moments: &Moments, lights: &[&LightMoments]) -> Self {
        let standard = standard_of(lights);
        let mut design = DMatrix::zeros(COLUMNS, COLUMNS);
        let size = 2 * moments.coefficients;
        let mut cross: [DMatrix<f64>; 3] = std::array::from_fn(|_| DMatrix::zeros(size, COLUMNS));
        for (light, weight) in lights.iter().zip(weights_of(lights)) {
            let row = standard.row(&light.descriptor);
            for (column, value) in row.iter().enumerate() {
                let value = value * weight;
                (0..COLUMNS).for_each(|other| design[(column, other)] += value * row[other]);
                for (sum, of_light) in cross.iter_mut().zip(&light.cross) {
                    (0..size).for_each(|index| sum[(index, column)] += value * of_light[index]);
                }
            }
        }
        let channels = std::array::from_fn(|channel| {
            let gram = &moments.gram[channel];
            // A coefficient that no sample has: nothing is known of its gain, and the prior stands.
            let scales: Vec<f64> = (0..size)
                .map(|index| gram[(index, index)].sqrt())
                .map(|scale| if scale > 0.0 { scale } else { 1.0 })
                .collect();
            let scaled =
                DMatrix::from_fn(size, size, |i, j| gram[(i, j)] / (scales[i] * scales[j]));
            let cross = DMatrix::from_fn(size, COLUMNS, |i, j| cross[channel][(i, j)] / scales[i]);
            Channel {
                eigen: eigen(scaled),
                scales,
                cross,
            }
        });
        Self {
            standard,
            channels,
            lights: eigen(design),
        }
    }

    /// Theta drawn towards `prior` by `ridge`, which counts against standardized columns: 1 is
    /// much.
    pub(super) fn solve(&self, ridge: f64, prior: &Theta) -> Theta {
        Theta(std::array::from_fn(|channel| {
            self.solve_channel(&self.channels[channel], ridge, &prior.0[channel])
        }))
    }

    fn solve_channel(&self, channel: &Channel, ridge: f64, prior: &DMatrix<f64>) -> DMatrix<f64> {
        let size = channel.scales.len();
        let rows = |matrix: &DMatrix<f64>, row: usize| -> Vec<f64> {
            (0..COLUMNS).map(|column| matrix[(row, column)]).collect()
        };
        let prior: Vec<Vec<f64>> = (0..size)
            .map(|row| self.standard.to_standardized(&rows(prior, row)))
            .collect();
        let right = DMatrix::from_fn(size, COLUMNS, |row, column| {
            channel.cross[(row, column)] + ridge * prior[row][column] * channel.scales[row]
        });
        let ((gram_values, gram_vectors), (light_values, light_vectors)) =
            (&channel.eigen, &self.lights);
        let turned = gram_vectors.transpose() * &right * light_vectors;
        let solved = DMatrix::from_fn(size, COLUMNS, |row, column| {
            let denominator = gram_values[row] * light_values[column] + ridge;
            if denominator > 0.0 {
                turned[(row, column)] / denominator
            } else {
                0.0
            }
        });
        let scaled = gram_vectors * &solved * light_vectors.transpose();
        let plain: Vec<Vec<f64>> = (0..size)
            .map(|row| self.standard.to_plain(&rows(&scaled, row)))
            .collect();
        DMatrix::from_fn(size, COLUMNS, |row, column| {
            plain[row][column] / channel.scales[row]
        })
    }
}

/// Rank of the space of descriptors that `lights` span.
pub(super) fn rank_of(lights: &[&LightMoments]) -> Rank {
    let standard = standard_of(lights);
    let mut design = DMatrix::zeros(lights.len().max(COLUMNS), COLUMNS);
    for (row, light) in lights.iter().enumerate() {
        let values = standard.row(&light.descriptor);
        // Here the constant is a column like any other.
        values
            .iter()
            .enumerate()
            .for_each(|(column, &value)| design[(row, column)] = value);
        design[(row, COLUMNS - 1)] = 1.0;
    }
    let values = design.singular_values();
    let (largest, smallest) = (values.max(), values.min());
    let rank = values
        .iter()
        .filter(|&&value| value > RANK_TOLERANCE * largest)
        .count();
    Rank {
        rank,
        smallest_over_largest: if largest > 0.0 {
            smallest / largest
        } else {
            0.0
        },
    }
}

/// Theta with nothing but zeros.
pub(super) fn zero(coefficients: usize) -> Theta {
    Theta(std::array::from_fn(|_| {
        DMatrix::zeros(2 * coefficients, COLUMNS)
    }))
}
