//! A rendered image against a photograph of the same view.

use serde::Serialize;

use super::{DifferenceError, check_finite, check_sizes, ssim};
use crate::rendered_image::Image;

/// Difference of a rendered image from a photograph, both clamped to 0 to 1, as it is and after one
/// gain per channel: cameras choose their exposure and white balance image by image, which splats
/// do not know.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PhotographDifference {
    /// Pixels that count.
    pub pixels: usize,
    /// Peak signal-to-noise ratio at peak 1, decibels; infinite for equal images.
    pub psnr_db: f64,
    /// Structural similarity over windows that count (Wang et al., 2004); `None` where there are
    /// none.
    pub ssim: Option<f64>,
    /// Factors of the rendered red, green and blue that make the squared difference least.
    pub gain: [f64; 3],
    /// Peak signal-to-noise ratio after the gain, decibels.
    pub gained_psnr_db: f64,
    /// Structural similarity after the gain.
    pub gained_ssim: Option<f64>,
    /// Mean share of light that splats, and not the sky, give the lower half of the image.
    pub lower_half_opacity: f64,
}

impl PhotographDifference {
    /// Difference over the pixels where `counts` is true, of which there is one entry per pixel.
    /// `None` where no pixel counts.
    ///
    /// # Errors
    /// Returns an error if the sizes differ, or a value is NaN or infinite.
    ///
    /// # Panics
    /// Panics if `counts` has not one entry per pixel.
    pub fn between(
        photograph: &Image,
        rendered: &Image,
        counts: &[bool],
    ) -> Result<Option<Self>, DifferenceError> {
        check_sizes(photograph, rendered)?;
        check_finite("first", photograph)?;
        check_finite("second", rendered)?;
        assert_eq!(counts.len(), photograph.rgb.len(), "one entry per pixel");
        let pixels = counts.iter().filter(|counts| **counts).count();
        if pixels == 0 {
            return Ok(None);
        }
        let gain = std::array::from_fn(|channel| {
            least_squares_gain(photograph, rendered, counts, channel)
        });
        let gained = gained(rendered, gain);
        let half = rendered.alpha.len() / 2;
        let lower = &rendered.alpha[half..];
        Ok(Some(Self {
            pixels,
            psnr_db: psnr_db(photograph, rendered, counts),
            ssim: ssim::mean_ssim_where(photograph, rendered, Some(counts)),
            gain,
            gained_psnr_db: psnr_db(photograph, &gained, counts),
            gained_ssim: ssim::mean_ssim_where(photograph, &gained, Some(counts)),
            lower_half_opacity: lower.iter().map(|alpha| f64::from(*alpha)).sum::<f64>()
                / lower.len() as f64,
        }))
    }
}

/// `image` with its channels times `gain`.
fn gained(image: &Image, gain: [f64; 3]) -> Image {
    let pixel = |rgb: &[f32; 3]| {
        std::array::from_fn(|channel| {
            (f64::from(rgb[channel]).clamp(0.0, 1.0) * gain[channel]) as f32
        })
    };
    Image {
        rgb: image.rgb.iter().map(pixel).collect(),
        ..Image::filled(image.width, image.height, [0.0; 3])
    }
}

/// Values of a channel of both images, where they count, 0 to 1.
fn values<'a>(
    a: &'a Image,
    b: &'a Image,
    counts: &'a [bool],
    channel: usize,
) -> impl Iterator<Item = [f64; 2]> + 'a {
    let value = move |rgb: &[f32; 3]| f64::from(rgb[channel]).clamp(0.0, 1.0);
    let both = a.rgb.iter().zip(&b.rgb).zip(counts);
    both.filter(|(_, counts)| **counts)
        .map(move |((a, b), _)| [value(a), value(b)])
}

/// Factor of `rendered` that makes the sum of squared differences least; 1 for a black channel.
fn least_squares_gain(
    photograph: &Image,
    rendered: &Image,
    counts: &[bool],
    channel: usize,
) -> f64 {
    let (mut product, mut square) = (0.0, 0.0);
    for [wanted, found] in values(photograph, rendered, counts, channel) {
        product += wanted * found;
        square += found * found;
    }
    if square > 0.0 { product / square } else { 1.0 }
}

fn psnr_db(a: &Image, b: &Image, counts: &[bool]) -> f64 {
    let (mut sum, mut count) = (0.0, 0_u64);
    for channel in 0..3 {
        for [a, b] in values(a, b, counts, channel) {
            sum += (a - b) * (a - b);
            count += 1;
        }
    }
    -10.0 * (sum / count as f64).log10()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ramp with a little noise, so that no window is flat.
    fn ramp(factor: f32) -> Image {
        let mut image = Image::filled(32, 24, [0.0; 3]);
        for (at, rgb) in image.rgb.iter_mut().enumerate() {
            let value = 0.1 + 0.5 * (at % 32) as f32 / 32.0 + 0.05 * (at * 7 % 13) as f32 / 13.0;
            *rgb = [factor * value, value, 0.5 * value];
        }
        image
    }

    #[test]
    fn equal_images_have_no_difference_and_a_gain_is_found() {
        let (photograph, all) = (ramp(1.0), vec![true; 32 * 24]);
        let same = PhotographDifference::between(&photograph, &photograph, &all)
            .unwrap()
            .unwrap();
        assert!(
            same.psnr_db.is_infinite() && same.ssim == Some(1.0),
            "{same:?}"
        );
        assert_eq!((same.gain, same.pixels), ([1.0; 3], 32 * 24));
        let darker = ramp(0.5);
        let found = PhotographDifference::between(&photograph, &darker, &all)
            .unwrap()
            .unwrap();
        assert!(
            (found.gain[0] - 2.0).abs() < 1e-6 && found.gain[1] == 1.0,
            "{found:?}"
        );
        // Half of the red is missing: the mean of its squared quarter over three channels.
        let square: f64 = photograph
            .rgb
            .iter()
            .map(|rgb| f64::from(0.5 * rgb[0]).powi(2))
            .sum();
        let expected_db = -10.0 * (square / (3.0 * 32.0 * 24.0)).log10();
        assert!((found.psnr_db - expected_db).abs() < 1e-4, "{found:?}");
        assert!(found.gained_psnr_db > 120.0 && found.gained_ssim > Some(0.999_999));
        assert!(found.ssim < Some(0.99), "the comparison tells images apart");
    }

    #[test]
    fn pixels_that_do_not_count_change_nothing() {
        let photograph = ramp(1.0);
        let mut rendered = ramp(0.9);
        let mut counts = vec![true; 32 * 24];
        counts[3 * 32 + 5] = false;
        let before = PhotographDifference::between(&photograph, &rendered, &counts).unwrap();
        rendered.rgb[3 * 32 + 5] = [1.0, 0.0, 1.0];
        assert_eq!(
            PhotographDifference::between(&photograph, &rendered, &counts).unwrap(),
            before
        );
        counts[3 * 32 + 5] = true;
        assert_ne!(
            PhotographDifference::between(&photograph, &rendered, &counts).unwrap(),
            before
        );
        let none = PhotographDifference::between(&photograph, &rendered, &[false; 32 * 24]);
        assert_eq!(none.unwrap(), None);
    }
}
