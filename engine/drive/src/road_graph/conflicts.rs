//! Conflicting cells, and the conflicts, forks and priorities of lanes that follow from them.

use decouplegs_scene::VehicleSize;

use super::cells::{Cells, Stretch};
use super::corridor;
use super::path::length_of;
use super::{Conflict, Fork, RoadLane, STRAIGHT_RAD};
use crate::grid::Grid;

/// Cells that follow each other along a way by less than this many lengths of a vehicle touch
/// because the way goes on.
const SEQUENCE_LENGTHS: f64 = 3.0;
/// Least height of a lane above another that it crosses on a bridge, meters.
const BRIDGE_M: f64 = 3.0;
/// Most pairs of cells in each other's way, and of cells compared: a large city has a tenth of it.
const PAIRS_MAX: usize = 10_000_000;
/// Largest difference of cells along a fork that counts as beside each other, meters.
const FORK_LEAD_M: f64 = 8.0;
/// Headings that cross by less, radians, come from the front or the same side.
const FROM_ASIDE_RAD: f64 = 0.26;

pub(super) type Found = (Cells, Vec<Vec<Conflict>>, Vec<Vec<Fork>>);

/// All conflicts of lanes for vehicles up to a size.
pub(super) fn find(lanes: &[Option<RoadLane>], vehicle: VehicleSize) -> Result<Found, String> {
    let mut cells = Cells::cut(lanes);
    cells.corridors = corridor::corridors(lanes, &cells, vehicle);
    cells.grid = Grid::new(&cells.corridors);
    let mut pairs = touching_pairs(lanes, &cells, SEQUENCE_LENGTHS * vehicle.length_m)?;
    let forks = take_forks(lanes, &cells, &mut pairs);
    let mut both: Vec<(u32, u32)> = pairs.iter().flat_map(|&(a, b)| [(a, b), (b, a)]).collect();
    both.sort_unstable();
    both.dedup();
    cells.starts = (0..=cells.count())
        .map(|cell| both.partition_point(|pair| (pair.0 as usize) < cell) as u32)
        .collect();
    cells.conflicts = both.iter().map(|pair| pair.1).collect();
    cells.stretches = (0..lanes.len())
        .map(|lane| stretches_of(lanes, &cells, lane))
        .collect();
    let conflicts = conflicts_of_lanes(lanes, &cells, &both);
    Ok((cells, conflicts, forks))
}

/// Pairs of cells of different lanes whose corridors touch, the lower first, unless one follows the
/// other along a way.
fn touching_pairs(
    lanes: &[Option<RoadLane>],
    cells: &Cells,
    sequence_m: f64,
) -> Result<Vec<(u32, u32)>, String> {
    let onward: Vec<Vec<(usize, f64)>> = (0..lanes.len())
        .map(|lane| lanes_within(lanes, lane, sequence_m))
        .collect();
    let follows = |a: u32, b: u32| {
        let ((from, a), (to, b)) = (cells.stretch_of(a as usize), cells.stretch_of(b as usize));
        let rest_m = length_of(lanes, from) - a.to_m + b.from_m;
        onward[from]
            .iter()
            .any(|&(lane, gap_m)| lane == to && rest_m + gap_m <= sequence_m)
    };
    let (mut pairs, mut compared) = (ends_that_meet(lanes, cells), 0);
    for group in cells.grid.groups() {
        compared += group.len() * group.len();
        if pairs.len() > PAIRS_MAX || compared > 20 * PAIRS_MAX {
            return Err(
                "its lanes lie upon each other by the thousand; expected the lanes of a city"
                    .into(),
            );
        }
        for (number, &(_, a)) in group.iter().enumerate() {
            for &(_, b) in &group[number + 1..] {
                let apart = cells.lane_of[a as usize] != cells.lane_of[b as usize];
                let touch = || cells.corridors[a as usize].overlaps(&cells.corridors[b as usize]);
                if apart
                    && touch()
                    && !follows(a, b)
                    && !follows(b, a)
                    && !over_each_other(lanes, cells, a, b)
                {
                    pairs.push((a, b));
                }
            }
        }
    }
    pairs.sort_unstable();
    pairs.dedup();
    Ok(pairs)
}

/// True if one of two cells is on a bridge over the other.
fn over_each_other(lanes: &[Option<RoadLane>], cells: &Cells, a: u32, b: u32) -> bool {
    let height = |cell: u32| {
        let (lane, stretch) = cells.stretch_of(cell as usize);
        let lane = lanes[lane].as_ref().filter(|lane| lane.has_height)?;
        Some(lane.line.at(0.5 * (stretch.from_m + stretch.to_m)).z)
    };
    height(a)
        .zip(height(b))
        .is_some_and(|(a, b)| (a - b).abs() > BRIDGE_M)
}

/// Lanes that begin within `max_m` after the end of `lane`, and how far after it.
fn lanes_within(lanes: &[Option<RoadLane>], lane: usize, max_m: f64) -> Vec<(usize, f64)> {
    let (mut found, mut open): (Vec<(usize, f64)>, _) = (Vec::new(), vec![(lane, 0.0)]);
    while let Some((at, gap_m)) = open.pop() {
        for &next in lanes[at].iter().flat_map(|lane| &lane.successors) {
            let known = found.iter_mut().find(|known| known.0 == next);
            match known {
                Some(known) if known.1 <= gap_m => continue,
                Some(known) => known.1 = gap_m,
                None => found.push((next, gap_m)),
            }
            let beyond_m = gap_m + length_of(lanes, next);
            if beyond_m < max_m {
                open.push((next, beyond_m));
            }
        }
    }
    found
}

/// Last cells of lanes that continue in the same lane, and first cells of lanes that leave the same
/// one: they meet, however they are drawn.
fn ends_that_meet(lanes: &[Option<RoadLane>], cells: &Cells) -> Vec<(u32, u32)> {
    let mut pairs = Vec::new();
    for lane in lanes.iter().flatten() {
        let last = |lane: usize| cells.range(lane, f64::MAX, f64::MAX).start as u32;
        let first = |lane: usize| cells.range(lane, 0.0, 0.0).start as u32;
        let ends = lane
            .predecessors
            .iter()
            .map(|&lane| last(lane))
            .collect::<Vec<_>>();
        let begins = lane
            .successors
            .iter()
            .map(|&lane| first(lane))
            .collect::<Vec<_>>();
        for group in [ends, begins] {
            for (number, &a) in group.iter().enumerate() {
                pairs.extend(group[number + 1..].iter().map(|&b| (a.min(b), a.max(b))));
            }
        }
    }
    pairs
}

/// Takes from `pairs` those beside each other at the start of two lanes that leave the same lane,
/// and nothing else leads to either: there vehicles are one behind the other still.
fn take_forks(
    lanes: &[Option<RoadLane>],
    cells: &Cells,
    pairs: &mut Vec<(u32, u32)>,
) -> Vec<Vec<Fork>> {
    let mut forks = vec![Vec::new(); lanes.len()];
    for lane in lanes.iter().flatten() {
        for (number, &a) in lane.successors.iter().enumerate() {
            for &b in &lane.successors[number + 1..] {
                let alone = |lane: usize| {
                    lanes[lane]
                        .as_ref()
                        .is_some_and(|lane| lane.predecessors.len() == 1)
                };
                if alone(a) && alone(b) {
                    take_fork(cells, a.min(b), a.max(b), pairs, &mut forks);
                }
            }
        }
    }
    forks
}

fn take_fork(
    cells: &Cells,
    a: usize,
    b: usize,
    pairs: &mut Vec<(u32, u32)>,
    forks: &mut [Vec<Fork>],
) {
    let cells_of_a = cells.range(a, 0.0, f64::MAX);
    let (first, last) = (cells_of_a.start as u32, cells_of_a.end as u32);
    let range =
        pairs.partition_point(|pair| pair.0 < first)..pairs.partition_point(|pair| pair.0 < last);
    let from = range.start;
    let (mut end_a_m, mut end_b_m, mut lead_m) = (0.0_f64, 0.0_f64, 0.0_f64);
    let mut beside = Vec::new();
    for at in range {
        let (_, on_a) = cells.stretch_of(pairs[at].0 as usize);
        let (lane, on_b) = cells.stretch_of(pairs[at].1 as usize);
        // As long as it is one row from the start: beyond, the two have parted.
        let in_row = on_a.from_m <= end_a_m + 1e-9 && on_b.from_m <= end_b_m + FORK_LEAD_M;
        if lane == b && in_row && (on_a.from_m - on_b.from_m).abs() <= FORK_LEAD_M {
            (end_a_m, end_b_m) = (end_a_m.max(on_a.to_m), end_b_m.max(on_b.to_m));
            lead_m = lead_m
                .max(on_a.to_m - on_b.from_m)
                .max(on_b.to_m - on_a.from_m);
            beside.push(at - from);
        }
    }
    let mut at = 0;
    let mut beside = beside.into_iter().peekable();
    pairs.retain(|_| {
        let taken = at >= from && beside.next_if_eq(&(at - from)).is_some();
        at += 1;
        !taken
    });
    forks[a].push(Fork {
        other: b,
        to_m: end_a_m,
        lead_m,
    });
    forks[b].push(Fork {
        other: a,
        to_m: end_b_m,
        lead_m,
    });
}

/// Rows of cells of a lane that have conflicts.
fn stretches_of(lanes: &[Option<RoadLane>], cells: &Cells, lane: usize) -> Vec<Stretch> {
    let mut stretches: Vec<Stretch> = Vec::new();
    if lanes[lane].is_none() {
        return stretches;
    }
    for cell in cells
        .range(lane, 0.0, f64::MAX)
        .filter(|&cell| !cells.conflicts_of(cell).is_empty())
    {
        let (_, stretch) = cells.stretch_of(cell);
        match stretches.last_mut() {
            Some(last) if stretch.from_m - last.to_m < 1e-6 => last.to_m = stretch.to_m,
            _ => stretches.push(stretch),
        }
    }
    stretches
}

/// Conflicts of whole lanes, from pairs of cells both ways around, sorted.
fn conflicts_of_lanes(
    lanes: &[Option<RoadLane>],
    cells: &Cells,
    both: &[(u32, u32)],
) -> Vec<Vec<Conflict>> {
    let mut conflicts: Vec<Vec<Conflict>> = vec![Vec::new(); lanes.len()];
    for &(a, b) in both {
        let ((lane, on), (other, on_other)) =
            (cells.stretch_of(a as usize), cells.stretch_of(b as usize));
        let (Some(road), Some(other_road)) = (&lanes[lane], &lanes[other]) else {
            continue;
        };
        if road.left == Some(other) || road.right == Some(other) {
            continue;
        }
        match conflicts[lane]
            .iter_mut()
            .find(|known| known.other == other)
        {
            Some(known) => {
                (known.from_m, known.to_m) = (known.from_m.min(on.from_m), known.to_m.max(on.to_m));
                known.other_from_m = known.other_from_m.min(on_other.from_m);
                known.other_to_m = known.other_to_m.max(on_other.to_m);
            }
            None => conflicts[lane].push(Conflict {
                other,
                from_m: on.from_m,
                to_m: on.to_m,
                other_from_m: on_other.from_m,
                other_to_m: on_other.to_m,
                goes_first: goes_first((lane, road), (other, other_road)),
            }),
        }
    }
    conflicts
}

/// True if the first of two lanes has priority over the second: exactly one of two has.
fn goes_first((lane, road): (usize, &RoadLane), (other, other_road): (usize, &RoadLane)) -> bool {
    let straight = |road: &RoadLane| road.turn_rad.abs() < STRAIGHT_RAD;
    if straight(road) != straight(other_road) {
        return straight(road);
    }
    let across = (other_road.line.heading_at(0.0) - road.line.heading_at(0.0)).sin();
    if across.abs() > FROM_ASIDE_RAD.sin() {
        // Who drives to the left across one's way came from the right.
        return across < 0.0;
    }
    (road.turn_rad, lane) < (other_road.turn_rad, other)
}
