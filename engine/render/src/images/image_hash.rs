//! Hashes of images that are only hashed: the device adds up, and no image comes to the host.
//!
//! A hash is XXH3 (xxHash, `doc/xxhash_spec.md`, version 0.2) of 128 bits over the hashes of pieces
//! of 1 MiB. XXH3 adds up what each block of 1,024 bytes gives by itself, and then stirs; so the
//! blocks are summed up side by side and the sums are chained.

use decouplegs_gpu::{Buffer, MemoryKind, QueueRole};
use rayon::prelude::*;
use xxhash_rust::xxh3::xxh3_128;

use crate::output::{ColorFormat, PURPOSE};
use crate::stages::{
    HashImages, HashedImage, ImageSums, LANES, PIECE_BYTES, pieces, units_of, units_of_piece,
};
use crate::{RenderError, Renderer};

/// Longest piece that is hashed in another way.
const SHORT_BYTES: usize = 240;
/// Secret of the hash, and the byte of it where the keys of last stripes and of both results begin.
const SECRET: [u64; 24] = [
    0xbe4b_a423_396c_feb8,
    0x1cad_21f7_2c81_017c,
    0xdb97_9083_e96d_d4de,
    0x1f67_b3b7_a4a4_4072,
    0x78e5_c0cc_4ee6_79cb,
    0x2172_ffcc_7dd0_5a82,
    0x8e24_43f7_7446_08b8,
    0x4c26_3a81_e690_35e0,
    0xcb00_c391_bb52_283c,
    0xa32e_531b_8b65_d088,
    0x4ef9_0da2_9748_6471,
    0xd8ac_dea9_46ef_1938,
    0x3f34_9ce3_3f76_faa8,
    0x1d4f_0bc7_c7bb_dcf9,
    0x3159_b4cd_4be0_518a,
    0x6473_78d9_c97e_9fc8,
    0xc3eb_d334_83ac_c5ea,
    0xeb63_13fa_ffa0_81c5,
    0x49da_f0b7_51dd_0d17,
    0x9e68_d429_2655_16d3,
    0xfca1_477d_58be_162b,
    0xce31_d07a_d1b8_f88f,
    0x2804_1695_8f3a_cb45,
    0x7e40_4bbb_cafb_d7af,
];
const LAST_KEYS_AT: usize = 121;
const RESULTS_AT: [usize; 2] = [11, 117];
/// Primes of the hash.
const PRIME32: [u64; 3] = [0x9e37_79b1, 0x85eb_ca77, 0xc2b2_ae3d];
const PRIME64: [u64; 5] = [
    0x9e37_79b1_85eb_ca87,
    0xc2b2_ae3d_27d4_eb4f,
    0x1656_67b1_9e37_79f9,
    0x85eb_ca77_c2b2_ae63,
    0x27d4_eb2f_1656_67c5,
];

/// Hash of `bytes`, as logs have it of readings: of the hashes of its pieces, which are found in
/// parallel.
#[must_use]
pub fn hash_bytes(bytes: &[u8]) -> u128 {
    let pieces = bytes.par_chunks(PIECE_BYTES).map(xxh3_128);
    hash_of_pieces(&pieces.collect::<Vec<u128>>())
}

fn hash_of_pieces(pieces: &[u128]) -> u128 {
    let pieces: Vec<[u8; 16]> = pieces.iter().map(|piece| piece.to_le_bytes()).collect();
    xxh3_128(pieces.as_flattened())
}

/// Key at a byte of the secret.
fn key(at: usize) -> u64 {
    let (word, bits) = (at / 8, 8 * (at % 8));
    match bits {
        0 => SECRET[word],
        bits => SECRET[word] >> bits | SECRET[word + 1] << (64 - bits),
    }
}

/// Keys of stripes: those of blocks, and behind them the 8 of last stripes.
#[must_use]
pub fn keys() -> [u64; 32] {
    std::array::from_fn(|index| match index.checked_sub(SECRET.len()) {
        None => SECRET[index],
        Some(lane) => key(LAST_KEYS_AT + 8 * lane),
    })
}

/// Hash of a piece of `bytes` bytes, longer than [`SHORT_BYTES`], from the sums of its units.
fn hash_of_sums(sums: &[[u64; LANES]], bytes: usize) -> u128 {
    let mut acc = [
        PRIME32[2], PRIME64[0], PRIME64[1], PRIME64[2], PRIME64[3], PRIME32[1], PRIME64[4],
        PRIME32[0],
    ];
    let add = |acc: &mut [u64; LANES], sums: &[u64; LANES]| {
        for (acc, sum) in acc.iter_mut().zip(sums) {
            *acc = acc.wrapping_add(*sum);
        }
    };
    let (blocks, ends) = sums.split_at(sums.len() - 2);
    for sums in blocks {
        add(&mut acc, sums);
        for (lane, acc) in acc.iter_mut().enumerate() {
            let stirred = *acc ^ (*acc >> 47) ^ SECRET[SECRET.len() - LANES + lane];
            *acc = stirred.wrapping_mul(PRIME32[0]);
        }
    }
    ends.iter().for_each(|sums| add(&mut acc, sums));
    let length = bytes as u64;
    let starts = [
        length.wrapping_mul(PRIME64[0]),
        !length.wrapping_mul(PRIME64[1]),
    ];
    let [low, high] = [0, 1].map(|half| {
        let folded = (0..4).map(|pair| {
            let keyed = |lane: usize| u128::from(acc[lane] ^ key(RESULTS_AT[half] + 8 * lane));
            let product = keyed(2 * pair) * keyed(2 * pair + 1);
            product as u64 ^ (product >> 64) as u64
        });
        let mixed = folded.fold(starts[half], u64::wrapping_add);
        let mixed = (mixed ^ (mixed >> 37)).wrapping_mul(0x1656_6791_9e37_79f9);
        mixed ^ (mixed >> 32)
    });
    u128::from(high) << 64 | u128::from(low)
}

/// Hash of an image of `bytes` bytes from the sums of its units.
fn hash_of_image(sums: &[[u64; LANES]], bytes: usize) -> u128 {
    let mut rest = sums;
    let parts: Vec<(&[[u64; LANES]], usize)> = pieces(bytes)
        .map(|bytes| {
            let (own, others) = rest.split_at(units_of_piece(bytes));
            rest = others;
            (own, bytes)
        })
        .collect();
    let hashes = parts
        .into_par_iter()
        .map(|(sums, bytes)| hash_of_sums(sums, bytes));
    hash_of_pieces(&hashes.collect::<Vec<u128>>())
}

/// Kernel and buffers of hashes.
pub(crate) struct ImageHasher {
    stage: HashImages,
    keys: Buffer<u64>,
    sums: Buffer<u64>,
    found: Buffer<u64>,
}

impl ImageHasher {
    fn new(renderer: &Renderer, units: usize) -> Result<Self, RenderError> {
        let gpu = renderer.gpu();
        let (name, len) = ("hashed_images", units * LANES);
        Ok(Self {
            stage: HashImages::new(gpu)?,
            keys: gpu.upload("hash_keys", PURPOSE, &keys())?,
            sums: gpu.buffer(name, PURPOSE, len, MemoryKind::Device)?,
            found: gpu.buffer(name, PURPOSE, len, MemoryKind::Readback)?,
        })
    }
}

impl Renderer {
    /// Hashes of the images of the frame that was finished last, in the order of its cameras: what
    /// [`hash_bytes`] makes of each of [`Renderer::read_bytes`]. None before the first frame.
    ///
    /// # Errors
    /// Returns an error if the device was lost or has not the memory.
    ///
    /// # Panics
    /// Panics if the renderer does not store [`ColorFormat::U8`].
    pub fn hash_images(&mut self) -> Result<Vec<u128>, RenderError> {
        assert!(
            self.options().outputs.color == ColorFormat::U8,
            "the images are stored as floats"
        );
        let (Some((view, buffers)), Some(frame)) = (self.shown_images(), self.shown_frame()) else {
            return Ok(Vec::new());
        };
        let (ranges, pixels) = (view.ranges(), buffers.images_u8.clone());
        let frame = frame.clone();
        let sizes = ranges
            .iter()
            .map(|(first, [width, height])| (*first, *width as usize * *height as usize));
        let sizes: Vec<(usize, usize)> = sizes.collect();
        let is_short = |(_, count): &(usize, usize)| {
            pieces(4 * count)
                .last()
                .is_none_or(|bytes| bytes <= SHORT_BYTES)
        };
        if sizes.iter().any(is_short) {
            let words = self.gpu().read(&pixels)?;
            let image = |(first, count): &(usize, usize)| &words[*first..first + count];
            return Ok(sizes
                .iter()
                .map(|size| hash_bytes(bytemuck::cast_slice(image(size))))
                .collect());
        }
        let units: usize = sizes.iter().map(|(_, count)| units_of(4 * count)).sum();
        let has_room = |hasher: &ImageHasher| hasher.sums.len() >= units * LANES;
        let hasher = match self.hasher.take().filter(has_room) {
            Some(hasher) => hasher,
            None => ImageHasher::new(self, units)?,
        };
        // Beside the next frame, which may be in flight on the main queue.
        let mut recorder = self.gpu().record(QueueRole::Update);
        let mut first_unit = 0;
        for &(first_pixel, pixel_count) in &sizes {
            let image = HashedImage {
                pixels: &pixels,
                first_pixel,
                pixel_count,
            };
            let to = ImageSums {
                keys: &hasher.keys,
                sums: &hasher.sums,
                first_unit,
            };
            hasher.stage.record(&mut recorder, image, to);
            first_unit += units_of(4 * pixel_count);
        }
        recorder.copy(&hasher.sums, 0, &hasher.found, 0, units * LANES);
        self.gpu().submit(recorder, &[&frame])?.wait()?;
        let (mut rest, _) = hasher.found.as_host(units * LANES).as_chunks::<LANES>();
        let hashes = sizes.iter().map(|(_, count)| {
            let (own, others) = rest.split_at(units_of(4 * count));
            rest = others;
            hash_of_image(own, 4 * count)
        });
        let hashes = hashes.collect();
        self.hasher = Some(hasher);
        Ok(hashes)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::twins::hash_images;

    fn bytes(len: usize, seed: u64) -> Vec<u8> {
        let mut state = seed | 1;
        let mut next = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as u8
        };
        (0..len).map(|_| next()).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn chained_sums_are_the_hash_of_the_bytes(len in 241usize..20_000, seed: u64) {
            let bytes = bytes(len, seed);
            let sums = hash_images(&bytes, &keys());
            prop_assert_eq!(hash_of_image(&sums, len), hash_bytes(&bytes));
            let mut other = bytes.clone();
            other[seed as usize % len] ^= 1;
            prop_assert_ne!(hash_of_image(&hash_images(&other, &keys()), len), hash_bytes(&bytes));
        }
    }

    #[test]
    fn pieces_and_blocks_of_every_kind_of_end_are_hashed() {
        let ends = [
            241,
            1023,
            1024,
            1025,
            1088,
            2048,
            PIECE_BYTES - 1,
            PIECE_BYTES,
        ];
        for len in ends.into_iter().chain(ends.map(|end| PIECE_BYTES + end)) {
            let bytes = bytes(len, len as u64);
            let sums = hash_images(&bytes, &keys());
            assert_eq!(sums.len(), units_of(len));
            assert_eq!(hash_of_image(&sums, len), hash_bytes(&bytes), "{len}");
        }
    }
}
