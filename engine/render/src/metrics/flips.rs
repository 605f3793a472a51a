//! Pixels where rounding decided otherwise than the definition.

use serde::Serialize;

use super::{DifferenceError, check_finite, check_sizes, null_where_infinite};
use crate::rendered_image::Image;

/// Difference of a channel above which a pixel counts as flipped. Rounding of sums and colors moves
/// a pixel by some 1e-6; a splat that is counted on one side of alpha >= 1/255 and not on the other
/// moves it by up to 0.004, by less than this behind what is nearly opaque.
pub const FLIP_MIN: f64 = 2e-5;

/// Pixels that [`Flips::psnr_without_worst_db`] leaves out.
pub const WORST_PIXELS: usize = 100;

/// The error of an image against another, with and without the pixels that flipped: a few carry
/// nearly all of the squared error of an image that is otherwise exact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Flips {
    /// Pixels with a channel that differs by more than [`FLIP_MIN`].
    pub pixels: usize,
    /// Share of such pixels, 0 to 1.
    pub share: f64,
    /// PSNR of all other pixels, decibels at peak 1; infinite where they are equal, serialized as
    /// null then.
    #[serde(serialize_with = "null_where_infinite")]
    pub psnr_without_db: f64,
    /// PSNR without the [`WORST_PIXELS`] of the largest squared error, likewise.
    #[serde(serialize_with = "null_where_infinite")]
    pub psnr_without_worst_db: f64,
}

impl Flips {
    /// Flips between `a` and `b`. Only their colors are compared.
    ///
    /// # Errors
    /// Returns an error if their sizes differ, or a value of either (alpha and depth too) is NaN or
    /// infinite.
    pub fn between(a: &Image, b: &Image) -> Result<Self, DifferenceError> {
        check_sizes(a, b)?;
        check_finite("first", a)?;
        check_finite("second", b)?;
        let mut squares = Vec::with_capacity(a.rgb.len());
        let (mut pixels, mut small_sum) = (0usize, 0.0f64);
        for (a, b) in a.rgb.iter().zip(&b.rgb) {
            let apart: [f64; 3] =
                std::array::from_fn(|channel| f64::from(a[channel]) - f64::from(b[channel]));
            let square: f64 = apart.iter().map(|difference| difference * difference).sum();
            if apart.iter().any(|difference| difference.abs() > FLIP_MIN) {
                pixels += 1;
            } else {
                small_sum += square;
            }
            squares.push(square);
        }
        let count = squares.len();
        squares.sort_unstable_by(f64::total_cmp);
        let kept = count.saturating_sub(WORST_PIXELS);
        let psnr_db = |sum: f64, count: usize| match count {
            0 => f64::INFINITY,
            _ => -10.0 * (sum / (3.0 * count as f64)).log10(),
        };
        Ok(Self {
            pixels,
            share: pixels as f64 / count as f64,
            psnr_without_db: psnr_db(small_sum, count - pixels),
            psnr_without_worst_db: psnr_db(squares[..kept].iter().sum(), kept),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flipped_pixels_are_counted_and_left_out() {
        let black = Image::filled(20, 10, [0.0; 3]);
        let mut image = Image::filled(20, 10, [1e-6; 3]);
        for pixel in 0..3 {
            image.rgb[7 * pixel][pixel] = 0.004;
        }
        let flips = Flips::between(&image, &black).unwrap();
        assert_eq!((flips.pixels, flips.share), (3, 0.015));
        assert!((flips.psnr_without_db - 120.0).abs() < 1e-3, "{flips:?}");
        assert!(
            (flips.psnr_without_worst_db - 120.0).abs() < 1e-3,
            "{flips:?}"
        );
    }

    #[test]
    fn small_and_equal_images_have_no_error_left() {
        let black = Image::filled(2, 1, [0.0; 3]);
        let flips = Flips::between(&black, &black).unwrap();
        assert_eq!((flips.pixels, flips.share), (0, 0.0));
        assert!(flips.psnr_without_db.is_infinite() && flips.psnr_without_worst_db.is_infinite());
        assert!(Flips::between(&black, &Image::filled(1, 2, [0.0; 3])).is_err());
    }
}
