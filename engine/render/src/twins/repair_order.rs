//! Putting almost sorted lists right, proving it, and taking it back: `repair_order.comp`, `check_order.comp` and
//! `restore_order.comp`.

use std::ops::Range;

use crate::layout::{OrderStep, ViewLists, ViewOrder};

/// Places of a camera's list of the background as far as there is room: `static_lists.glsl`.
fn static_list(camera: usize, firsts: &[u32], chunk_count: usize, records_max: u32) -> Range<usize> {
    let place = |camera: usize| firsts[camera * chunk_count].min(records_max) as usize;
    place(camera)..place(camera + 1)
}

/// Writes to `repaired` the values of the lists to be repaired, each at its sorted place as far as the entries up to `reach`
/// places around it tell. Where they do not, two may claim one place, and which of them has it in the end is open.
pub fn repair_order(
    view_orders: &[ViewOrder],
    firsts: &[u32],
    keys: &[u32],
    values: &[u32],
    repaired: &mut [u32],
    camera_count: usize,
    chunk_count: usize,
    records_max: u32,
    reach: usize,
) {
    for camera in (0..camera_count).filter(|&camera| view_orders[camera].path == OrderStep::Repaired as u32) {
        let list = static_list(camera, firsts, chunk_count, records_max);
        let entry = |place: usize| (keys[place], values[place]);
        for place in list.clone() {
            let before = list.start.max(place.saturating_sub(reach))..place;
            let behind = place + 1..list.end.min(place + reach + 1);
            let belong_behind = before.filter(|&other| entry(other) > entry(place)).count();
            let belong_before = behind.filter(|&other| entry(other) < entry(place)).count();
            repaired[place - belong_behind + belong_before] = values[place];
        }
    }
}

/// Takes the repaired lists over with their records' keys, and adds to `inversions` how many entries of each list that the radix
/// sort leaves alone are none of its records, or do not stand behind the one before them.
pub fn check_order(
    view_orders: &[ViewOrder],
    firsts: &[u32],
    keys: &mut [u32],
    values: &mut [u32],
    repaired: &[u32],
    unranked_keys: &[u32],
    inversions: &mut [u32],
    camera_count: usize,
    chunk_count: usize,
    records_max: u32,
) {
    for camera in (0..camera_count).filter(|&camera| view_orders[camera].path != OrderStep::Sorted as u32) {
        let list = static_list(camera, firsts, chunk_count, records_max);
        let is_repaired = view_orders[camera].path == OrderStep::Repaired as u32;
        let is_record = |place: usize| list.contains(&(repaired[place] as usize));
        let entries: Vec<(u32, u32)> = (list.clone())
            .map(|place| match (is_repaired, is_repaired && is_record(place)) {
                (false, _) => (keys[place], values[place]),
                (true, true) => (unranked_keys[repaired[place] as usize], repaired[place]),
                (true, false) => (0, 0),
            })
            .collect();
        for (index, place) in list.clone().enumerate() {
            let foreign = is_repaired && !is_record(place);
            let behind = index == 0 || entries[index] > entries[index - 1];
            inversions[camera] += u32::from(foreign || !behind);
            (keys[place], values[place]) = entries[index];
        }
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
