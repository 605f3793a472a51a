//! Exclusive sums over a list of counts: `scan.comp`.

/// Writes the exclusive sums of `counts`, and their total behind them.
pub fn scan(counts: &[u32], offsets: &mut [u32]) {
    let mut before = 0u32;
    for (first, count) in offsets.iter_mut().zip(counts) {
        *first = before;
        before = before.wrapping_add(*count);
    }
    offsets[counts.len()] = before;
}
