//! One vehicle of the traffic: where on its path it is, where it goes, what it is about to do.

use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::driver::Driver;
use super::following::PathPosition;
use super::idm::{IdmParameters, advance, stopping_m};
use super::random;
use super::relaxation::Accepted;
use super::signals::{NextLight, NextSign, STANDING_MPS};
use super::watch::Watch;
use crate::polyline::wrapped;
use crate::road_graph::{RoadGraph, length_of, position_on};

/// Length of the path that is known ahead, meters: beyond what any model looks for.
const PATH_AHEAD_M: f64 = 250.0;
/// Lanes that lead on so far, meters, or half as far as any, are chosen from.
const ONWARD_M: f64 = 500.0;
/// Parts of a lane change at which its box is examined, and the gap beside another vehicle that it
/// keeps, meters.
const LEAVING_STEPS: u32 = 64;
const LEAVING_MARGIN_M: f64 = 0.2;
/// Number of lanes behind the vehicle that are remembered.
const LANES_BEHIND: usize = 24;

/// A run of conflicts on a path. Positions are meters from the start of the agent's lane.
#[derive(Clone, Copy, Debug)]
pub(super) struct Crossing {
    pub from_m: f64,
    pub to_m: f64,
    /// True if the whole crossing is reserved for the agent until it has left it.
    pub granted: bool,
}

/// A vehicle that is not in the middle of its lane.
#[derive(Clone, Debug)]
pub(super) struct Aside {
    pub traveled_m: f64,
    pub length_m: f64,
    pub kind: AsideKind,
}

/// Room that a lane change needs on the lane that it leaves, meters of way from its start.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct LeavingRoom {
    /// A vehicle whose rear is farther than this before the front is not touched.
    pub passes_m: f64,
    /// The vehicle is wholly off the lane after this way.
    pub leaves_m: f64,
}

impl LeavingRoom {
    /// Room of a vehicle of `size` that comes `aside_m` to a side within `length_m`, beside
    /// vehicles of up to `width_m`.
    pub(super) fn new(aside_m: f64, length_m: f64, size: &VehicleSize, width_m: f64) -> Self {
        let (half_m, half_width_m) = (0.5 * size.length_m, 0.5 * size.width_m);
        let mut room = Self::default();
        for step in 0..LEAVING_STEPS {
            let share = f64::from(step) / f64::from(LEAVING_STEPS);
            let (rest, slope) = change_after(share);
            let (sin, cos) = (slope * aside_m.abs() / length_m).atan().sin_cos();
            let moved_m = aside_m.abs() * (1.0 - rest);
            // The corners towards the lane that it leaves: its rear comes off it last.
            for corner_m in [half_m, -half_m] {
                let off_m = moved_m + corner_m * sin - half_width_m * cos;
                if off_m < 0.5 * width_m + LEAVING_MARGIN_M {
                    room.leaves_m = length_m * (share + 1.0 / f64::from(LEAVING_STEPS));
                    let ahead_m = room.leaves_m + corner_m * cos - half_m;
                    room.passes_m = room.passes_m.max(ahead_m);
                }
            }
        }
        room
    }
}

/// Share of the offset of a lane change that is left after a share of its way, and how fast it
/// falls.
fn change_after(share: f64) -> (f64, f64) {
    (
        1.0 - share * share * (3.0 - 2.0 * share),
        6.0 * share * (1.0 - share),
    )
}

#[derive(Clone, Debug)]
pub(super) enum AsideKind {
    /// Change from another lane, on which it still counts.
    Change {
        from: usize,
        /// Position on the other lane.
        from_arc_m: f64,
        /// Offset at its start from the agent's position on the new lane: along and to the left,
        /// meters.
        offset_m: DVec2,
        /// Room that it needs on the other lane.
        room: LeavingRoom,
    },
    /// Swerve out to a side and back.
    Swerve {
        shape: SwerveShape,
        /// Cells of other lanes that it takes up meanwhile.
        cells: Vec<u32>,
    },
}

/// Way of a swerve.
#[derive(Clone, Copy, Debug)]
pub(super) enum SwerveShape {
    /// Out to a side by as much, meters, and back.
    OutAndBack { amplitude_m: f64 },
    /// Back to the middle from an offset, meters, and a slope to the left there.
    Back { offset_m: f64, slope: f64 },
}

/// Phase of a behavior.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Phase {
    /// The trigger has not come.
    Waiting(Watch),
    /// The behavior has begun, and is tried until `until_s`, seconds.
    Trying {
        until_s: f64,
    },
    Done,
}

#[derive(Clone, Debug)]
pub(super) struct Agent {
    pub number: usize,
    pub size: VehicleSize,
    pub half_m: f64,
    pub driver: Driver,
    /// Differences of what it accepts to what its driver wants, which fade.
    pub accepted: Accepted,
    /// True for a drawn driver who has stood since the start.
    pub stands_since_start: bool,
    /// Speed on a free road instead of the speed limit, m/s.
    pub cruise_mps: Option<f64>,
    pub changes_lanes: bool,
    /// Lanes from where its rear was on; each but the first is a successor of the one before.
    pub path: Vec<usize>,
    /// Index in `path` of the lane below its center.
    pub here: usize,
    pub arc_m: f64,
    pub speed_mps: f64,
    pub acceleration_mps2: f64,
    /// Speed on a free road, for its lane and curves.
    pub free_mps: f64,
    pub aside: Option<Aside>,
    pub crossing: Option<Crossing>,
    /// Position along its path up to which there are no conflicts behind its own crossing, or where
    /// it stops, meters.
    pub clear_m: f64,
    /// Next stop line with a traffic light on its path.
    pub light: Option<NextLight>,
    /// Next stop sign on its path, and the one at which it has stood.
    pub sign: Option<NextSign>,
    pub stood_at: Option<usize>,
    /// True if it must stop before its crossing.
    pub held_up: bool,
    pub waited_s: f64,
    /// Time until it may change lanes again, seconds.
    pub cool_down_s: f64,
    /// Hard braking, and until when.
    pub brake: Option<(f64, f64)>,
    /// True if it brakes harder than in normal driving.
    pub emergency: bool,
    pub phases: Vec<Phase>,
    /// Random choices made so far.
    pub choices: u32,
    /// Waiting time for room to merge before the end of its lane, seconds.
    pub merging_s: f64,
    /// Time until which it is off the map, seconds; `None` while it is on it.
    pub away_until_s: Option<f64>,
}

impl Agent {
    /// Place on the path.
    pub(super) fn path_position(&self) -> PathPosition<'_> {
        PathPosition {
            agent: self.number,
            path: &self.path,
            here: self.here,
            arc_m: self.arc_m,
        }
    }

    pub(super) fn new(
        number: usize,
        size: VehicleSize,
        driver: Driver,
        lane: usize,
        arc_m: f64,
    ) -> Self {
        Self {
            number,
            size,
            half_m: 0.5 * size.length_m,
            driver,
            accepted: Accepted::default(),
            stands_since_start: false,
            cruise_mps: None,
            changes_lanes: false,
            path: vec![lane],
            here: 0,
            arc_m,
            speed_mps: 0.0,
            acceleration_mps2: 0.0,
            free_mps: driver.idm.speed_mps,
            aside: None,
            crossing: None,
            light: None,
            sign: None,
            stood_at: None,
            clear_m: f64::NEG_INFINITY,
            held_up: false,
            waited_s: 0.0,
            cool_down_s: 0.0,
            brake: None,
            emergency: false,
            phases: Vec::new(),
            choices: 0,
            merging_s: 0.0,
            away_until_s: None,
        }
    }

    /// The same vehicle at the start of a lane, standing.
    pub(super) fn at_start_of(&self, lane: usize) -> Self {
        Self {
            cruise_mps: self.cruise_mps,
            changes_lanes: self.changes_lanes,
            phases: self.phases.clone(),
            choices: self.choices,
            ..Self::new(self.number, self.size, self.driver, lane, self.half_m + 0.1)
        }
    }

    /// True if it is on the map.
    pub(super) fn is_here(&self) -> bool {
        self.away_until_s.is_none()
    }

    pub(super) fn lane(&self) -> usize {
        self.path[self.here]
    }

    pub(super) fn front_m(&self) -> f64 {
        self.arc_m + self.half_m
    }

    pub(super) fn rear_m(&self) -> f64 {
        self.arc_m - self.half_m
    }

    /// Position of its front after full braking.
    pub(super) fn stop_m(&self) -> f64 {
        self.front_m() + stopping_m(self.speed_mps)
    }

    /// Driver model at the desired speed here.
    pub(super) fn idm(&self) -> IdmParameters {
        IdmParameters {
            speed_mps: self.free_mps,
            headway_s: self.driver.idm.headway_s + self.accepted.headway_s,
            standstill_gap_m: self.driver.idm.standstill_gap_m + self.accepted.standstill_gap_m,
            ..self.driver.idm
        }
    }

    /// Extends the path where needed: at crossings a way is chosen among those that lead on.
    pub(super) fn extend_path(&mut self, graph: &RoadGraph, seed: u64) {
        let mut ahead_m: f64 = self.path[self.here..]
            .iter()
            .map(|&lane| length_of(graph.lanes(), lane))
            .sum();
        while ahead_m - self.arc_m < PATH_AHEAD_M {
            let last = self.path[self.path.len() - 1];
            let all = &graph.road(last).successors;
            // A vehicle does not circle where a way leads out: a circle leads on endlessly.
            let new = |way: &usize| !self.path.contains(way);
            let has_new = all.iter().any(new);
            let ways: Vec<usize> = all
                .iter()
                .copied()
                .filter(|way| !has_new || new(way))
                .collect();
            let onward_m = |way: usize| graph.road(way).onward_m;
            let farthest_m = ways.iter().map(|&way| onward_m(way)).fold(0.0, f64::max);
            let good = |way: &&usize| onward_m(**way) >= ONWARD_M.min(0.5 * farthest_m);
            let count = ways.iter().filter(good).count();
            if count == 0 {
                break;
            }
            let chosen = if count == 1 {
                0
            } else {
                random::way(seed, self.number, self.choices, count)
            };
            self.choices += u32::from(count > 1);
            let Some(&next) = ways.iter().filter(good).nth(chosen) else {
                break;
            };
            self.path.push(next);
            ahead_m += length_of(graph.lanes(), next);
        }
    }

    /// Place before which it stops for a light or a sign, meters from the start of its lane.
    pub(super) fn hold_m(&self) -> Option<f64> {
        let light_m = self.light.and_then(|light| light.hold_m);
        let sign_m = self.sign.map(|sign| sign.hold_m);
        light_m.into_iter().chain(sign_m).min_by(f64::total_cmp)
    }

    /// End of the path, if it ends within the map: meters from the start of its lane.
    pub(super) fn wall_m(&self, graph: &RoadGraph) -> Option<f64> {
        wall_on(graph, &self.path[self.here..])
    }

    /// The lane that it is leaving by a lane change, and where it is on that lane, meters; `None`
    /// once no part of it is on that lane.
    pub(super) fn left_lane(&self) -> Option<(usize, f64)> {
        let aside = self.aside.as_ref()?;
        match aside.kind {
            AsideKind::Change {
                from,
                from_arc_m,
                room,
                ..
            } if aside.traveled_m < room.leaves_m => Some((from, from_arc_m)),
            _ => None,
        }
    }

    /// Distance before its front beyond which its lane change touches no vehicle on the lane that
    /// it is leaving, meters: below zero where its front is beside such a vehicle already.
    pub(super) fn leaving_m(&self) -> f64 {
        let aside = self.aside.as_ref();
        aside.map_or(0.0, |aside| match aside.kind {
            AsideKind::Change { room, .. } => room.passes_m - aside.traveled_m,
            AsideKind::Swerve { .. } => 0.0,
        })
    }

    /// One step on. Positions are counted from the new lane where it comes to one.
    pub(super) fn advance(
        &mut self,
        graph: &RoadGraph,
        seed: u64,
        acceleration_mps2: f64,
        dt_s: f64,
    ) {
        let (moved_m, after_mps) = advance(self.speed_mps, acceleration_mps2, dt_s);
        self.acceleration_mps2 = (after_mps - self.speed_mps) / dt_s;
        self.speed_mps = after_mps;
        self.arc_m += moved_m;
        self.cool_down_s = (self.cool_down_s - dt_s).max(0.0);
        self.accepted.fade(dt_s);
        self.stands_since_start &= self.speed_mps < STANDING_MPS;
        if let Some(aside) = &mut self.aside {
            aside.traveled_m += moved_m;
            if aside.traveled_m >= aside.length_m {
                self.aside = None;
            }
        }
        while self.here + 1 < self.path.len() && self.arc_m >= length_of(graph.lanes(), self.lane())
        {
            let length_m = length_of(graph.lanes(), self.lane());
            self.arc_m -= length_m;
            self.clear_m -= length_m;
            if let Some(crossing) = &mut self.crossing {
                (crossing.from_m, crossing.to_m) =
                    (crossing.from_m - length_m, crossing.to_m - length_m);
            }
            self.here += 1;
        }
        if self.here > LANES_BEHIND {
            let behind_m: f64 = self.path[LANES_BEHIND / 2..self.here]
                .iter()
                .map(|&lane| length_of(graph.lanes(), lane))
                .sum();
            if behind_m > self.size.length_m {
                self.path.drain(..LANES_BEHIND / 2);
                self.here -= LANES_BEHIND / 2;
            }
        }
        self.extend_path(graph, seed);
    }

    /// State of its box.
    pub(super) fn state(&self, graph: &RoadGraph) -> VehicleState {
        let (position_m, yaw_rad) = self.pose_at(graph, 0.0, self.aside.as_ref());
        VehicleState {
            position_m,
            yaw_rad,
            speed_mps: self.speed_mps,
            acceleration_mps2: self.acceleration_mps2,
        }
    }

    /// Position and heading `ahead_m` farther on, at a position of a maneuver that it may be in.
    pub(super) fn pose_at(
        &self,
        graph: &RoadGraph,
        ahead_m: f64,
        aside: Option<&Aside>,
    ) -> (DVec2, f64) {
        let mut position = position_on(graph.lanes(), &self.path, self.here, self.arc_m + ahead_m);
        if self.driver.keeps_right {
            position.position_m -= DVec2::from_angle(position.yaw_rad).perp() * self.right_m(graph);
        }
        let Some(aside) = aside else {
            return (position.position_m, position.yaw_rad);
        };
        let (offset_m, slope) = aside.offset_after(ahead_m);
        let position_m = position.position_m + DVec2::from_angle(position.yaw_rad).rotate(offset_m);
        (position_m, wrapped(position.yaw_rad + slope.atan()))
    }

    /// Offset from the middle of its lane, meters, positive to the left.
    pub(super) fn lateral_m(&self, graph: &RoadGraph) -> f64 {
        let aside = self.aside.as_ref();
        aside.map_or(0.0, |aside| aside.offset_after(0.0).0.y) - self.right_m(graph)
    }

    /// Offset to the right from the middle of the lane where it keeps to the right, meters: within
    /// what the largest vehicle takes up of the lane, which is free for it.
    fn right_m(&self, graph: &RoadGraph) -> f64 {
        match self.driver.keeps_right {
            true => 0.5 * (graph.vehicle().width_m - self.size.width_m).max(0.0),
            false => 0.0,
        }
    }
}

/// End of a path, if it ends within the map: meters from the start of its first lane.
pub(super) fn wall_on(graph: &RoadGraph, path: &[usize]) -> Option<f64> {
    let last = graph.road(path[path.len() - 1]);
    let ends = last.successors.is_empty() && !last.leaves_map;
    let length_m = |&lane: &usize| length_of(graph.lanes(), lane);
    ends.then(|| path.iter().map(length_m).sum())
}

/// Sharpest bend of a swerve, 1/m, times the square of its length, m^2: the largest second
/// derivative of `amplitude sin^2(pi t)` for t from 0 to 1.
pub(super) fn swerve_bend_m(amplitude_m: f64) -> f64 {
    2.0 * std::f64::consts::PI.powi(2) * amplitude_m.abs()
}

impl Aside {
    /// Speed at which it takes no more than `lateral_mps2` across, m/s.
    pub(super) fn speed_mps_max(&self, lateral_mps2: f64) -> f64 {
        let bend = match self.kind {
            AsideKind::Change { offset_m, .. } => 6.0 * offset_m.y.abs(),
            AsideKind::Swerve { shape, .. } => match shape {
                SwerveShape::OutAndBack { amplitude_m } => swerve_bend_m(amplitude_m),
                SwerveShape::Back { offset_m, slope } => {
                    6.0 * offset_m.abs() + 4.0 * slope.abs() * self.length_m
                }
            },
        };
        self.length_m * (lateral_mps2 / bend.max(1e-6)).sqrt()
    }

    /// Way until it is over, meters.
    pub(super) fn rest_m(&self) -> f64 {
        self.length_m - self.traveled_m
    }

    /// Offset along and to the left of the path after `ahead_m` more, meters, and how much to the
    /// left a meter ahead.
    pub(super) fn offset_after(&self, ahead_m: f64) -> (DVec2, f64) {
        let t = ((self.traveled_m + ahead_m) / self.length_m).clamp(0.0, 1.0);
        match self.kind {
            AsideKind::Change { offset_m, .. } => {
                let (rest, falls) = change_after(t);
                (offset_m * rest, -offset_m.y * falls / self.length_m)
            }
            AsideKind::Swerve { shape, .. } => match shape {
                SwerveShape::OutAndBack { amplitude_m } => {
                    let (sin, cos) = (std::f64::consts::PI * t).sin_cos();
                    let slope =
                        2.0 * std::f64::consts::PI * amplitude_m * sin * cos / self.length_m;
                    (DVec2::new(0.0, amplitude_m * sin * sin), slope)
                }
                SwerveShape::Back { offset_m, slope } => {
                    let (rest, falls) = change_after(t);
                    let way_m = slope * self.length_m * t * (1.0 - t) * (1.0 - t);
                    let turns = slope * (1.0 - t) * (1.0 - 3.0 * t);
                    let left = offset_m * falls / self.length_m;
                    (DVec2::new(0.0, offset_m * rest + way_m), turns - left)
                }
            },
        }
    }
}
