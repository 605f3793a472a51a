//! Where each (camera, chunk) begins in the list of records: `scan.comp`.

use crate::capacity::groups_for;
use crate::layout::{Needs, PAIR_BLOCK};
use crate::stages::Arguments;

/// Writes the exclusive sums of `counts`, their total, and the dispatches that depend on it. Nothing for no counts.
pub fn scan(
    counts: &[u32],
    firsts: &mut [u32],
    needs: &mut Needs,
    arguments: &mut [[u32; 3]],
    records_max: u32,
    sort_block: u32,
) {
    if counts.is_empty() {
        return;
    }
    let mut before = 0u32;
    for (first, count) in firsts.iter_mut().zip(counts) {
        *first = before;
        before = before.wrapping_add(*count);
    }
    needs.records = before;
    let records = before.min(records_max);
    arguments[Arguments::SortRecords as usize] = groups_for(records.div_ceil(sort_block) as usize);
    arguments[Arguments::PairBlocks as usize] = groups_for(records.div_ceil(PAIR_BLOCK as u32) as usize);
}
