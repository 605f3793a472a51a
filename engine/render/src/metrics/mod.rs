//! Differences between images.
//!
//! Max abs, RMSE, PSNR and the share of channels are of the values as blended, unclamped; SSIM and
//! FLIP model what is seen on a display, so they clamp to 0 to 1. Peak is 1. An image with a value
//! that is not a number has no score: it is an error.

mod false_color;
mod flip;
mod flips;
mod masked;
mod photograph;
mod ssim;

pub use false_color::difference_image;
pub use flip::PIXELS_PER_DEGREE;
pub use flips::{FLIP_MIN, Flips, WORST_PIXELS};
pub use masked::{MaskedDifference, MaskedErrors, Peak};
pub use photograph::PhotographDifference;

use serde::{Serialize, Serializer};

use crate::rendered_image::Image;

/// One level of an 8-bit image. A channel is 'off' where it differs by more.
const LEVEL: f64 = 1.0 / 255.0;

/// Added to [`LEVEL`]: two neighboring levels read from 8-bit files differ by one level and the
/// rounding of both to f32.
const LEVEL_ROUNDING: f64 = 1e-6;

/// The error of an image against another, over all pixels and the channels R, G and B. Symmetric in
/// the two.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Largest absolute difference of a channel.
    pub max_abs: f64,
    /// Root of the mean squared difference of the channels.
    pub rmse: f64,
    /// Peak signal-to-noise ratio in decibels at peak 1, `-20 log10(rmse)`. Infinite for equal
    /// images; serialized as null then.
    #[serde(serialize_with = "null_where_infinite")]
    pub psnr_db: f64,
    /// Structural similarity, mean over channels and over all windows inside the image (Wang et
    /// al., 2004); 1 for equal images. `None` where no window of 11 by 11 pixels fits.
    pub ssim: Option<f64>,
    /// Mean of the FLIP map at [`PIXELS_PER_DEGREE`] (Andersson et al., 2020); 0 for equal images,
    /// at most 1.
    pub flip: f64,
    /// Share of channels, 0 to 1, that differ by more than 1/255.
    pub share_off: f64,
}

/// Reason why two images have no difference.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DifferenceError {
    /// The images are not of one size.
    #[error("the first image has {}x{} pixels and the second {}x{}: render both at one size", first[0], first[1], second[0], second[1])]
    Sizes {
        /// Width and height of the first.
        first: [u32; 2],
        /// Width and height of the second.
        second: [u32; 2],
    },
    /// An image holds a value that is NaN or infinite, so nothing can be said for it.
    #[error(
        "the {which} image has {count} values that are not finite numbers, the first at column {column}, row {row}"
    )]
    NotFinite {
        /// `first` or `second`.
        which: &'static str,
        /// Number of values of RGB, alpha and depth.
        count: usize,
        /// Column of one of them, from the left.
        column: u32,
        /// Row of the same, from the top.
        row: u32,
    },
}

impl Difference {
    /// Difference between `a` and `b`. Only their colors are compared.
    ///
    /// # Errors
    /// Returns an error if their sizes differ, or a value of either (alpha and depth too) is NaN or
    /// infinite.
    pub fn between(a: &Image, b: &Image) -> Result<Self, DifferenceError> {
        check_sizes(a, b)?;
        check_finite("first", a)?;
        check_finite("second", b)?;
        let (mut max_abs, mut square_sum, mut off) = (0.0f64, 0.0, 0u64);
        for (a, b) in a.rgb.iter().flatten().zip(b.rgb.iter().flatten()) {
            let difference = (f64::from(*a) - f64::from(*b)).abs();
            max_abs = max_abs.max(difference);
            square_sum += difference * difference;
            off += u64::from(difference > LEVEL + LEVEL_ROUNDING);
        }
        let channels = 3.0 * a.rgb.len() as f64;
        let rmse = (square_sum / channels).sqrt();
        Ok(Self {
            max_abs,
            rmse,
            psnr_db: -20.0 * rmse.log10(),
            ssim: ssim::mean_ssim(a, b),
            flip: flip::mean_flip(a, b),
            share_off: off as f64 / channels,
        })
    }
}

fn null_where_infinite<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    if value.is_finite() {
        serializer.serialize_some(value)
    } else {
        serializer.serialize_none()
    }
}

fn check_sizes(a: &Image, b: &Image) -> Result<(), DifferenceError> {
    let (first, second) = ([a.width, a.height], [b.width, b.height]);
    if first == second {
        Ok(())
    } else {
        Err(DifferenceError::Sizes { first, second })
    }
}

fn check_finite(which: &'static str, image: &Image) -> Result<(), DifferenceError> {
    let depth = image.depth().into_iter().flatten().enumerate();
    let mut faults = (image
        .rgb
        .iter()
        .flatten()
        .enumerate()
        .map(|(at, value)| (at / 3, value)))
    .chain(image.alpha.iter().enumerate())
    .chain(depth)
    .filter(|(_, value)| !value.is_finite())
    .map(|(pixel, _)| pixel as u32);
    match faults.next() {
        None => Ok(()),
        Some(pixel) => Err(DifferenceError::NotFinite {
            which,
            count: 1 + faults.count(),
            column: pixel % image.width,
            row: pixel / image.width,
        }),
    }
}

/// One channel of an image clamped to 0 to 1, row-major.
fn clamped_channel(image: &Image, channel: usize) -> Vec<f64> {
    image
        .rgb
        .iter()
        .map(|rgb| f64::from(rgb[channel]).clamp(0.0, 1.0))
        .collect()
}

#[cfg(test)]
mod tests;
