//! Lanes as strips: pairs of points on the left and the right border, at equal steps along the
//! lane.

use decouplegs_scene::{Lane, LaneKind, LaneMap};
use glam::{DVec2, DVec3, Vec3};

/// Distance between sections, meters: a chord of it departs 2 cm from an arc of 6 m radius.
const STEP_M: f64 = 1.0;

/// Most sections of a map; beyond, steps grow.
const SECTIONS_MAX: f64 = 400_000.0;

/// Lanes farther from the first are another place, meters.
const DISTANCE_MAX_M: f64 = 50_000.0;

/// Half the width of a lane whose file tells none, meters.
const HALF_WIDTH_M: f64 = 1.75;

/// Wider lanes are mistakes of their file, meters.
const WIDTH_M_MAX: f32 = 60.0;

/// A cut across a lane, relative to the origin, meters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Section {
    pub(super) left: Vec3,
    pub(super) right: Vec3,
}

impl Section {
    pub(super) fn middle(&self) -> Vec3 {
        0.5 * (self.left + self.right)
    }

    pub(super) fn lerp(&self, other: &Self, share: f32) -> Self {
        Self {
            left: self.left.lerp(other.left, share),
            right: self.right.lerp(other.right, share),
        }
    }

    pub(super) fn width_m(&self) -> f32 {
        self.left.distance(self.right)
    }
}

/// A lane to be drawn: at least two sections, in driving direction.
#[derive(Clone, Debug)]
pub(super) struct Strip {
    pub(super) kind: LaneKind,
    pub(super) sections: Vec<Section>,
    /// Position of each section along the middle, meters.
    along_m: Vec<f32>,
}

impl Strip {
    fn new(kind: LaneKind, sections: Vec<Section>) -> Self {
        let mut along_m = vec![0.0];
        for pair in sections.windows(2) {
            along_m.push(along_m[along_m.len() - 1] + pair[0].middle().distance(pair[1].middle()));
        }
        Self {
            kind,
            sections,
            along_m,
        }
    }

    /// Length of the strip, meters.
    pub(super) fn length_m(&self) -> f32 {
        self.along_m[self.along_m.len() - 1]
    }

    /// The cut `at_m` along.
    pub(super) fn at(&self, at_m: f32) -> Section {
        let next = self
            .along_m
            .partition_point(|&along_m| along_m <= at_m)
            .clamp(1, self.sections.len() - 1);
        let (from_m, to_m) = (self.along_m[next - 1], self.along_m[next]);
        let share = ((at_m - from_m) / (to_m - from_m).max(1e-6)).clamp(0.0, 1.0);
        self.sections[next - 1].lerp(&self.sections[next], share)
    }
}

/// The lanes of `map` as strips relative to the middle of them all, and that middle.
pub(super) fn strips(map: &LaneMap) -> (Vec<Strip>, DVec3) {
    let good = |points: &[DVec3]| points.len() >= 2 && points.iter().all(|point| point.is_finite());
    let first = map
        .lanes
        .iter()
        .find(|lane| good(&lane.centerline))
        .map(|lane| lane.centerline[0]);
    let Some(first) = first else {
        return (Vec::new(), DVec3::ZERO);
    };
    let near = |points: &[DVec3]| {
        points
            .iter()
            .all(|point| point.distance(first) < DISTANCE_MAX_M)
    };
    let lines = map
        .lanes
        .iter()
        .filter(|lane| good(&lane.centerline))
        .map(|lane| (lane.kind, borders(lane)));
    let lines: Vec<(LaneKind, [Vec<DVec3>; 2])> = lines
        .filter(|(_, [left, right])| good(left) && good(right) && near(left) && near(right))
        .collect();
    let points = || {
        lines
            .iter()
            .flat_map(|(_, borders)| borders.iter().flatten())
    };
    let (low, high) = points().fold((first, first), |(low, high), point| {
        (low.min(*point), high.max(*point))
    });
    let origin = (0.5 * (low + high)).round();
    let total_m: f64 = lines
        .iter()
        .map(|(_, [left, right])| length_m(left).max(length_m(right)))
        .sum();
    let step_m = STEP_M.max(total_m / SECTIONS_MAX);
    let strip = |(kind, [left, right]): &(LaneKind, [Vec<DVec3>; 2])| {
        let steps = (length_m(left).max(length_m(right)) / step_m)
            .ceil()
            .clamp(1.0, SECTIONS_MAX) as usize;
        let (left, right) = (spread(left, steps), spread(right, steps));
        let section = |(left, right): (DVec3, DVec3)| Section {
            left: (left - origin).as_vec3(),
            right: (right - origin).as_vec3(),
        };
        Strip::new(*kind, left.into_iter().zip(right).map(section).collect())
    };
    let drawable = |strip: &Strip| {
        let widest_m = strip
            .sections
            .iter()
            .map(Section::width_m)
            .fold(0.0, f32::max);
        strip.length_m() > 0.1 && (0.05..WIDTH_M_MAX).contains(&widest_m)
    };
    (lines.iter().map(strip).filter(drawable).collect(), origin)
}

/// Left and right of a lane. Where the file tells one or none, they are laid about the centerline.
fn borders(lane: &Lane) -> [Vec<DVec3>; 2] {
    let known = |border: &[DVec3]| border.len() >= 2;
    let mirrored = |border: &[DVec3]| {
        let steps = (lane.centerline.len() + border.len()).min(100_000);
        let pairs = spread(&lane.centerline, steps)
            .into_iter()
            .zip(spread(border, steps));
        pairs
            .map(|(middle, border)| 2.0 * middle - border)
            .collect()
    };
    match (known(&lane.left), known(&lane.right)) {
        (true, true) => [lane.left.clone(), lane.right.clone()],
        (true, false) => [lane.left.clone(), mirrored(&lane.left)],
        (false, true) => [mirrored(&lane.right), lane.right.clone()],
        (false, false) => [
            offset(&lane.centerline, HALF_WIDTH_M),
            offset(&lane.centerline, -HALF_WIDTH_M),
        ],
    }
}

/// `line` moved to its left.
fn offset(line: &[DVec3], by_m: f64) -> Vec<DVec3> {
    let at = |index: usize| {
        let (before, after) = (
            line[index.saturating_sub(1)],
            line[(index + 1).min(line.len() - 1)],
        );
        let ahead = (after - before).truncate().normalize_or(DVec2::X);
        line[index] + (ahead.perp() * by_m).extend(0.0)
    };
    (0..line.len()).map(at).collect()
}

fn length_m(line: &[DVec3]) -> f64 {
    line.windows(2).map(|pair| pair[0].distance(pair[1])).sum()
}

/// `steps + 1` points at equal distances along `line`, its ends included.
fn spread(line: &[DVec3], steps: usize) -> Vec<DVec3> {
    let total_m = length_m(line);
    let mut points = Vec::with_capacity(steps + 1);
    let (mut segment, mut passed_m) = (0, 0.0);
    for step in 0..=steps {
        let at_m = total_m * step as f64 / steps as f64;
        let mut span_m = line[segment].distance(line[segment + 1]);
        while passed_m + span_m < at_m && segment + 2 < line.len() {
            passed_m += span_m;
            segment += 1;
            span_m = line[segment].distance(line[segment + 1]);
        }
        let share = if span_m > 0.0 {
            ((at_m - passed_m) / span_m).clamp(0.0, 1.0)
        } else {
            0.0
        };
        points.push(line[segment].lerp(line[segment + 1], share));
    }
    points
}
