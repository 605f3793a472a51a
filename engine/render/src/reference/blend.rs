//! One pixel, front to back, in f64.

use decouplegs_scene::rules::{ALPHA_MIN, TRANSMITTANCE_MIN, TRANSMITTANCE_MIN_INCLUSIVE};
use decouplegs_scene::{EarlyStop, Rules};
use glam::DVec2;

use super::project::Projected64;

/// A splat ready to be blended.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat64 {
    /// Footprint and depth.
    pub projected: Projected64,
    /// Display-referred RGB, at least 0.
    pub color: [f64; 3],
    /// Index in the world's cloud; orders equal depths.
    pub index: u32,
    /// 0 the background, `k` the `k`-th agent.
    pub instance: u16,
}

/// Value of a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pixel64 {
    /// Blended color, sky included, unclamped.
    pub rgb: [f64; 3],
    /// 1 - T, with T the transmittance that is left for the sky.
    pub alpha: f64,
    /// The mean depth of the blended splats by their weights, meters; 0 where nothing was blended.
    pub depth_m: f64,
    /// Instance of the splat with the largest weight, the nearer one of equals; 0 where nothing was
    /// blended.
    pub instance: u16,
}

/// Alpha of `splat` at the pixel with center `center_px`; `None` below `ALPHA_MIN`, and where the
/// response is below that of the rules.
#[must_use]
pub fn alpha_at(splat: &Projected64, center_px: DVec2, rules: &Rules) -> Option<f64> {
    let d = center_px - splat.mean_px;
    // Outside this box alpha is below `ALPHA_MIN`: saves the exponential, changes nothing.
    if d.x.abs() > splat.half_extent_px.x || d.y.abs() > splat.half_extent_px.y {
        return None;
    }
    let response = (-0.5 * splat.conic.q(d)).exp();
    let alpha = (splat.opacity * response).min(rules.alpha_max);
    (alpha >= ALPHA_MIN && response >= rules.response_min).then_some(alpha)
}

/// Blends `splats`, which come front to back, at the pixel whose center is `center_px`, over `sky`.
pub fn blend<'a>(
    splats: impl Iterator<Item = &'a Splat64>,
    center_px: DVec2,
    rules: &Rules,
    sky: [f64; 3],
) -> Pixel64 {
    let mut transmittance = 1.0;
    let mut rgb = [0.0; 3];
    let (mut weighted_depth_m, mut weight_sum) = (0.0, 0.0);
    let (mut weight_max, mut instance) = (0.0, 0);
    for splat in splats {
        let Some(alpha) = alpha_at(&splat.projected, center_px, rules) else {
            continue;
        };
        let behind = transmittance * (1.0 - alpha);
        if rules.stop == EarlyStop::Exclusive && behind <= TRANSMITTANCE_MIN {
            break;
        }
        let weight = transmittance * alpha;
        for (sum, color) in rgb.iter_mut().zip(splat.color) {
            *sum += weight * color;
        }
        weighted_depth_m += weight * splat.projected.depth_m;
        weight_sum += weight;
        if weight > weight_max {
            (weight_max, instance) = (weight, splat.instance);
        }
        transmittance = behind;
        if rules.stop == EarlyStop::Inclusive && behind <= TRANSMITTANCE_MIN_INCLUSIVE {
            break;
        }
        // Every further weight would be exactly zero.
        if transmittance == 0.0 {
            break;
        }
    }
    for (sum, color) in rgb.iter_mut().zip(sky) {
        *sum += transmittance * color;
    }
    let depth_m = if weight_sum > 0.0 {
        weighted_depth_m / weight_sum
    } else {
        0.0
    };
    Pixel64 {
        rgb,
        alpha: 1.0 - transmittance,
        depth_m,
        instance,
    }
}
