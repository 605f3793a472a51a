//! The way that an ego is to go: lanes after and beside each other, joined into one smooth line.

use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{Invalid, LaneMap};
use glam::{DVec2, DVec3};

use crate::polyline::{Foot, Polyline};

mod joined;
mod search;
mod turns;

pub use search::{LaneSpot, lanes_between, straight_on};
pub use turns::RouteTurn;

/// Distance behind the last progress that is searched, meters: a vehicle does not drive backwards,
/// but the nearest point may.
const SEARCH_BEHIND_M: f64 = 5.0;
/// Distance ahead of it that is searched: more than a vehicle drives in a step, less than the
/// length of a detour around a block.
const SEARCH_AHEAD_M: f64 = 40.0;

/// The line an ego is to follow, from its start to its end.
#[derive(Clone, Debug)]
pub struct Route {
    line: Polyline,
    turns: Vec<RouteTurn>,
    /// Start of each lane along the line, meters, and its index in the map; rising.
    lanes: Vec<(f64, usize)>,
    has_height: bool,
}

impl Route {
    /// The route of `task` through `map`: from `start_m` along its first lane to `end_m` along its
    /// last. Where a lane is a neighbor of the one before it, the line goes over to it within 30 m,
    /// or less where the lanes are shorter.
    ///
    /// # Errors
    /// A sentence naming the lane: one that is not in the map, or twice; one that does not follow
    /// or neighbor the one before; a start or end beyond it; no room to change to it.
    pub fn new(map: &LaneMap, task: &EgoTask) -> Result<Self, Invalid> {
        let joined = joined::join(map, task)?;
        let turns = turns::turns_of(&joined.line);
        Ok(Self {
            turns,
            line: joined.line,
            lanes: joined.lanes,
            has_height: joined.has_height,
        })
    }

    /// The line, a point every meter or so; z is the lanes' height, 0 where the map knows none.
    #[must_use]
    pub fn line(&self) -> &Polyline {
        &self.line
    }

    /// Meters from start to end.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.line.length_m()
    }

    /// True if all of its lanes have heights.
    #[must_use]
    pub fn has_height(&self) -> bool {
        self.has_height
    }

    /// Place and heading (radians, counted from x towards y, not wrapped) `progress_m` along it;
    /// its ends beyond them.
    #[must_use]
    pub fn pose_at(&self, progress_m: f64) -> (DVec3, f64) {
        (self.line.at(progress_m), self.line.heading_at(progress_m))
    }

    /// The position on the route nearest to `position_m`, from 5 m behind `last_progress_m` to 40 m
    /// ahead of it: where the route passes the same position twice, the search does not jump.
    /// `arc_m` of the answer is the progress.
    #[must_use]
    pub fn project(&self, position_m: DVec2, last_progress_m: f64) -> Foot {
        self.line.project_within(
            position_m,
            last_progress_m - SEARCH_BEHIND_M,
            last_progress_m + SEARCH_AHEAD_M,
        )
    }

    /// The lane, an index in the map, that the route is on `progress_m` along; in the middle of a
    /// lane change the new one begins.
    #[must_use]
    pub fn lane_at(&self, progress_m: f64) -> usize {
        let after = self
            .lanes
            .partition_point(|(begin_m, _)| *begin_m <= progress_m);
        self.lanes[after.saturating_sub(1)].1
    }

    /// Start of each of its lanes (indices in the map) along it, meters, rising.
    #[must_use]
    pub fn lanes(&self) -> &[(f64, usize)] {
        &self.lanes
    }

    /// Turns along it, in order.
    #[must_use]
    pub fn turns(&self) -> &[RouteTurn] {
        &self.turns
    }

    /// The turn that `progress_m` is in, otherwise the next one ahead.
    #[must_use]
    pub fn next_turn(&self, progress_m: f64) -> Option<&RouteTurn> {
        self.turns.iter().find(|turn| turn.end_m > progress_m)
    }
}
