//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli, Image Quality Assessment: From Error
//! Visibility to Structural Similarity, 2004): windows of 11 by 11 weighted by a Gaussian of 1.5
//! pixels, K1 = 0.01, K2 = 0.03, peak 1.

use rayon::prelude::*;

use super::clamped_channel;
use crate::rendered_image::Image;

const RADIUS_PX: usize = 5;
const SIGMA_PX: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Mean over R, G and B and over all windows that lie inside the image; `None` where none does.
pub fn mean_ssim(a: &Image, b: &Image) -> Option<f64> {
    mean_ssim_where(a, b, None)
}

/// [`mean_ssim`], over windows all of whose pixels count.
pub fn mean_ssim_where(a: &Image, b: &Image, counts: Option<&[bool]>) -> Option<f64> {
    let (width, height) = (a.width as usize, a.height as usize);
    if width <= 2 * RADIUS_PX || height <= 2 * RADIUS_PX {
        return None;
    }
    // Windows that hold a pixel that does not count.
    let left_out = counts.map(|counts| {
        let left_out: Vec<f64> = counts.iter().map(|counts| f64::from(!counts)).collect();
        windowed_mean(&left_out, width)
    });
    let is_left_out = |at: usize| left_out.as_ref().is_some_and(|of| of[at] > 0.0);
    let of_channel = |channel| {
        let (x, y) = (clamped_channel(a, channel), clamped_channel(b, channel));
        let local_mean = |value: fn(f64, f64) -> f64| {
            let values: Vec<f64> = x.iter().zip(&y).map(|(&x, &y)| value(x, y)).collect();
            windowed_mean(&values, width)
        };
        let (mean_x, mean_y) = (local_mean(|x, _| x), local_mean(|_, y| y));
        let (mean_xx, mean_yy, mean_xy) = (
            local_mean(|x, _| x * x),
            local_mean(|_, y| y * y),
            local_mean(|x, y| x * y),
        );
        let (mut sum, mut windows) = (0.0, 0_u64);
        for at in (0..mean_x.len()).filter(|at| !is_left_out(*at)) {
            windows += 1;
            let (mx, my) = (mean_x[at], mean_y[at]);
            let (variance_x, variance_y, covariance) = (
                mean_xx[at] - mx * mx,
                mean_yy[at] - my * my,
                mean_xy[at] - mx * my,
            );
            sum += (2.0 * mx * my + C1) * (2.0 * covariance + C2)
                / ((mx * mx + my * my + C1) * (variance_x + variance_y + C2));
        }
        (windows > 0).then(|| sum / windows as f64)
    };
    let channels: Option<Vec<f64>> = (0..3).map(of_channel).collect();
    Some(channels?.iter().sum::<f64>() / 3.0)
}

/// The Gaussian mean of every window that lies inside, row-major.
fn windowed_mean(values: &[f64], width: usize) -> Vec<f64> {
    let weights = window_weights();
    let taps = weights.len();
    let across: Vec<f64> = values
        .par_chunks_exact(width)
        .flat_map_iter(|row| {
            row.windows(taps).map(|window| {
                window
                    .iter()
                    .zip(&weights)
                    .map(|(value, weight)| value * weight)
                    .sum()
            })
        })
        .collect();
    let columns = width + 1 - taps;
    let rows = values.len() / width + 1 - taps;
    (0..rows * columns)
        .into_par_iter()
        .map(|at| {
            weights
                .iter()
                .enumerate()
                .map(|(tap, weight)| across[at + tap * columns] * weight)
                .sum()
        })
        .collect()
}

fn window_weights() -> [f64; 2 * RADIUS_PX + 1] {
    let gaussian: [f64; 2 * RADIUS_PX + 1] = std::array::from_fn(|tap| {
        let offset = tap as f64 - RADIUS_PX as f64;
        (-0.5 * (offset / SIGMA_PX).powi(2)).exp()
    });
    let sum: f64 = gaussian.iter().sum();
    gaussian.map(|weight| weight / sum)
}
