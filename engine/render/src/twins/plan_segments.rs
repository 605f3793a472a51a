//! Cuts each coarse tile's list into segments and plans how their results are joined:
//! `plan_segments.comp`.
//!
//! Items come in waves: segment 0 of every tile, segment 1, segments 2 and 3, segments 4 to 7 and
//! so on.

use super::composite::composite_runs;
use crate::capacity::groups_for;
use crate::layout::{BlendItem, COARSE_PIXELS, Composite, NO_PARTIAL, NOT_BLENDED, RequiredCounts};
use crate::stages::IndirectArguments;

/// Workgroups that share the joining of one coarse tile.
const COMPOSITE_GROUPS: u32 = COARSE_PIXELS as u32 / 256;

/// Pairs that were wanted; `u32::MAX` where they are more than it can hold.
pub(super) fn wanted_pairs(required: &RequiredCounts) -> u32 {
    let pairs = (u64::from(required.pairs_high) << 16) + u64::from(required.pairs_low);
    u32::try_from(pairs).unwrap_or(u32::MAX)
}

/// Writes the segments of all coarse tiles as far as there is room, the coarse tiles that were cut,
/// in parts, how many of each there are, and the dispatches that depend on it.
pub fn plan_segments(
    required: &mut RequiredCounts,
    tile_lists: &[[u32; 2]],
    items: &mut [BlendItem],
    composites: &mut [Composite],
    arguments: &mut [[u32; 3]],
    bin_count: u32,
    pairs_max: u32,
    partials_max: u32,
    segment_pairs: u32,
) {
    let lists = &tile_lists[..bin_count as usize];
    let segments_of = |[_, length]: [u32; 2]| match length {
        NOT_BLENDED => 0,
        length => length.div_ceil(segment_pairs).max(1),
    };

    let (mut partial, mut composite) = (0u32, 0u32);
    let mut first_partials = Vec::new();
    for (bin, &list) in (0u32..).zip(lists) {
        let segments = segments_of(list);
        first_partials.push(partial);
        if segments > 1 {
            for part in 0..composite_runs(segments) {
                if let Some(listed) = composites.get_mut((composite + part) as usize) {
                    *listed = Composite {
                        bin,
                        first_partial: partial,
                        partials: segments,
                        part,
                    };
                }
            }
            composite += composite_runs(segments);
            partial += segments;
        }
    }

    let mut item = 0u32;
    let longest = lists
        .iter()
        .map(|&list| segments_of(list))
        .max()
        .unwrap_or(0);
    let mut wave = 0..1;
    while wave.start < longest {
        for (bin, &list) in (0u32..).zip(lists) {
            for segment in wave.start..wave.end.min(segments_of(list)) {
                let taken = segment * segment_pairs;
                // Where there is no room for the partial result, any slot will do: the image is
                // drawn again.
                let slot =
                    (first_partials[bin as usize] + segment).min(partials_max.wrapping_sub(1));
                if let Some(index) = items.get_mut(item as usize) {
                    let pairs = if segment + 1 < segments_of(list) {
                        segment_pairs
                    } else {
                        list[1] - taken
                    };
                    let partial = if segments_of(list) > 1 {
                        slot
                    } else {
                        NO_PARTIAL
                    };
                    *index = BlendItem {
                        bin,
                        first_pair: list[0] + taken,
                        pairs,
                        partial,
                        segment,
                    };
                }
                item += 1;
            }
        }
        wave = wave.end..2 * wave.end;
    }
    if bin_count == 0 {
        return;
    }
    let lengths = lists.iter().map(|list| list[1]);
    let blended = lengths.filter(|&length| length != NOT_BLENDED);
    required.longest = blended.max().unwrap_or(0);
    required.pairs = wanted_pairs(required);
    (required.items, required.partials, required.composites) = (item, partial, composite);
    let fits = required.pairs <= pairs_max;
    let composite_groups = if fits && partial <= partials_max {
        composite * COMPOSITE_GROUPS
    } else {
        0
    };
    arguments[IndirectArguments::Blend as usize] = groups_for(if fits {
        item.min(items.len() as u32) as usize
    } else {
        0
    });
    arguments[IndirectArguments::Composite as usize] = groups_for(composite_groups as usize);
}
