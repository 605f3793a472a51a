//! Differences of images inside a mask: brightness and hue of inserted objects (DecoupleGS,
//! supplement 'Photometric Realism Metrics'), with choices that the paper leaves open: the
//! signal-to-noise ratio is of the mean over channels, hue ignores dark pixels, and each peak,
//! which is one pixel, comes with its quantiles.

use decouplegs_scene::light::LUMA;
use serde::Serialize;

use super::{DifferenceError, check_finite, check_sizes, null_where_infinite};
use crate::rendered_image::Image;

/// Errors over the pixels of masks, of one image or of many.
#[derive(Clone, Debug)]
pub struct MaskedErrors {
    floor: f64,
    square_sum: f64,
    /// Luminance error of every pixel.
    intensities: Vec<f64>,
    /// Hue error of every pixel that is bright enough, degrees.
    angles_deg: Vec<f64>,
}

/// A peak, and what it hides.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Peak {
    /// Error of the worst pixel.
    pub max: f64,
    /// Error that 99 % of the pixels stay below.
    pub p99: f64,
    /// Error that 95 % of the pixels stay below.
    pub p95: f64,
    /// Mean error.
    pub mean: f64,
}

/// Summary of [`MaskedErrors`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MaskedDifference {
    /// Pixels in the masks.
    pub pixels: usize,
    /// Signal-to-noise ratio from the mean squared error of the channels, decibels at peak 1;
    /// infinite for equal images, serialized as null then.
    #[serde(serialize_with = "null_where_infinite")]
    pub psnr_db: f64,
    /// Error of luminance: PIE is its `max`.
    pub intensity: Peak,
    /// Angle between the colors as vectors, degrees: PAE is its `max`. `None` where no pixel is
    /// bright enough.
    pub angle_deg: Option<Peak>,
    /// Pixels that were bright enough to have a hue.
    pub bright: usize,
}

impl MaskedErrors {
    /// None yet. Pixels whose true color is shorter than `floor` as a vector, of at most sqrt(3),
    /// have no hue.
    #[must_use]
    pub fn new(floor: f64) -> Self {
        Self {
            floor: floor.max(1e-9),
            square_sum: 0.0,
            intensities: Vec::new(),
            angles_deg: Vec::new(),
        }
    }

    /// Adds the errors of `found` against `truth` where `in_mask` is true of the pixel, counted row
    /// by row.
    ///
    /// # Errors
    /// Returns an error if sizes differ or a value is not finite.
    pub fn add(
        &mut self,
        found: &Image,
        truth: &Image,
        in_mask: impl Fn(usize) -> bool,
    ) -> Result<(), DifferenceError> {
        check_sizes(found, truth)?;
        check_finite("first", found)?;
        check_finite("second", truth)?;
        for (_, (found, truth)) in found
            .rgb
            .iter()
            .zip(&truth.rgb)
            .enumerate()
            .filter(|(pixel, _)| in_mask(*pixel))
        {
            let [found, truth] = [found, truth].map(|rgb| rgb.map(f64::from));
            self.square_sum += found
                .iter()
                .zip(truth)
                .map(|(a, b)| (a - b).powi(2))
                .sum::<f64>();
            let intensity: f64 = found
                .iter()
                .zip(truth)
                .zip(LUMA)
                .map(|((a, b), weight)| weight * (a - b))
                .sum();
            self.intensities.push(intensity.abs());
            self.angles_deg.extend(angle_deg(found, truth, self.floor));
        }
        Ok(())
    }

    /// Summarizes the errors; `None` if no pixel was in a mask.
    #[must_use]
    pub fn finish(mut self) -> Option<MaskedDifference> {
        let pixels = self.intensities.len();
        let intensity = peak(&mut self.intensities)?;
        Some(MaskedDifference {
            pixels,
            psnr_db: -10.0 * (self.square_sum / (3 * pixels) as f64).log10(),
            intensity,
            bright: self.angles_deg.len(),
            angle_deg: peak(&mut self.angles_deg),
        })
    }
}

/// The angle between two colors; `None` where the true one is dark. Black where there is color is
/// off by a right angle, as far as two colors can be.
fn angle_deg(found: [f64; 3], truth: [f64; 3], floor: f64) -> Option<f64> {
    let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let length = dot(truth, truth).sqrt();
    if length < floor {
        return None;
    }
    let found_length = dot(found, found).sqrt();
    if found_length == 0.0 {
        return Some(90.0);
    }
    // From the cross product: the arc cosine knows nothing of angles below 1e-8.
    let [a, b] = [found, truth];
    let cross = [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ];
    Some(dot(cross, cross).sqrt().atan2(dot(a, b)).to_degrees())
}

fn peak(values: &mut [f64]) -> Option<Peak> {
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    let at = |share: f64| {
        values[((share * values.len() as f64).ceil() as usize)
            .saturating_sub(1)
            .min(last)]
    };
    Some(Peak {
        max: values[last],
        p99: at(0.99),
        p95: at(0.95),
        mean: values.iter().sum::<f64>() / values.len() as f64,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A hundred pixels of one color, and the first of another.
    fn images(first: [f32; 3], rest: [f32; 3]) -> Image {
        let mut image = Image::filled(10, 10, rest);
        image.rgb[0] = first;
        image
    }

    fn difference(
        found: &Image,
        truth: &Image,
        in_mask: impl Fn(usize) -> bool,
    ) -> Option<MaskedDifference> {
        let mut errors = MaskedErrors::new(0.05);
        errors.add(found, truth, in_mask).unwrap();
        errors.finish()
    }

    #[test]
    fn peaks_are_of_one_pixel_and_quantiles_are_not() {
        let truth = images([0.5; 3], [0.5; 3]);
        let found = images([0.5, 0.0, 0.0], [0.6; 3]);
        let masked = difference(&found, &truth, |_| true).unwrap();
        let angle = masked.angle_deg.unwrap();
        // Red against gray: cos = 1 / sqrt(3). A gray that is brighter has the same hue.
        assert!(
            (angle.max - 54.735_61).abs() < 1e-4
                && angle.p99 < 1e-4
                && (angle.mean - 0.547_356).abs() < 1e-4
        );
        assert!(
            (masked.intensity.max - 0.5 * (1.0 - 0.2126)).abs() < 1e-6
                && (masked.intensity.p95 - 0.1).abs() < 1e-6
        );
        let mean_square = (0.5f64.powi(2) * 2.0 + 99.0 * 3.0 * 0.01) / 300.0;
        assert!(
            (masked.psnr_db + 10.0 * mean_square.log10()).abs() < 1e-4,
            "the mean over channels, not their sum"
        );
    }

    #[test]
    fn only_the_mask_counts_and_only_light_has_a_hue() {
        let truth = images([0.0, 0.0, 0.02], [0.5; 3]);
        let found = images([0.02, 0.0, 0.0], [0.1, 0.9, 0.1]);
        let masked = difference(&found, &truth, |pixel| pixel == 0).unwrap();
        assert_eq!(
            (masked.pixels, masked.bright, masked.angle_deg),
            (1, 0, None)
        );
        assert!(masked.intensity.max < 0.01);
        assert!(difference(&found, &truth, |_| false).is_none());
        let black = images([0.0; 3], [0.0; 3]);
        assert_eq!(
            difference(&black, &truth, |pixel| pixel > 0)
                .unwrap()
                .angle_deg
                .unwrap()
                .max,
            90.0
        );
        let equal = difference(&truth, &truth, |_| true).unwrap();
        assert_eq!(
            (
                equal.psnr_db,
                equal.intensity.max,
                equal.angle_deg.unwrap().max
            ),
            (f64::INFINITY, 0.0, 0.0)
        );
    }

    #[test]
    fn images_that_cannot_be_compared_are_refused() {
        let mut errors = MaskedErrors::new(0.05);
        assert!(
            errors
                .add(
                    &Image::filled(2, 2, [0.5; 3]),
                    &Image::filled(3, 2, [0.5; 3]),
                    |_| true
                )
                .is_err()
        );
        let mut broken = Image::filled(2, 2, [0.5; 3]);
        broken.rgb[1][1] = f32::NAN;
        assert!(
            errors
                .add(&broken, &Image::filled(2, 2, [0.5; 3]), |_| true)
                .unwrap_err()
                .to_string()
                .contains("not finite")
        );
        assert!(errors.finish().is_none());
    }
}
