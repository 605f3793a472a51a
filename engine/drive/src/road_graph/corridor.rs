//! Swept area of a vehicle: its box at positions along every path, sliced; each slice belongs to
//! the cell below it.

use decouplegs_scene::VehicleSize;
use glam::DVec2;

use super::RoadLane;
use super::cells::Cells;
use super::path::{length_of, position_on};
use crate::oriented_box::OrientedBox;

/// Distance between positions along the box, and the length of a slice, meters: on a circle of 6 m
/// the box departs 5 mm between two positions.
const STEP_M: f64 = 0.5;
/// Added to each side of the box: for what it departs between positions, and for the nose of one
/// that changes lanes.
const MARGIN_M: f64 = 0.1;
/// Ways on that are followed from an end of a lane. Junctions have fewer than ten.
const WAYS_MAX: usize = 32;

/// The least rectangle along each cell that holds its slices.
pub(super) fn corridors(
    lanes: &[Option<RoadLane>],
    cells: &Cells,
    vehicle: VehicleSize,
) -> Vec<OrientedBox> {
    let mut frames: Vec<Frame> = (0..cells.count())
        .map(|cell| Frame::at_cell(lanes, cells, cell))
        .collect();
    let half_m = DVec2::new(0.5 * vehicle.length_m, 0.5 * vehicle.width_m + MARGIN_M);
    // The axles of a short vehicle lie beyond its box.
    let needed_m = half_m.x + 2.0;
    for (number, lane) in lanes.iter().enumerate() {
        let Some(lane) = lane else { continue };
        let length_m = lane.line.length_m();
        let back = ways(lanes, number, needed_m, |lane| &lane.predecessors);
        let onward = ways(lanes, number, needed_m, |lane| &lane.successors);
        let steps = (length_m / STEP_M).ceil().max(1.0);
        for step in 0..=steps as u64 {
            let at_m = length_m * step as f64 / steps;
            // Only near an end of the lane does it matter where the path comes from or goes.
            let back = if at_m < needed_m {
                &back[..]
            } else {
                &back[..1]
            };
            let onward = if length_m - at_m < needed_m {
                &onward[..]
            } else {
                &onward[..1]
            };
            for before in back {
                for after in onward {
                    let mut path: Vec<usize> = before.iter().rev().copied().collect();
                    let here = path.len();
                    path.push(number);
                    path.extend(after);
                    sweep(lanes, cells, &mut frames, &path, here, at_m, half_m);
                }
            }
        }
    }
    frames.iter().map(Frame::outline).collect()
}

/// Chains of lanes from an end of `lane` as far as `needed_m`; one empty chain where none goes on.
fn ways(
    lanes: &[Option<RoadLane>],
    lane: usize,
    needed_m: f64,
    next: impl Fn(&RoadLane) -> &Vec<usize>,
) -> Vec<Vec<usize>> {
    let (mut found, mut open) = (Vec::new(), vec![(Vec::new(), 0.0)]);
    while let Some((way, length_m)) = open.pop() {
        let last = *way.last().unwrap_or(&lane);
        let further = lanes[last].as_ref().map_or(&[][..], |lane| next(lane));
        if length_m >= needed_m
            || further.is_empty()
            || way.len() > WAYS_MAX
            || open.len() > WAYS_MAX
        {
            found.push(way);
            continue;
        }
        open.extend(further.iter().map(|&step| {
            let longer: Vec<usize> = way.iter().copied().chain([step]).collect();
            (longer, length_m + length_of(lanes, step))
        }));
    }
    found
}

/// The box with its middle `at_m` along `path[here]`: each slice widens the cells that it is over.
fn sweep(
    lanes: &[Option<RoadLane>],
    cells: &Cells,
    frames: &mut [Frame],
    path: &[usize],
    here: usize,
    at_m: f64,
    half_m: DVec2,
) {
    let position = position_on(lanes, path, here, at_m);
    let ahead = DVec2::from_angle(position.yaw_rad);
    let starts: Vec<f64> = starts_of(lanes, path, here);
    let slices = (2.0 * half_m.x / STEP_M).ceil();
    for slice in 0..slices as u32 {
        let local = |share: f64| half_m.x * (2.0 * (f64::from(slice) + share) / slices - 1.0);
        let (low_m, high_m) = (local(0.0), local(1.0));
        let corner = |along_m: f64, across_m: f64| {
            position.position_m + ahead * along_m + ahead.perp() * across_m
        };
        let corners = [
            corner(low_m, half_m.y),
            corner(low_m, -half_m.y),
            corner(high_m, half_m.y),
            corner(high_m, -half_m.y),
        ];
        for (number, &lane) in path.iter().enumerate() {
            let (from_m, to_m) = (
                at_m + low_m - starts[number],
                at_m + high_m - starts[number],
            );
            // Beyond the path's ends a vehicle belongs to its last cells.
            let begins = number == 0 || to_m >= 0.0;
            let ends = number + 1 == path.len() || from_m <= length_of(lanes, lane);
            if begins && ends {
                cells
                    .range(lane, from_m, to_m)
                    .for_each(|cell| frames[cell].widen(corners));
            }
        }
    }
}

/// Start of each lane of `path`, meters from the start of `path[here]`.
fn starts_of(lanes: &[Option<RoadLane>], path: &[usize], here: usize) -> Vec<f64> {
    let mut starts = Vec::with_capacity(path.len());
    let mut at_m = -path[..here]
        .iter()
        .map(|&lane| length_of(lanes, lane))
        .sum::<f64>();
    for &lane in path {
        starts.push(at_m);
        at_m += length_of(lanes, lane);
    }
    starts
}

/// A rectangle that grows: bounds along and across a cell.
struct Frame {
    origin: DVec2,
    along: DVec2,
    low: DVec2,
    high: DVec2,
}

impl Frame {
    fn at_cell(lanes: &[Option<RoadLane>], cells: &Cells, cell: usize) -> Self {
        let (lane, stretch) = cells.stretch_of(cell);
        let at = |at_m: f64| position_on(lanes, &[lane], 0, at_m);
        let (from, to) = (at(stretch.from_m).position_m, at(stretch.to_m).position_m);
        let along = (to - from)
            .try_normalize()
            .unwrap_or_else(|| DVec2::from_angle(at(stretch.from_m).yaw_rad));
        Self {
            origin: from,
            along,
            low: DVec2::ZERO,
            high: DVec2::new(from.distance(to), 0.0),
        }
    }

    fn widen(&mut self, corners: [DVec2; 4]) {
        for corner in corners {
            let off = corner - self.origin;
            let local = DVec2::new(self.along.dot(off), self.along.perp_dot(off));
            (self.low, self.high) = (self.low.min(local), self.high.max(local));
        }
    }

    fn outline(&self) -> OrientedBox {
        let (middle, half_m) = (0.5 * (self.low + self.high), 0.5 * (self.high - self.low));
        OrientedBox {
            center_m: self.origin + self.along.rotate(middle),
            yaw_rad: self.along.to_angle(),
            half_length_m: half_m.x,
            half_width_m: half_m.y,
        }
    }
}
