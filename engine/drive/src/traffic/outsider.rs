//! Road users that no lane guides, as vehicles see them: egos and pedestrians, with the lanes
//! they are on and the cells they take up.

use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::idm::stopping_m;
use super::lane_order::{Entry, NO_LANE, PEDESTRIAN, ego_number};
use crate::oriented_box::OrientedBox;
use crate::road_graph::RoadGraph;

/// Time for which an outsider is expected to go straight on before it brakes comfortably, seconds.
const REACTION_S: f64 = 0.5;
/// Deceleration that is expected of an outsider, m/s^2.
const BRAKING_MPS2: f64 = 3.0;
/// Upper limit of plausible speeds: larger values are mistakes.
const SPEED_MPS_MAX: f64 = 100.0;

/// Road user off the lanes' order.
#[derive(Clone, Debug)]
pub(super) struct Outsider {
    pub position_m: DVec2,
    pub outline: OrientedBox,
    /// One for each lane whose corridor its box touches.
    pub entries: Vec<Entry>,
    /// Cells that it touches, or will soon; sorted.
    pub cells: Vec<u32>,
}

/// Egos and pedestrians of a step.
#[derive(Clone, Debug, Default)]
pub(super) struct Outsiders {
    pub egos: Vec<Outsider>,
    /// Pedestrians on the road, or about to step on it, and actors of a story.
    pub pedestrians: Vec<Outsider>,
}

impl Outsiders {
    /// Ego that is nearest to a point.
    pub(super) fn nearest_ego(&self, at_m: DVec2) -> Option<&Outsider> {
        let apart_m = |ego: &&Outsider| ego.position_m.distance_squared(at_m);
        let egos = self.egos.iter();
        egos.min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)))
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &Outsider> {
        self.egos.iter().chain(&self.pedestrians)
    }
}

impl Outsider {
    /// Ego number `ego`, from 0; `None` where its numbers are not finite.
    pub(super) fn ego(
        graph: &RoadGraph,
        ego: usize,
        (state, size): &(VehicleState, VehicleSize),
    ) -> Option<Self> {
        Self::vehicle(graph, state, size, ego_number(ego))
    }

    /// True if it is on a cell, or will soon be.
    pub(super) fn will_be_on(&self, cell: usize) -> bool {
        self.cells.binary_search(&(cell as u32)).is_ok()
    }

    /// An actor of a story, which follows its script; `None` off the road.
    pub(super) fn actor(
        graph: &RoadGraph,
        state: &VehicleState,
        size: &VehicleSize,
    ) -> Option<Self> {
        Self::vehicle(graph, state, size, PEDESTRIAN).filter(|seen| !seen.cells.is_empty())
    }

    fn vehicle(
        graph: &RoadGraph,
        state: &VehicleState,
        size: &VehicleSize,
        agent: u32,
    ) -> Option<Self> {
        let numbers = [state.yaw_rad, state.speed_mps, size.length_m, size.width_m];
        if !state.position_m.is_finite() || !numbers.iter().all(|number| number.is_finite()) {
            return None;
        }
        let speed_mps = state.speed_mps.clamp(0.0, SPEED_MPS_MAX);
        let size = VehicleSize {
            length_m: size.length_m.clamp(0.1, 40.0),
            width_m: size.width_m.clamp(0.1, 10.0),
            ..*size
        };
        let outline = OrientedBox::for_vehicle(state, &size);
        let mut cells = Vec::new();
        graph.cells().touched(&outline, &mut cells);
        let entries = entries(graph, &outline, state.ahead() * speed_mps, &cells, agent);
        // It may go straight on and then stop.
        let stopping_m = speed_mps * REACTION_S + speed_mps * speed_mps / (2.0 * BRAKING_MPS2);
        graph
            .cells()
            .touched(&outline.extended(stopping_m), &mut cells);
        Some(Self {
            position_m: state.position_m,
            outline,
            entries,
            cells,
        })
    }

    /// A pedestrian whose box soon covers `outline`; `None` where that is off the road.
    pub(super) fn pedestrian(graph: &RoadGraph, outline: &OrientedBox) -> Option<Self> {
        let mut cells = Vec::new();
        graph.cells().touched(outline, &mut cells);
        let entries = entries(graph, outline, DVec2::ZERO, &cells, PEDESTRIAN);
        (!cells.is_empty()).then_some(Self {
            position_m: outline.center_m,
            outline: *outline,
            entries,
            cells,
        })
    }
}

/// The nearest of `egos` to a point.
pub(super) fn nearest_ego(egos: &[VehicleState], at_m: DVec2) -> Option<&VehicleState> {
    let apart_m = |ego: &&VehicleState| ego.position_m.distance_squared(at_m);
    let egos = egos.iter();
    egos.min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)))
}

/// Position of a box on each lane of `cells`. `agent` is that of an ego or [`PEDESTRIAN`].
fn entries(
    graph: &RoadGraph,
    outline: &OrientedBox,
    velocity_mps: DVec2,
    cells: &[u32],
    agent: u32,
) -> Vec<Entry> {
    let mut entries = Vec::new();
    let stretch = |cell: &u32| graph.cells().stretch_of(*cell as usize);
    for group in cells.chunk_by(|a, b| stretch(a).0 == stretch(b).0) {
        let (lane, first) = stretch(&group[0]);
        let (_, last) = stretch(&group[group.len() - 1]);
        let line = &graph.road(lane).line;
        let foot = |at: DVec2| line.project_within(at, first.from_m - 2.0, last.to_m + 2.0);
        let arcs = outline.corners().map(|corner| foot(corner).arc_m);
        let rear_m = arcs
            .iter()
            .copied()
            .fold(f64::INFINITY, f64::min)
            .max(first.from_m);
        let front_m = arcs
            .iter()
            .copied()
            .fold(f64::NEG_INFINITY, f64::max)
            .min(last.to_m)
            .max(rear_m + 0.1);
        // Who comes towards one counts as standing.
        let speed_mps = velocity_mps
            .dot(DVec2::from_angle(foot(outline.center_m).heading_rad))
            .max(0.0);
        entries.push(Entry {
            lane: lane as u32,
            agent,
            next: NO_LANE,
            middle_m: 0.5 * (rear_m + front_m),
            rear_m,
            front_m,
            stop_rear_m: rear_m + stopping_m(speed_mps),
            speed_mps,
        });
    }
    entries
}
