//! Fog: light that is lost on the way to a camera, and light that the air adds.

use crate::Invalid;

/// Distance at which fog hides the sky, unless a scene says otherwise, meters.
const SKY_RANGE_M: f64 = 1000.0;

/// Even fog. A splat of color c at the distance r is seen as c e^(-βr) + a (1 - e^(-βr)), by the
/// law of Koschmieder (1924), with the extinction β and the color a of the air.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fog {
    /// Extinction β, per meter; 3 / β is about the distance at which dark things vanish.
    pub extinction_per_m: f64,
    /// Color a of the air, display-referred RGB.
    pub color: [f64; 3],
    /// Distance at which the sky counts, meters: fog does not reach up for ever.
    pub sky_range_m: f64,
}

impl Fog {
    /// Fog of a color, which hides the sky as it hides what is 1000 m away.
    #[must_use]
    pub fn new(extinction_per_m: f64, color: [f64; 3]) -> Self {
        Self {
            extinction_per_m,
            color,
            sky_range_m: SKY_RANGE_M,
        }
    }

    /// Share of light that is left after `range_m` meters.
    #[must_use]
    pub fn left(&self, range_m: f64) -> f64 {
        (-self.extinction_per_m * range_m).exp()
    }

    /// Color of what has the color `rgb` at `range_m` meters.
    #[must_use]
    pub fn seen(&self, rgb: [f64; 3], range_m: f64) -> [f64; 3] {
        let left = self.left(range_m);
        std::array::from_fn(|channel| left * rgb[channel] + (1.0 - left) * self.color[channel])
    }

    /// Color of the sky where it has the color `rgb` in clear air.
    #[must_use]
    pub fn seen_sky(&self, rgb: [f64; 3]) -> [f64; 3] {
        self.seen(rgb, self.sky_range_m)
    }

    /// Checks that all numbers can be used.
    ///
    /// # Errors
    /// Returns an error if the extinction or the distance of the sky is negative, or a number is
    /// not finite.
    pub fn check(&self) -> Result<(), Invalid> {
        let lengths = [
            ("extinction_per_m", self.extinction_per_m),
            ("sky_range_m", self.sky_range_m),
        ];
        if let Some((name, value)) = lengths
            .into_iter()
            .find(|(_, value)| !(value.is_finite() && *value >= 0.0))
        {
            return Err(Invalid::new(format!(
                "{name} is {value}; expected a finite number of at least 0"
            )));
        }
        if !self.color.iter().all(|value| value.is_finite()) {
            return Err("a number of the color is not finite".into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fog_hides_by_distance() {
        let fog = Fog::new(0.1, [0.5, 0.6, 0.7]);
        assert_eq!(fog.seen([0.1, 0.2, 0.3], 0.0), [0.1, 0.2, 0.3]);
        let half_m = 2.0f64.ln() / 0.1;
        let half = fog.seen([0.1, 0.2, 0.3], half_m);
        for (found, expected) in half.into_iter().zip([0.3, 0.4, 0.5]) {
            assert!((found - expected).abs() < 1e-12);
        }
        assert_eq!(fog.seen([9.0; 3], 1e6), fog.color);
        let clear = Fog::new(0.0, fog.color);
        assert_eq!(clear.seen([0.1, 0.2, 0.3], 1e6), [0.1, 0.2, 0.3]);
    }

    #[test]
    fn numbers_that_cannot_be_used_are_refused() {
        let fog = Fog::new(0.1, [0.5; 3]);
        assert_eq!(fog.check(), Ok(()));
        let message = |fog: Fog| fog.check().unwrap_err().to_string();
        let negative = Fog {
            extinction_per_m: -0.1,
            ..fog
        };
        assert!(message(negative).contains("extinction_per_m is -0.1"));
        let endless = Fog {
            sky_range_m: f64::INFINITY,
            ..fog
        };
        assert!(message(endless).contains("sky_range_m is inf"));
        assert!(message(Fog::new(0.1, [f64::NAN; 3])).contains("color"));
    }
}
