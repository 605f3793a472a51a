//! Colors as vectors of one codebook, and what their DC terms are off by.

use decouplegs_scene::codebook::ycocg_from_rgb;
use decouplegs_scene::{SplatCloud, sh};

/// Coefficients are held to this: far beyond any color, and within what f16 holds.
const COEFFICIENT_MAX: f32 = 1000.0;

/// Codes on either side of zero that DC residuals have: luma, orange, green.
const RESIDUAL_HALF: [f32; 3] = [16.0, 8.0, 8.0];

/// Share of the weight of splats whose residuals are within the range of codes; those beyond are
/// held to its ends.
const RESIDUAL_SHARE: f64 = 0.9999;

/// Least step: a 4096th of the range of a channel.
const RESIDUAL_STEP_MIN: f32 = 1e-3;

/// The coefficients of all splats, DC first and weighted, `[splat][coefficient][rgb]`.
pub(super) fn vectors(cloud: &SplatCloud, dc_weight: f32) -> Vec<f32> {
    let mut values = Vec::with_capacity(cloud.len() * 3 * sh::coefficient_count(cloud.sh_degree));
    for splat in 0..cloud.len() {
        values.extend(
            cloud.sh_dc[splat]
                .map(|value| value.clamp(-COEFFICIENT_MAX, COEFFICIENT_MAX) * dc_weight),
        );
        values.extend(
            cloud
                .rest_of(splat)
                .as_flattened()
                .iter()
                .map(|value| value.clamp(-COEFFICIENT_MAX, COEFFICIENT_MAX)),
        );
    }
    values
}

/// Entries of the book as coefficients, the weight of DC taken out again, rounded to the f16 that
/// files hold.
pub(super) fn entries(values: &[f32], sh_degree: u8, dc_weight: f32) -> Vec<[f32; 3]> {
    let mut entries: Vec<[f32; 3]> = values.as_chunks::<3>().0.to_vec();
    for dc in entries.iter_mut().step_by(sh::coefficient_count(sh_degree)) {
        *dc = dc.map(|value| value / dc_weight);
    }
    entries
        .iter_mut()
        .for_each(|rgb| *rgb = rgb.map(|value| half::f16::from_f32(value).to_f32()));
    entries
}

/// Difference from the DC of `entry` to `dc`: luma, orange, green.
pub(super) fn residual(dc: &[f32; 3], entry: &[f32; 3]) -> [f32; 3] {
    ycocg_from_rgb(std::array::from_fn(|channel| {
        dc[channel].clamp(-COEFFICIENT_MAX, COEFFICIENT_MAX) - entry[channel]
    }))
}

/// The steps with which nearly all `residuals`, by their weights, are within the range of codes.
pub(super) fn residual_steps(residuals: &[[f32; 3]], weights: &[f32]) -> [f32; 3] {
    let total: f64 = weights.iter().map(|&weight| f64::from(weight)).sum();
    std::array::from_fn(|axis| {
        let mut order: Vec<(f32, f32)> = residuals
            .iter()
            .zip(weights)
            .map(|(r, &weight)| (r[axis].abs(), weight))
            .collect();
        order.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut below = 0.0;
        let cutoff = order.iter().find(|(_, weight)| {
            below += f64::from(*weight);
            below >= RESIDUAL_SHARE * total
        });
        (cutoff.map_or(0.0, |&(size, _)| size) / (RESIDUAL_HALF[axis] - 0.5)).max(RESIDUAL_STEP_MIN)
    })
}

/// The codes of a residual, held to their range.
pub(super) fn residual_codes(residual: &[f32; 3], steps: &[f32; 3]) -> [i8; 3] {
    std::array::from_fn(|axis| {
        let half = RESIDUAL_HALF[axis];
        (residual[axis] / steps[axis])
            .round()
            .clamp(-half, half - 1.0) as i8
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compress::tests::plane;

    #[test]
    fn residuals_are_told_to_half_a_step_and_outliers_are_held() {
        let residuals: Vec<[f32; 3]> = (0..5000)
            .map(|i| [(i as f32 * 0.1).sin() * 0.3, 0.0, (i as f32).cos() * 0.02])
            .collect();
        let weights = vec![1.0; residuals.len()];
        let steps = residual_steps(&residuals, &weights);
        for residual in &residuals {
            let codes = residual_codes(residual, &steps);
            for axis in 0..3 {
                assert!(
                    (f32::from(codes[axis]) * steps[axis] - residual[axis]).abs()
                        <= 0.51 * steps[axis],
                    "{residual:?}"
                );
            }
        }
        assert_eq!(steps[1], RESIDUAL_STEP_MIN);
        assert_eq!(residual_codes(&[9.0, -9.0, 0.0], &steps), [15, -8, 0]);
    }

    #[test]
    fn the_weight_of_dc_comes_out_as_it_went_in() {
        let cloud = plane(4, 2);
        let back = entries(&vectors(&cloud, 0.25), 2, 0.25);
        assert_eq!(back.len(), 4 * 9);
        for splat in 0..4 {
            let f16 = |rgb: [f32; 3]| rgb.map(|value| half::f16::from_f32(value).to_f32());
            assert_eq!(back[splat * 9], f16(cloud.sh_dc[splat]));
            assert_eq!(back[splat * 9 + 3], f16(cloud.rest_of(splat)[2]));
        }
    }
}
