//! Sums over samples, of which a fit and its error are functions.
//!
//! A transfer x = (T_0 .. T_K-1, b_0 .. b_K-1) of one channel in one light is judged by the mean
//! over samples i of `|sum_k (T_k c_ik + b_k) Y_k(d) - sum_k q_ik Y_k(d)|^2` over directions d, q
//! the truth. With G_i the Gram matrix of the basis over those directions and D_i = [diag(c_i); 1]
//! that is `x' B x - 2 x' r + p`, with `B = mean(D_i G_i D_i')` the same in every light, `r =
//! mean(D_i G_i q_i)` and `p = mean(q_i' G_i q_i)`.

use decouplegs_scene::AmbientDescriptor;
use nalgebra::DMatrix;
use rayon::prelude::*;

use super::Objective;
use super::lighting::Lighting;
use super::sample::{Gram, Sample, gram_of_sphere};
use super::surface::Color;

/// Contribution of one light.
#[derive(Clone, Debug)]
pub(super) struct LightMoments {
    /// Index of the source probe; `None` for the neutral light.
    pub probe: Option<usize>,
    pub descriptor: [f64; AmbientDescriptor::LEN],
    /// r of each channel.
    pub cross: [Vec<f64>; 3],
    /// p of each channel.
    pub power: [f64; 3],
}

/// The sums of all samples in all lights.
#[derive(Clone, Debug)]
pub(super) struct Moments {
    /// Number of coefficients.
    pub coefficients: usize,
    /// B of each channel, 2K x 2K.
    pub gram: [DMatrix<f64>; 3],
    pub lights: Vec<LightMoments>,
}

impl Moments {
    /// The moments of `samples` in `lights`, where `truth` tells a sample's color in a light.
    pub(super) fn from_samples(
        samples: &[Sample],
        lights: &[Lighting<'_>],
        coefficients: usize,
        objective: Objective,
        truth: impl Fn(&Sample, &Lighting<'_>) -> Color + Sync,
    ) -> Self {
        let sphere = gram_of_sphere();
        let gram_of = |sample: &Sample| match objective {
            Objective::Seen => *sample.seen,
            Objective::Coefficients => sphere,
        };
        let gram = std::array::from_fn(|channel| {
            let mut sum = DMatrix::zeros(2 * coefficients, 2 * coefficients);
            samples
                .iter()
                .for_each(|sample| add_outer(&mut sum, &gram_of(sample), sample, channel));
            let share = 1.0 / samples.len() as f64;
            DMatrix::from_fn(2 * coefficients, 2 * coefficients, |i, j| {
                sum[(i, j)] * share
            })
        });
        let light_moments = |light: &Lighting<'_>| {
            let mut moments = LightMoments {
                probe: light.probe.map(|(index, _)| index),
                descriptor: light.descriptor.to_vector(),
                cross: std::array::from_fn(|_| vec![0.0; 2 * coefficients]),
                power: [0.0; 3],
            };
            for sample in samples {
                let mut truth = truth(sample, light);
                truth[coefficients..].fill([0.0; 3]);
                moments.add(&gram_of(sample), &sample.surface.color, &truth);
            }
            let share = 1.0 / samples.len() as f64;
            moments
                .cross
                .iter_mut()
                .flatten()
                .chain(&mut moments.power)
                .for_each(|value| *value *= share);
            moments
        };
        // Each light is one task and its samples are summed in order: threads change nothing.
        Self {
            coefficients,
            gram,
            lights: lights.par_iter().map(light_moments).collect(),
        }
    }

    /// The moments of the other samples, if `part` are those of a `share` of all of them.
    pub(super) fn without(&self, part: &Self, share: f64) -> Self {
        let rest = |all: f64, part: f64| (all - share * part) / (1.0 - share);
        let of_light = |(all, part): (&LightMoments, &LightMoments)| {
            let cross = |channel: usize| {
                let pairs = all.cross[channel].iter().zip(&part.cross[channel]);
                pairs.map(|(all, part)| rest(*all, *part)).collect()
            };
            LightMoments {
                cross: std::array::from_fn(cross),
                power: std::array::from_fn(|channel| rest(all.power[channel], part.power[channel])),
                ..all.clone()
            }
        };
        let size = 2 * self.coefficients;
        let gram = |channel: usize| {
            let (all, part) = (&self.gram[channel], &part.gram[channel]);
            DMatrix::from_fn(size, size, |i, j| rest(all[(i, j)], part[(i, j)]))
        };
        Self {
            coefficients: self.coefficients,
            gram: std::array::from_fn(gram),
            lights: self.lights.iter().zip(&part.lights).map(of_light).collect(),
        }
    }

    /// Mean squared error over channels of the transfers `x`, one per channel, in one light.
    pub(super) fn error(&self, light: &LightMoments, x: &[Vec<f64>; 3]) -> f64 {
        let of_channel = |channel: usize| {
            let (gram, x) = (&self.gram[channel], &x[channel]);
            let bent: f64 = (0..x.len())
                .map(|i| x[i] * (0..x.len()).map(|j| gram[(i, j)] * x[j]).sum::<f64>())
                .sum();
            let along: f64 = x
                .iter()
                .zip(&light.cross[channel])
                .map(|(x, cross)| x * cross)
                .sum();
            bent - 2.0 * along + light.power[channel]
        };
        (0..3).map(of_channel).sum::<f64>() / 3.0
    }
}

impl LightMoments {
    fn add(&mut self, gram: &Gram, color: &Color, truth: &Color) {
        let coefficients = self.cross[0].len() / 2;
        for channel in 0..3 {
            let cross = &mut self.cross[channel];
            for k in 0..coefficients {
                let seen: f64 = (0..coefficients)
                    .map(|j| gram[k][j] * truth[j][channel])
                    .sum();
                cross[k] += color[k][channel] * seen;
                cross[coefficients + k] += seen;
                self.power[channel] += truth[k][channel] * seen;
            }
        }
    }
}

/// Adds D G D' of one sample.
fn add_outer(sum: &mut DMatrix<f64>, gram: &Gram, sample: &Sample, channel: usize) {
    let coefficients = sum.nrows() / 2;
    let color = |k: usize| sample.surface.color[k][channel];
    for i in 0..coefficients {
        for j in 0..coefficients {
            let value = gram[i][j];
            sum[(i, j)] += color(i) * color(j) * value;
            sum[(i, coefficients + j)] += color(i) * value;
            sum[(coefficients + i, j)] += color(j) * value;
            sum[(coefficients + i, coefficients + j)] += value;
        }
    }
}
