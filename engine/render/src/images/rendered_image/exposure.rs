//! Motion blur: the mean of sharp images over the time of an exposure.

use decouplegs_scene::photometry::{ColorCurve, DISPLAY_GAMMA};

use super::Image;

/// Times of `count` sub-exposures of an exposure of `exposure_s`, seconds from its middle: the
/// middles of equal parts.
pub fn sub_exposures_s(exposure_s: f64, count: u32) -> impl Iterator<Item = f64> {
    let share = move |index: u32| (f64::from(index) + 0.5) / f64::from(count) - 0.5;
    (0..count).map(move |index| exposure_s * share(index))
}

/// Sum of the light of sub-exposures.
pub struct ExposureSum {
    /// Exponent from colors to light.
    gamma: f64,
    images: u32,
    rgb: Vec<[f64; 3]>,
    alpha: Vec<f64>,
}

impl ExposureSum {
    /// No light yet on an image of `pixels`, whose colors have the meaning `curve`:
    /// display-referred ones are light to the power of 1 / 2.2.
    #[must_use]
    pub fn new(pixels: usize, curve: ColorCurve) -> Self {
        Self {
            gamma: match curve {
                ColorCurve::Display => DISPLAY_GAMMA,
                ColorCurve::Linear => 1.0,
            },
            images: 0,
            rgb: vec![[0.0; 3]; pixels],
            alpha: vec![0.0; pixels],
        }
    }

    /// Adds a sub-exposure. Negative values are no light.
    ///
    /// # Panics
    /// Panics if `image` has other pixels.
    pub fn add(&mut self, image: &Image) {
        assert_eq!(self.rgb.len(), image.rgb.len());
        self.images += 1;
        for (sum, rgb) in self.rgb.iter_mut().zip(&image.rgb) {
            for (sum, value) in sum.iter_mut().zip(rgb) {
                *sum += f64::from(*value).max(0.0).powf(self.gamma);
            }
        }
        for (sum, alpha) in self.alpha.iter_mut().zip(&image.alpha) {
            *sum += f64::from(*alpha);
        }
    }

    /// `sharp`, the image of the middle of the exposure, with the mean color and alpha of all
    /// sub-exposures. Planes stay.
    #[must_use]
    pub fn applied(self, sharp: Image) -> Image {
        let share = 1.0 / f64::from(self.images.max(1));
        let color = |sum: [f64; 3]| sum.map(|sum| (share * sum).powf(1.0 / self.gamma) as f32);
        let alpha = |sum: f64| (share * sum) as f32;
        Image {
            rgb: self.rgb.into_iter().map(color).collect(),
            alpha: self.alpha.into_iter().map(alpha).collect(),
            ..sharp
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sub_exposures_lie_evenly_around_the_middle() {
        let times: Vec<f64> = sub_exposures_s(0.08, 4).collect();
        for (found, expected) in times.iter().zip([-0.03, -0.01, 0.01, 0.03]) {
            assert!((found - expected).abs() < 1e-15, "{times:?}");
        }
    }

    #[test]
    fn light_is_averaged_and_not_color() {
        let blurred = |curve| {
            let mut sum = ExposureSum::new(2, curve);
            sum.add(&Image::filled(2, 1, [1.0, 0.25, -1.0]));
            sum.add(&Image::filled(2, 1, [0.0, 0.25, 0.5]));
            sum.applied(Image::filled(2, 1, [0.0; 3])).rgb[1]
        };
        let linear = blurred(ColorCurve::Linear);
        assert_eq!(linear, [0.5, 0.25, 0.25]);
        let display = blurred(ColorCurve::Display);
        let half = 0.5f64.powf(1.0 / DISPLAY_GAMMA);
        for (found, expected) in display.into_iter().zip([half, 0.25, 0.5 * half]) {
            assert!((f64::from(found) - expected).abs() < 1e-6, "{display:?}");
        }
    }
}
