//! Coding of spherical harmonics on the device, one band at a time; `sh.glsl` is the decoder.
//!
//! A band of RGB coefficients becomes one scale and signed fractions of it, a stream of bits from
//! the lowest bit of the first word on. The scale is the largest coefficient rounded up, so the
//! error is at most half of scale / (2^(bits - 1) - 1): for 16 bits a thirtieth of what the same
//! bytes would give as f16. The scale takes the bits that the fractions leave, 16 at most: the
//! upper bits of a positive f16.

/// Bits of a fraction in codebooks and in [`crate::Storage::Exact`].
pub const EXACT_BITS: usize = 16;

/// Words of the largest band.
pub const WORDS_MAX: usize = 11;

/// Bits of a scale, at least: the exponent of an f16 and two bits below it.
const SCALE_BITS_MIN: usize = 7;

/// Words of `coefficients` RGB coefficients whose fractions have `bits` bits.
#[must_use]
pub const fn words_for(coefficients: usize, bits: usize) -> usize {
    (3 * coefficients * bits + SCALE_BITS_MIN).div_ceil(32)
}

/// Words of band `band` (1 to 3) of one color in a codebook.
#[must_use]
pub const fn words_of(band: usize) -> usize {
    words_for(2 * band + 1, EXACT_BITS)
}

/// Bits of the scale of `coefficients` RGB coefficients whose fractions have `bits` bits.
const fn scale_bits(coefficients: usize, bits: usize) -> usize {
    let left = 32 * words_for(coefficients, bits) - 3 * coefficients * bits;
    if left < 16 { left } else { 16 }
}

/// The words of one band with fractions of `bits` bits; those beyond its [`words_for`] are zero.
#[must_use]
pub fn encode_band(coefficients: &[[f32; 3]], bits: usize) -> [u32; WORDS_MAX] {
    let largest = coefficients
        .iter()
        .flatten()
        .fold(0.0f32, |largest, value| largest.max(value.abs()));
    let scale_bits = scale_bits(coefficients.len(), bits);
    let (code, scale) = scale_at_least(largest, scale_bits);
    let most = fractions_of(bits);
    let mut words = [0u32; WORDS_MAX];
    put(&mut words, 0, scale_bits, code);
    for (index, value) in coefficients.iter().flatten().enumerate() {
        let fraction = (f64::from(*value) / f64::from(scale) * f64::from(most))
            .round()
            .clamp(-f64::from(most), f64::from(most));
        put(
            &mut words,
            scale_bits + index * bits,
            bits,
            fraction as i32 as u32,
        );
    }
    words
}

/// The coefficients that the device reads back from `words`.
#[must_use]
pub fn decode_band(words: &[u32], coefficients: usize, bits: usize) -> Vec<[f32; 3]> {
    let scale_bits = scale_bits(coefficients, bits);
    let code = get(words, 0, scale_bits) as u16;
    let scale = f16_value(code << (16 - scale_bits).saturating_sub(1)) / fractions_of(bits);
    let value = |index: usize| {
        let fraction = get(words, scale_bits + index * bits, bits) << (32 - bits);
        (fraction as i32 >> (32 - bits)) as f32 * scale
    };
    (0..coefficients)
        .map(|k| std::array::from_fn(|channel| value(3 * k + channel)))
        .collect()
}

/// The largest fraction of `bits` bits.
fn fractions_of(bits: usize) -> f32 {
    ((1u32 << (bits - 1)) - 1) as f32
}

/// Writes the lower `bits` bits of `value` from bit `index` on.
fn put(words: &mut [u32], index: usize, bits: usize, value: u32) {
    let value = u64::from(value) & ((1 << bits) - 1);
    let (word, shifted) = (index / 32, value << (index % 32));
    words[word] |= shifted as u32;
    if index % 32 + bits > 32 {
        words[word + 1] |= (shifted >> 32) as u32;
    }
}

/// The `bits` bits from bit `index` on.
fn get(words: &[u32], index: usize, bits: usize) -> u32 {
    let (word, next) = (index / 32, (index + bits - 1) / 32);
    let joined = u64::from(words[next]) << 32 | u64::from(words[word]);
    let joined = if next == word {
        joined & 0xffff_ffff
    } else {
        joined
    };
    ((joined >> (index % 32)) & ((1 << bits) - 1)) as u32
}

/// The smallest scale of `bits` bits that is at least `value`, as code and value: the upper bits of
/// the pattern of an f16, whose sign is left out below 16 bits. Values above the largest saturate.
fn scale_at_least(value: f32, bits: usize) -> (u32, f32) {
    let dropped = (16 - bits).saturating_sub(1);
    let (pattern, _) = f16_at_least(value);
    let code = (u32::from(pattern) + (1 << dropped) - 1) >> dropped;
    let code = code.min(0x7bff >> dropped);
    (code, f16_value((code << dropped) as u16))
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
    fn bands_of_codebooks_take_5_8_and_11_words() {
        assert_eq!([1, 2, 3].map(words_of), [5, 8, 11]);
        assert_eq!(
            [3, 5, 7].map(|count| scale_bits(count, EXACT_BITS)),
            [16; 3]
        );
    }

    #[test]
    fn streams_of_16_bits_are_halves_in_order() {
        let words = encode_band(&[[1.0, -1.0, 0.5], [0.0, 0.25, -0.5], [1.0; 3]], EXACT_BITS);
        let halves: Vec<u16> = words
            .iter()
            .flat_map(|w| [*w as u16, (w >> 16) as u16])
            .collect();
        let fractions = [
            32_767, -32_767, 16_384, 0, 8_192, -16_384, 32_767, 32_767, 32_767i16,
        ];
        assert_eq!(halves[0], 0x3c00);
        assert_eq!(halves[1..10], fractions.map(|fraction| fraction as u16));
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
        fn the_error_is_within_half_a_step(
            values in prop::collection::vec(prop::array::uniform3(-10.0f32..10.0), 1..8),
            bits in 8usize..=16,
        ) {
            let largest = values.iter().flatten().fold(0.0f32, |l, v| l.max(v.abs()));
            let words = encode_band(&values, bits);
            let decoded = decode_band(&words, values.len(), bits);
            let coarse = 1.0 + 2f32.powi(5 - scale_bits(values.len(), bits) as i32);
            let bound = largest.max(6.2e-5) * coarse * 0.5001 / fractions_of(bits) + 1e-7 * largest;
            for (a, b) in values.iter().flatten().zip(decoded.iter().flatten()) {
                prop_assert!((a - b).abs() <= bound, "{} became {}", a, b);
            }
            let used = words_for(values.len(), bits);
            prop_assert!(words[used..].iter().all(|word| *word == 0));
        }
    }
}
