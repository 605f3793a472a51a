//! Writes a (macro tile, record) pair for every macro tile that a record reaches: `emit_pairs.comp`.

use super::footprint::{reached_macro_rows, reached_macro_tiles};
use super::record::load_footprint;
use crate::capacity::groups_for;
use crate::layout::{CameraRecord, Needs, PAIR_BLOCK, SortSegment, ViewLists};
use crate::stages::Arguments;

/// The camera of a record: records of the background lie by camera, and behind them those of the agents.
fn camera_of(record: u32, lists: &[ViewLists], camera_count: usize) -> usize {
    let moving = record >= lists[0].first_moving;
    let first = |camera: usize| if moving { lists[camera].first_moving } else { lists[camera].first_static };
    (1..camera_count).fold(0, |camera, next| if first(next) <= record { next } else { camera })
}

/// Writes the pairs of the records of `order`, each record's by row and then column of its tiles (the kernel leaves the
/// order within a record open), as far as there is room; and how many there were, as far as 32 bits tell.
pub fn emit_pairs(
    cameras: &[CameraRecord],
    needs: &mut Needs,
    order: &[u32],
    lists: &[ViewLists],
    footprints: &[[f32; 4]],
    bins: &mut [u32],
    records: &mut [u32],
    arguments: &mut [[u32; 3]],
    segment: &mut SortSegment,
    records_max: u32,
    sort_block: u32,
) {
    let record_count = if needs.records > records_max { 0 } else { needs.records as usize };
    if record_count == 0 {
        return;
    }
    let mut place = 0usize;
    for &record in &order[..record_count] {
        let camera = &cameras[camera_of(record, lists, cameras.len())];
        let splat = load_footprint(footprints, record as usize);
        let [first_row, last_row] = reached_macro_rows(&splat, camera.size_px[1]);
        for row in first_row..=last_row {
            let [left, right] = reached_macro_tiles(&splat, row as u32, camera.size_px);
            for tile in left..=right {
                if place < bins.len() {
                    bins[place] = camera.first_bin + row as u32 * camera.macro_tiles[0] + tile as u32;
                    records[place] = record;
                }
                place += 1;
            }
        }
    }
    needs.pairs = u32::try_from(place).unwrap_or(u32::MAX);
    let pairs = needs.pairs.min(bins.len() as u32);
    *segment = SortSegment { first: 0, count: pairs, first_block: 0 };
    arguments[Arguments::SortPairs as usize] = groups_for(pairs.div_ceil(sort_block) as usize);
    arguments[Arguments::Ranges as usize] = groups_for(pairs.div_ceil(PAIR_BLOCK as u32) as usize);
}
