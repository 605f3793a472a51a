//! Light transfer, the effect of light on colors: c' = T(L) (.) c + b(L) with T = W_T L + w_0 and b
//! = W_B L + b_0.

use crate::light::confidence::on_brighter_ground;
use crate::light::{AmbientDescriptor, TransferConfidence, Trust, luminance, to_linear};
use crate::{Invalid, SplatCloud, sh};

/// [`sh::DC_SHIFT`] as colors are stored.
const DC_SHIFT: f32 = sh::DC_SHIFT as f32;

/// Coefficients of the highest degree.
const COEFFICIENTS: usize = sh::coefficient_count(sh::DEGREE_MAX);

/// T and b of one agent in one light: a factor and a summand for each coefficient and channel. Both
/// are meant for the plain expansion: DC without the 0.5 that splats' colors add.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColorTransfer {
    /// `[coefficient][rgb]`.
    pub gain: [[f32; 3]; COEFFICIENTS],
    /// `[coefficient][rgb]`.
    pub offset: [[f32; 3]; COEFFICIENTS],
}

impl ColorTransfer {
    /// Leaves colors as they are.
    pub const IDENTITY: Self = Self {
        gain: [[1.0; 3]; COEFFICIENTS],
        offset: [[0.0; 3]; COEFFICIENTS],
    };

    /// `color`, the coefficients of one color with DC first, in this light.
    pub fn apply(&self, color: &mut [[f32; 3]]) {
        for (index, coefficient) in color.iter_mut().enumerate() {
            let shift = if index == 0 { DC_SHIFT } else { 0.0 };
            for (channel, value) in coefficient.iter_mut().enumerate() {
                *value = self.gain[index][channel] * (*value + shift) + self.offset[index][channel]
                    - shift;
            }
        }
    }

    /// All splats of `cloud` in this light.
    #[must_use]
    pub fn relit(&self, cloud: &SplatCloud) -> SplatCloud {
        let mut relit = cloud.clone();
        let stride = sh::coefficient_count(cloud.sh_degree);
        let mut color = vec![[0.0; 3]; stride];
        for splat in 0..cloud.len() {
            color[0] = cloud.sh_dc[splat];
            color[1..].copy_from_slice(cloud.rest_of(splat));
            self.apply(&mut color);
            relit.sh_dc[splat] = color[0];
            relit.sh_rest[splat * (stride - 1)..(splat + 1) * (stride - 1)]
                .copy_from_slice(&color[1..]);
        }
        relit
    }
}

/// Theta of the paper: how light becomes a [`ColorTransfer`], the same for all agents.
#[derive(Clone, Debug, PartialEq)]
pub struct LightTransfer {
    /// Degree of the colors that it was calibrated for; coefficients above it stay as they are.
    pub sh_degree: u8,
    /// W_T and w_0: a row of 27 weights and a constant for each `[coefficient][rgb]`.
    pub gain: Vec<([f32; AmbientDescriptor::LEN], f32)>,
    /// W_B and b_0, likewise.
    pub offset: Vec<([f32; AmbientDescriptor::LEN], f32)>,
    /// The light that assets are shown in as they are: for positions whose light is not known.
    pub neutral: AmbientDescriptor,
    /// Errors that the calibration measured; `None`: nothing is known, and the effect is applied in
    /// full.
    pub confidence: Option<TransferConfidence>,
}

impl LightTransfer {
    /// Checks the transfer and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.sh_degree > sh::DEGREE_MAX {
            return Err(Invalid::new(format!(
                "a light transfer of degree {}; 0 to {} are known",
                self.sh_degree,
                sh::DEGREE_MAX
            )));
        }
        let rows = 3 * sh::coefficient_count(self.sh_degree);
        if self.gain.len() != rows || self.offset.len() != rows {
            return Err(Invalid::new(format!(
                "{} rows of gain and {} of offset; expected {rows} each",
                self.gain.len(),
                self.offset.len()
            )));
        }
        if let Some(confidence) = &self.confidence {
            confidence.check(rows / 3)?;
        }
        let rows = self
            .gain
            .iter()
            .chain(&self.offset)
            .flat_map(|(weights, constant)| weights.iter().chain([constant]));
        match rows
            .chain(self.neutral.coefficients.as_flattened())
            .find(|value| !value.is_finite())
        {
            Some(value) => Err(Invalid::new(format!(
                "a light transfer holds {value}; expected finite numbers"
            ))),
            None => Ok(()),
        }
    }

    /// T(L) and b(L), `light` in the frame of the colors that they are for.
    #[must_use]
    pub fn at(&self, light: &AmbientDescriptor) -> ColorTransfer {
        let light = light.to_vector();
        let value = |(weights, constant): &([f32; AmbientDescriptor::LEN], f32)| {
            let sum: f64 = weights
                .iter()
                .zip(light)
                .map(|(weight, l)| f64::from(*weight) * l)
                .sum();
            (sum + f64::from(*constant)) as f32
        };
        let mut transfer = ColorTransfer::IDENTITY;
        for (row, (gain, offset)) in self.gain.iter().zip(&self.offset).enumerate() {
            transfer.gain[row / 3][row % 3] = value(gain);
            transfer.offset[row / 3][row % 3] = value(offset);
        }
        transfer
    }

    /// Albedo of the ground that the calibration took agents to stand on, linear: in neutral light
    /// the ground shows it.
    #[must_use]
    pub fn ground_albedo(&self) -> f64 {
        to_linear(luminance(self.neutral.mean().map(f64::from)))
    }

    /// T(L) and b(L) drawn towards the identity by their predicted error, and how much of them is
    /// kept; all of them where no error is known. `light` as in [`LightTransfer::at`];
    /// `albedo_spread` is the standard deviation of the logarithm of the ground's albedo.
    #[must_use]
    pub fn trusted_at(
        &self,
        light: &AmbientDescriptor,
        albedo_spread: f64,
    ) -> (ColorTransfer, Option<Trust>) {
        let mut transfer = self.at(light);
        let trust = self.confidence.as_ref().map(|confidence| {
            let brighter = self.at(&on_brighter_ground(light, albedo_spread.exp()));
            let neutral = self.at(&self.neutral);
            confidence.shrink(&mut transfer, [&brighter, &neutral], &light.to_vector())
        });
        (transfer, trust)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Brightness follows the mean of the light; a green summand on the band 1 coefficient along z.
    fn transfer() -> LightTransfer {
        let row = ([0.0; AmbientDescriptor::LEN], 0.0);
        let mut transfer = LightTransfer {
            sh_degree: 1,
            gain: vec![row; 12],
            offset: vec![row; 12],
            neutral: AmbientDescriptor::uniform([0.5; 3]),
            confidence: None,
        };
        for channel in 0..3 {
            transfer.gain[channel].0[channel] = 2.0 * sh::Y0 as f32;
        }
        transfer.offset[7].1 = 0.25;
        transfer
    }

    #[test]
    fn black_stays_black_in_any_light() {
        let mut black = [[-DC_SHIFT; 3]];
        transfer()
            .at(&AmbientDescriptor::uniform([0.9, 0.1, 0.4]))
            .apply(&mut black);
        assert!(black[0].iter().all(|dc| (dc + DC_SHIFT).abs() < 1e-6));
    }

    #[test]
    fn gains_and_offsets_go_to_their_coefficients_and_channels() {
        let mut color = [[0.0; 3]; 4];
        transfer()
            .at(&AmbientDescriptor::uniform([1.0, 0.5, 0.0]))
            .apply(&mut color);
        // A color of 0.5 in light twice, once and no times as bright as the one that changes
        // nothing.
        let shown = color[0].map(|dc| 0.5 + sh::Y0 as f32 * dc);
        assert!(
            (shown[0] - 1.0).abs() < 1e-6 && (shown[1] - 0.5).abs() < 1e-6 && shown[2].abs() < 1e-6
        );
        assert_eq!(color[2], [0.0, 0.25, 0.0]);
    }

    #[test]
    fn the_identity_changes_nothing_and_broken_ones_are_named() {
        let mut color = [[0.3, -0.2, 0.9]; 16];
        ColorTransfer::IDENTITY.apply(&mut color);
        assert!(
            color
                .as_flattened()
                .iter()
                .zip([0.3, -0.2, 0.9].iter().cycle())
                .all(|(a, b): (&f32, &f32)| (a - b).abs() < 1e-6)
        );
        let mut broken = transfer();
        broken.gain.pop();
        assert!(broken.check().unwrap_err().reason().contains("11 rows"));
        let mut broken = transfer();
        broken.offset[3].1 = f32::NAN;
        assert!(broken.check().unwrap_err().reason().contains("NaN"));
    }
}
