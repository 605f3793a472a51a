//! What the front-to-back order goes by: `depth_key.glsl`, in f64 instead of pairs of f32.

use glam::{DVec3, Vec3};

use crate::layout::CameraRecord;

/// Steps from one f32 to the next.
const STEPS: f64 = 16.0;

/// Camera-space z of a mean, or its distance, metres: from what the shader is given, f32 values and what rounding left.
#[must_use]
pub fn depth_m(mean_m: [f32; 3], camera: &CameraRecord, radial: bool) -> f64 {
    let both = |high: [f32; 3], low: [f32; 3]| Vec3::from_array(high).as_dvec3() + Vec3::from_array(low).as_dvec3();
    let offset: DVec3 = Vec3::from_array(mean_m).as_dvec3() - both(camera.centre_high_m, camera.centre_low_m);
    if radial { offset.length() } else { both(camera.row_z, camera.row_z_low).dot(offset) }
}

/// Sixteen steps between one f32 and the next, counted from the near plane. The shader may be one step away where a depth
/// is a step's edge to within its 48 digits.
#[must_use]
pub fn depth_key(depth_m: f64, near_m: f32) -> u32 {
    let rounded = depth_m as f32;
    let places = rounded.max(near_m).to_bits() - near_m.to_bits();
    if places >= 0x0fff_fffe {
        return u32::MAX;
    }
    let place_m = f64::from(f32::from_bits(rounded.to_bits() & 0x7f80_0000)) * 2f64.powi(-23);
    let step = (((depth_m - f64::from(rounded)) / place_m).clamp(-0.5, 0.5) * STEPS + 0.5).floor();
    (places << 4) + (8.0 + step) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_order_what_f32_depths_cannot() {
        let depths: Vec<f64> = (0..1000).map(|i| 3.9999 + 2e-7 * f64::from(i)).collect();
        let keys: Vec<u32> = depths.iter().map(|&depth| depth_key(depth, 0.01)).collect();
        assert!(keys.is_sorted() && keys.windows(2).all(|pair| pair[0] < pair[1]), "nothing is tied across a power of two");
        let floats = depths.iter().map(|&depth| depth as f32);
        assert!(floats.clone().zip(floats.skip(1)).any(|(a, b)| a == b), "as f32 some would be");
        assert_eq!(depth_key(1e30, 0.01), u32::MAX);
    }

    #[test]
    fn what_the_last_digit_of_a_rotation_adds_to_a_depth_keeps_its_tie() {
        for depth_m in [2.143_554_7f32, 0.5, 1.0, 1e3] {
            let depth_m = f64::from(depth_m);
            assert_eq!(depth_key(depth_m * (1.0 - f64::EPSILON), 0.01), depth_key(depth_m, 0.01));
            assert_eq!(depth_key(depth_m * (1.0 + f64::EPSILON), 0.01), depth_key(depth_m, 0.01));
        }
    }
}
