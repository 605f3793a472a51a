//! Turns at junctions: whether a vehicle comes out where the lane that it came from leads.

use std::collections::HashMap;

use decouplegs_scene::VehicleState;
use glam::DVec2;

use crate::road_parts::RoadParts;

/// Way beyond what was driven within which lanes are looked for, meters: more than a vehicle moves
/// between two moments.
const AHEAD_M: f64 = 30.0;

/// The lanes that a vehicle may be on, moment by moment.
///
/// Lanes that start from one lane lie upon each other, so there may be several. Within a junction
/// lanes that do not follow are not examined; behind it they are a wrong turn.
#[derive(Clone, Debug, Default)]
pub struct TurnWatch {
    /// Lanes that it may be on, with the places on them, meters.
    on: Vec<(usize, f64)>,
    /// Way since it was seen on them, meters.
    way_m: f64,
    /// True if it was in a junction since then.
    was_in_junction: bool,
    last_m: Option<DVec2>,
}

impl TurnWatch {
    /// The vehicle is at `state` now, in a junction or not. True at the moment at which it has
    /// come through a junction onto a lane that those it came from do not lead to.
    pub fn advance(&mut self, parts: &RoadParts, state: &VehicleState, in_junction: bool) -> bool {
        let last_m = self.last_m.replace(state.position_m);
        self.way_m += last_m.map_or(0.0, |last_m| last_m.distance(state.position_m));
        self.was_in_junction |= in_junction;
        let below = parts.lanes_on(state);
        if below.is_empty() {
            return false;
        }
        let reached = reached(parts, &self.on, self.way_m + AHEAD_M);
        let is_reached = |one: &(usize, f64)| reached.contains_key(&one.0);
        let follow: Vec<_> = below.iter().copied().filter(is_reached).collect();
        if follow.is_empty() && in_junction && !self.on.is_empty() {
            return false;
        }
        let is_wrong = follow.is_empty() && !self.on.is_empty() && self.was_in_junction;
        self.on = if follow.is_empty() { below } else { follow };
        (self.way_m, self.was_in_junction) = (0.0, in_junction);
        is_wrong
    }
}

/// Lanes that those of `from` lead to within `way_m`, and the ways to their starts, meters.
fn reached(parts: &RoadParts, from: &[(usize, f64)], way_m: f64) -> HashMap<usize, f64> {
    let mut found: HashMap<usize, f64> = HashMap::new();
    // Ways to the starts of lanes: below zero for those that it is on.
    let mut open: Vec<(usize, f64)> = from.iter().map(|&(lane, at_m)| (lane, -at_m)).collect();
    while let Some((lane, start_m)) = open.pop() {
        if start_m > way_m || found.get(&lane).is_some_and(|&known_m| known_m <= start_m) {
            continue;
        }
        found.insert(lane, start_m);
        let end_m = start_m + parts.length_m(lane);
        open.extend(parts.onward(lane).iter().map(|&next| (next, end_m)));
        open.extend(parts.beside(lane).map(|beside| (beside, start_m)));
    }
    found
}
