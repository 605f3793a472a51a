//! Kept lists merged with those of agents: `plan_merges.comp` and `merge_lists.comp`.

use super::plan_segments::wanted_pairs;
use crate::capacity::groups_for;
use crate::layout::{MERGE_PAIRS, MergePiece, NOT_BLENDED, RequiredCounts};
use crate::stages::IndirectArguments;

/// Length of a merged list; 0 where the list is that of the background.
fn merged_length(kept: [u32; 2], moving: [u32; 2]) -> u32 {
    match moving[1] {
        0 => 0,
        length => kept[1] + length,
    }
}

/// Writes the list of each coarse tile, which is that of the background, merged from index
/// `pairs_max` on, or not blended, the pieces of merged lists, and the dispatch that merges them.
/// `drawn_alone` has the coarse tiles that the image shows already, where `drawn_holds`; of length
/// 0 where all are blended.
pub fn plan_merges(
    required: &mut RequiredCounts,
    kept_required: &RequiredCounts,
    kept_lists: &[[u32; 2]],
    moving_lists: &[[u32; 2]],
    merged_lists: &mut [[u32; 2]],
    pieces: &mut [MergePiece],
    arguments: &mut [[u32; 3]],
    drawn_alone: &mut [u32],
    pairs_max: u32,
    drawn_holds: bool,
) {
    let (mut pair, mut piece) = (0u32, 0usize);
    for (bin, (&kept, &moving)) in kept_lists.iter().zip(moving_lists).enumerate() {
        let length = merged_length(kept, moving);
        let alone = moving[1] == 0;
        let mut in_image = false;
        if let Some(drawn) = drawn_alone.get_mut(bin) {
            in_image = alone && drawn_holds && *drawn != 0;
            *drawn = u32::from(alone);
        }
        merged_lists[bin] = match (in_image, alone) {
            (true, _) => [0, NOT_BLENDED],
            (false, true) => kept,
            (false, false) => [pairs_max.wrapping_add(pair), length],
        };
        pair = pair.wrapping_add(length);
        for next in 0..length.div_ceil(MERGE_PAIRS as u32) {
            if let Some(listed) = pieces.get_mut(piece) {
                *listed = MergePiece {
                    bin: bin as u32,
                    piece: next,
                };
            }
            piece += 1;
        }
    }
    let pairs = wanted_pairs(kept_required).saturating_add(wanted_pairs(required));
    (required.pairs_low, required.pairs_high) = (pairs & 0xffff, pairs >> 16);
    required.merges = piece as u32;
    let fits = pairs <= pairs_max;
    arguments[IndirectArguments::Merge as usize] = groups_for(if fits { piece } else { 0 });
}

/// The records of `kept` and `moving`, each in the order of depth keys, in that order; those of
/// `kept` first where keys are equal.
#[must_use]
pub fn merge_lists(kept: &[u32], moving: &[u32], keys: &[u32]) -> Vec<u32> {
    let (mut kept, mut moving) = (kept.iter().peekable(), moving.iter().peekable());
    let mut merged = Vec::with_capacity(kept.len() + moving.len());
    loop {
        let next = match (kept.peek(), moving.peek()) {
            (Some(&&first), Some(&&other)) if keys[first as usize] <= keys[other as usize] => {
                kept.next()
            }
            (Some(_), None) => kept.next(),
            (_, Some(_)) => moving.next(),
            (None, None) => return merged,
        };
        merged.extend(next);
    }
}
