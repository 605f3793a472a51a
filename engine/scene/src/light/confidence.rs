//! Confidence of a light transfer: how far its effect can be trusted in a given light.

use crate::light::environment::GAMMA;
use crate::light::{AmbientDescriptor, ColorTransfer};
use crate::{Invalid, sh};

/// Standard deviation of the logarithm of the ground's albedo where nobody told it: worn asphalt
/// reflects 0.10 to 0.15 of the light, new asphalt 0.05 to 0.10, worn concrete 0.20 to 0.30
/// (EPA, Reducing Urban Heat Islands: Cool Pavements, 2008).
pub const ALBEDO_SPREAD: f64 = 0.15;

/// Spread of an albedo that a scene gives: tables tell it to some 10 %.
pub const ALBEDO_SPREAD_GIVEN: f64 = 0.10;

/// Options of the effect of light on colors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelightOptions {
    /// Applies the effect in full, also where its predicted error is large. False: it is drawn
    /// towards none there, if the transfer knows its errors.
    pub full_effect: bool,
    /// Mean albedo of the level ground, linear, above 0, at most 1. The ground tells how bright the
    /// light is only if its albedo is known. `None`: that of the calibration,
    /// [`crate::LightTransfer::ground_albedo`], with the uncertainty [`ALBEDO_SPREAD`].
    pub ground_albedo: Option<f64>,
    /// Shades each splat by its normal instead ([`crate::light::Shading`]): needs no transfer. The
    /// ground's albedo is then that of [`crate::light::Surroundings`] where none is given.
    pub by_normals: bool,
}

impl RelightOptions {
    /// Checks the options and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        match self.ground_albedo {
            Some(albedo) if !(albedo > 0.0 && albedo <= 1.0) => Err(Invalid::new(format!(
                "ground_albedo is {albedo}; expected a number above 0, at most 1"
            ))),
            _ => Ok(()),
        }
    }

    /// Standard deviation of the logarithm of the ground's albedo.
    pub(super) fn albedo_spread(&self) -> f64 {
        match self.ground_albedo {
            Some(_) => ALBEDO_SPREAD_GIVEN,
            None => ALBEDO_SPREAD,
        }
    }
}

/// The errors that a calibration measured, and the lights that it knows.
#[derive(Clone, Debug, PartialEq)]
pub struct TransferConfidence {
    /// Per `[coefficient][rgb]` the means of c², c and 1 over the visible splats of the calibrated
    /// assets, each times the squared basis function: they turn a change of gain and offset into
    /// the mean squared change of colors.
    pub effect: Vec<[f32; 3]>,
    /// Per coefficient, the mean squared color error in lights left out of the fit, relative to the
    /// mean square of the color that DC has there.
    pub residual: Vec<f32>,
    /// Mean descriptor of the calibrated lights.
    pub light_mean: [f32; AmbientDescriptor::LEN],
    /// Inverse covariance of the calibrated descriptors, 27 x 27.
    pub light_precision: Vec<[f32; AmbientDescriptor::LEN]>,
}

/// Share of the transfer that is applied in one light, and why.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trust {
    /// Per coefficient, 0 (colors stay as they are) to 1 (the full effect).
    pub kept: [f32; sh::coefficient_count(sh::DEGREE_MAX)],
    /// Root of the mean squared color change by DC, display values.
    pub effect: f64,
    /// Predicted root mean squared error of that change, display values.
    pub error: f64,
    /// Squared distance of the light from the calibrated ones, Mahalanobis, relative to the mean
    /// over these: 1 is usual, above about 3 the light is unlike any that was calibrated.
    pub distance: f64,
}

impl TransferConfidence {
    /// Checks sizes and values for `coefficients` coefficients.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self, coefficients: usize) -> Result<(), Invalid> {
        let sizes = [
            ("effects", self.effect.len(), 3 * coefficients),
            ("residuals", self.residual.len(), coefficients),
            (
                "rows of precision",
                self.light_precision.len(),
                AmbientDescriptor::LEN,
            ),
        ];
        if let Some((what, found, expected)) =
            sizes.iter().find(|(_, found, expected)| found != expected)
        {
            return Err(Invalid::new(format!(
                "{found} {what} of confidence; expected {expected}"
            )));
        }
        let not_negative = |value: &&f32| !(value.is_finite() && **value >= 0.0);
        if let Some(value) = self.residual.iter().find(not_negative) {
            return Err(Invalid::new(format!(
                "a residual of {value}; expected a number of at least 0"
            )));
        }
        let rows = self.light_precision.as_flattened().iter();
        match rows
            .chain(self.effect.as_flattened())
            .chain(&self.light_mean)
            .find(|value| !value.is_finite())
        {
            Some(value) => Err(Invalid::new(format!(
                "the confidence holds {value}; expected finite numbers"
            ))),
            None => Ok(()),
        }
    }

    /// Mean squared color change, over channels, from coefficient `k` of `from` to that of `to`.
    #[must_use]
    pub fn change(&self, k: usize, from: &ColorTransfer, to: &ColorTransfer) -> f64 {
        let difference = |from: [f32; 3], to: [f32; 3]| -> [f64; 3] {
            std::array::from_fn(|channel| f64::from(to[channel]) - f64::from(from[channel]))
        };
        let gain = difference(from.gain[k], to.gain[k]);
        self.energy(k, gain, difference(from.offset[k], to.offset[k]))
    }

    /// Mean square of the color, over channels, that coefficient `k` has under `transfer`.
    #[must_use]
    pub fn shown(&self, k: usize, transfer: &ColorTransfer) -> f64 {
        let (gain, offset) = (transfer.gain[k], transfer.offset[k]);
        self.energy(k, gain.map(f64::from), offset.map(f64::from))
    }

    fn energy(&self, k: usize, gain: [f64; 3], offset: [f64; 3]) -> f64 {
        let of = |channel: usize| {
            let [square, mean, one] = self.effect[3 * k + channel].map(f64::from);
            let (gain, offset) = (gain[channel], offset[channel]);
            gain * gain * square + 2.0 * gain * offset * mean + offset * offset * one
        };
        ((0..3).map(of).sum::<f64>() / 3.0).max(0.0)
    }

    /// Squared Mahalanobis distance of `light` from the calibrated lights, over its mean there.
    #[must_use]
    pub fn distance(&self, light: &[f64; AmbientDescriptor::LEN]) -> f64 {
        let off: [f64; AmbientDescriptor::LEN] =
            std::array::from_fn(|index| light[index] - f64::from(self.light_mean[index]));
        let row = |(row, value): (&[f32; AmbientDescriptor::LEN], &f64)| {
            let along: f64 = row.iter().zip(&off).map(|(p, o)| f64::from(*p) * o).sum();
            value * along
        };
        let sum: f64 = self.light_precision.iter().zip(&off).map(row).sum();
        sum.max(0.0) / AmbientDescriptor::LEN as f64
    }

    /// Draws `transfer` towards the identity, coefficient by coefficient, by what is expected to be
    /// wrong with it, and returns the shares kept.
    ///
    /// With x the effect of a coefficient on colors and e its error, the share that errs least in
    /// the mean square is `1 - E|e|² / |x|²`, at least 0 (James and Stein, Estimation with
    /// quadratic loss, 1961). E|e|² adds the residual of the calibration, which grows with the
    /// distance of the light from the calibrated ones; the effect of `brighter`: the change of gain
    /// and offset if the ground's albedo were one deviation off; and that of `neutral`: the
    /// transfer in the light that shows colors as they are, whose effect should be none.
    pub(super) fn shrink(
        &self,
        transfer: &mut ColorTransfer,
        [brighter, neutral]: [&ColorTransfer; 2],
        light: &[f64; AmbientDescriptor::LEN],
    ) -> Trust {
        let distance = self.distance(light);
        let shown = self.shown(0, transfer);
        let mut trust = Trust {
            kept: [1.0; sh::coefficient_count(sh::DEGREE_MAX)],
            effect: 0.0,
            error: 0.0,
            distance,
        };
        for (k, residual) in self.residual.iter().enumerate() {
            let effect = self.change(k, &ColorTransfer::IDENTITY, transfer);
            let of_albedo = self.change(k, transfer, brighter);
            let of_neutral = self.change(k, &ColorTransfer::IDENTITY, neutral);
            let residual = f64::from(*residual) * shown * distance.max(1.0);
            let error = residual + of_albedo + of_neutral;
            let kept = if effect > error {
                1.0 - error / effect
            } else {
                0.0
            };
            if k == 0 {
                (trust.effect, trust.error) = (effect.sqrt(), error.sqrt());
            }
            trust.kept[k] = kept as f32;
            transfer.gain[k] =
                transfer.gain[k].map(|gain| (1.0 + kept * (f64::from(gain) - 1.0)) as f32);
            transfer.offset[k] = transfer.offset[k].map(|value| value * kept as f32);
        }
        trust
    }
}

/// `light` as the ground shows it if its albedo is higher by the factor `ratio`.
pub(super) fn on_brighter_ground(light: &AmbientDescriptor, ratio: f64) -> AmbientDescriptor {
    let mut brighter = *light;
    let factor = ratio.powf(1.0 / GAMMA) as f32;
    brighter.coefficients[0] = brighter.coefficients[0].map(|value| value * factor);
    brighter
}
