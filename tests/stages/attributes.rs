//! Attributes of records whose sums are known to the bit: each word is the depth times a power of
//! two, which commutes with every rounding.

use decouplegs::render::stages::PartialResults;
use decouplegs::render::{Outputs, Plane, Planes};

use super::{TILE_PIXELS, UNTOUCHED};
use crate::device::Validated;

/// All planes that are blended together with color.
pub fn outputs() -> Outputs {
    let planes: Planes = Plane::ALL
        .into_iter()
        .filter(|plane| !plane.is_median())
        .collect();
    Outputs {
        planes,
        ..Outputs::default()
    }
}

/// Word `word` of the attributes of a record of `depth_m`.
pub fn attribute_of_depth(word: usize, depth_m: f32) -> f32 {
    let sign = if word.is_multiple_of(2) { 1.0 } else { -1.0 };
    sign * depth_m * (-(word as f32)).exp2()
}

/// The means of attributes in all `words` of images of `pixels` pixels are those of depth. Returns
/// how many pixels were written.
///
/// # Errors
/// Names the first word that differs.
pub fn check_means(words: &[u32], pixels: usize) -> Result<usize, String> {
    let (mut first, mut first_word) = (2 * pixels, 0);
    let mut written = 0;
    for plane in outputs().planes.iter().skip(2) {
        let channels = plane.channels();
        for (index, &depth) in words[..pixels].iter().enumerate() {
            written += usize::from(first_word == 0 && depth != UNTOUCHED);
            for channel in 0..channels {
                let expected = match depth {
                    UNTOUCHED => UNTOUCHED,
                    depth => {
                        attribute_of_depth(first_word + channel, f32::from_bits(depth)).to_bits()
                    }
                };
                let found = words[first + channels * index + channel];
                if found != expected && f32::from_bits(found) != f32::from_bits(expected) {
                    return Err(format!(
                        "{plane:?}, pixel {index}, channel {channel}: {found:x}, expected {expected:x}"
                    ));
                }
            }
        }
        first += channels * pixels;
        first_word += channels;
    }
    assert_eq!(first, words.len());
    Ok(written)
}

/// The sums of attributes in partial results are those of depth. Returns how many are not zero.
///
/// # Errors
/// Names the first word that differs.
pub fn check_partials(gpu: &Validated, partials: &PartialResults) -> Result<usize, String> {
    let tiles = gpu.read(&partials.tiles).unwrap();
    let held: u32 = tiles.iter().map(|held| held.tiles.count_ones()).sum();
    // What lies behind was never written.
    let words = (3 + outputs().planes.attribute_words()) * TILE_PIXELS * held as usize;
    check_sums(&gpu.read(&partials.planes).unwrap()[..words])
}

/// [`check_partials`] of the words of some pixels.
fn check_sums(words: &[u32]) -> Result<usize, String> {
    let attributes = outputs().planes.attribute_words();
    let mut found = 0;
    for (index, pixel) in words.chunks_exact(3 + attributes).enumerate() {
        let depth = f32::from_bits(pixel[0]);
        for (word, &sum) in pixel[3..].iter().enumerate() {
            if f32::from_bits(sum) != attribute_of_depth(word, depth) {
                return Err(format!("pixel {index}, word {word}: {sum:x} for {depth}"));
            }
        }
        found += usize::from(depth != 0.0);
    }
    Ok(found)
}

#[test]
fn words_of_another_attribute_are_seen() {
    let planes = outputs().planes;
    let words = planes.attribute_words();
    let sums: Vec<u32> = (0..words)
        .map(|word| attribute_of_depth(word, 3.0).to_bits())
        .collect();
    let mut partial = [&[3.0f32.to_bits(), 0, 0][..], &sums].concat();
    assert_eq!(check_sums(&partial), Ok(1));
    partial.swap(4, 5);
    assert!(
        check_sums(&partial)
            .unwrap_err()
            .starts_with("pixel 0, word 1")
    );
    let mut image = [&[3.0f32.to_bits(), 0][..], &sums].concat();
    assert_eq!(check_means(&image, 1), Ok(1));
    image.swap(2, 3);
    assert!(check_means(&image, 1).unwrap_err().starts_with("Range"));
}
