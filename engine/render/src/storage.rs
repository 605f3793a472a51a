//! Storage of the background's splats on the device; `stored_splat.glsl` and `sh.glsl` are the
//! decoders.
//!
//! | bytes of | [`Storage::Exact`] | [`Storage::Compact`] |
//! |---|---|---|
//! | mean | 12: three f32 | 12: the same |
//! | scales, rotation | 28: f32 | 16: see [`CompactShape`] |
//! | opacity | 4: f32 | 4: the same, and the last bits of the scales |
//! | DC | 12: three f32 | 8: fractions of 19 bits |
//! | bands 1, 2, 3 | 20, 32, 44: fractions of 16 bits | 16, 28, 36: of 13, 14 and 13 bits |
//! | splat of degree 3 | 152 | 120 |
//!
//! Means and opacities are never rounded: order, and whether a splat reaches 1/255, stay what they
//! are. An opacity below 1/255, which no pixel shows, is stored as 0.

use decouplegs_scene::{SplatCloud, sh};
use decouplegs_shaders::constants::{
    OPACITY_BIAS, OPACITY_BITS, SCALE_BIAS, SCALE_BITS, SCALE_LOW_BITS,
};
use rayon::prelude::*;

use crate::sh_codec::{self, EXACT_BITS};

/// Storage of the background's splats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Storage {
    /// 152 bytes per splat of degree 3, of which only the bands of spherical harmonics are rounded.
    #[default]
    Exact,
    /// 120 bytes per splat of degree 3.
    Compact,
}

impl Storage {
    /// All kinds of storage.
    pub const ALL: [Self; 2] = [Self::Exact, Self::Compact];

    /// Name in reports, on command lines and in Python.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Compact => "compact",
        }
    }

    /// The storage called `name`.
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|storage| storage.name() == name)
    }

    /// Bits of the fractions of band `band` (0 to 3); `None` where coefficients are f32.
    #[must_use]
    pub const fn sh_bits(self, band: usize) -> Option<usize> {
        match (self, band) {
            (Self::Exact, 0) => None,
            (Self::Exact, _) => Some(EXACT_BITS),
            (Self::Compact, 0) => Some(19),
            (Self::Compact, 2) => Some(14),
            (Self::Compact, _) => Some(13),
        }
    }

    /// Words of band `band` (0 to 3) of one splat.
    #[must_use]
    pub const fn sh_words(self, band: usize) -> usize {
        match self.sh_bits(band) {
            None => 3,
            Some(bits) => sh_codec::words_for(2 * band + 1, bits),
        }
    }

    /// Bytes of one splat with colors of degree `sh_degree`, without the boxes of clusters and the
    /// ids of instances.
    #[must_use]
    pub fn splat_bytes(self, sh_degree: u8) -> usize {
        let shape_and_opacity = match self {
            Self::Exact => 32,
            Self::Compact => 20,
        };
        let sh_words: usize = (0..=usize::from(sh_degree)).map(|l| self.sh_words(l)).sum();
        size_of::<[f32; 3]>() + shape_and_opacity + 4 * sh_words
    }

    /// Scales (m) and unit quaternion (w, x, y, z) as the device reads them back.
    #[must_use]
    pub fn stored_shape(self, scales_m: [f32; 3], rotation: [f32; 4]) -> ([f32; 3], [f32; 4]) {
        match self {
            Self::Exact => (scales_m, rotation),
            Self::Compact => {
                let ([x, y, z, _], rotation) = CompactShape::new(scales_m, rotation, 1.0).unpack();
                ([x, y, z], rotation)
            }
        }
    }

    /// Coefficients of band `band` as the device reads them back.
    #[must_use]
    pub fn stored_band(self, band: usize, coefficients: &[[f32; 3]]) -> Vec<[f32; 3]> {
        let Some(bits) = self.sh_bits(band) else {
            return coefficients.to_vec();
        };
        let words = sh_codec::encode_band(coefficients, bits);
        sh_codec::decode_band(&words, coefficients.len(), bits)
    }

    /// The splats as the device reads them back: what storage alone does to an image is the
    /// difference between theirs and the original's. Splats with a defect are left as they are.
    #[must_use]
    pub fn stored_cloud(self, cloud: &SplatCloud) -> SplatCloud {
        let mut stored = cloud.clone();
        let drawn = |splat: usize| cloud.defect_of(splat).is_none();
        stored
            .scales
            .par_iter_mut()
            .zip(&mut stored.rotations)
            .zip(&mut stored.sh_dc)
            .enumerate()
            .filter(|(splat, _)| drawn(*splat))
            .for_each(|(_, ((scales, rotation), dc))| {
                (*scales, *rotation) = self.stored_shape(*scales, unit(*rotation));
                *dc = self.stored_band(0, &[*dc])[0];
            });
        let stride = cloud.rest_stride();
        if stride > 0 {
            let rest = stored.sh_rest.par_chunks_mut(stride).enumerate();
            rest.filter(|(splat, _)| drawn(*splat))
                .for_each(|(_, rest)| {
                    for band in 1..=cloud.sh_degree {
                        let first = sh::coefficient_count(band - 1) - 1;
                        let range = first..sh::coefficient_count(band) - 1;
                        let values = self.stored_band(band.into(), &rest[range.clone()]);
                        rest[range].copy_from_slice(&values);
                    }
                });
        }
        stored
    }
}

/// The quaternion at unit length, normalized in f64.
pub(crate) fn unit(rotation: [f32; 4]) -> [f32; 4] {
    let q = rotation.map(f64::from);
    let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
    q.map(|x| (x / norm) as f32)
}

/// Scales, rotation and opacity of a splat in 160 bits.
///
/// A scale has 23 bits: 5 of exponent and 18 of mantissa, from 2^-18 to 2^14 m, rounded to 2e-6 of
/// itself; smaller ones become 2^-18 m (3.8 um) or 0, larger ones 2^14 m (16 km). Alpha at a
/// splat's rim changes by up to 11 times the relative change of its scales, which is what decides
/// most of the pixels that storage changes. The rotation leaves out the largest component of its
/// quaternion (2 bits say which); the others are signed fractions of 1/sqrt(2) with 21 bits, an
/// error of 3.4e-7 each. The opacity is the f32 itself, counted from the largest below 1/255.
///
/// | word | bits 0 to 20 | bits 21 to 31 |
/// |---|---|---|
/// | 0 | scale along x, upper 21 bits | lower 11 bits of the first fraction |
/// | 1 | scale along y | its upper 10 bits, then the lower bit of the component left out |
/// | 2 | scale along z | lower 11 bits of the second fraction |
/// | 3 | third fraction | upper 10 bits of the second, then the upper bit of the component |
///
/// The word of the opacity has that in its bits 0 to 25, and the two lower bits of each scale, x
/// first, in those above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompactShape {
    /// Scales and rotation.
    pub shape: [u32; 4],
    /// Opacity and the last bits of the scales.
    pub opacity: u32,
}

/// Largest code of a component's 21 bits.
const COMPONENT_MAX: u32 = (1 << 21) - 1;
/// Largest code of a scale.
const SCALE_MAX: u32 = (1 << (SCALE_BITS + SCALE_LOW_BITS)) - 1;
/// Bits of an f32 that a scale's code has not.
const SCALE_DROPPED: u32 = 5;
/// Value of one step of a component, 1/sqrt(2) / (2^20 - 1).
const COMPONENT_STEP: f32 = std::f32::consts::FRAC_1_SQRT_2 / 1_048_575.0;

impl CompactShape {
    /// The code of scales that are finite and not negative, of a unit quaternion (w, x, y, z) and
    /// of an opacity of at most 1.
    #[must_use]
    pub fn new(scales_m: [f32; 3], rotation: [f32; 4], opacity: f32) -> Self {
        let scales = scales_m.map(scale_code);
        let largest = (0..4).fold(0, |best, k| {
            if rotation[k].abs() > rotation[best].abs() {
                k
            } else {
                best
            }
        });
        let sign = f64::from(rotation[largest].signum());
        let code = |component: f32| {
            let fraction = sign * f64::from(component) * std::f64::consts::SQRT_2 * 1_048_575.0;
            fraction.round().clamp(-1_048_575.0, 1_048_575.0) as i32 as u32 & COMPONENT_MAX
        };
        let mut others = (0..4).filter(|k| *k != largest).map(|k| code(rotation[k]));
        let [first, second, third] = std::array::from_fn(|_| others.next().unwrap_or(0));
        let left_out = largest as u32;
        let [x, y, z] = scales.map(|scale| scale >> SCALE_LOW_BITS);
        let low = scales.map(|scale| scale & ((1 << SCALE_LOW_BITS) - 1));
        let low = low[0] | low[1] << SCALE_LOW_BITS | low[2] << (2 * SCALE_LOW_BITS);
        Self {
            shape: [
                x | first << 21,
                y | first >> 11 << 21 | left_out << 31,
                z | second << 21,
                third | second >> 11 << 21 | left_out >> 1 << 31,
            ],
            opacity: opacity.to_bits().saturating_sub(OPACITY_BIAS) | low << OPACITY_BITS,
        }
    }

    /// Scales (m) with opacity, and unit quaternion, in the arithmetic of `stored_splat.glsl`.
    #[must_use]
    pub fn unpack(self) -> ([f32; 4], [f32; 4]) {
        let [x, y, z, w] = self.shape;
        let scale = |axis: u32, word: u32| {
            let low = self.opacity >> (OPACITY_BITS + SCALE_LOW_BITS * axis)
                & ((1 << SCALE_LOW_BITS) - 1);
            match (word & ((1 << SCALE_BITS) - 1)) << SCALE_LOW_BITS | low {
                0 => 0.0,
                code => f32::from_bits((code + SCALE_BIAS) << SCALE_DROPPED),
            }
        };
        let component = |code: u32| ((code << 11) as i32 >> 11) as f32 * COMPONENT_STEP;
        let high = |word: u32| (word >> 21 & 0x3ff) << 11;
        let [a, b, c] = [x >> 21 | high(y), z >> 21 | high(w), w].map(component);
        let left_out = (1.0 - (a * a + b * b + c * c)).max(0.0).sqrt();
        let rotation = match y >> 31 | w >> 31 << 1 {
            0 => [left_out, a, b, c],
            1 => [a, left_out, b, c],
            2 => [a, b, left_out, c],
            _ => [a, b, c, left_out],
        };
        let opacity = match self.opacity & ((1 << OPACITY_BITS) - 1) {
            0 => 0.0,
            code => f32::from_bits(code + OPACITY_BIAS),
        };
        ([scale(0, x), scale(1, y), scale(2, z), opacity], rotation)
    }
}

/// The code of one scale: code 0 is a scale of 0.
fn scale_code(scale_m: f32) -> u32 {
    let rounded = (scale_m.to_bits() + (1 << (SCALE_DROPPED - 1))) >> SCALE_DROPPED;
    if scale_m < 2f32.powi(-19) {
        0
    } else {
        rounded.saturating_sub(SCALE_BIAS).clamp(1, SCALE_MAX)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn a_splat_takes_152_or_120_bytes() {
        assert_eq!(
            [0, 1, 2, 3].map(|l| Storage::Exact.splat_bytes(l)),
            [56, 76, 108, 152]
        );
        assert_eq!(
            [0, 1, 2, 3].map(|l| Storage::Compact.splat_bytes(l)),
            [40, 56, 84, 120]
        );
    }

    #[test]
    fn scales_of_any_size_are_kept_or_saturate() {
        let stored = |scale: f32| {
            Storage::Compact
                .stored_shape([scale; 3], [1.0, 0.0, 0.0, 0.0])
                .0[0]
        };
        for scale in [0.0, 1.0, 0.25, 2f32.powi(-17), 1024.0, 16_000.0] {
            assert_eq!(stored(scale), scale);
        }
        assert_eq!(stored(1e-7), 0.0);
        assert!(stored(2.5e-6) > 3.8e-6 && stored(2.5e-6) < 3.82e-6);
        assert!(stored(1e9) > 16_383.0 && stored(f32::MAX) < 16_384.0);
    }

    #[test]
    fn turns_about_axes_are_exact() {
        for k in 0..4 {
            let rotation = std::array::from_fn(|i| if i == k { 1.0 } else { 0.0 });
            assert_eq!(
                Storage::Compact.stored_shape([1.0; 3], rotation).1,
                rotation
            );
            let opposite = rotation.map(|x: f32| -x);
            assert_eq!(
                Storage::Compact.stored_shape([1.0; 3], opposite).1,
                rotation
            );
        }
    }

    #[test]
    fn opacities_that_a_pixel_can_show_are_kept() {
        let stored = |opacity: f32| {
            let code = CompactShape::new([1.0, 0.3, 7.7], [1.0, 0.0, 0.0, 0.0], opacity);
            code.unpack().0[3]
        };
        let least = 1.0f32 / 255.0;
        for opacity in [least, least.next_up(), 0.1, 0.999_999_94, 1.0] {
            assert_eq!(stored(opacity), opacity);
        }
        for opacity in [least.next_down(), 0.001, 0.0] {
            assert_eq!(stored(opacity), 0.0);
        }
    }

    proptest! {
        #[test]
        fn shapes_are_rounded_to_their_last_bit(
            exponents in prop::array::uniform3(-17.9f32..13.9),
            q in prop::array::uniform4(-1.0f32..1.0),
        ) {
            prop_assume!(q.iter().map(|x| x * x).sum::<f32>() > 1e-4);
            let (scales, rotation) = (exponents.map(f32::exp2), unit(q));
            let (stored_scales, stored) = Storage::Compact.stored_shape(scales, rotation);
            for (a, b) in scales.iter().zip(stored_scales) {
                prop_assert!((a - b).abs() <= 2e-6 * a, "{} became {}", a, b);
            }
            let dot: f32 = rotation.iter().zip(stored).map(|(a, b)| a * b).sum();
            for (a, b) in rotation.iter().zip(stored) {
                prop_assert!((a - b * dot.signum()).abs() <= 1.2e-6, "{:?} became {:?}", rotation, stored);
            }
            // Storing again changes nothing.
            let again = Storage::Compact.stored_shape(stored_scales, unit(stored));
            prop_assert_eq!(again.0, stored_scales);
        }
    }
}
