//! Photometric calibration of cameras: from the color of a scene to the color of an image.

use crate::Invalid;

/// Exponent of the display curve by which exposure acts on display-referred colors.
pub const DISPLAY_GAMMA: f64 = 2.2;

/// Largest exposure, stops.
const EXPOSURE_EV_MAX: f64 = 32.0;

/// Meaning of the colors that splats were trained with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ColorCurve {
    /// Display-referred: exposure acts through a curve of exponent [`DISPLAY_GAMMA`].
    #[default]
    Display,
    /// Linear radiance: exposure is a factor.
    Linear,
}

/// Loss of light towards the corners: a factor of 1 + a r² + b r⁴ + c r⁶ per channel, clamped to 0
/// to 1 ("PPISP", arXiv 2601.18336).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vignetting {
    /// Center, pixels.
    pub center_px: [f64; 2],
    /// Distances along x and y at which r is 1, pixels.
    pub radius_px: [f64; 2],
    /// Coefficients a, b and c of red, green and blue.
    pub rgb: [[f64; 3]; 3],
}

/// Photometric calibration of a camera. Its stages come in the order of its members, after the sky
/// was added.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Photometry {
    /// Exposure, stops: 1 doubles the light.
    pub exposure_ev: f64,
    /// Meaning of the colors of splats.
    pub curve: ColorCurve,
    /// Loss of light towards the corners.
    pub vignetting: Option<Vignetting>,
    /// Rows of red, green and blue: three factors and an offset.
    pub matrix: [[f64; 4]; 3],
    /// Exponents of red, green and blue. Where one is not 1, negative values are 0.
    pub gamma: [f64; 3],
}

impl Default for Photometry {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl Photometry {
    /// The calibration that leaves colors as they are.
    pub const IDENTITY: Self = Self {
        exposure_ev: 0.0,
        curve: ColorCurve::Display,
        vignetting: None,
        matrix: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
        gamma: [1.0; 3],
    };

    /// True if colors stay as they are.
    #[must_use]
    pub fn is_identity(&self) -> bool {
        let Self { curve, .. } = *self;
        *self
            == Self {
                curve,
                ..Self::IDENTITY
            }
    }

    /// This calibration, or `other` where it is the identity.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        if self.is_identity() { other } else { self }
    }

    /// Factor of the exposure.
    #[must_use]
    pub fn gain(&self) -> f64 {
        match self.curve {
            ColorCurve::Display => (self.exposure_ev / DISPLAY_GAMMA).exp2(),
            ColorCurve::Linear => self.exposure_ev.exp2(),
        }
    }

    /// Color of the image at `at_px`, pixels, of the color `rgb` of the scene.
    #[must_use]
    pub fn color(&self, rgb: [f64; 3], at_px: [f64; 2]) -> [f64; 3] {
        let gain = self.gain();
        let mut exposed = rgb.map(|value| value * gain);
        if let Some(vignetting) = &self.vignetting {
            let factors = vignetting.factors(at_px);
            exposed = std::array::from_fn(|channel| exposed[channel] * factors[channel]);
        }
        let [red, green, blue] = exposed;
        std::array::from_fn(|channel| {
            let [of_red, of_green, of_blue, offset] = self.matrix[channel];
            let value = of_red * red + of_green * green + of_blue * blue + offset;
            match self.gamma[channel] {
                1.0 => value,
                gamma => value.max(0.0).powf(gamma),
            }
        })
    }

    /// The calibration of the same camera whose image is scaled by `sx` and `sy`.
    #[must_use]
    pub fn scaled(&self, sx: f64, sy: f64) -> Self {
        let by = [sx, sy];
        let scaled = |of: [f64; 2]| [of[0] * by[0], of[1] * by[1]];
        let vignetting = |vignetting: Vignetting| Vignetting {
            center_px: scaled(vignetting.center_px),
            radius_px: scaled(vignetting.radius_px),
            ..vignetting
        };
        Self {
            vignetting: self.vignetting.map(vignetting),
            ..*self
        }
    }

    /// The calibration of the window whose top left pixel is `(left_px, top_px)`.
    #[must_use]
    pub fn cropped(&self, left_px: f64, top_px: f64) -> Self {
        let vignetting = |vignetting: Vignetting| Vignetting {
            center_px: [
                vignetting.center_px[0] - left_px,
                vignetting.center_px[1] - top_px,
            ],
            ..vignetting
        };
        Self {
            vignetting: self.vignetting.map(vignetting),
            ..*self
        }
    }

    /// Checks that all numbers can be used.
    ///
    /// # Errors
    /// Returns an error if the exposure is beyond 32 stops, a radius or an exponent is not
    /// positive, or a number is not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.exposure_ev.is_nan() || self.exposure_ev.abs() > EXPOSURE_EV_MAX {
            return Err(Invalid::new(format!(
                "exposure_ev is {}; expected {} to {EXPOSURE_EV_MAX} stops",
                self.exposure_ev, -EXPOSURE_EV_MAX
            )));
        }
        if let Some(Vignetting {
            center_px,
            radius_px,
            rgb,
        }) = &self.vignetting
        {
            let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
            if !(finite(center_px) && finite(radius_px) && finite(rgb.as_flattened())) {
                return Err("a number of the vignetting is not finite".into());
            }
            if radius_px.iter().any(|radius_px| *radius_px <= 0.0) {
                return Err(Invalid::new(format!(
                    "radius_px of the vignetting is {radius_px:?}; expected two positive numbers"
                )));
            }
        }
        if !self
            .matrix
            .as_flattened()
            .iter()
            .all(|value| value.is_finite())
        {
            return Err("a number of the color matrix is not finite".into());
        }
        if !self
            .gamma
            .iter()
            .all(|gamma| gamma.is_finite() && *gamma > 0.0)
        {
            return Err(Invalid::new(format!(
                "gamma is {:?}; expected three positive numbers",
                self.gamma
            )));
        }
        Ok(())
    }
}

impl Vignetting {
    /// Factors of red, green and blue at `at_px`, pixels.
    #[must_use]
    pub fn factors(&self, at_px: [f64; 2]) -> [f64; 3] {
        let along = |axis: usize| (at_px[axis] - self.center_px[axis]) / self.radius_px[axis];
        let r2 = along(0).powi(2) + along(1).powi(2);
        self.rgb
            .map(|[a, b, c]| (1.0 + r2 * (a + r2 * (b + r2 * c))).clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Photometry = Photometry {
        exposure_ev: 1.0,
        curve: ColorCurve::Linear,
        vignetting: Some(Vignetting {
            center_px: [10.0, 20.0],
            radius_px: [5.0, 10.0],
            rgb: [[-0.5, 0.0, 0.0], [0.0, -0.25, 0.0], [0.0, 0.0, 0.1]],
        }),
        matrix: [
            [1.0, 0.5, 0.0, 0.25],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.5, -2.0],
        ],
        gamma: [1.0, 0.5, 2.0],
    };

    #[test]
    fn stages_come_in_their_order() {
        // At r = 1: twice the light, then half of red, three quarters of green, all of blue; then
        // the matrix, then the exponents. Blue is negative before its exponent.
        let found = ALL.color([0.25, 0.5, 0.75], [15.0, 20.0]);
        let expected = [0.25 + 0.5 * 0.75 + 0.25, 0.75f64.sqrt(), 0.0];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        // The same position in an image twice as wide, and in a crop.
        assert_eq!(
            ALL.scaled(2.0, 1.0).color([0.25, 0.5, 0.75], [30.0, 20.0]),
            found
        );
        assert_eq!(
            ALL.cropped(3.0, 4.0).color([0.25, 0.5, 0.75], [12.0, 16.0]),
            found
        );
    }

    #[test]
    fn exposure_acts_through_the_display_curve_unless_colors_are_linear() {
        let one_stop = Photometry {
            exposure_ev: 1.0,
            ..Photometry::IDENTITY
        };
        let display = one_stop.color([0.5; 3], [0.0; 2])[0];
        assert!((display.powf(2.2) - 2.0 * 0.5f64.powf(2.2)).abs() < 1e-12);
        let linear = Photometry {
            curve: ColorCurve::Linear,
            ..one_stop
        };
        assert_eq!(linear.color([0.5; 3], [0.0; 2]), [1.0; 3]);
        assert!(Photometry::IDENTITY.is_identity() && !one_stop.is_identity());
    }

    #[test]
    fn numbers_that_cannot_be_used_are_refused() {
        let with = |change: fn(&mut Photometry)| {
            let mut changed = ALL;
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        assert_eq!(ALL.check(), Ok(()));
        assert!(with(|all| all.exposure_ev = f64::NAN).contains("exposure_ev is NaN"));
        assert!(with(|all| all.exposure_ev = 40.0).contains("-32 to 32"));
        assert!(with(|all| all.gamma[1] = 0.0).contains("gamma"));
        assert!(with(|all| all.matrix[2][3] = f64::INFINITY).contains("matrix"));
        let vignetting = |change: fn(&mut Vignetting)| {
            let mut changed = ALL;
            change(changed.vignetting.as_mut().unwrap());
            changed.check().unwrap_err().to_string()
        };
        assert!(vignetting(|all| all.radius_px[0] = 0.0).contains("radius_px"));
        assert!(vignetting(|all| all.rgb[0][0] = f64::NAN).contains("not finite"));
    }
}
