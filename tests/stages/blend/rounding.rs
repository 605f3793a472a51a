//! Rounding error of a blended pixel: a running error analysis (Higham, Accuracy and Stability of
//! Numerical Algorithms, 2002, section 3.3) of the same sums in f64.

use decouplegs::render::layout::{
    COARSE_HEIGHT_PX, COARSE_WIDTH_PX, CameraRecord, response_squares_max,
};
use decouplegs::render::twins::footprint::{Footprint, center_of};
use decouplegs::render::twins::output::Pixel;
use decouplegs::render::twins::record::load_footprint;
use decouplegs::scene::rules::{TRANSMITTANCE_MIN, TRANSMITTANCE_MIN_INCLUSIVE};
use decouplegs::scene::{EarlyStop, Rules};

use crate::stages::ROUNDOFF;
use crate::stages::scenes::ProjectedTwin;

/// Largest difference between two correct implementations at one pixel.
#[derive(Debug)]
pub struct PixelBounds {
    pub color: f64,
    pub transmittance: f64,
    pub weighted_depth: f64,
    /// Rounding decides whether a splat counts here, or where an early stop falls.
    pub unsettled: bool,
    alpha: f64,
    /// Largest weight of each instance, and how far a weight may be off.
    best_weights: [f64; 3],
    weight_error: f64,
}

/// A splat of a list, decoded once for all pixels.
pub struct ListedSplat {
    footprint: Footprint,
    /// Largest channel.
    color: f64,
    depth_m: f64,
    instance: usize,
}

impl ListedSplat {
    /// Record `record`, its mean relative to `origin`, the first pixel of a coarse tile of
    /// `camera`.
    pub fn new(
        projected: &ProjectedTwin,
        record: u32,
        camera: &CameraRecord,
        origin: [u32; 2],
    ) -> Self {
        let record = record as usize;
        let (footprints, shift) = (&projected.footprints, camera.mean_shift);
        Self {
            footprint: load_footprint(footprints, record, shift, origin),
            color: f64::from(projected.color(record).max_element()),
            depth_m: f64::from(projected.depth_m(record)),
            instance: projected.labels[record][1] as usize,
        }
    }
}

/// State of blending a pixel in f64.
struct Run {
    transmittance: f64,
    /// Sum of weight times depth of what lies before the list: rounding is relative to it.
    depth_before: f64,
    bounds: PixelBounds,
}

impl PixelBounds {
    /// Bounds of the pixel at column and row `at` of its coarse tile, where `list` is blended front
    /// to back, behind `before` if given.
    pub fn new(list: &[ListedSplat], at: [u32; 2], rules: &Rules, before: Option<&Pixel>) -> Self {
        let bounds = Self {
            color: 0.0,
            transmittance: 0.0,
            weighted_depth: 0.0,
            unsettled: false,
            alpha: 0.0,
            best_weights: [0.0; 3],
            weight_error: 0.0,
        };
        let mut run = Run {
            transmittance: 1.0,
            depth_before: 0.0,
            bounds,
        };
        if let Some(before) = before {
            run.transmittance = f64::from(before.transmittance.abs());
            run.depth_before = f64::from(before.planes.weighted_depth);
            run.bounds.best_weights[before.planes.best_instance as usize] =
                f64::from(before.planes.best_weight);
        }
        // Where a pixel is full, an implementation that stops inclusively may leave out all that
        // follows.
        let mut behind = [0.0f64; 2];
        for splat in list {
            let (log2_alpha, error) = log2_alpha(&splat.footprint, at);
            let squares_max = f64::from(response_squares_max(rules));
            let peak = f64::from(splat.footprint.log2_opacity);
            let least = (peak - squares_max).max(-LOG2_255);
            if log2_alpha < least - error {
                continue;
            }
            let (color, depth_m) = (splat.color, splat.depth_m);
            let full = run.transmittance <= TRANSMITTANCE_MIN * (1.0 + 1e-3);
            if rules.stop == EarlyStop::None && full {
                behind = [behind[0].max(color), behind[1].max(depth_m)];
                continue;
            }
            run.bounds.unsettled |= (log2_alpha - least).abs() <= error;
            if run.add(log2_alpha, error, [color, depth_m], splat.instance, rules) {
                break;
            }
        }
        let mut bounds = run.bounds;
        if behind != [0.0; 2] {
            let left = TRANSMITTANCE_MIN * (1.0 + 2e-3);
            bounds.transmittance += left;
            bounds.color += left * behind[0];
            bounds.weighted_depth += left * behind[1];
        }
        bounds.alpha = 1.0 - run.transmittance;
        bounds
    }

    /// Bound of the written depth for the twin's `depth_m` and `alpha`: a quotient of two sums with
    /// errors.
    pub fn depth_m(&self, depth_m: f32, alpha: f32) -> f64 {
        if alpha == 0.0 {
            return 0.0;
        }
        let (depth_m, alpha) = (f64::from(depth_m), f64::from(alpha));
        (self.weighted_depth + depth_m * (self.transmittance + 2.0 * ROUNDOFF))
            / (alpha - self.transmittance)
            + 8.0 * ROUNDOFF * depth_m
    }

    /// Two instances may be confused where their largest weights are equal to rounding.
    pub fn check_instance(&self, what: &str, kernel: u32, twin: u32) -> Result<(), String> {
        let weight = |instance: u32| {
            self.best_weights
                .get(instance as usize)
                .copied()
                .unwrap_or(-1.0)
        };
        if kernel == twin || (weight(kernel) - weight(twin)).abs() <= 2.0 * self.weight_error {
            return Ok(());
        }
        Err(format!(
            "{what}: the kernel names instance {kernel}, the twin {twin}"
        ))
    }
}

const LOG2_255: f64 = 7.994_353_436_858_858;

/// log2 of a splat's alpha at a pixel, and how far it may be off.
fn log2_alpha(splat: &Footprint, at: [u32; 2]) -> (f64, f64) {
    let d = (center_of(at[0], at[1]) - splat.mean_px).as_dvec2();
    let [slope, rate_x, rate_y] = [splat.slope, splat.rate_x, splat.rate_y].map(f64::from);
    let (shear, peak) = (slope * d.y, f64::from(splat.log2_opacity));
    let (u, v) = ((d.x - shear) * rate_x, d.y * rate_y);
    let value = peak - v * v - u * u;
    // A kernel may sum pixel and mean relative to the coarse tile, each times its rate, instead of
    // subtracting them first: terms of the tile's size cancel.
    let (width, height) = (f64::from(COARSE_WIDTH_PX), f64::from(COARSE_HEIGHT_PX));
    let u_terms = d.x.abs() + shear.abs() + 2.0 * (width + slope.abs() * height);
    let u_error = 4.0 * ROUNDOFF * rate_x * u_terms + 2.0 * ROUNDOFF * u.abs();
    let v_error = 4.0 * ROUNDOFF * rate_y * (d.y.abs() + 2.0 * height);
    let squares_error = 2.0 * (u.abs() * u_error + v.abs() * v_error);
    (
        value,
        squares_error + 6.0 * ROUNDOFF * (peak.abs() + v * v + u * u),
    )
}

impl Run {
    /// Adds one splat; true if the pixel stops before or behind it.
    fn add(
        &mut self,
        log2_alpha: f64,
        log2_error: f64,
        [color, depth_m]: [f64; 2],
        instance: usize,
        rules: &Rules,
    ) -> bool {
        // exp2 may be off by 3 + 2 |x| roundings in the last place (Vulkan specification), on both
        // sides.
        let relative =
            std::f64::consts::LN_2 * log2_error + 4.0 * ROUNDOFF * (3.0 + 2.0 * log2_alpha.abs());
        let alpha = log2_alpha.exp2().min(rules.alpha_max);
        let alpha_error = alpha * relative;
        let Self {
            transmittance,
            depth_before,
            bounds,
        } = self;
        let left = *transmittance * (1.0 - alpha);
        let left_error =
            bounds.transmittance * (1.0 - alpha) + *transmittance * (alpha_error + 2.0 * ROUNDOFF);
        if rules.stop == EarlyStop::Exclusive {
            bounds.unsettled |= (left - TRANSMITTANCE_MIN).abs() <= left_error;
            if left <= TRANSMITTANCE_MIN {
                return true;
            }
        }
        let weight = *transmittance * alpha;
        let weight_error =
            bounds.transmittance * alpha + *transmittance * alpha_error + 2.0 * ROUNDOFF * weight;
        // Sums of weights are at most 1, so no partial sum is larger than the largest value.
        bounds.color += weight_error * color + 4.0 * ROUNDOFF * color.max(1.0);
        bounds.weighted_depth +=
            weight_error * depth_m + 4.0 * ROUNDOFF * depth_m.max(*depth_before);
        bounds.transmittance = left_error;
        bounds.weight_error = bounds.weight_error.max(weight_error);
        bounds.best_weights[instance] = bounds.best_weights[instance].max(weight);
        *transmittance = left;
        let inclusive = rules.stop == EarlyStop::Inclusive;
        bounds.unsettled |= inclusive && (left - TRANSMITTANCE_MIN_INCLUSIVE).abs() <= left_error;
        inclusive && left <= TRANSMITTANCE_MIN_INCLUSIVE
    }
}
