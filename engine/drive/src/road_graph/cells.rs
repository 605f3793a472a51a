//! Lanes cut into cells of two meters: what of the plane a vehicle on each may touch, and how fast
//! it may be there.

use std::ops::Range;

use super::RoadLane;
use super::grid::Grid;
use super::path::place_on;
use crate::oriented_box::OrientedBox;
use crate::polyline::wrapped;

/// Length of a cell, meters, a little less where the lane asks for it. Longer ones keep more room
/// free than is needed, shorter ones cost time.
const CELL_M: f64 = 2.0;
/// Acceleration across that is comfortable in a curve, m/s^2.
const LATERAL_MPS2: f64 = 2.0;
/// Braking for a curve, m/s^2.
const APPROACH_MPS2: f64 = 1.5;
/// Lower limit of comfortable speeds in curves, m/s.
const CURVE_MPS_MIN: f64 = 2.5;

/// A part of a lane, meters along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stretch {
    pub from_m: f64,
    pub to_m: f64,
}

/// The cells of one lane.
#[derive(Clone, Copy, Debug, Default)]
struct LaneCells {
    first: usize,
    count: usize,
    length_m: f64,
}

/// All cells of a graph, those of a lane in a row.
#[derive(Clone, Debug, Default)]
pub(crate) struct Cells {
    lanes: Vec<LaneCells>,
    pub(super) lane_of: Vec<u32>,
    pub(super) corridors: Vec<OrientedBox>,
    pub(super) grid: Grid,
    /// Cells of other lanes in each one's way: those of cell `c` are `conflicts[starts[c]..starts[c
    /// + 1]]`.
    pub(super) starts: Vec<u32>,
    pub(super) conflicts: Vec<u32>,
    /// Conflicting cells on each lane, as rows.
    pub(super) stretches: Vec<Vec<Stretch>>,
    approach_mps: Vec<f64>,
}

impl Cells {
    /// Cells without corridors or conflicts.
    pub(super) fn cut(lanes: &[Option<RoadLane>]) -> Self {
        let mut cells = Self::default();
        for (number, lane) in lanes.iter().enumerate() {
            let length_m = lane.as_ref().map_or(0.0, |lane| lane.line.length_m());
            let count = (length_m / CELL_M).ceil() as usize;
            cells.lanes.push(LaneCells {
                first: cells.lane_of.len(),
                count,
                length_m: length_m / count.max(1) as f64,
            });
            cells
                .lane_of
                .extend(std::iter::repeat_n(number as u32, count));
            if let Some(lane) = lane {
                cells
                    .approach_mps
                    .extend(approach_speeds(lanes, number, lane, count));
            }
        }
        cells
    }

    pub(crate) fn count(&self) -> usize {
        self.lane_of.len()
    }

    /// Cells of `lane` between two places along it, clamped to the lane: at least one.
    pub(crate) fn range(&self, lane: usize, from_m: f64, to_m: f64) -> Range<usize> {
        let LaneCells {
            first,
            count,
            length_m,
        } = self.lanes[lane];
        let cell = |at_m: f64| ((at_m / length_m).max(0.0) as usize).min(count.saturating_sub(1));
        first + cell(from_m)..first + (cell(to_m) + 1).min(count)
    }

    /// The lane of a cell and where on it the cell is.
    pub(crate) fn stretch_of(&self, cell: usize) -> (usize, Stretch) {
        let lane = self.lane_of[cell] as usize;
        let LaneCells {
            first, length_m, ..
        } = self.lanes[lane];
        let from_m = (cell - first) as f64 * length_m;
        (
            lane,
            Stretch {
                from_m,
                to_m: from_m + length_m,
            },
        )
    }

    /// Cells of other lanes on which a vehicle may touch one on `cell`.
    pub(crate) fn conflicts_of(&self, cell: usize) -> &[u32] {
        &self.conflicts[self.starts[cell] as usize..self.starts[cell + 1] as usize]
    }

    /// Conflicting stretches of `lane`.
    pub(crate) fn stretches(&self, lane: usize) -> &[Stretch] {
        &self.stretches[lane]
    }

    /// Speed limit at `at_m` along `lane` for the curves ahead on it.
    pub(crate) fn approach_mps(&self, lane: usize, at_m: f64) -> f64 {
        self.approach_mps[self.range(lane, at_m, at_m).start]
    }

    /// Cells that `outline` touches, sorted, into `touched`.
    pub(crate) fn touched(&self, outline: &OrientedBox, touched: &mut Vec<u32>) {
        self.grid.near(outline, touched);
        touched.retain(|&cell| self.corridors[cell as usize].overlaps(outline));
    }
}

/// For each cell of a lane: slow enough for its curve, and to become slow enough for those behind
/// it.
fn approach_speeds(
    lanes: &[Option<RoadLane>],
    number: usize,
    lane: &RoadLane,
    count: usize,
) -> Vec<f64> {
    let length_m = lane.line.length_m() / count.max(1) as f64;
    let yaw =
        |at_m: f64| place_on(lanes, &[number], 0, at_m.clamp(0.0, lane.line.length_m())).yaw_rad;
    let mut speeds: Vec<f64> = (0..count)
        .map(|cell| {
            let from_m = cell as f64 * length_m;
            // Over more than a cell: corners of coarse lines are no curves.
            let (before_m, after_m) = (
                (from_m - 1.0).max(0.0),
                (from_m + length_m + 1.0).min(lane.line.length_m()),
            );
            let turn_rad = wrapped(yaw(after_m) - yaw(before_m)).abs();
            let radius_m = (after_m - before_m) / turn_rad.max(1e-6);
            (LATERAL_MPS2 * radius_m)
                .sqrt()
                .max(CURVE_MPS_MIN)
                .min(lane.speed_limit_mps)
        })
        .collect();
    for cell in (1..count).rev() {
        let reached = (speeds[cell] * speeds[cell] + 2.0 * APPROACH_MPS2 * length_m).sqrt();
        speeds[cell - 1] = speeds[cell - 1].min(reached);
    }
    speeds
}

/// Speed limit `distance_m` before a place, so that the vehicle reaches the place at its limit.
pub(crate) fn speed_before(there_mps: f64, distance_m: f64) -> f64 {
    (there_mps * there_mps + 2.0 * APPROACH_MPS2 * distance_m.max(0.0)).sqrt()
}
