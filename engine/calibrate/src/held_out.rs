//! Errors of the colors of visible surfaces, for light that a fit was not trained on.

use decouplegs_scene::{ColorTransfer, LightTransfer};
use rayon::prelude::*;

use super::lighting::Lighting;
use super::moments::{LightMoments, Moments};
use super::ridge::{Ridge, zero};
use super::sample::Sample;
use super::surface::{COEFFICIENTS, Color};

/// Darker truths have no hue worth an angle: the largest channel's display value.
pub const HUE_FLOOR: f64 = 0.05;

/// Bins of angles a degree; the 95th percentile is exact to one of them.
const BINS_PER_DEGREE: f64 = 50.0;

/// Enough to solve for what a single light asks for, whatever its conditioning in f64.
const TRACE_RIDGE: f64 = 1e-9;

/// The distance of display-referred colors, 0 to 1 a channel, from the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct ColorError {
    squares: f64,
    channels: u64,
    angle_sum_deg: f64,
    /// Angles in bins of a fiftieth of a degree.
    angles: Vec<u64>,
}

impl ColorError {
    fn none() -> Self {
        Self {
            squares: 0.0,
            channels: 0,
            angle_sum_deg: 0.0,
            angles: vec![0; (180.0 * BINS_PER_DEGREE) as usize + 1],
        }
    }

    fn add(&mut self, found: [f64; 3], truth: [f64; 3]) {
        self.squares += found
            .iter()
            .zip(truth)
            .map(|(a, b)| (a - b).powi(2))
            .sum::<f64>();
        self.channels += 3;
        if truth.iter().copied().fold(0.0, f64::max) < HUE_FLOOR {
            return;
        }
        let (found, truth) = (
            glam::DVec3::from_array(found),
            glam::DVec3::from_array(truth),
        );
        // Black has no hue: as far off as colors can be.
        let angle_deg = if found == glam::DVec3::ZERO {
            90.0
        } else {
            found.angle_between(truth).to_degrees()
        };
        self.angle_sum_deg += angle_deg;
        self.angles[(angle_deg * BINS_PER_DEGREE) as usize] += 1;
    }

    fn merge(&mut self, other: &Self) {
        self.squares += other.squares;
        self.channels += other.channels;
        self.angle_sum_deg += other.angle_sum_deg;
        self.angles
            .iter_mut()
            .zip(&other.angles)
            .for_each(|(count, more)| *count += more);
    }

    /// Root of the mean squared error over colors and channels.
    #[must_use]
    pub fn rmse(&self) -> f64 {
        (self.squares / self.channels.max(1) as f64).sqrt()
    }

    /// Mean angle between RGB vectors, degrees, over truths of at least [`HUE_FLOOR`].
    #[must_use]
    pub fn angle_mean_deg(&self) -> f64 {
        self.angle_sum_deg / self.angles.iter().sum::<u64>().max(1) as f64
    }

    /// The angle that 95 % of them do not exceed, degrees, rounded up to a fiftieth.
    #[must_use]
    pub fn angle_p95_deg(&self) -> f64 {
        let wanted = self.angles.iter().sum::<u64>() as f64 * 0.95;
        let mut passed = 0.0;
        let bin = self.angles.iter().position(|&count| {
            passed += count as f64;
            passed >= wanted
        });
        (bin.unwrap_or(0) + 1) as f64 / BINS_PER_DEGREE
    }
}

/// Seen colors in some lights, by three ways to relight, against the truth.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Error of the colors as they are.
    pub none: ColorError,
    /// Error of colors by the light transfer.
    pub relit: ColorError,
    /// Error of colors by the T and b that fit each light best, which no transfer can beat but by
    /// clamping.
    pub affine: ColorError,
}

impl Comparison {
    /// Creates an accumulator without comparisons.
    pub(super) fn new() -> Self {
        Self {
            none: ColorError::none(),
            relit: ColorError::none(),
            affine: ColorError::none(),
        }
    }

    pub(super) fn merge(&mut self, other: &Self) {
        self.none.merge(&other.none);
        self.relit.merge(&other.relit);
        self.affine.merge(&other.affine);
    }

    /// Compares the prediction of `transfer` with `samples` in `lights`. `moments` holds the
    /// moments by visible colors.
    pub(super) fn for_transfer(
        transfer: &LightTransfer,
        samples: &[Sample],
        moments: &Moments,
        lights: &[(&Lighting<'_>, &LightMoments)],
    ) -> Self {
        let parts: Vec<Self> = lights
            .par_iter()
            .map(|(light, of_light)| Self::in_light(transfer, samples, moments, light, of_light))
            .collect();
        let mut sum = Self::new();
        parts.iter().for_each(|part| sum.merge(part));
        sum
    }

    fn in_light(
        transfer: &LightTransfer,
        samples: &[Sample],
        moments: &Moments,
        light: &Lighting<'_>,
        of_light: &LightMoments,
    ) -> Self {
        let relit = transfer.at(&light.descriptor);
        let affine = best_affine(moments, of_light);
        let mut comparison = Self::new();
        for sample in samples {
            let color = &sample.surface.color;
            let truth = sample
                .surface
                .lit(light.reflected_by_white(sample.surface.normal));
            let (relit, affine) = (relit_color(&relit, color), relit_color(&affine, color));
            for basis in &sample.views {
                let truth = shown(&truth, basis);
                comparison.none.add(shown(color, basis), truth);
                comparison.relit.add(shown(&relit, basis), truth);
                comparison.affine.add(shown(&affine, basis), truth);
            }
        }
        comparison
    }
}

pub(super) fn relit_color(transfer: &ColorTransfer, color: &Color) -> Color {
    std::array::from_fn(|k| {
        let affine = |channel: usize| {
            f64::from(transfer.gain[k][channel]) * color[k][channel]
                + f64::from(transfer.offset[k][channel])
        };
        std::array::from_fn(affine)
    })
}

pub(super) fn shown(color: &Color, basis: &[f64; COEFFICIENTS]) -> [f64; 3] {
    let value = |channel: usize| {
        basis
            .iter()
            .zip(color)
            .map(|(y, coefficient)| y * coefficient[channel])
            .sum::<f64>()
    };
    std::array::from_fn(|channel| value(channel).clamp(0.0, 1.0))
}

/// The transfer that fits `light` best.
pub(super) fn best_affine(moments: &Moments, light: &LightMoments) -> ColorTransfer {
    let count = moments.coefficients;
    let fitted = Ridge::new(moments, &[light])
        .solve(TRACE_RIDGE, &zero(count))
        .at(&light.descriptor);
    let mut transfer = ColorTransfer::IDENTITY;
    for k in 0..count {
        transfer.gain[k] = std::array::from_fn(|channel| fitted[channel][k] as f32);
        transfer.offset[k] = std::array::from_fn(|channel| fitted[channel][count + k] as f32);
    }
    transfer
}
