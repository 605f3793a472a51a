//! Lanes cut into cells of two meters: what of the plane a vehicle on each may touch, and how fast
//! it may be there.

use std::ops::Range;

use super::RoadLane;
use super::path::{HALF_AXLES_M, length_of, position_on};
use crate::grid::Grid;
use crate::oriented_box::OrientedBox;
use crate::polyline::wrapped;

/// Length of a cell, meters, a little less where the lane asks for it. Longer ones keep more room
/// free than is needed, shorter ones cost time.
const CELL_M: f64 = 2.0;
/// Acceleration across that is comfortable in a curve, m/s^2.
const LATERAL_MPS2: f64 = 2.0;
/// Bends are looked for in steps of this, meters.
const BEND_STEP_M: f64 = 0.5;
/// Braking for a curve, m/s^2.
const APPROACH_MPS2: f64 = 1.5;
/// Lower limit of comfortable speeds in curves, m/s.
const CURVE_MPS_MIN: f64 = 1.5;

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
    /// Speed of each cell for the curves ahead on its lane, without speed limits.
    curve_mps: Vec<f64>,
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
            cells
                .curve_mps
                .extend(std::iter::repeat_n(f64::INFINITY, count));
        }
        for (number, lane) in lanes.iter().enumerate() {
            let Some(lane) = lane else { continue };
            let length_m = lane.line.length_m();
            cells.slow_down(lanes, &[number], 0.0..length_m);
            for &next in &lane.successors {
                let around = length_m - HALF_AXLES_M..length_m + HALF_AXLES_M;
                cells.slow_down(lanes, &[number, next], around);
            }
        }
        for lane in 0..lanes.len() {
            cells.approach(lane);
        }
        cells
    }

    /// Limits speeds for the bends of a path, where `range_m` along it. Corners of coarse lines are
    /// bends as long as a vehicle's wheelbase.
    fn slow_down(&mut self, lanes: &[Option<RoadLane>], path: &[usize], range_m: Range<f64>) {
        let first_m = length_of(lanes, path[0]);
        let yaw = |at_m: f64| position_on(lanes, path, 0, at_m).yaw_rad;
        let steps = ((range_m.end - range_m.start) / BEND_STEP_M)
            .ceil()
            .max(1.0) as usize;
        let step_m = (range_m.end - range_m.start) / steps as f64;
        let mut before_rad = yaw(range_m.start);
        for step in 0..steps {
            let from_m = range_m.start + step as f64 * step_m;
            let after_rad = yaw(from_m + step_m);
            let curvature = wrapped(after_rad - before_rad).abs() / step_m;
            before_rad = after_rad;
            let bend_mps = (LATERAL_MPS2 / curvature.max(1e-6))
                .sqrt()
                .max(CURVE_MPS_MIN);
            for at_m in [from_m, from_m + step_m] {
                let cell = match path.get(1) {
                    Some(&next) if at_m >= first_m => self.cell_at(next, at_m - first_m),
                    _ => self.cell_at(path[0], at_m),
                };
                if let Some(speed_mps) = self.curve_mps.get_mut(cell) {
                    *speed_mps = speed_mps.min(bend_mps);
                }
            }
        }
    }

    /// Makes each cell of a lane slow enough to become slow enough for those behind it.
    fn approach(&mut self, lane: usize) {
        let LaneCells {
            first,
            count,
            length_m,
        } = self.lanes[lane];
        for cell in (first + 1..first + count).rev() {
            let reached_mps = speed_before(self.curve_mps[cell], length_m);
            self.curve_mps[cell - 1] = self.curve_mps[cell - 1].min(reached_mps);
        }
    }

    pub(crate) fn count(&self) -> usize {
        self.lane_of.len()
    }

    /// Cells of `lane` between two positions along it, clamped to the lane: at least one.
    pub(crate) fn range(&self, lane: usize, from_m: f64, to_m: f64) -> Range<usize> {
        let LaneCells {
            first,
            count,
            length_m,
        } = self.lanes[lane];
        let cell = |at_m: f64| ((at_m / length_m).max(0.0) as usize).min(count.saturating_sub(1));
        first + cell(from_m)..first + (cell(to_m) + 1).min(count)
    }

    /// The cell of `lane` at a position along it, clamped to the lane.
    fn cell_at(&self, lane: usize, at_m: f64) -> usize {
        self.range(lane, at_m, at_m).start
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

    /// Largest speed at `at_m` along `lane` for the curves ahead on it, without speed limits.
    pub(crate) fn curve_mps(&self, lane: usize, at_m: f64) -> f64 {
        self.curve_mps[self.cell_at(lane, at_m)]
    }

    /// Cells that `outline` touches, sorted, into `touched`.
    pub(crate) fn touched(&self, outline: &OrientedBox, touched: &mut Vec<u32>) {
        self.grid.near(outline, touched);
        touched.retain(|&cell| self.corridors[cell as usize].overlaps(outline));
    }
}

/// Speed limit `distance_m` before a position, so that the vehicle reaches the position at its
/// limit.
pub(crate) fn speed_before(there_mps: f64, distance_m: f64) -> f64 {
    (there_mps * there_mps + 2.0 * APPROACH_MPS2 * distance_m.max(0.0)).sqrt()
}
