//! Putting almost sorted lists right, proving it, and taking it back: `repair_order.comp`, `check_order.comp` and
//! `restore_order.comp`.

use std::ops::Range;

use crate::layout::{OrderStep, ViewLists, ViewOrder};
use crate::stages::REPAIR_WINDOW;

/// Places of a camera's list of the background as far as there is room: `static_lists.glsl`.
fn static_list(camera: usize, firsts: &[u32], chunk_count: usize, records_max: u32) -> Range<usize> {
    let place = |camera: usize| firsts[camera * chunk_count].min(records_max) as usize;
    place(camera)..place(camera + 1)
}

/// Sorts every window of [`REPAIR_WINDOW`] places of the lists to be repaired by itself, by key and value; windows begin `shift`
/// places before the list.
pub fn repair_order(
    view_orders: &[ViewOrder],
    firsts: &[u32],
    keys: &mut [u32],
    values: &mut [u32],
    camera_count: usize,
    chunk_count: usize,
    records_max: u32,
    shift: usize,
) {
    for camera in (0..camera_count).filter(|&camera| view_orders[camera].path == OrderStep::Repaired as u32) {
        let list = static_list(camera, firsts, chunk_count, records_max);
        let mut first = list.start;
        while first < list.end {
            let windows_begun = (first - list.start + shift) / REPAIR_WINDOW + 1;
            let end = (list.start + windows_begun * REPAIR_WINDOW - shift).min(list.end);
            let mut window: Vec<(u32, u32)> = (first..end).map(|place| (keys[place], values[place])).collect();
            window.sort_unstable();
            for (place, entry) in (first..end).zip(window) {
                (keys[place], values[place]) = entry;
            }
            first = end;
        }
    }
}

/// Adds to `inversions` how many neighbours of each list that the radix sort leaves alone stand the wrong way round.
pub fn check_order(
    view_orders: &[ViewOrder],
    firsts: &[u32],
    keys: &[u32],
    values: &[u32],
    inversions: &mut [u32],
    camera_count: usize,
    chunk_count: usize,
    records_max: u32,
) {
    for camera in (0..camera_count).filter(|&camera| view_orders[camera].path != OrderStep::Sorted as u32) {
        let entry = |place: usize| (keys[place], values[place]);
        let list = static_list(camera, firsts, chunk_count, records_max);
        let inverted = (list.start + 1..list.end).filter(|&place| entry(place - 1) > entry(place));
        inversions[camera] += inverted.count() as u32;
    }
}

/// Puts the lists whose repair left inversions back in splat order, keys and values.
pub fn restore_order(
    view_orders: &[ViewOrder],
    inversions: &[u32],
    lists: &[ViewLists],
    unranked_keys: &[u32],
    keys: &mut [u32],
    values: &mut [u32],
    camera_count: usize,
) {
    for camera in 0..camera_count {
        if view_orders[camera].path == OrderStep::Repaired as u32 && inversions[camera] > 0 {
            let first = lists[camera].first_static;
            for place in first..first + lists[camera].static_count {
                keys[place as usize] = unranked_keys[place as usize];
                values[place as usize] = place;
            }
        }
    }
}
