//! A color in 64 bits: `color_code.glsl`.

use decouplegs_shaders::constants::{
    COLOR_CHANNEL_BITS, COLOR_EXPONENT_MAX, COLOR_EXPONENT_MIN, COLOR_MAX,
};
use glam::Vec3;

/// Error of a channel, at most, in units of the largest channel.
pub const COLOR_CODE_ERROR: f32 = 1.0 / (1 << COLOR_CHANNEL_BITS) as f32;

const CHANNEL_MAX: u32 = (1 << COLOR_CHANNEL_BITS) - 1;

fn power_of_two(field: u32) -> f32 {
    f32::from_bits(field << 23)
}

/// The code of `color`, whose channels are between 0 and [`COLOR_MAX`]; others become the nearest
/// of these.
#[must_use]
pub fn pack_color(color: Vec3) -> [u32; 2] {
    let color = color.clamp(Vec3::ZERO, Vec3::splat(COLOR_MAX));
    let rounded = (color.max_element().to_bits() + 16) >> 23;
    let exponent = rounded.clamp(COLOR_EXPONENT_MIN, COLOR_EXPONENT_MAX);
    let scaled = color * power_of_two(272 - exponent);
    let [r, g, b] = scaled
        .to_array()
        .map(|channel| ((channel + 0.5) as u32).min(CHANNEL_MAX));
    [
        r | g << 19,
        g >> 13 | b << 6 | (exponent - COLOR_EXPONENT_MIN) << 25,
    ]
}

/// The color of `code`.
#[must_use]
pub fn unpack_color([low, high]: [u32; 2]) -> Vec3 {
    let exponent = (high >> 25) + COLOR_EXPONENT_MIN;
    let channels = [low, low >> 19 | high << 13, high >> 6];
    Vec3::from_array(channels.map(|channel| (channel & CHANNEL_MAX) as f32))
        * power_of_two(exponent - 18)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A channel of any size that the code holds.
    fn channel() -> impl Strategy<Value = f32> {
        prop_oneof![
            Just(0.0),
            (-80.0f32..33.0).prop_map(|exponent| exponent.exp2().min(COLOR_MAX)),
            0.0f32..1.5,
        ]
    }

    fn is_near(color: Vec3, share: f32) -> bool {
        let error = (unpack_color(pack_color(color)) - color)
            .abs()
            .max_element();
        error <= share * color.max_element()
    }

    proptest! {
        #[test]
        fn a_code_is_its_color(r in channel(), g in channel(), b in channel()) {
            let color = Vec3::new(r, g, b);
            prop_assert!(is_near(color, COLOR_CODE_ERROR), "{color}");
            let once = unpack_color(pack_color(color));
            prop_assert_eq!(unpack_color(pack_color(once)), once);
        }
    }

    #[test]
    fn rounding_is_seen() {
        let color = Vec3::splat(1.0 + COLOR_CODE_ERROR);
        assert!(!is_near(color, 0.25 * COLOR_CODE_ERROR));
    }

    #[test]
    fn colors_beyond_the_code_become_the_nearest_one() {
        for (color, nearest) in [
            (Vec3::new(-1.0, 0.5, 0.0), Vec3::new(0.0, 0.5, 0.0)),
            (Vec3::splat(f32::INFINITY), Vec3::splat(COLOR_MAX)),
            (Vec3::splat(1e30), Vec3::splat(COLOR_MAX)),
            (Vec3::splat(1e-36), Vec3::splat(0.0)),
            // Rounding takes the largest channel to the next power of two.
            (Vec3::new(2.0 - 1e-7, 1.0, 0.0), Vec3::new(2.0, 1.0, 0.0)),
        ] {
            assert_eq!(unpack_color(pack_color(color)), nearest, "{color}");
        }
        // A NaN is refused when a scene is read; here it spoils no other channel.
        let spoiled = unpack_color(pack_color(Vec3::new(f32::NAN, 0.5, 0.25)));
        assert_eq!(spoiled.y, 0.5);
    }
}
