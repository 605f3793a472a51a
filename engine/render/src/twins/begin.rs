//! `begin.comp` on the CPU.

/// Copies each of `staged` to its index in `copies`, and sets `counted` to zero. Slices are as long
/// as the words that are written.
pub fn begin(staged: &[&[u32]], copies: &mut [&mut [u32]], counted: &mut [&mut [u32]]) {
    for (from, to) in staged.iter().zip(copies) {
        to.copy_from_slice(from);
    }
    for words in counted {
        words.fill(0);
    }
}
