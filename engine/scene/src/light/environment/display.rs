//! Conversion between linear light and what a camera of the engine's scenes displays: gamma 2.2
//! with a shoulder instead of a clip.

/// Encoding exponent is its reciprocal.
pub(in crate::light) const GAMMA: f64 = 2.2;

/// Display value above which the curve bends towards 1 without reaching it.
const SHOULDER: f64 = 0.8;

/// Largest display value that [`to_linear`] tells from others: near 1 the shoulder turns the last
/// of 256 steps into any amount of light. 0.99 stands for 3.4 times the light of 0.8.
pub const DISPLAY_MAX: f64 = 0.99;

/// A linear value, 1 being a white surface in light that shows colors as they are, as it is
/// displayed, 0 to 1.
#[must_use]
pub fn to_display(linear: f64) -> f64 {
    let encoded = linear.max(0.0).powf(1.0 / GAMMA);
    let above = encoded - SHOULDER;
    if above <= 0.0 {
        encoded
    } else {
        SHOULDER + (1.0 - SHOULDER) * (1.0 - (-above / (1.0 - SHOULDER)).exp())
    }
}

/// The linear value that is displayed as `display`, which is clamped to 0 to [`DISPLAY_MAX`].
#[must_use]
pub fn to_linear(display: f64) -> f64 {
    let display = display.clamp(0.0, DISPLAY_MAX);
    let encoded = if display <= SHOULDER {
        display
    } else {
        SHOULDER - (1.0 - SHOULDER) * (1.0 - (display - SHOULDER) / (1.0 - SHOULDER)).ln()
    };
    encoded.powf(GAMMA)
}

/// Share of a display value that is gone where the share `linear` of the light is, both 0 to 1;
/// without the shoulder.
pub(in crate::light) fn shown_loss(linear: f64) -> f64 {
    1.0 - (1.0 - linear).powf(1.0 / GAMMA)
}

/// The inverse of [`shown_loss`].
pub(in crate::light) fn linear_loss(shown: f64) -> f64 {
    1.0 - (1.0 - shown).powf(GAMMA)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_is_the_identity() {
        for step in 0..=990 {
            let display = f64::from(step) / 1000.0;
            assert!(
                (to_display(to_linear(display)) - display).abs() < 1e-12,
                "{display}"
            );
        }
        assert_eq!(
            (to_linear(1.5), to_linear(-1.0)),
            (to_linear(DISPLAY_MAX), 0.0)
        );
    }

    #[test]
    fn the_curve_rises_stays_below_one_and_does_not_break_at_the_shoulder() {
        let values: Vec<f64> = (0..3000)
            .map(|step| to_display(f64::from(step) * 1e-3))
            .collect();
        assert!(values.windows(2).all(|pair| pair[0] < pair[1]) && values[2999] < 1.0);
        let at = SHOULDER.powf(GAMMA);
        let slopes = [
            to_display(at) - to_display(at - 1e-6),
            to_display(at + 1e-6) - to_display(at),
        ];
        assert!((slopes[0] / slopes[1] - 1.0).abs() < 1e-4, "{slopes:?}");
        assert!((to_display(0.5) - 0.5f64.powf(1.0 / 2.2)).abs() < 1e-15);
    }
}
