//! Turns of a route, found by its curvature.

use crate::polyline::Polyline;

/// A part of a route in which the heading changes by as much as it does at a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RouteTurn {
    /// Start, meters along the route.
    pub begin_m: f64,
    /// End, meters along the route.
    pub end_m: f64,
    /// Change of heading, radians, positive to the left.
    pub angle_rad: f64,
}

/// A road that bends more than this is turned on, 1/m: a radius of 40 m. A change of lanes over 30
/// m bends by 1/45 m.
const TURN_CURVATURE: f64 = 1.0 / 40.0;
/// A turn reaches out to where the way bends less than this, 1/m.
const BEND_CURVATURE: f64 = 1.0 / 80.0;
/// Largest distance between parts of a turn, meters: a turn around a corner is often two bends with
/// a straight piece between.
const TURN_GAP_M: f64 = 6.0;
/// Least change of heading that counts as a turn; smaller ones are curves of the road, radians: 30
/// degrees.
const TURN_ANGLE_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// Distance between samples of the curvature, meters.
const STRIDE_M: f64 = 1.0;
/// Curvature is measured over this far before and behind, meters.
const HALF_SPAN_M: f64 = 2.0;
/// Largest number of strides of a line; a longer line is examined in longer ones.
const STRIDES_MAX: f64 = 200_000.0;

/// All turns of `line`, in order.
pub(super) fn turns_of(line: &Polyline) -> Vec<RouteTurn> {
    let stride_m = STRIDE_M.max(line.length_m() / STRIDES_MAX);
    let count = (line.length_m() / stride_m).floor() as usize + 1;
    let curvature = |at: usize| {
        let arc_m = at as f64 * stride_m;
        let turned = |arc_m: f64| line.heading_at(arc_m.clamp(0.0, line.length_m()));
        (turned(arc_m + HALF_SPAN_M) - turned(arc_m - HALF_SPAN_M)) / (2.0 * HALF_SPAN_M)
    };
    let curvatures: Vec<f64> = (0..count).map(curvature).collect();
    let mut turns: Vec<RouteTurn> = Vec::new();
    for (begin, end) in bends(&curvatures) {
        let span = &curvatures[begin..end];
        if span
            .iter()
            .all(|curvature| curvature.abs() < TURN_CURVATURE)
        {
            continue;
        }
        let (begin_m, end_m) = (
            begin as f64 * stride_m,
            ((end - 1) as f64 * stride_m).min(line.length_m()),
        );
        let angle_rad = line.heading_at(end_m) - line.heading_at(begin_m);
        match turns.last_mut() {
            Some(last)
                if last.angle_rad * angle_rad > 0.0 && begin_m - last.end_m <= TURN_GAP_M =>
            {
                last.angle_rad = line.heading_at(end_m) - line.heading_at(last.begin_m);
                last.end_m = end_m;
            }
            _ => turns.push(RouteTurn {
                begin_m,
                end_m,
                angle_rad,
            }),
        }
    }
    turns.retain(|turn| turn.angle_rad.abs() >= TURN_ANGLE_RAD);
    turns
}

/// Spans in which the way bends to one side, from their first stride to the one after their last.
fn bends(curvatures: &[f64]) -> Vec<(usize, usize)> {
    let side = |curvature: f64| {
        if curvature.abs() < BEND_CURVATURE {
            0.0
        } else {
            curvature.signum()
        }
    };
    let (mut spans, mut begin) = (Vec::new(), 0);
    for at in 1..=curvatures.len() {
        let ends = at == curvatures.len() || side(curvatures[at]) != side(curvatures[begin]);
        if ends {
            if side(curvatures[begin]) != 0.0 {
                spans.push((begin, at));
            }
            begin = at;
        }
    }
    spans
}
