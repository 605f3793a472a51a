//! Conversion between trained parameters, as files store them, and the values that are drawn.

/// A standard deviation, meters, from its stored natural logarithm.
///
/// Through f64, here and below: libraries differ in the last bit of an f32 `exp`, while the f64 one
/// is right far beyond the bits that are kept. So a file gives the same cloud on every machine.
pub(crate) fn scale_of_log(log_scale: f32) -> f32 {
    f64::from(log_scale).exp() as f32
}

/// The inverse of [`scale_of_log`].
pub(crate) fn log_of_scale(scale: f32) -> f32 {
    f64::from(scale).ln() as f32
}

/// 1 / (1 + e^-x). Plus infinity, which trainers do write, gives 1.
pub(crate) fn sigmoid(logit: f32) -> f32 {
    (1.0 / (1.0 + (-f64::from(logit)).exp())) as f32
}

/// The inverse of [`sigmoid`]; infinite at 0 and 1.
pub(crate) fn logit(opacity: f32) -> f32 {
    let opacity = f64::from(opacity);
    (opacity / (1.0 - opacity)).ln() as f32
}

/// `rotation` (w, x, y, z) at unit length; one that has no direction stays as it is, for
/// `SplatCloud::defect_of` to see.
pub(crate) fn normalized(rotation: [f32; 4]) -> [f32; 4] {
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
        assert_eq!(
            (
                sigmoid(f32::INFINITY),
                sigmoid(f32::NEG_INFINITY),
                sigmoid(0.0)
            ),
            (1.0, 0.0, 0.5)
        );
        assert_eq!(
            (logit(1.0), logit(0.0), logit(0.5)),
            (f32::INFINITY, f32::NEG_INFINITY, 0.0)
        );
        assert!(sigmoid(f32::NAN).is_nan());
        for opacity in [0.001, 0.3, 0.999] {
            assert!((sigmoid(logit(opacity)) - opacity).abs() < 1e-6);
        }
    }

    #[test]
    fn logarithms_of_scales_survive() {
        assert_eq!(
            (scale_of_log(0.0), scale_of_log(1.0), log_of_scale(0.0)),
            (1.0, std::f32::consts::E, f32::NEG_INFINITY)
        );
        for log_scale in [-12.0f32, -3.7, 0.3, 5.9] {
            assert!(
                (log_of_scale(scale_of_log(log_scale)) - log_scale).abs() <= 1e-6,
                "{log_scale}"
            );
        }
    }

    #[test]
    fn only_what_has_a_direction_is_normalized() {
        assert_eq!(normalized([0.0, 3.0, 0.0, 4.0]), [0.0, 0.6, 0.0, 0.8]);
        assert_eq!(normalized([0.0; 4]), [0.0; 4]);
        assert_eq!(normalized([f32::INFINITY, 0.0, 0.0, 0.0])[0], f32::INFINITY);
        // Squares that overflow f32 still have a direction.
        let huge = 100f32.exp2();
        assert_eq!(
            normalized([3.0 * huge, 0.0, 4.0 * huge, 0.0]),
            [0.6, 0.0, 0.8, 0.0]
        );
    }
}
