//! Photometric calibration of cameras: from the color of a scene to the color of an image.

use crate::Invalid;

/// Exponent of the display curve by which exposure acts on display-referred colors.
pub const DISPLAY_GAMMA: f64 = 2.2;

/// Sum of the light that is added where a color is scaled to its sum: the "PPISP" constant.
const SUM_LEAST: f64 = 1e-5;
/// Least base of a power in a response: the "PPISP" constant.
const RESPONSE_LEAST: f64 = 1e-6;

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
    /// Centers of red, green and blue, pixels.
    pub center_px: [[f64; 2]; 3],
    /// Distances along x and y at which r is 1, pixels.
    pub radius_px: [f64; 2],
    /// Coefficients a, b and c of red, green and blue.
    pub rgb: [[f64; 3]; 3],
}

/// Response of a sensor to light from 0 to 1, a curve per channel: below `center` the power `toe`,
/// above it the mirrored power `shoulder`, joined there with one slope, and then the power `gamma`
/// ("PPISP", arXiv 2601.18336). Light beyond 0 to 1 is clamped before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Exponents below the center, of red, green and blue.
    pub toe: [f64; 3],
    /// Exponents above the center.
    pub shoulder: [f64; 3],
    /// Exponents of the joined curve.
    pub gamma: [f64; 3],
    /// Light at which the parts meet, above 0 and below 1.
    pub center: [f64; 3],
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
    /// Balance of colors: a homography of (red, green, sum of all three), rows first, after which
    /// the color is scaled to the sum that it had ("PPISP", arXiv 2601.18336).
    pub balance: Option<[[f64; 3]; 3]>,
    /// Rows of red, green and blue: three factors and an offset.
    pub matrix: [[f64; 4]; 3],
    /// Exponents of red, green and blue. Where one is not 1, negative values are 0.
    pub gamma: [f64; 3],
    /// Response of the sensor.
    pub response: Option<Response>,
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
        balance: None,
        matrix: [
            [1.0, 0.0, 0.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 1.0, 0.0],
        ],
        gamma: [1.0; 3],
        response: None,
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
        if let Some(balance) = &self.balance {
            exposed = balanced(balance, exposed);
        }
        let [red, green, blue] = exposed;
        let mixed: [f64; 3] = std::array::from_fn(|channel| {
            let [of_red, of_green, of_blue, offset] = self.matrix[channel];
            let value = of_red * red + of_green * green + of_blue * blue + offset;
            match self.gamma[channel] {
                1.0 => value,
                gamma => value.max(0.0).powf(gamma),
            }
        });
        match &self.response {
            Some(response) => {
                std::array::from_fn(|channel| response.respond(channel, mixed[channel]))
            }
            None => mixed,
        }
    }

    /// The calibration of the same camera whose image is scaled by `sx` and `sy`.
    #[must_use]
    pub fn scaled(&self, sx: f64, sy: f64) -> Self {
        let by = [sx, sy];
        let scaled = |of: [f64; 2]| [of[0] * by[0], of[1] * by[1]];
        let vignetting = |vignetting: Vignetting| Vignetting {
            center_px: vignetting.center_px.map(scaled),
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
            center_px: vignetting.center_px.map(|[x, y]| [x - left_px, y - top_px]),
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
    /// positive, the center of a response is not between 0 and 1, or a number is not finite.
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
            if !(finite(center_px.as_flattened())
                && finite(radius_px)
                && finite(rgb.as_flattened()))
            {
                return Err("a number of the vignetting is not finite".into());
            }
            if radius_px.iter().any(|radius_px| *radius_px <= 0.0) {
                return Err(Invalid::new(format!(
                    "radius_px of the vignetting is {radius_px:?}; expected two positive numbers"
                )));
            }
        }
        if self
            .balance
            .is_some_and(|balance| !finite(balance.as_flattened()))
        {
            return Err("a number of the balance is not finite".into());
        }
        if !finite(self.matrix.as_flattened()) {
            return Err("a number of the color matrix is not finite".into());
        }
        check_positive("gamma", self.gamma)?;
        if let Some(response) = self.response {
            check_positive("toe of the response", response.toe)?;
            check_positive("shoulder of the response", response.shoulder)?;
            check_positive("gamma of the response", response.gamma)?;
            let center = response.center;
            if !center.iter().all(|center| *center > 0.0 && *center < 1.0) {
                return Err(Invalid::new(format!(
                    "center of the response is {center:?}; expected three numbers between 0 and 1"
                )));
            }
        }
        Ok(())
    }
}

fn finite(values: &[f64]) -> bool {
    values.iter().all(|value| value.is_finite())
}

fn check_positive(name: &str, values: [f64; 3]) -> Result<(), Invalid> {
    let is_positive = |value: &f64| value.is_finite() && *value > 0.0;
    if values.iter().all(is_positive) {
        Ok(())
    } else {
        Err(Invalid::new(format!(
            "{name} is {values:?}; expected three positive numbers"
        )))
    }
}

/// The color `rgb` after the homography `balance` of its red, its green and its sum, at the sum
/// that it had; black where the homography leaves no sum.
fn balanced(balance: &[[f64; 3]; 3], [red, green, blue]: [f64; 3]) -> [f64; 3] {
    let sum = red + green + blue;
    let [red, green, of_sum] = balance.map(|[a, b, c]| a * red + b * green + c * sum);
    let divisor = of_sum + SUM_LEAST;
    if divisor <= 0.0 {
        return [0.0; 3];
    }
    let scale = sum / divisor;
    let (red, green) = (red * scale, green * scale);
    [red, green, of_sum * scale - red - green]
}

impl Response {
    /// Response of `channel` to `light`.
    #[must_use]
    pub fn respond(&self, channel: usize, light: f64) -> f64 {
        let (toe, shoulder) = (self.toe[channel], self.shoulder[channel]);
        let center = self.center[channel];
        let light = light.clamp(0.0, 1.0);
        let at_center = self.at_center(channel);
        let joined = if light <= center {
            at_center * (light / center).max(RESPONSE_LEAST).powf(toe)
        } else {
            let from_white = (1.0 - light) / (1.0 - center);
            1.0 - (1.0 - at_center) * from_white.max(RESPONSE_LEAST).powf(shoulder)
        };
        joined.max(RESPONSE_LEAST).powf(self.gamma[channel])
    }

    /// Value of the joined curve of `channel` at its center, which gives both parts one slope.
    #[must_use]
    pub fn at_center(&self, channel: usize) -> f64 {
        let (toe, shoulder) = (self.toe[channel], self.shoulder[channel]);
        let center = self.center[channel];
        shoulder * center / (toe + center * (shoulder - toe))
    }
}

impl Vignetting {
    /// Factors of red, green and blue at `at_px`, pixels.
    #[must_use]
    pub fn factors(&self, at_px: [f64; 2]) -> [f64; 3] {
        std::array::from_fn(|channel| {
            let center_px = self.center_px[channel];
            let along = |axis: usize| (at_px[axis] - center_px[axis]) / self.radius_px[axis];
            let r2 = along(0).powi(2) + along(1).powi(2);
            let [a, b, c] = self.rgb[channel];
            (1.0 + r2 * (a + r2 * (b + r2 * c))).clamp(0.0, 1.0)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: Photometry = Photometry {
        exposure_ev: 1.0,
        curve: ColorCurve::Linear,
        vignetting: Some(Vignetting {
            center_px: [[10.0, 20.0]; 3],
            radius_px: [5.0, 10.0],
            rgb: [[-0.5, 0.0, 0.0], [0.0, -0.25, 0.0], [0.0, 0.0, 0.1]],
        }),
        balance: None,
        matrix: [
            [1.0, 0.5, 0.0, 0.25],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.5, -2.0],
        ],
        gamma: [1.0, 0.5, 2.0],
        response: None,
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

    const RESPONSE: Response = Response {
        toe: [1.0, 2.0, 1.4],
        shoulder: [1.0, 0.5, 1.2],
        gamma: [1.0, 1.0, 0.6],
        center: [0.5, 0.5, 0.4],
    };

    #[test]
    fn a_response_joins_its_parts_with_one_slope() {
        // Exponents of 1 are the identity between 0 and 1, and clamp beyond it.
        for (light, expected) in [(-0.5, 1e-6), (0.25, 0.25), (0.75, 0.75), (3.0, 1.0)] {
            let found = RESPONSE.respond(0, light);
            assert!((found - expected).abs() < 1e-6, "{light}: {found}");
        }
        // toe 2, shoulder 0.5, center 0.5: the value there is 0.5 * 0.5 / (2 - 0.75) = 0.2.
        assert!((RESPONSE.at_center(1) - 0.2).abs() < 1e-15);
        assert!((RESPONSE.respond(1, 0.25) - 0.2 * 0.25).abs() < 1e-15);
        assert!((RESPONSE.respond(1, 0.875) - (1.0 - 0.8 * 0.25f64.sqrt())).abs() < 1e-15);
        for channel in 0..3 {
            let at = |light: f64| RESPONSE.respond(channel, light);
            let center = RESPONSE.center[channel];
            let slope = |from: f64, to: f64| (at(to) - at(from)) / (to - from);
            let (below, above) = (slope(center - 1e-6, center), slope(center, center + 1e-6));
            assert!((below - above).abs() < 1e-4, "{below} {above}");
            let lights = (0..=100).map(|step| at(0.01 * f64::from(step)));
            assert!(lights.is_sorted());
        }
    }

    #[test]
    fn a_balance_moves_chromaticity_and_keeps_the_sum() {
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let color = [0.2, 0.5, 0.3];
        for (found, expected) in balanced(&identity, color).iter().zip(color) {
            assert!((found - expected).abs() < 2e-5, "{found} {expected}");
        }
        // Red becomes 1.1 red + 0.05 of the sum; the sum itself 1 + 0.2 green of it.
        let warm = [[1.1, 0.0, 0.05], [0.0, 1.0, 0.0], [0.0, 0.2, 1.0]];
        let found = balanced(&warm, color);
        let expected = [0.27 / 1.1, 0.5 / 1.1, 1.0 - 0.77 / 1.1];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 2e-5, "{found} {expected}");
        }
        assert_eq!(balanced(&warm, [0.0; 3]), [0.0; 3]);
        assert_eq!(
            balanced(&[[0.0; 3], [0.0; 3], [0.0, 0.0, -1.0]], color),
            [0.0; 3]
        );
        // It acts before the matrix.
        let all = Photometry {
            balance: Some(warm),
            matrix: [[2.0, 0.0, 0.0, 0.0], ALL.matrix[1], ALL.matrix[2]],
            ..Photometry::IDENTITY
        };
        assert!((all.color(color, [0.0; 2])[0] - 2.0 * found[0]).abs() < 1e-12);
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
        assert!(with(|all| all.balance = Some([[f64::NAN; 3]; 3])).contains("balance"));
        let response = |change: fn(&mut Response)| {
            let mut changed = (ALL, RESPONSE);
            change(&mut changed.1);
            changed.0.response = Some(changed.1);
            changed.0.check().unwrap_err().to_string()
        };
        assert!(response(|of| of.toe[0] = 0.0).contains("toe"));
        assert!(response(|of| of.shoulder[1] = f64::NAN).contains("shoulder"));
        assert!(response(|of| of.gamma[2] = -1.0).contains("gamma of the response"));
        assert!(response(|of| of.center[2] = 1.0).contains("center"));
        let vignetting = |change: fn(&mut Vignetting)| {
            let mut changed = ALL;
            change(changed.vignetting.as_mut().unwrap());
            changed.check().unwrap_err().to_string()
        };
        assert!(vignetting(|all| all.radius_px[0] = 0.0).contains("radius_px"));
        assert!(vignetting(|all| all.rgb[0][0] = f64::NAN).contains("not finite"));
    }
}
