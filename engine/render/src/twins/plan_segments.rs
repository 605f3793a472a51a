//! Cuts each macro tile's list into segments and plans how their results are joined: `plan_segments.comp`.

use crate::capacity::groups_for;
use crate::layout::{Composite, Item, MACRO_PIXELS, NO_PARTIAL, Needs};
use crate::stages::Arguments;

/// Workgroups that share the joining of one macro tile.
const COMPOSITE_GROUPS: u32 = MACRO_PIXELS as u32 / 256;

/// Writes the segments of all macro tiles as far as there is room, the macro tiles that were cut, how many of each there
/// are, and the dispatches that depend on it.
pub fn plan_segments(
    needs: &mut Needs,
    range_firsts: &[u32],
    items: &mut [Item],
    composites: &mut [Composite],
    arguments: &mut [[u32; 3]],
    bin_count: u32,
    pairs_max: u32,
    partials_max: u32,
    segment_pairs: u32,
) {
    let pairs = needs.pairs.min(pairs_max);
    let (mut item, mut partial, mut composite) = (0u32, 0u32, 0u32);
    for bin in 0..bin_count {
        let [first_pair, end] = if pairs == 0 { [0, 0] } else { [range_firsts[bin as usize], range_firsts[bin as usize + 1]] };
        let length = end - first_pair;
        let segments = length.div_ceil(segment_pairs).max(1);
        for segment in 0..segments {
            let taken = segment * segment_pairs;
            // Where there is no room for the partial result, any slot will do: the picture is drawn again.
            let slot = if segments > 1 { (partial + segment).min(partials_max.wrapping_sub(1)) } else { NO_PARTIAL };
            if let Some(place) = items.get_mut((item + segment) as usize) {
                *place = Item { bin, first_pair: first_pair + taken, pairs: segment_pairs.min(length - taken), partial: slot };
            }
        }
        item += segments;
        if segments > 1 {
            composites[composite as usize] = Composite { bin, first_partial: partial, partials: segments };
            composite += 1;
            partial += segments;
        }
    }
    if bin_count == 0 {
        return;
    }
    (needs.items, needs.partials, needs.composites) = (item, partial, composite);
    let composite_groups = if partial <= partials_max { composite * COMPOSITE_GROUPS } else { 0 };
    arguments[Arguments::Blend as usize] = groups_for(item.min(items.len() as u32) as usize);
    arguments[Arguments::Composite as usize] = groups_for(composite_groups as usize);
}
