//! Between trained parameters, as files store them, and the values that are drawn.

/// 1 / (1 + e^-x). Plus infinity, which trainers do write, gives 1.
pub(crate) fn sigmoid(logit: f32) -> f32 {
    (1.0 / (1.0 + (-f64::from(logit)).exp())) as f32
}

/// The inverse of [`sigmoid`]; infinite at 0 and 1.
pub(crate) fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity);
    (opacity / (1.0 - opacity)).ln() as f32
}

/// `rotation` (w, x, y, z) at unit length; one that has no direction stays as it is, for `SplatCloud::defect_of` to see.
pub(crate) fn normalised(rotation: [f32; 4]) -> [f32; 4] {
    let wide = rotation.map(f64::from);
    let length_squared: f64 = wide.iter().map(|q| q * q).sum();
    if length_squared.is_finite() && length_squared > 1e-30 {
        let length = length_squared.sqrt();
        wide.map(|q| (q / length) as f32)
    } else {
        rotation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_logits_are_full_and_empty() {
        assert_eq!((sigmoid(f32::INFINITY), sigmoid(f32::NEG_INFINITY), sigmoid(0.0)), (1.0, 0.0, 0.5));
        assert_eq!((logit(1.0), logit(0.0), logit(0.5)), (f32::INFINITY, f32::NEG_INFINITY, 0.0));
        assert!(sigmoid(f32::NAN).is_nan());
        for opacity in [0.001, 0.3, 0.999] {
            assert!((sigmoid(logit(opacity)) - opacity).abs() < 1e-6);
        }
    }

    #[test]
    fn only_what_has_a_direction_is_normalised() {
        assert_eq!(normalised([0.0, 3.0, 0.0, 4.0]), [0.0, 0.6, 0.0, 0.8]);
        assert_eq!(normalised([0.0; 4]), [0.0; 4]);
        assert_eq!(normalised([f32::INFINITY, 0.0, 0.0, 0.0])[0], f32::INFINITY);
        // Squares that overflow f32 still have a direction.
        let huge = 100f32.exp2();
        assert_eq!(normalised([3.0 * huge, 0.0, 4.0 * huge, 0.0]), [0.6, 0.0, 0.8, 0.0]);
    }
}
