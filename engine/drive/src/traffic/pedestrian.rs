//! Pedestrians: each walks along a path, waits beside the road for a gap, and stops where a vehicle
//! is in the way.
//!
//! Vehicles see a pedestrian on the road, or about to step on it, as something that stands there
//! (`outsider`). A pedestrian who is held up on the road for long goes back, so that none waits for
//! a vehicle that waits for the pedestrian.

use decouplegs_scene::scenario::Trigger;
use decouplegs_scene::{Pedestrian, VehicleSize, VehicleState};

use super::outsider::{Outsider, nearest_ego};
use super::watch::Watch;
use crate::oriented_box::OrientedBox;
use crate::polyline::{Polyline, wrapped};
use crate::road_graph::RoadGraph;

/// Pedestrians wait this far from where vehicles drive, meters: beside the lane.
const CURB_M: f64 = 0.8;
/// Stretches of road nearer to each other than this are crossed at once, meters: there is no room
/// to stand between them.
const REFUGE_M: f64 = 1.5;
/// The path is examined in steps of this, meters.
const STEP_M: f64 = 0.25;
/// Change of the walking speed, m/s^2.
const START_MPS2: f64 = 2.0;
const STOP_MPS2: f64 = 4.0;
/// A vehicle nearer ahead than this is not walked into, meters.
const IN_THE_WAY_M: f64 = 0.6;
/// Time for which a pedestrian stands on the road before going back, seconds.
const PATIENCE_S: f64 = 2.0;
/// Time for which vehicles expect a pedestrian to walk on, seconds.
const FORESIGHT_S: f64 = 2.0;
/// Free time before and after a vehicle at each position of the road, seconds.
const GAP_S: (f64, f64) = (1.0, 1.5);
/// Free room around a vehicle: behind it, before it and beside it, meters.
const GAP_M: (f64, f64, f64) = (0.5, 1.0, 0.8);

/// Pedestrian in motion.
#[derive(Clone, Debug)]
pub(super) struct Walker {
    line: Polyline,
    size: VehicleSize,
    walk_mps: f64,
    start: Trigger,
    waits_for_gap: bool,
    watch: Watch,
    has_started: bool,
    /// True while walking back to the side of the road.
    returns: bool,
    arc_m: f64,
    speed_mps: f64,
    acceleration_mps2: f64,
    /// Time for which a vehicle has been in the way, seconds.
    held_s: f64,
    /// Stretches of the path on which the box touches the road, meters along it.
    roads: Vec<(f64, f64)>,
}

/// Vehicle that a pedestrian minds.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vehicle {
    pub outline: OrientedBox,
    pub speed_mps: f64,
}

impl Walker {
    /// `None` where the path has no length.
    pub(super) fn new(graph: &RoadGraph, pedestrian: &Pedestrian) -> Option<Self> {
        let line = Polyline::new(pedestrian.path_m.iter().map(|point| point.extend(0.0)))?;
        let mut walker = Self {
            line,
            size: pedestrian.size,
            walk_mps: pedestrian.speed_mps,
            start: pedestrian.start,
            waits_for_gap: pedestrian.waits_for_gap,
            watch: Watch::default(),
            has_started: false,
            returns: false,
            arc_m: 0.0,
            speed_mps: 0.0,
            acceleration_mps2: 0.0,
            held_s: 0.0,
            roads: Vec::new(),
        };
        walker.roads = walker.roads_on(graph);
        Some(walker)
    }

    fn roads_on(&self, graph: &RoadGraph) -> Vec<(f64, f64)> {
        let steps = (self.line.length_m() / STEP_M).ceil() as usize;
        let (mut roads, mut cells): (Vec<(f64, f64)>, Vec<u32>) = (Vec::new(), Vec::new());
        for step in 0..=steps {
            let arc_m = (step as f64 * STEP_M).min(self.line.length_m());
            graph.cells().touched(&self.outline_at(arc_m), &mut cells);
            if cells.is_empty() {
                continue;
            }
            match roads.last_mut() {
                Some(road) if arc_m - road.1 < REFUGE_M => road.1 = arc_m,
                _ => roads.push((arc_m, arc_m)),
            }
        }
        roads
    }

    fn state_at(&self, arc_m: f64) -> VehicleState {
        let back_rad = if self.returns {
            std::f64::consts::PI
        } else {
            0.0
        };
        VehicleState {
            position_m: self.line.at(arc_m).truncate(),
            yaw_rad: wrapped(self.line.heading_at(arc_m) + back_rad),
            speed_mps: self.speed_mps,
            acceleration_mps2: self.acceleration_mps2,
        }
    }

    fn outline_at(&self, arc_m: f64) -> OrientedBox {
        OrientedBox::for_vehicle(&self.state_at(arc_m), &self.size)
    }

    /// Size of the box.
    pub(super) fn size(&self) -> VehicleSize {
        self.size
    }

    pub(super) fn state(&self) -> VehicleState {
        self.state_at(self.arc_m)
    }

    /// The stretch of road that the pedestrian is on, or the next one.
    fn road(&self) -> Option<(f64, f64)> {
        let beyond = |road: &&(f64, f64)| road.1 > self.arc_m;
        self.roads.iter().find(beyond).copied()
    }

    fn is_on_road(&self) -> bool {
        self.road().is_some_and(|road| road.0 < self.arc_m)
    }

    /// Place where the pedestrian turns or stops for good, meters along the path.
    fn end_m(&self) -> f64 {
        match self.road() {
            Some((from_m, _)) if self.returns => (from_m - CURB_M).max(0.0),
            _ if self.returns => self.arc_m,
            _ => self.line.length_m(),
        }
    }

    /// The pedestrian as vehicles see it; `None` off the road.
    pub(super) fn seen(&self, graph: &RoadGraph) -> Option<Outsider> {
        let walks_m = match self.speed_mps > 0.0 {
            true => (self.speed_mps * FORESIGHT_S).min((self.end_m() - self.arc_m).abs()),
            false => 0.0,
        };
        Outsider::pedestrian(graph, &self.outline_at(self.arc_m).extended(walks_m))
    }

    /// Speed after a step among `vehicles`, m/s. The nearest of `egos` starts the walk.
    pub(super) fn decide(
        &mut self,
        (time_s, dt_s): (f64, f64),
        egos: &[VehicleState],
        vehicles: &[Vehicle],
    ) -> f64 {
        let at_m = self.line.at(self.arc_m).truncate();
        let ego = nearest_ego(egos, at_m);
        self.has_started |= match self.start {
            Trigger::Time { time_s: start_s } => time_s >= start_s,
            Trigger::NearEgo { distance_m } => {
                ego.is_some_and(|ego| ego.position_m.distance(at_m) <= distance_m)
            }
            Trigger::Measured(measured) => {
                let own = self.state();
                self.watch.is_due(&measured, time_s, &own, ego)
            }
            // A pedestrian has no behaviors.
            Trigger::After(_) => false,
        };
        if !self.has_started {
            return 0.0;
        }
        let near = self.outline_at(self.arc_m).extended(IN_THE_WAY_M);
        let held = vehicles
            .iter()
            .any(|vehicle| vehicle.outline.overlaps(&near));
        self.held_s = if held { self.held_s + dt_s } else { 0.0 };
        if held {
            if self.held_s > PATIENCE_S && self.is_on_road() {
                self.returns = !self.returns;
                self.waits_for_gap = true;
                self.held_s = 0.0;
            }
            return 0.0;
        }
        let mut rest_m = (self.end_m() - self.arc_m).abs();
        let ahead = self
            .road()
            .filter(|road| !self.returns && road.0 >= self.arc_m);
        if let Some(road) = ahead
            && self.waits_for_gap
            && !self.has_gap(road, vehicles)
        {
            rest_m = rest_m.min((road.0 - CURB_M - self.arc_m).max(0.0));
        }
        // Slow enough to stop after this step.
        let stops_mps = STOP_MPS2 * ((dt_s * dt_s + 2.0 * rest_m / STOP_MPS2).sqrt() - dt_s);
        self.walk_mps
            .min(self.speed_mps + START_MPS2 * dt_s)
            .min(stops_mps)
    }

    /// True if the pedestrian can cross a stretch of road before or after every vehicle, if these
    /// go straight on.
    fn has_gap(&self, road: (f64, f64), vehicles: &[Vehicle]) -> bool {
        let steps = ((road.1 - road.0) / STEP_M).ceil() as usize;
        vehicles.iter().all(|vehicle| {
            let (v_mps, outline) = (vehicle.speed_mps, &vehicle.outline);
            (0..=steps).all(|step| {
                let arc_m = (road.0 + step as f64 * STEP_M).min(road.1);
                let time_s = (arc_m - self.arc_m) / self.walk_mps + 0.5;
                let local_m = outline.to_local(self.line.at(arc_m).truncate());
                let rear_m = -outline.half_length_m - GAP_M.0 + v_mps * (time_s - GAP_S.0).max(0.0);
                let front_m = outline.half_length_m + GAP_M.1 + v_mps * (time_s + GAP_S.1);
                local_m.y.abs() > outline.half_width_m + GAP_M.2
                    || !(rear_m..front_m).contains(&local_m.x)
            })
        })
    }

    /// Advances by `dt_s` at the decided speed.
    pub(super) fn advance(&mut self, speed_mps: f64, dt_s: f64) {
        self.acceleration_mps2 = (speed_mps - self.speed_mps) / dt_s;
        self.speed_mps = speed_mps;
        let end_m = self.end_m();
        if self.returns {
            self.arc_m = (self.arc_m - speed_mps * dt_s).max(end_m);
            self.returns = self.arc_m > end_m + 1e-6;
        } else {
            self.arc_m = (self.arc_m + speed_mps * dt_s).min(end_m);
        }
    }
}
