//! FLIP for low dynamic range images (Andersson, Nilsson, Akenine-Möller, Oskarsson, Åström and
//! Fairchild, FLIP: A Difference Evaluator for Alternating Images, 2020): the error that is seen
//! when the two images take turns on a display.
//!
//! Images are taken as sRGB. Colors are blurred as the eye blurs them and compared in Hunt-adjusted
//! CIELAB; edges and points of the unblurred luminance raise the error where structure differs.
//! Written from the paper; every filter of it is a sum of products of one-dimensional ones.

use std::f64::consts::PI;

use rayon::prelude::*;

use super::clamped_channel;
use crate::rendered_image::Image;

/// Pixels per degree of the observer's view: a display 0.7 m wide with 3840 pixels seen from 0.7 m,
/// the paper's default.
pub const PIXELS_PER_DEGREE: f64 = 3840.0 * PI / 180.0;

/// Exponent of the color difference.
const COLOR_EXPONENT: f64 = 0.7;
/// Share of the largest color difference up to which errors are spread over 0 to [`ERROR_AT_KNEE`].
const KNEE: f64 = 0.4;
const ERROR_AT_KNEE: f64 = 0.95;
/// Exponent of the feature difference.
const FEATURE_EXPONENT: f64 = 0.5;
/// Width of the feature detectors, degrees.
const FEATURE_WIDTH_DEG: f64 = 0.082;

/// Contrast sensitivity of each channel of YCxCz as a sum of Gaussians `a sqrt(pi / b) exp(-pi^2
/// d^2 / b)`, d in degrees: pairs (a, b) for luminance, red-green and blue-yellow.
const SENSITIVITY: [&[(f64, f64)]; 3] = [
    &[(1.0, 0.0047)],
    &[(1.0, 0.0053)],
    &[(34.1, 0.04), (13.5, 0.025)],
];
/// Largest b, which tells how far all three filters reach.
const SENSITIVITY_B_MAX: f64 = 0.04;

type Plane = Vec<f64>;

/// Mean of the FLIP map of two images of one size, 0 to 1.
pub fn mean_flip(a: &Image, b: &Image) -> f64 {
    let (first, second) = (Seen::new(a), Seen::new(b));
    let color_max = hyab(hunt_lab([0.0, 1.0, 0.0]), hunt_lab([0.0, 0.0, 1.0])).powf(COLOR_EXPONENT);
    let error_of = |at: usize| {
        let color = color_error(
            hyab(first.lab[at], second.lab[at]).powf(COLOR_EXPONENT),
            color_max,
        );
        let edge = (first.edge[at] - second.edge[at]).abs();
        let point = (first.point[at] - second.point[at]).abs();
        let feature = (edge.max(point) / std::f64::consts::SQRT_2).powf(FEATURE_EXPONENT);
        color.powf(1.0 - feature)
    };
    let errors: Vec<f64> = (0..first.lab.len()).into_par_iter().map(error_of).collect();
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// An image as an observer has it.
struct Seen {
    /// Hunt-adjusted L*a*b* of the blurred colors.
    lab: Vec<[f64; 3]>,
    /// Edge strength of each pixel.
    edge: Plane,
    /// Point and line strength of each pixel.
    point: Plane,
}

impl Seen {
    fn new(image: &Image) -> Self {
        let width = image.width as usize;
        let srgb: [Plane; 3] = std::array::from_fn(|channel| clamped_channel(image, channel));
        let opponent: Vec<[f64; 3]> = (0..image.rgb.len())
            .map(|at| ycxcz_of(std::array::from_fn(|channel| linear(srgb[channel][at]))))
            .collect();
        let blurred: [Plane; 3] = std::array::from_fn(|channel| {
            let plane: Plane = opponent.iter().map(|color| color[channel]).collect();
            blur(&plane, width, SENSITIVITY[channel])
        });
        let lab = (0..image.rgb.len())
            .into_par_iter()
            .map(|at| {
                hunt_lab(linear_of_ycxcz(std::array::from_fn(|channel| {
                    blurred[channel][at]
                })))
            })
            .collect();
        let luminance: Plane = opponent
            .iter()
            .map(|color| (color[0] + 16.0) / 116.0)
            .collect();
        let [smooth, slope, curvature] = feature_filters();
        Self {
            lab,
            edge: gradient(&luminance, width, &slope, &smooth),
            point: gradient(&luminance, width, &curvature, &smooth),
        }
    }
}

/// The color difference mapped to 0 to 1: large differences are compressed, since all of them look
/// 'wrong'.
fn color_error(difference: f64, difference_max: f64) -> f64 {
    let knee = KNEE * difference_max;
    if difference < knee {
        ERROR_AT_KNEE / knee * difference
    } else {
        ERROR_AT_KNEE + (difference - knee) / (difference_max - knee) * (1.0 - ERROR_AT_KNEE)
    }
}

/// The eye's blur of one channel.
fn blur(plane: &[f64], width: usize, sensitivity: &[(f64, f64)]) -> Plane {
    let radius_px =
        (3.0 * (SENSITIVITY_B_MAX / (2.0 * PI * PI)).sqrt() * PIXELS_PER_DEGREE).ceil() as i32;
    let mut blurred = vec![0.0; plane.len()];
    let mut weight_sum = 0.0;
    for &(a, b) in sensitivity {
        let taps: Vec<f64> = (-radius_px..=radius_px)
            .map(|offset| (-PI * PI * (f64::from(offset) / PIXELS_PER_DEGREE).powi(2) / b).exp())
            .collect();
        let scale = a * (PI / b).sqrt();
        weight_sum += scale * taps.iter().sum::<f64>().powi(2);
        for (sum, value) in blurred
            .iter_mut()
            .zip(separable(plane, width, &taps, &taps))
        {
            *sum += scale * value;
        }
    }
    blurred.iter().map(|value| value / weight_sum).collect()
}

/// A Gaussian and its first and second derivative. The derivatives' positive and negative taps sum
/// to 1 and -1.
fn feature_filters() -> [Vec<f64>; 3] {
    let sigma_px = 0.5 * FEATURE_WIDTH_DEG * PIXELS_PER_DEGREE;
    let radius_px = (3.0 * sigma_px).ceil() as i32;
    let taps = |factor: &dyn Fn(f64) -> f64| -> Vec<f64> {
        let value = |offset: f64| factor(offset) * (-0.5 * (offset / sigma_px).powi(2)).exp();
        let taps: Vec<f64> = (-radius_px..=radius_px)
            .map(|offset| value(f64::from(offset)))
            .collect();
        let positive: f64 = taps.iter().filter(|&&tap| tap > 0.0).sum();
        let negative: f64 = -taps.iter().filter(|&&tap| tap < 0.0).sum::<f64>();
        taps.iter()
            .map(|&tap| {
                tap / if tap > 0.0 {
                    positive
                } else {
                    negative.max(f64::MIN_POSITIVE)
                }
            })
            .collect()
    };
    [
        taps(&|_| 1.0),
        taps(&|offset| -offset),
        taps(&|offset| (offset / sigma_px).powi(2) - 1.0),
    ]
}

/// The length of the vector of responses to `filter` along x and along y, smoothed across.
fn gradient(plane: &[f64], width: usize, filter: &[f64], smooth: &[f64]) -> Plane {
    let (x, y) = (
        separable(plane, width, filter, smooth),
        separable(plane, width, smooth, filter),
    );
    x.iter().zip(&y).map(|(x, y)| x.hypot(*y)).collect()
}

/// Correlates rows with `across` and columns with `down`, both of odd length; pixels beyond an edge
/// repeat it.
fn separable(plane: &[f64], width: usize, across: &[f64], down: &[f64]) -> Plane {
    let height = plane.len() / width;
    let at = |center: usize, tap: usize, taps: usize, size: usize| {
        (center + tap).saturating_sub(taps / 2).min(size - 1)
    };
    let mut rows = vec![0.0; plane.len()];
    rows.par_chunks_exact_mut(width)
        .zip(plane.par_chunks_exact(width))
        .for_each(|(to, from)| {
            for (x, value) in to.iter_mut().enumerate() {
                *value = across
                    .iter()
                    .enumerate()
                    .map(|(tap, weight)| weight * from[at(x, tap, across.len(), width)])
                    .sum();
            }
        });
    let mut out = vec![0.0; plane.len()];
    out.par_chunks_exact_mut(width)
        .enumerate()
        .for_each(|(y, to)| {
            for (tap, weight) in down.iter().enumerate() {
                let row = at(y, tap, down.len(), height) * width;
                for (value, from) in to.iter_mut().zip(&rows[row..row + width]) {
                    *value += weight * from;
                }
            }
        });
    out
}

/// Linear RGB with the primaries of sRGB, to CIE XYZ.
const XYZ_FROM_LINEAR: [[f64; 3]; 3] = [
    [
        10_135_552.0 / 24_577_794.0,
        8_788_810.0 / 24_577_794.0,
        4_435_075.0 / 24_577_794.0,
    ],
    [
        2_613_072.0 / 12_288_897.0,
        8_788_810.0 / 12_288_897.0,
        887_015.0 / 12_288_897.0,
    ],
    [
        1_425_312.0 / 73_733_382.0,
        8_788_810.0 / 73_733_382.0,
        70_074_185.0 / 73_733_382.0,
    ],
];

/// sRGB to linear light (IEC 61966-2-1).
fn linear(srgb: f64) -> f64 {
    if srgb <= 0.04045 {
        srgb / 12.92
    } else {
        ((srgb + 0.055) / 1.055).powf(2.4)
    }
}

/// XYZ over that of white.
fn relative_xyz(linear: [f64; 3]) -> [f64; 3] {
    XYZ_FROM_LINEAR.map(|row| {
        let white: f64 = row.iter().sum();
        row.iter()
            .zip(linear)
            .map(|(weight, value)| weight * value)
            .sum::<f64>()
            / white
    })
}

/// The opponent space that the contrast sensitivities are of: a linearized CIELAB.
fn ycxcz_of(linear: [f64; 3]) -> [f64; 3] {
    let [x, y, z] = relative_xyz(linear);
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// Back to linear RGB, clamped to what a display can show.
fn linear_of_ycxcz([luma, cx, cz]: [f64; 3]) -> [f64; 3] {
    let y = (luma + 16.0) / 116.0;
    let relative = glam::DVec3::new(y + cx / 500.0, y, y - cz / 200.0);
    let relative_from_linear = glam::DMat3::from_cols_array_2d(
        &XYZ_FROM_LINEAR.map(|row| row.map(|weight| weight / row.iter().sum::<f64>())),
    )
    .transpose();
    (relative_from_linear.inverse() * relative)
        .to_array()
        .map(|value| value.clamp(0.0, 1.0))
}

/// CIELAB with a* and b* scaled by lightness: colors differ less where it is dark (Hunt effect).
fn hunt_lab(linear: [f64; 3]) -> [f64; 3] {
    const DELTA: f64 = 6.0 / 29.0;
    let [x, y, z] = relative_xyz(linear).map(|t| {
        if t > DELTA.powi(3) {
            t.cbrt()
        } else {
            t / (3.0 * DELTA * DELTA) + 4.0 / 29.0
        }
    });
    let lightness = 116.0 * y - 16.0;
    let hunt = 0.01 * lightness;
    [lightness, hunt * 500.0 * (x - y), hunt * 200.0 * (y - z)]
}

/// Distance for large color differences: city-block between lightness and chroma, Euclidean within
/// chroma.
fn hyab(a: [f64; 3], b: [f64; 3]) -> f64 {
    (a[0] - b[0]).abs() + (a[1] - b[1]).hypot(a[2] - b[2])
}
