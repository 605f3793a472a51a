//! Lanes beside each other as one road: its reference line and the borders along it.

use decouplegs_scene::LaneMap;
use glam::{DVec2, DVec3};

use super::write::{Road, WIDTH_M, apart};

/// A lane whose centerline would be moved by more is no part of a road, meters.
const OFF_M: f64 = 0.05;
/// A lane that ends so much before or behind the others is no part of a road, meters.
const ENDS_M: f64 = 0.5;
/// A lane so much higher or lower is no part of a road, meters: one elevation is for all.
const HEIGHT_M: f64 = 0.15;
/// Least width of a lane of a road, meters.
const WIDTH_MIN_M: f64 = 0.1;
/// Lines are looked for within this of the reference line, meters.
const SIDE_MAX_M: f64 = 40.0;
/// A border is read so far beyond its ends, meters: lines rarely end on one normal.
const BEYOND_M: f64 = 2.0;
/// An arc of a smaller curvature, 1/m, is a straight piece.
const STRAIGHT: f64 = 1e-6;
/// Crossings that are looked for in one road: lines of many thousand points stay apart.
const CROSSINGS_MAX: usize = 20_000_000;
/// Bends sharper than this at one place, radians, have no arcs.
const BEND_RAD: f64 = 1.2;

/// A piece of a reference line: straight, or an arc.
pub(super) struct Piece {
    pub(super) start_m: f64,
    pub(super) from: DVec2,
    pub(super) heading_rad: f64,
    pub(super) length_m: f64,
    /// 1/m, above zero to the left; 0 for a straight piece.
    pub(super) curvature: f64,
}

/// A reference line through points.
pub(super) struct ReferenceLine {
    pub(super) pieces: Vec<Piece>,
    /// Distances of the points along the line, meters.
    pub(super) places_m: Vec<f64>,
}

impl ReferenceLine {
    /// Straight pieces through `points`, at least two.
    pub(super) fn straight(points: &[DVec3]) -> Self {
        let mut line = Self {
            pieces: Vec::new(),
            places_m: vec![0.0],
        };
        for pair in points.windows(2) {
            let along = (pair[1] - pair[0]).truncate();
            line.push(pair[0].truncate(), along.to_angle(), along.length(), 0.0);
            line.places_m.push(line.length_m());
        }
        line
    }

    /// Two arcs between each two of `points`, whose headings there are along `tangents`.
    /// `None` where the line would have to turn back.
    fn arcs(points: &[DVec2], tangents: &[DVec2]) -> Option<Self> {
        let mut line = Self {
            pieces: Vec::new(),
            places_m: vec![0.0],
        };
        for (point, tangent) in points.windows(2).zip(tangents.windows(2)) {
            line.push_arcs([point[0], point[1]], [tangent[0], tangent[1]])?;
            line.places_m.push(line.length_m());
        }
        Some(line)
    }

    pub(super) fn length_m(&self) -> f64 {
        self.pieces
            .last()
            .map_or(0.0, |last| last.start_m + last.length_m)
    }

    fn push(&mut self, from: DVec2, heading_rad: f64, length_m: f64, curvature: f64) {
        self.pieces.push(Piece {
            start_m: self.length_m(),
            from,
            heading_rad,
            length_m,
            curvature,
        });
    }

    /// Adds a biarc whose two arcs have tangents of one length (Bolton, "Biarc curves", 1975).
    fn push_arcs(&mut self, points: [DVec2; 2], tangents: [DVec2; 2]) -> Option<()> {
        let across = points[1] - points[0];
        let sum = tangents[0] + tangents[1];
        // across^2 - 2 d across (t0 + t1) + 2 d^2 (t0 t1 - 1) = 0
        let (a, b) = (2.0 * (tangents[0].dot(tangents[1]) - 1.0), across.dot(sum));
        let length = if a.abs() < 1e-12 {
            across.length_squared() / (2.0 * b)
        } else {
            (b - (b * b - a * across.length_squared()).sqrt()) / a
        };
        if !(length.is_finite() && length > 0.0 && length < 10.0 * across.length()) {
            return None;
        }
        let middle = 0.5 * (points[0] + points[1] + (tangents[0] - tangents[1]) * length);
        let joint = (points[1] - tangents[1] * length) - (points[0] + tangents[0] * length);
        let joint = joint.try_normalize()?;
        self.push_arc(points[0], middle, tangents[0], joint)?;
        self.push_arc(middle, points[1], joint, tangents[1])
    }

    fn push_arc(&mut self, from: DVec2, to: DVec2, start: DVec2, end: DVec2) -> Option<()> {
        let chord_m = from.distance(to);
        let turn_rad = start.angle_to(end);
        if chord_m < 1e-9 || turn_rad.abs() > BEND_RAD {
            return None;
        }
        let curvature = 2.0 * (0.5 * turn_rad).sin() / chord_m;
        let (length_m, curvature) = match curvature.abs() < STRAIGHT {
            true => (chord_m, 0.0),
            false => (turn_rad / curvature, curvature),
        };
        self.push(from, start.to_angle(), length_m, curvature);
        Some(())
    }
}

/// Roads of all lanes, of which `singles` are the roads of one lane each: lanes of one direction
/// beside each other are one road as far as their lines allow.
pub(super) fn roads(map: &LaneMap, singles: Vec<Road>) -> Vec<Road> {
    let right_of = |lane: usize| {
        let right = map.lanes[lane].right_neighbor?;
        let other = map.lanes.get(right)?;
        (other.left_neighbor == Some(lane) && right != lane).then_some(right)
    };
    let mut singles: Vec<Option<Road>> = singles.into_iter().map(Some).collect();
    let has_left = |lane: usize| {
        let left = map.lanes[lane].left_neighbor;
        left.is_some_and(|left| left < map.lanes.len() && right_of(left) == Some(lane))
    };
    let mut roads = Vec::new();
    // Lanes around a ring have no leftmost one: they come last, as roads of one lane.
    for first in (0..map.lanes.len()).filter(|lane| !has_left(*lane)) {
        let mut next = Some(first);
        while let Some(leftmost) = next {
            let Some(mut road) = singles[leftmost].take() else {
                break;
            };
            next = right_of(leftmost);
            while let Some(lane) = next {
                let mut lanes = road.lanes.clone();
                lanes.push(lane);
                let Some(wider) = beside(map, lanes) else {
                    break;
                };
                (road, singles[lane]) = (wider, None);
                next = right_of(lane);
            }
            roads.push(road);
        }
    }
    roads.extend(singles.into_iter().flatten());
    roads.sort_by_key(|road| road.lanes.iter().min().copied());
    roads
}

/// The road of `lanes` from left to right; `None` where it would not be where they are.
fn beside(map: &LaneMap, lanes: Vec<usize>) -> Option<Road> {
    let of = |at: usize| &map.lanes[lanes[at]];
    let points = apart(&of(0).centerline);
    let all = lanes.iter().map(|lane| &map.lanes[*lane]);
    let others: usize = all
        .map(|lane| lane.centerline.len() + lane.left.len() + lane.right.len())
        .sum();
    if points.len().saturating_mul(others) > CROSSINGS_MAX {
        return None;
    }
    let flat: Vec<DVec2> = points.iter().map(|point| point.truncate()).collect();
    let tangents = tangents_of(&flat);
    let line = ReferenceLine::arcs(&flat, &tangents)?;
    let mut centers_m = vec![Vec::with_capacity(flat.len()); lanes.len()];
    let mut borders_m = vec![Vec::with_capacity(flat.len()); lanes.len() + 1];
    for (at, (&point, &tangent)) in points.iter().zip(&tangents).enumerate() {
        let across =
            |line: &[DVec3], near_m: f64| crossing(line, point.truncate(), tangent, near_m);
        // From the left border of a lane to its right one, as the map has them.
        let mut sides = Vec::with_capacity(lanes.len());
        let mut near_m = 0.0;
        for (number, center) in centers_m.iter_mut().enumerate() {
            let lane = of(number);
            let (middle_m, height_m) = across(&lane.centerline, near_m)?;
            if lane.has_height != of(0).has_height || (height_m - point.z).abs() > HEIGHT_M {
                return None;
            }
            center.push(middle_m);
            sides.push([&lane.left, &lane.right].map(|border| {
                let found = across(border, middle_m).map(|(side_m, _)| side_m);
                found.filter(|side_m| (side_m - middle_m).abs() < SIDE_MAX_M)
            }));
            near_m = middle_m - WIDTH_M;
        }
        let last = lanes.len() - 1;
        let mut place = |border: usize, value_m: f64| borders_m[border].push(value_m);
        place(0, sides[0][0].unwrap_or(centers_m[0][at] + 0.5 * WIDTH_M));
        for border in 1..=last {
            let own = [sides[border - 1][1], sides[border][0]];
            place(
                border,
                match own {
                    [Some(right_m), Some(left_m)] => 0.5 * (right_m + left_m),
                    [Some(only_m), None] | [None, Some(only_m)] => only_m,
                    [None, None] => 0.5 * (centers_m[border - 1][at] + centers_m[border][at]),
                },
            );
        }
        place(
            last + 1,
            sides[last][1].unwrap_or(centers_m[last][at] - 0.5 * WIDTH_M),
        );
        for (number, center) in centers_m.iter().enumerate() {
            let [left_m, right_m] = [0, 1].map(|side| borders_m[number + side][at]);
            let off_m = (0.5 * (left_m + right_m) - center[at]).abs();
            if off_m > OFF_M || left_m - right_m < WIDTH_MIN_M {
                return None;
            }
        }
    }
    // Lanes that begin or end elsewhere, or lie beyond the middle of a bend, are not beside it.
    for number in 1..lanes.len() {
        let lane = of(number);
        let ends = [
            (lane.centerline[0], 0),
            (lane.centerline[lane.centerline.len() - 1], flat.len() - 1),
        ];
        let is_off = |(end, at): &(DVec3, usize)| {
            (end.truncate() - flat[*at]).dot(tangents[*at]).abs() > ENDS_M
        };
        if ends.iter().any(is_off) {
            return None;
        }
    }
    let farthest_m = borders_m
        .iter()
        .flatten()
        .fold(0.0_f64, |most, border_m| most.max(border_m.abs()));
    if line
        .pieces
        .iter()
        .any(|piece| piece.curvature.abs() * farthest_m > 0.9)
    {
        return None;
    }
    Some(Road {
        heights_m: points.iter().map(|point| point.z).collect(),
        lanes,
        line,
        borders_m,
    })
}

/// Directions of a line at its points: those of the circle through each point and its neighbors.
fn tangents_of(points: &[DVec2]) -> Vec<DVec2> {
    let chord = |at: usize| (points[at + 1] - points[at]).normalize_or_zero();
    let last = points.len() - 1;
    let mut tangents = vec![chord(0); points.len()];
    tangents[last] = chord(last - 1);
    for (at, tangent) in tangents.iter_mut().enumerate().take(last).skip(1) {
        let [before_m, after_m] = [at - 1, at].map(|from| points[from].distance(points[from + 1]));
        // Weighted by the other's length, as the circle's tangent is.
        let sum = chord(at - 1) * after_m + chord(at) * before_m;
        *tangent = sum.try_normalize().unwrap_or(chord(at));
    }
    if last >= 2 {
        // The same circle at the ends: mirrored about the chord.
        let mirrored = |tangent: DVec2, chord: DVec2| 2.0 * tangent.dot(chord) * chord - tangent;
        tangents[0] = mirrored(tangents[1], chord(0));
        tangents[last] = mirrored(tangents[last - 1], chord(last - 1));
    }
    tangents
}

/// Crossing of `line` and the normal of `tangent` at `point`: the distance to the left, meters, and
/// the height. Of several crossings that nearest to `near_m`. `None` without one.
fn crossing(line: &[DVec3], point: DVec2, tangent: DVec2, near_m: f64) -> Option<(f64, f64)> {
    let count = line.len().checked_sub(1)?;
    let local = |place: DVec3| {
        let from_point = place.truncate() - point;
        DVec2::new(tangent.dot(from_point), tangent.perp_dot(from_point))
    };
    let mut best: Option<(f64, f64)> = None;
    for at in 0..count {
        let (from, to) = (local(line[at]), local(line[at + 1]));
        let run_m = to.x - from.x;
        if run_m.abs() < 1e-9 {
            continue;
        }
        let share = -from.x / run_m;
        let beyond = BEYOND_M / from.distance(to);
        let least = if at == 0 { -beyond } else { 0.0 };
        let most = if at + 1 == count { 1.0 + beyond } else { 1.0 };
        if !(least..=most).contains(&share) {
            continue;
        }
        let side_m = from.y + share * (to.y - from.y);
        if side_m.abs() < SIDE_MAX_M
            && best.is_none_or(|(other, _)| (side_m - near_m).abs() < (other - near_m).abs())
        {
            best = Some((side_m, line[at].z + share * (line[at + 1].z - line[at].z)));
        }
    }
    best
}
