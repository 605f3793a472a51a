//! Storage of the bands of spherical harmonics on the device: `sh.glsl` is the decoder.
//!
//! A band of `2l + 1` RGB coefficients becomes one f16 scale and `3 (2l + 1)` signed 16-bit
//! fractions of it: 5, 8 and 11 words. The scale is the largest coefficient rounded up to f16, so
//! the error is at most half of scale / 32767: a thirtieth of what the same bytes would give as
//! f16.

/// Words of the largest band.
pub const WORDS_MAX: usize = 11;

/// Words that band `band` (1 to 3) of one splat takes.
#[must_use]
pub fn words_of(band: usize) -> usize {
    (3 * (2 * band + 1)).div_ceil(2)
}

/// The words of one band; those beyond [`words_of`] the band are zero.
#[must_use]
pub fn encode_band(coefficients: &[[f32; 3]]) -> [u32; WORDS_MAX] {
    let largest = coefficients
        .iter()
        .flatten()
        .fold(0.0f32, |largest, value| largest.max(value.abs()));
    let (scale_bits, scale) = f16_at_least(largest);
    let mut halves = [0u16; 2 * WORDS_MAX];
    halves[0] = scale_bits;
    for (half, value) in halves[1..].iter_mut().zip(coefficients.iter().flatten()) {
        let fraction = (f64::from(*value) / f64::from(scale) * 32_767.0)
            .round()
            .clamp(-32_767.0, 32_767.0);
        *half = (fraction as i16) as u16;
    }
    std::array::from_fn(|word| u32::from(halves[2 * word]) | u32::from(halves[2 * word + 1]) << 16)
}

/// The coefficients that the device reads back from `words`.
#[must_use]
pub fn decode_band(words: &[u32], coefficients: usize) -> Vec<[f32; 3]> {
    let half = |index: usize| (words[index / 2] >> (16 * (index % 2))) as u16;
    let scale = f16_value(half(0)) / 32_767.0;
    (0..coefficients)
        .map(|k| std::array::from_fn(|channel| f32::from(half(1 + 3 * k + channel) as i16) * scale))
        .collect()
}

/// The smallest normal f16 that is at least `value`, as bits and value. At least 2^-14: devices may
/// flush smaller ones to zero. Coefficients above 65504 saturate; a color that far from 0 to 1 says
/// nothing.
fn f16_at_least(value: f32) -> (u16, f32) {
    let clamped = value.clamp(f16_value(0x0400), f16_value(0x7bff));
    let bits = clamped.to_bits();
    let exponent = (bits >> 23) as i32 - 127 + 15;
    let truncated = (exponent as u16) << 10 | (bits >> 13) as u16 & 0x3ff;
    let rounded = if f16_value(truncated) < clamped {
        truncated + 1
    } else {
        truncated
    };
    (rounded, f16_value(rounded))
}

/// The value of a positive normal f16.
fn f16_value(bits: u16) -> f32 {
    let exponent = i32::from(bits >> 10) - 15;
    (1.0 + f32::from(bits & 0x3ff) / 1024.0) * 2.0f32.powi(exponent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn bands_take_5_8_and_11_words() {
        assert_eq!([1, 2, 3].map(words_of), [5, 8, 11]);
    }

    #[test]
    fn the_scale_is_never_below_the_value() {
        for value in [
            0.0, 1e-9, 6.2e-5, 0.1, 0.333_333, 1.0, 1.000_1, 10.0, 65_504.0,
        ] {
            let (bits, scale) = f16_at_least(value);
            assert!(
                scale >= value && scale <= (value * 1.001).max(6.2e-5),
                "{value} -> {scale}"
            );
            assert_eq!(f16_value(bits), scale);
        }
    }

    proptest! {
        #[test]
        fn the_error_is_within_half_a_step(values in prop::collection::vec(prop::array::uniform3(-10.0f32..10.0), 1..8)) {
            let largest = values.iter().flatten().fold(0.0f32, |l, v| l.max(v.abs()));
            let decoded = decode_band(&encode_band(&values), values.len());
            let bound = largest.max(6.2e-5) * 1.001 * 1.6e-5;
            for (a, b) in values.iter().flatten().zip(decoded.iter().flatten()) {
                prop_assert!((a - b).abs() <= bound, "{} became {}", a, b);
            }
        }
    }
}
