//! Depth key of the front-to-back order: `depth_key.glsl`, in f64 instead of pairs of f32.

use decouplegs_shaders::constants::{
    KEY_FLOATS_FROM as FLOATS_FROM, KEY_LINEAR_CODES, KEY_LINEAR_STEP, KEY_LINEAR_STEPS, KEY_STEPS,
};
use glam::{DVec3, Vec3};

use crate::layout::CameraRecord;

/// Steps from one f32 to the next.
const STEPS: f64 = KEY_STEPS as f64;
/// Steps of one size to 1, below [`KEY_FLOATS_FROM`].
const LINEAR_STEPS: f64 = KEY_LINEAR_STEPS as f64;

/// Depth of a mean along the camera's direction, between -1 and 1, or its distance: from what the
/// shader is given, f32 values and what rounding left.
#[must_use]
pub fn scaled_depth(mean_m: [f32; 3], camera: &CameraRecord, radial: bool) -> f64 {
    let both = |high: [f32; 3], low: [f32; 3]| {
        Vec3::from_array(high).as_dvec3() + Vec3::from_array(low).as_dvec3()
    };
    let mean: DVec3 = Vec3::from_array(mean_m).as_dvec3();
    let scale = f64::from(camera.key_scale);
    if radial {
        return (mean - both(camera.center_high_m, camera.center_low_m)).length() * scale;
    }
    let [high, low] = camera.key_offset.map(f64::from);
    both(camera.row_z, camera.row_z_low).dot(mean) * scale + high + low
}

/// The key of a depth between -1 and 1. The shader may be one step away where a depth is a step's
/// edge to within its 48 digits.
#[must_use]
pub fn depth_key(depth: f64) -> u32 {
    let size = depth.abs();
    let rounded = size as f32;
    let code = if rounded < FLOATS_FROM {
        (size * LINEAR_STEPS + 0.5).floor() as u32
    } else {
        let ulps = rounded.to_bits() - FLOATS_FROM.to_bits();
        let ulp = f64::from(f32::from_bits(rounded.to_bits() & 0x7f80_0000)) * 2f64.powi(-23);
        let part =
            (((size - f64::from(rounded)) / ulp).clamp(-0.5, 0.5) * STEPS + 0.5).floor() as i64;
        (i64::from(ulps.min(0x07ff_ffff)) * 16 + part + i64::from(KEY_LINEAR_CODES))
            .min(0x7fff_ffff) as u32
    };
    if depth < 0.0 {
        0x8000_0000 - code
    } else {
        0x8000_0000 + code
    }
}

/// A depth whose key is `key`, or less by a step of the key.
#[must_use]
pub fn depth_of_key(key: u32) -> f32 {
    let code = key.abs_diff(0x8000_0000);
    let size = match code.checked_sub(KEY_LINEAR_CODES) {
        None => code as f32 * KEY_LINEAR_STEP,
        Some(floats) => f32::from_bits(FLOATS_FROM.to_bits() + (floats >> 4)),
    };
    if key < 0x8000_0000 { -size } else { size }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn keys_keep_the_order_of_depths(a in -1.0f64..1.0, share in -12.0f64..0.0, sign: bool) {
            let step = 10f64.powf(share) * if sign { 1.0 } else { -1.0 };
            let b = (a * (1.0 + step)).clamp(-0.999_999_9, 0.999_999_9);
            let (low, high) = if a <= b { (a, b) } else { (b, a) };
            prop_assert!(depth_key(low) <= depth_key(high));
            // What is a step of 2^-27 of its size apart, or of 2^-42, is told apart.
            let step = (low.abs().max(high.abs()) * 2f64.powi(-26)).max(2f64.powi(-41));
            prop_assert!(high - low < step || depth_key(low) < depth_key(high));
        }
    }

    proptest! {
        #[test]
        fn the_depth_of_a_key_never_falls_with_it(key in 0x8000_0001u32 - 0x7fff_ffff..u32::MAX, step in 0u32..100) {
            let higher = key.saturating_add(step);
            prop_assert!(depth_of_key(key) <= depth_of_key(higher), "{key} {higher}");
        }

        #[test]
        fn a_depth_is_found_again_from_its_key(depth in -0.999f64..0.999) {
            let found = f64::from(depth_of_key(depth_key(depth)));
            prop_assert!((found - depth).abs() <= depth.abs() * 2f64.powi(-22) + 2f64.powi(-40), "{depth} {found}");
        }
    }

    #[test]
    fn keys_order_what_f32_depths_cannot() {
        let depths: Vec<f64> = (0..1000).map(|i| 0.499_999 + 2e-8 * f64::from(i)).collect();
        let keys: Vec<u32> = depths.iter().map(|&depth| depth_key(depth)).collect();
        assert!(
            keys.windows(2).all(|pair| pair[0] < pair[1]),
            "nothing is tied across a power of two"
        );
        let floats = depths.iter().map(|&depth| depth as f32);
        assert!(
            floats.clone().zip(floats.skip(1)).any(|(a, b)| a == b),
            "as f32 some would be"
        );
    }

    #[test]
    fn keys_rise_through_zero_and_over_the_change_of_steps() {
        let from = f64::from(FLOATS_FROM);
        let depths = [
            -1.0 + 1e-7,
            -0.5,
            -from,
            -from * 0.999_999,
            -1e-12,
            0.0,
            1e-12,
            from * 0.999_999,
            from,
            0.5,
            1.0 - 1e-7,
        ];
        assert!(
            depths
                .map(depth_key)
                .windows(2)
                .all(|pair| pair[0] < pair[1])
        );
        assert_eq!(depth_key(-0.0), depth_key(0.0));
    }

    #[test]
    fn what_the_last_digit_of_a_rotation_adds_to_a_depth_keeps_its_tie() {
        for depth in [2.143_554_7f32 / 16.0, 0.5, -0.25, 1e-3] {
            let depth = f64::from(depth);
            assert_eq!(depth_key(depth * (1.0 - f64::EPSILON)), depth_key(depth));
            assert_eq!(depth_key(depth * (1.0 + f64::EPSILON)), depth_key(depth));
        }
    }
}
