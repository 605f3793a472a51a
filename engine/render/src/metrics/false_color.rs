//! False-color image of the differences between two images.

use super::{DifferenceError, check_sizes};
use crate::rendered_image::Image;

/// Colors from no error to an error of 1 and more after amplification, at equal steps: black, blue,
/// magenta, orange, white.
const RAMP: [[f32; 3]; 5] = [
    [0.0, 0.0, 0.0],
    [0.1, 0.15, 0.75],
    [0.8, 0.1, 0.55],
    [1.0, 0.65, 0.1],
    [1.0, 1.0, 1.0],
];

/// A value that is not a number: on no ramp.
const NOT_FINITE_RGB: [f32; 3] = [0.0, 1.0, 0.0];

/// The largest absolute difference of a pixel's channels times `gain`, in false colors: black where
/// equal, white from 1 on, bright green where either image has a value that is NaN or infinite.
///
/// # Errors
/// Returns an error if the sizes differ.
pub fn difference_image(a: &Image, b: &Image, gain: f32) -> Result<Image, DifferenceError> {
    check_sizes(a, b)?;
    let color = |(a, b): (&[f32; 3], &[f32; 3])| {
        if a.iter().chain(b).any(|value| !value.is_finite()) {
            return NOT_FINITE_RGB;
        }
        ramp(
            gain * (0..3)
                .map(|channel| (a[channel] - b[channel]).abs())
                .fold(0.0, f32::max),
        )
    };
    let mut image = Image::filled(a.width, a.height, [0.0; 3]);
    image.rgb = a.rgb.iter().zip(&b.rgb).map(color).collect();
    Ok(image)
}

fn ramp(error: f32) -> [f32; 3] {
    let position = error.clamp(0.0, 1.0) * (RAMP.len() - 1) as f32;
    let below = (position as usize).min(RAMP.len() - 2);
    let share = position - below as f32;
    std::array::from_fn(|channel| {
        RAMP[below][channel] * (1.0 - share) + RAMP[below + 1][channel] * share
    })
}
