//! Sums over the blocks of an image that its hash adds up: `hash_images.comp`.

/// Sums of the units of an image's bytes, as XXH3 adds them up. `keys` are those of its secret, and
/// behind them the 8 of last stripes.
///
/// # Panics
/// Panics if a piece of 1 MiB, or the last one, is of less than 64 bytes.
#[must_use]
pub fn hash_images(bytes: &[u8], keys: &[u64; 32]) -> Vec<[u64; 8]> {
    let mut sums = Vec::new();
    for piece in bytes.chunks(1 << 20) {
        let before_last = &piece[..piece.len() - 1];
        for block in 0..=before_last.len() / 1024 {
            let rest = &before_last[1024 * block..];
            let block = &rest[..rest.len().min(1024) / 64 * 64];
            // Whole blocks reach to the last byte; what is left of stripes ends before it.
            sums.push(sum(block, keys, 0));
        }
        sums.push(sum(&piece[piece.len() - 64..], keys, 24));
    }
    sums
}

/// Sums of stripes whose first keys are those from `first_key` on.
fn sum(stripes: &[u8], keys: &[u64; 32], first_key: usize) -> [u64; 8] {
    let mut sums = [0u64; 8];
    for (stripe, bytes) in stripes.chunks_exact(64).enumerate() {
        for (lane, word) in bytes.as_chunks::<8>().0.iter().enumerate() {
            let data = u64::from_le_bytes(*word);
            let keyed = data ^ keys[first_key + stripe + lane];
            let product = (keyed & 0xffff_ffff).wrapping_mul(keyed >> 32);
            sums[lane] = sums[lane].wrapping_add(product);
            sums[lane ^ 1] = sums[lane ^ 1].wrapping_add(data);
        }
    }
    sums
}
