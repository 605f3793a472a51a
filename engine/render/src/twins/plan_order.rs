//! Where every camera's two lists lie, and which of them the radix sort has to order: `plan_order.comp`.

use crate::capacity::groups_for;
use crate::layout::{Needs, OrderStep, PAIR_BLOCK, SortSegment, ViewLists, ViewOrder};
use crate::stages::Arguments;

/// Writes the lists of each camera, the segments of the sort (background and agents of each camera, of no length where nothing
/// has to be sorted), the records needed and the sizes of four dispatches. Records without room give lists of no length.
pub fn plan_order(
    view_orders: &[ViewOrder],
    static_firsts: &[u32],
    moving_firsts: &[u32],
    inversions: &[u32],
    lists: &mut [ViewLists],
    segments: &mut [SortSegment],
    needs: &mut Needs,
    arguments: &mut [[u32; 3]],
    camera_count: usize,
    static_chunks: usize,
    moving_chunks: usize,
    records_max: u32,
    sort_block: u32,
) {
    let static_records = static_firsts[camera_count * static_chunks];
    let records = static_records + moving_firsts[camera_count * moving_chunks];
    let fits = records <= records_max;
    let count = |firsts: &[u32], camera: usize, chunks: usize| {
        if fits { firsts[(camera + 1) * chunks] - firsts[camera * chunks] } else { 0 }
    };
    let (mut sort_blocks, mut merge_blocks, mut any_restored) = (0, 0, false);
    for camera in 0..camera_count {
        let (first_static, first_moving) = (static_firsts[camera * static_chunks], moving_firsts[camera * moving_chunks]);
        let list = ViewLists {
            first_static,
            static_count: count(static_firsts, camera, static_chunks),
            first_moving: static_records + first_moving,
            moving_count: count(moving_firsts, camera, moving_chunks),
            first_ordered: first_static + first_moving,
            first_block: merge_blocks,
        };
        lists[camera] = list;
        merge_blocks += (list.static_count + list.moving_count).div_ceil(PAIR_BLOCK as u32);
        let path = view_orders[camera].path;
        let restored = path == OrderStep::Repaired as u32 && inversions[camera] > 0;
        any_restored |= restored;
        let sorted = path == OrderStep::Sorted as u32 || restored;
        let static_count = if sorted { list.static_count } else { 0 };
        for (place, first, count) in [(0, first_static, static_count), (1, list.first_moving, list.moving_count)] {
            segments[2 * camera + place] = SortSegment { first, count, first_block: sort_blocks };
            sort_blocks += count.div_ceil(sort_block);
        }
    }
    needs.records = records;
    let pair_blocks = if fits { records.div_ceil(PAIR_BLOCK as u32) } else { 0 };
    arguments[Arguments::SortRecords as usize] = groups_for(sort_blocks as usize);
    arguments[Arguments::PairBlocks as usize] = groups_for(pair_blocks as usize);
    arguments[Arguments::Merge as usize] = groups_for(merge_blocks as usize);
    arguments[Arguments::Restore as usize] = groups_for(if any_restored { pair_blocks as usize } else { 0 });
}
