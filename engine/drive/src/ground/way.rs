//! The recorded way of the ego as a road: heights and slopes below a vehicle that drove there.

use std::collections::HashMap;

use decouplegs_scene::TimedPose;
use glam::{DMat3, DVec2, DVec3};

/// Distance between nodes, meters, where that gives not too many.
const STEP_M: f64 = 0.5;
/// Most nodes of a way.
const NODES_MAX: f64 = 1e6;
/// Poses nearer to the one before are of a vehicle that stands, meters.
const MOVED_M: f64 = 0.05;
/// Standard deviation of the smoothing along the way, meters: about the distance of the axles, as
/// springs move the body and not the road.
const SMOOTH_M: f64 = 2.5;
/// Standard deviations of the smoothing that count.
const SMOOTH_SIGMAS: f64 = 3.0;
/// Bend of a road that is no surprise, 1/m: an unsure bend is drawn towards none.
const BEND_HOLD: f64 = 0.05;
/// Side of a cell of the index, meters.
const CELL_M: f64 = 8.0;
/// A road is not steeper; what is, is no road.
const SLOPE_MAX: f64 = 0.4;
/// Height differences count this many times as much as distances where ways cross.
const LEVEL_WEIGHT: f64 = 4.0;

/// A point of the road below the way.
#[derive(Clone, Copy, Debug)]
pub struct Node {
    /// World coordinates, meters.
    pub point: DVec3,
    /// Rise a meter along the way.
    pub grade: f64,
    /// Rise a meter to the left.
    pub left: f64,
    /// Distance along the way, meters.
    pub arc_m: f64,
}

/// The way, as nodes at even distances.
pub struct Way {
    nodes: Vec<Node>,
    cells: HashMap<[i32; 2], Vec<u32>>,
}

/// The road beside or on the way.
#[derive(Clone, Copy, Debug)]
pub struct BesideWay {
    /// Height, meters, world coordinates.
    pub z_m: f64,
    /// Distance to the left of the way, meters.
    pub left_m: f64,
}

impl Way {
    /// Largest distance of a position from the way, meters.
    pub const DISTANCE_MAX_M: f64 = CELL_M;

    /// The road `height_m` below the poses of a vehicle. `None` if it does not drive.
    pub fn new(poses: &[TimedPose], height_m: f64) -> Option<Self> {
        let mut points: Vec<(DVec3, f64)> = Vec::new();
        for timed in poses {
            let pose = &timed.pose;
            let point = pose.transform(DVec3::new(0.0, 0.0, -height_m));
            let left = pose.rotation * DVec3::Y;
            let slope = left.z / left.truncate().length();
            let moved = points
                .last()
                .is_none_or(|(last, _)| last.truncate().distance(point.truncate()) >= MOVED_M);
            if point.is_finite() && slope.abs() <= SLOPE_MAX && moved {
                points.push((point, slope));
            }
        }
        let nodes = smoothed(&spaced(&points));
        if nodes.len() < 2 {
            return None;
        }
        let mut cells: HashMap<[i32; 2], Vec<u32>> = HashMap::new();
        for (at, node) in nodes.iter().enumerate() {
            cells
                .entry(cell_of(node.point.truncate()))
                .or_default()
                .push(at as u32);
        }
        Some(Self { nodes, cells })
    }

    /// Nodes, in the order of driving.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// Direction of driving at a node, of length one.
    pub fn ahead(&self, node: usize) -> DVec2 {
        let (before, after) = (node.saturating_sub(1), (node + 1).min(self.nodes.len() - 1));
        let along = self.nodes[after].point - self.nodes[before].point;
        along.truncate().normalize_or(DVec2::X)
    }

    /// Raises all of it by `up_m`.
    pub fn raise(&mut self, up_m: f64) {
        for node in &mut self.nodes {
            node.point.z += up_m;
        }
    }

    /// The road at `xy_m` by the part of the way nearest to it, of several levels the one nearest
    /// to `expected_z_m`. `None` farther than [`Way::DISTANCE_MAX_M`].
    pub fn beside(&self, xy_m: DVec2, expected_z_m: Option<f64>) -> Option<BesideWay> {
        let [x, y] = cell_of(xy_m);
        let near = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy)));
        let near = near.filter_map(|(dx, dy)| {
            self.cells
                .get(&[x.saturating_add(dx), y.saturating_add(dy)])
        });
        let off = |at: &u32| {
            let point = self.nodes[*at as usize].point;
            let level = expected_z_m.map_or(0.0, |z_m| (point.z - z_m).abs());
            point.truncate().distance(xy_m) + LEVEL_WEIGHT * (level - 1.0).max(0.0)
        };
        let nearest = *near
            .flatten()
            .min_by(|a, b| off(a).total_cmp(&off(b)).then(a.cmp(b)))?
            as usize;
        let (from, to) = self.segment(nearest, xy_m);
        let (a, b) = (&self.nodes[from], &self.nodes[to]);
        let along = (b.point - a.point).truncate();
        let length_m = along.length();
        let ahead = along / length_m;
        let (offset_m, last) = (xy_m - a.point.truncate(), self.nodes.len() - 1);
        let arc_m = ahead.dot(offset_m);
        let on_m = arc_m.clamp(0.0, length_m);
        // Beyond its ends the way goes on as it ended; elsewhere a node joins two segments.
        let beyond_m = match (from == 0 && arc_m < 0.0, to == last && arc_m > length_m) {
            (false, false) => 0.0,
            _ => arc_m - on_m,
        };
        let share = on_m / length_m;
        let join = |of: fn(&Node) -> f64| of(a) + share * (of(b) - of(a));
        let left_m = ahead.perp().dot(offset_m);
        if left_m.hypot(beyond_m) > Self::DISTANCE_MAX_M {
            return None;
        }
        let z_m = join(|node| node.point.z)
            + join(|node| node.left) * left_m
            + join(|node| node.grade) * beyond_m;
        Some(BesideWay { z_m, left_m })
    }

    /// The two neighbors of which `nearest` is one and between which `xy_m` is.
    fn segment(&self, nearest: usize, xy_m: DVec2) -> (usize, usize) {
        let last = self.nodes.len() - 1;
        let offset_m = xy_m - self.nodes[nearest].point.truncate();
        let behind = self.ahead(nearest).dot(offset_m) < 0.0;
        match behind {
            _ if nearest == 0 => (0, 1),
            _ if nearest == last => (last - 1, last),
            true => (nearest - 1, nearest),
            false => (nearest, nearest + 1),
        }
    }
}

/// Points at even distances along `points`, with slopes to the left.
fn spaced(points: &[(DVec3, f64)]) -> Vec<Node> {
    let length_m: f64 = points
        .windows(2)
        .map(|pair| pair[0].0.truncate().distance(pair[1].0.truncate()))
        .sum();
    let step_m = STEP_M.max(length_m / NODES_MAX);
    let (mut nodes, mut arc_m, mut next_m) = (Vec::new(), 0.0, 0.0);
    for pair in points.windows(2) {
        let [(from, from_left), (to, to_left)] = [pair[0], pair[1]];
        let piece_m = from.truncate().distance(to.truncate());
        while next_m <= arc_m + piece_m {
            let share = (next_m - arc_m) / piece_m;
            nodes.push(Node {
                point: from.lerp(to, share),
                grade: 0.0,
                left: from_left + share * (to_left - from_left),
                arc_m: next_m,
            });
            next_m += step_m;
        }
        arc_m += piece_m;
    }
    nodes
}

/// `nodes` with heights and slopes smoothed along the way. Grades are those of the heights: the
/// pitch of a body is not that of its road.
fn smoothed(nodes: &[Node]) -> Vec<Node> {
    let window_m = SMOOTH_SIGMAS * SMOOTH_M;
    let fit = |node: &Node| {
        let from = nodes.partition_point(|other| other.arc_m < node.arc_m - window_m);
        let to = nodes.partition_point(|other| other.arc_m <= node.arc_m + window_m);
        let (mut normal, mut right, mut weights, mut left) = (DMat3::ZERO, DVec3::ZERO, 0.0, 0.0);
        for other in &nodes[from..to] {
            let arc_m = other.arc_m - node.arc_m;
            let weight = (-0.5 * (arc_m / SMOOTH_M).powi(2)).exp();
            let row = DVec3::new(1.0, arc_m, arc_m * arc_m);
            normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z) * weight;
            right += row * (weight * (other.point.z - node.point.z));
            weights += weight;
            left += weight * other.left;
        }
        let hold = DMat3::from_diagonal(DVec3::new(0.0, 1e-9, (0.01 / BEND_HOLD).powi(2)));
        let fitted = (normal + hold).inverse() * right;
        Node {
            point: node.point + DVec3::Z * fitted.x,
            grade: fitted.y,
            left: left / weights,
            arc_m: node.arc_m,
        }
    };
    let finite = |node: &Node| node.point.is_finite() && node.grade.abs() <= SLOPE_MAX;
    nodes.iter().map(fit).filter(finite).collect()
}

fn cell_of(at: DVec2) -> [i32; 2] {
    crate::cells::cell_of(at, CELL_M).to_array()
}
