//! Codebooks in the light of their agents: `relight.comp`.

use crate::layout::RelightRecord;
use crate::sh_codec::{EXACT_BITS, decode_band, encode_band, words_of};

/// 0.5 / Y0: what the DC term of a splat's color leaves out.
const DC_SHIFT: f32 = 1.772_453_9;

/// Words that bands 1 to 3 of a color take, one behind the other.
const COLOR_WORDS: usize = 24;

/// Writes `c' = T c + b` for every coefficient of every color of `relights`, bands above
/// `sh_degree` left alone.
pub fn relight(
    relights: &[RelightRecord],
    coded_dc: &[[f32; 3]],
    coded_bands: &[[u32; COLOR_WORDS]],
    relit_dc: &mut [[f32; 3]],
    relit_bands: &mut [[u32; COLOR_WORDS]],
    sh_degree: usize,
) {
    for relight in relights {
        for entry in 0..relight.colors as usize {
            let (from, to) = (
                relight.first_color as usize + entry,
                relight.first_relit as usize + entry,
            );
            let lit =
                |number: usize, value: f32| relight.gain[number] * value + relight.summand[number];
            relit_dc[to] = std::array::from_fn(|channel| {
                lit(channel, coded_dc[from][channel] + DC_SHIFT) - DC_SHIFT
            });
            let mut first_word = 0;
            for band in 1..=sh_degree {
                let words = words_of(band);
                let mut coefficients = decode_band(
                    &coded_bands[from][first_word..first_word + words],
                    2 * band + 1,
                    EXACT_BITS,
                );
                for (k, coefficient) in coefficients.iter_mut().enumerate() {
                    *coefficient = std::array::from_fn(|channel| {
                        lit(3 * (band * band + k) + channel, coefficient[channel])
                    });
                }
                relit_bands[to][first_word..first_word + words]
                    .copy_from_slice(&encode_band(&coefficients, EXACT_BITS)[..words]);
                first_word += words;
            }
        }
    }
}
