//! Exclusive sums over a list of counts: `scan.comp`.

/// Writes the exclusive sums of `counts`, and their total behind them.
pub fn scan(counts: &[u32], firsts: &mut [u32]) {
    let mut before = 0u32;
    for (first, count) in firsts.iter_mut().zip(counts) {
        *first = before;
        before = before.wrapping_add(*count);
    }
    firsts[counts.len()] = before;
}
