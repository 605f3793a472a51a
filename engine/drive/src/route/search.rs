//! Routes from one position to another, and straight on.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3};

use crate::polyline::Polyline;

/// A position on a lane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneSpot {
    /// Index of the lane in its map.
    pub lane: usize,
    /// Position along the lane, meters.
    pub at_m: f64,
}

/// Cost of a lane change, millimeters: as much as a detour of that length.
const LANE_CHANGE_MM: u64 = 50_000;

/// Lanes of the shortest way over driving lanes, from the lane of `from` to that of `to`. A lane
/// change counts as 50 m. `None` if there is no way.
#[must_use]
pub fn lanes_between(map: &LaneMap, from: LaneSpot, to: LaneSpot) -> Option<Vec<usize>> {
    if from.lane == to.lane {
        return (to.at_m > from.at_m).then(|| vec![from.lane]);
    }
    let mut before: Vec<Option<usize>> = vec![None; map.lanes.len()];
    let mut best: Vec<u64> = vec![u64::MAX; map.lanes.len()];
    let mut queue = BinaryHeap::from([(Reverse(0), from.lane)]);
    best[from.lane] = 0;
    while let Some((Reverse(cost), lane)) = queue.pop() {
        if lane == to.lane {
            let mut lanes = vec![lane];
            while let Some(previous) = before[lanes[lanes.len() - 1]] {
                lanes.push(previous);
            }
            lanes.reverse();
            return Some(lanes);
        }
        if cost > best[lane] {
            continue;
        }
        let listed = &map.lanes[lane];
        let along = (1000.0 * length_m(listed)) as u64;
        let onward = listed.successors.iter().map(|&next| (next, along));
        let beside = [listed.left_neighbor, listed.right_neighbor];
        let beside = beside
            .into_iter()
            .flatten()
            .map(|next| (next, LANE_CHANGE_MM));
        for (next, step) in onward.chain(beside) {
            let next_cost = cost.saturating_add(step);
            if map.lanes[next].kind == LaneKind::Driving && next_cost < best[next] {
                best[next] = next_cost;
                before[next] = Some(lane);
                queue.push((Reverse(next_cost), next));
            }
        }
    }
    None
}

/// Lanes straight on from a position, and its end: `distance_m` further, or where the lanes end. At
/// forks the way is the successor that turns least; no lane comes twice.
#[must_use]
pub fn straight_on(map: &LaneMap, from: LaneSpot, distance_m: f64) -> (Vec<usize>, LaneSpot) {
    let mut lanes = vec![from.lane];
    let mut known = HashSet::from([from.lane]);
    let mut lane = from.lane;
    let mut left_m = from.at_m + distance_m;
    loop {
        let listed = &map.lanes[lane];
        let here_m = length_m(listed);
        if left_m <= here_m {
            break;
        }
        let next = listed
            .successors
            .iter()
            .copied()
            .filter(|next| map.lanes[*next].kind == LaneKind::Driving && !known.contains(next))
            .min_by(|&a, &b| turn_rad(map, lane, a).total_cmp(&turn_rad(map, lane, b)));
        let Some(next) = next else {
            left_m = here_m;
            break;
        };
        left_m -= here_m;
        known.insert(next);
        lanes.push(next);
        lane = next;
    }
    (lanes, LaneSpot { lane, at_m: left_m })
}

/// Angle between the middle of a lane's start and that of its successor's end, radians.
fn turn_rad(map: &LaneMap, lane: usize, next: usize) -> f64 {
    let ends = |line: &[DVec3], at: usize| (line[at + 1] - line[at]).truncate();
    let (own, onward) = (&map.lanes[lane].centerline, &map.lanes[next].centerline);
    let out: DVec2 = ends(own, own.len() - 2);
    out.angle_to(ends(onward, onward.len() - 2)).abs()
}

fn length_m(lane: &Lane) -> f64 {
    let line = Polyline::new(lane.centerline.iter().copied());
    line.map_or(0.0, |line| line.length_m())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two lanes beside each other, the right one goes on to the east and to the north.
    fn fork() -> LaneMap {
        let lane = |id: &str, from: [f64; 2], to: [f64; 2]| Lane {
            id: id.into(),
            centerline: vec![
                DVec3::new(from[0], from[1], 0.0),
                DVec3::new(to[0], to[1], 0.0),
            ],
            ..Lane::default()
        };
        let mut lanes = vec![
            lane("left", [0.0, 3.5], [100.0, 3.5]),
            lane("right", [0.0, 0.0], [100.0, 0.0]),
            lane("north", [100.0, 0.0], [110.0, 90.0]),
            lane("east", [100.0, 0.0], [180.0, 1.0]),
        ];
        lanes[0].right_neighbor = Some(1);
        lanes[1].left_neighbor = Some(0);
        lanes[1].successors = vec![2, 3];
        LaneMap {
            lanes,
            ..LaneMap::default()
        }
    }

    fn spot(lane: usize, at_m: f64) -> LaneSpot {
        LaneSpot { lane, at_m }
    }

    #[test]
    fn the_shortest_way_changes_lanes_where_it_must() {
        let map = fork();
        let between = |from, to| lanes_between(&map, from, to);
        assert_eq!(between(spot(0, 5.0), spot(2, 5.0)), Some(vec![0, 1, 2]));
        assert_eq!(between(spot(1, 5.0), spot(1, 9.0)), Some(vec![1]));
        assert_eq!(between(spot(1, 9.0), spot(1, 5.0)), None);
        assert_eq!(between(spot(2, 5.0), spot(0, 5.0)), None);
    }

    #[test]
    fn straight_on_turns_least_and_ends_with_the_lanes() {
        let map = fork();
        assert_eq!(
            straight_on(&map, spot(1, 50.0), 60.0),
            (vec![1, 3], spot(3, 10.0))
        );
        let (lanes, end) = straight_on(&map, spot(1, 50.0), 1e6);
        assert_eq!(lanes, [1, 3]);
        assert!((end.at_m - 80.006).abs() < 0.01, "{end:?}");
        assert_eq!(
            straight_on(&map, spot(0, 50.0), 10.0),
            (vec![0], spot(0, 60.0))
        );
    }
}
