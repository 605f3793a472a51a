//! The way of a plan, in the world.

use decouplegs_scene::{Plan, VehicleState};
use glam::DVec2;

use crate::polyline::Polyline;

/// Points of a plan nearer than this to the one before show no direction, meters: planners that
/// want to stand jitter.
const DIRECTION_M: f64 = 0.2;
/// Points of the line for each piece between two points of the plan.
const PIECES: usize = 6;

/// A smooth line from the ego through the points of a plan, straight on beyond its end.
#[derive(Clone, Debug)]
pub(super) struct PlannedPath {
    line: Polyline,
    end: DVec2,
    beyond: DVec2,
}

impl PlannedPath {
    /// The way of `plan` from `ego` on, where it leads anywhere, and how far along it each point of
    /// the plan is, meters, never falling.
    pub(super) fn from_plan(plan: &Plan, ego: &VehicleState) -> (Option<Self>, Vec<f64>) {
        let (knots, reached) = knots(plan);
        let nowhere = || vec![0.0; plan.points().len()];
        if knots.len() < 2 {
            return (None, nowhere());
        }
        let tangents = tangents(&knots);
        let mut points = vec![DVec2::ZERO];
        for at in 1..knots.len() {
            let length_m = knots[at - 1].distance(knots[at]);
            points.extend((1..=PIECES).map(|piece| {
                let share = piece as f64 / PIECES as f64;
                hermite(
                    [knots[at - 1], knots[at]],
                    [tangents[at - 1] * length_m, tangents[at] * length_m],
                    share,
                )
            }));
        }
        let world = points.iter().map(|point| ego.to_world(*point).extend(0.0));
        let Some(line) = Polyline::new(world) else {
            return (None, nowhere());
        };
        let mut arc_m = 0.0;
        let mut arcs_m = vec![0.0];
        arcs_m.extend(points.windows(2).map(|pair| {
            arc_m += pair[0].distance(pair[1]);
            arc_m
        }));
        let mut farthest_m = 0.0_f64;
        let arcs_m = reached.iter().map(|(knot, past_m)| {
            farthest_m = farthest_m.max(arcs_m[knot * PIECES] + past_m);
            farthest_m
        });
        let arcs_m = arcs_m.collect();
        let end = line.at(line.length_m()).truncate();
        let beyond = ego.ahead().rotate(tangents[tangents.len() - 1]);
        (Some(Self { line, end, beyond }), arcs_m)
    }

    /// The position `arc_m` along it.
    pub(super) fn at(&self, arc_m: f64) -> DVec2 {
        let past_m = arc_m - self.line.length_m();
        if past_m > 0.0 {
            self.end + self.beyond * past_m
        } else {
            self.line.at(arc_m).truncate()
        }
    }

    /// Arc length of the nearest point to `at`, searched within the given distances behind and
    /// ahead of `near_m`, meters.
    pub(super) fn project(&self, at: DVec2, near_m: f64, window_m: f64) -> f64 {
        let length_m = self.line.length_m();
        let arc_m = self
            .line
            .project_within(at, near_m - window_m, near_m + window_m)
            .arc_m;
        if arc_m < length_m {
            arc_m
        } else {
            length_m + (at - self.end).dot(self.beyond).max(0.0)
        }
    }
}

/// Points of the plan in the ego's frame that show where it goes, the ego's own position first; and
/// for each point of the plan the knot that it has reached and how far past it it is, meters. They
/// end where the plan turns back.
fn knots(plan: &Plan) -> (Vec<DVec2>, Vec<(usize, f64)>) {
    let (mut knots, mut heading, mut ended) = (vec![DVec2::ZERO], DVec2::X, false);
    let mut reached = Vec::with_capacity(plan.points().len());
    for point in plan.points() {
        let step = point.position_m - knots[knots.len() - 1];
        let mut past_m = if ended {
            0.0
        } else {
            step.dot(heading).max(0.0)
        };
        if !ended && step.length() >= DIRECTION_M {
            ended = step.dot(heading) < 0.0;
            if !ended {
                heading = step.normalize();
                knots.push(point.position_m);
                past_m = 0.0;
            }
        }
        reached.push((knots.len() - 1, past_m));
    }
    (knots, reached)
}

/// Unit directions at the knots: the ego's own at the first, then those of the parabola through
/// neighbors.
fn tangents(knots: &[DVec2]) -> Vec<DVec2> {
    let mut tangents = vec![DVec2::X];
    for at in 1..knots.len() {
        let before = knots[at] - knots[at - 1];
        let Some(after) = knots.get(at + 1).map(|next| *next - knots[at]) else {
            // As much beyond the last piece as its chord lies beyond the tangent before: an arc
            // goes on as it came.
            let chord = before.normalize();
            let last = tangents[at - 1];
            let mirrored = chord * (2.0 * chord.dot(last)) - last;
            tangents.push(if chord.dot(last) > 0.5 {
                mirrored
            } else {
                chord
            });
            break;
        };
        let weights = (1.0 / before.length_squared(), 1.0 / after.length_squared());
        let along = before * weights.0 + after * weights.1;
        tangents.push(along.try_normalize().unwrap_or(after.normalize()));
    }
    tangents
}

/// The cubic between two positions with the derivatives at both.
fn hermite(positions: [DVec2; 2], derivatives: [DVec2; 2], share: f64) -> DVec2 {
    let (t, u) = (share, 1.0 - share);
    positions[0] * (u * u * (1.0 + 2.0 * t))
        + positions[1] * (t * t * (1.0 + 2.0 * u))
        + derivatives[0] * (u * u * t)
        - derivatives[1] * (t * t * u)
}
