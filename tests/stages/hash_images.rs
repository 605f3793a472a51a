//! `hash_images.comp`: sums over blocks of images.

use decouplegs::render::image_hash::keys;
use decouplegs::render::stages::{HashImages, HashedImage, ImageSums};
use decouplegs::render::twins;

use super::{Random, identical, open, run, upload};
use crate::device::Validated;

/// Sums of `count` pixels from `first` on, on the device; and those of the twin from
/// `twin_pixels`.
fn compare(
    gpu: &Validated,
    pixels: &[u32],
    first: usize,
    twin_pixels: &[u32],
) -> Result<(), String> {
    let twin = twins::hash_images(bytemuck::cast_slice(&twin_pixels[first..]), &keys());
    let first_unit = 3;
    let sums = upload(gpu, &vec![7u64; 8 * (first_unit + twin.len() + 1)]);
    let stage = HashImages::new(gpu).unwrap();
    run(gpu, |r| {
        let image = HashedImage {
            pixels: &upload(gpu, pixels),
            first_pixel: first,
            pixel_count: pixels.len() - first,
        };
        let to = ImageSums {
            keys: &upload(gpu, &keys()),
            sums: &sums,
            first_unit,
        };
        stage.record(r, image, to);
    });
    let mut expected = vec![7u64; 8 * first_unit];
    expected.extend(twin.as_flattened());
    expected.extend([7; 8]);
    identical("sums", &gpu.read(&sums).unwrap(), &expected)
}

fn pixels(count: usize, seed: u64) -> Vec<u32> {
    let mut random = Random(seed);
    (0..count).map(|_| random.below(u32::MAX)).collect()
}

#[test]
fn sums_of_images_of_every_kind_of_end() {
    let gpu = open();
    let piece = 1 << 18;
    for count in [
        61,
        64,
        255,
        256,
        257,
        272,
        273,
        5_000,
        piece,
        piece + 61,
        2 * piece + 300,
    ] {
        for first in [0, 5] {
            let pixels = pixels(first + count, count as u64);
            let result = compare(&gpu, &pixels, first, &pixels);
            result.unwrap_or_else(|error| panic!("{count} pixels from {first}: {error}"));
        }
    }
    // All ones: sums carry from word to word.
    compare(&gpu, &[u32::MAX; 3_000], 0, &[u32::MAX; 3_000]).unwrap();
}

#[test]
fn one_bit_of_one_pixel_is_another_sum() {
    let gpu = open();
    let pixels = pixels(3_000, 1);
    for at in [0, 1_500, 2_999] {
        let mut other = pixels.clone();
        other[at] ^= 1 << 13;
        assert!(compare(&gpu, &pixels, 0, &other).is_err(), "{at}");
    }
}
