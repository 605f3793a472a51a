//! Recorded motion of a road user, and the line that it lies on.

use decouplegs_scene::story::TrackedAgent;
use decouplegs_scene::{LaneKind, LaneMap, VehicleState};
use glam::{DVec2, DVec3};

use crate::lane_index::LaneIndex;
use crate::oriented_box::OrientedBox;
use crate::polyline::{Polyline, wrapped};
use crate::route::{LaneSpot, straight_on};

/// Times nearer to each other are one, seconds: sums of steps are not exact.
const SAME_TIME_S: f64 = 1e-6;
/// Poses nearer to the last one that counts make no line, meters: who stands seems to tremble.
const SPACING_M: f64 = 1.0;
/// Length of the line beyond the last pose, meters, and the spacing of its points there.
const ONWARD_M: f64 = 200.0;
const ONWARD_STEP_M: f64 = 2.0;
/// Distance from the middle of a lane within which a vehicle is on it, meters, and the angle
/// beyond which it is not, radians.
const ON_LANE_M: f64 = 3.0;
const ALONG_RAD: f64 = 0.6;
/// Half of the length over which the bend of the line is measured, meters.
const HALF_BEND_M: f64 = 5.0;
/// Acceleration across the lane that is driven where nobody drove faster, m/s^2.
const LATERAL_MPS2: f64 = 2.5;
/// Length of a line that bends, in shares of the way straight on, and what others are looked for
/// beyond it, meters.
const BENT: f64 = 1.3;
const AROUND_M: f64 = 12.0;
/// Room beside a vehicle that it wants to pass through, meters.
const BESIDE_M: f64 = 0.15;

/// Point of the line.
#[derive(Clone, Copy, Debug)]
struct LinePoint {
    yaw_rad: f64,
    /// Speed that bends allow, m/s.
    bend_mps: f64,
}

/// Recorded motion in time, and along its line.
#[derive(Clone, Debug)]
pub(super) struct Way {
    times_s: Vec<f64>,
    states: Vec<VehicleState>,
    /// Meters along the line, of each pose.
    arcs_m: Vec<f64>,
    line: Polyline,
    points: Vec<LinePoint>,
    /// Highest recorded speed, m/s.
    pub top_mps: f64,
}

/// Another road user on a line: meters along it, and its speed along it, m/s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen {
    pub rear_m: f64,
    pub front_m: f64,
    pub speed_mps: f64,
}

impl Seen {
    pub(super) fn middle_m(&self) -> f64 {
        0.5 * (self.rear_m + self.front_m)
    }
}

impl Way {
    /// The way of `agent`, whose track was checked. Beyond its end the line follows the lanes of
    /// `map`, straight on.
    pub(super) fn new(agent: &TrackedAgent, map: &LaneMap, index: &LaneIndex) -> Self {
        let states = states(agent);
        let mut kept = vec![0];
        for (at, state) in states.iter().enumerate() {
            let last = &states[kept[kept.len() - 1]];
            if state.position_m.distance(last.position_m) >= SPACING_M {
                kept.push(at);
            }
        }
        let mut points_m: Vec<DVec2> = kept.iter().map(|&at| states[at].position_m).collect();
        let mut points: Vec<LinePoint> = kept
            .iter()
            .map(|&at| LinePoint {
                yaw_rad: states[at].yaw_rad,
                bend_mps: states[at].speed_mps,
            })
            .collect();
        let last = &states[kept[kept.len() - 1]];
        for (point_m, yaw_rad) in onward(map, index, last) {
            points_m.push(point_m);
            points.push(LinePoint {
                yaw_rad,
                bend_mps: 0.0,
            });
        }
        let line = Polyline::new(points_m.iter().map(|point| point.extend(0.0)));
        let line = line.unwrap_or_else(|| stub(last, &mut points));
        for at in 1..points.len() {
            let before_rad = points[at - 1].yaw_rad;
            points[at].yaw_rad = before_rad + wrapped(points[at].yaw_rad - before_rad);
        }
        let mut way = Self {
            times_s: agent.times_s.clone(),
            top_mps: states
                .iter()
                .map(|state| state.speed_mps)
                .fold(0.0, f64::max),
            arcs_m: Vec::new(),
            states,
            line,
            points,
        };
        way.measure_bends();
        way.measure_arcs();
        way
    }

    /// Finds the speeds that bends allow: what was driven there, or more where the line is
    /// straight.
    fn measure_bends(&mut self) {
        let arcs_m = self.line.arcs_m().to_vec();
        for (point, arc_m) in arcs_m.into_iter().enumerate() {
            let turn_rad = self.yaw_at(arc_m + HALF_BEND_M) - self.yaw_at(arc_m - HALF_BEND_M);
            let bend_mps = (LATERAL_MPS2 * 2.0 * HALF_BEND_M / turn_rad.abs().max(1e-6)).sqrt();
            let found = &mut self.points[point];
            found.bend_mps = found.bend_mps.max(bend_mps);
        }
    }

    fn measure_arcs(&mut self) {
        let mut arc_m = 0.0;
        let mut last_m = self.states[0].position_m;
        for state in &self.states {
            let ahead_m = arc_m + 2.0 * state.position_m.distance(last_m) + 2.0 * SPACING_M;
            arc_m = self
                .line
                .project_within(state.position_m, arc_m, ahead_m)
                .arc_m;
            last_m = state.position_m;
            self.arcs_m.push(arc_m);
        }
    }

    /// True while the track lasts.
    pub(super) fn lasts_at(&self, time_s: f64) -> bool {
        let (first_s, last_s) = (self.times_s[0], self.times_s[self.times_s.len() - 1]);
        (first_s - SAME_TIME_S..=last_s + SAME_TIME_S).contains(&time_s)
    }

    /// True after its last pose.
    pub(super) fn is_over_at(&self, time_s: f64) -> bool {
        time_s > self.times_s[self.times_s.len() - 1] + SAME_TIME_S
    }

    /// Two poses of the track about a time, and the share of the second. Times of the track itself
    /// have a share of 0.
    fn locate(&self, time_s: f64) -> (usize, usize, f64) {
        let last = self.times_s.len() - 1;
        let next = self
            .times_s
            .partition_point(|&at_s| at_s <= time_s + SAME_TIME_S)
            .min(last);
        let at = next.saturating_sub(1);
        let [from, to] = match time_s >= self.times_s[last] - SAME_TIME_S {
            true => [last, last],
            false => [at, next],
        };
        let part_s = self.times_s[to] - self.times_s[from];
        let passed_s = time_s - self.times_s[from];
        let share = if part_s > 0.0 && passed_s > SAME_TIME_S {
            passed_s / part_s
        } else {
            0.0
        };
        (from, to, share.clamp(0.0, 1.0))
    }

    /// Recorded state at a time, between poses interpolated; that of an end beyond it.
    pub(super) fn state_at(&self, time_s: f64) -> VehicleState {
        let (from, to, share) = self.locate(time_s);
        let (a, b) = (&self.states[from], &self.states[to]);
        if share == 0.0 {
            return *a;
        }
        let between = |a: f64, b: f64| a + share * (b - a);
        VehicleState {
            position_m: a.position_m.lerp(b.position_m, share),
            yaw_rad: wrapped(a.yaw_rad + share * wrapped(b.yaw_rad - a.yaw_rad)),
            speed_mps: between(a.speed_mps, b.speed_mps),
            acceleration_mps2: between(a.acceleration_mps2, b.acceleration_mps2),
        }
    }

    /// Place on the line at a time, meters.
    pub(super) fn arc_at(&self, time_s: f64) -> f64 {
        let (from, to, share) = self.locate(time_s);
        self.arcs_m[from] + share * (self.arcs_m[to] - self.arcs_m[from])
    }

    /// Place on a part of the line that is nearest to a point, meters.
    pub(super) fn arc_near(&self, at_m: DVec2, from_m: f64, to_m: f64) -> f64 {
        self.line.project_within(at_m, from_m, to_m).arc_m
    }

    /// Length of the line, meters.
    pub(super) fn length_m(&self) -> f64 {
        self.line.length_m()
    }

    /// Position and heading on the line.
    pub(super) fn pose_at(&self, arc_m: f64) -> (DVec2, f64) {
        (self.line.at(arc_m).truncate(), self.yaw_at(arc_m))
    }

    fn yaw_at(&self, arc_m: f64) -> f64 {
        let arcs_m = self.line.arcs_m();
        let next = arcs_m
            .partition_point(|&at_m| at_m <= arc_m)
            .clamp(1, arcs_m.len() - 1);
        let share = (arc_m - arcs_m[next - 1]) / (arcs_m[next] - arcs_m[next - 1]);
        let (a, b) = (&self.points[next - 1], &self.points[next]);
        a.yaw_rad + share.clamp(0.0, 1.0) * (b.yaw_rad - a.yaw_rad)
    }

    /// Highest speed from which bends ahead are reached slowly enough, m/s, by braking of
    /// `braking_mps2`.
    pub(super) fn bend_mps(&self, arc_m: f64, speed_mps: f64, braking_mps2: f64) -> f64 {
        let arcs_m = self.line.arcs_m();
        let from = arcs_m
            .partition_point(|&at_m| at_m <= arc_m)
            .saturating_sub(1);
        let ahead_m = 10.0 + speed_mps * speed_mps / (2.0 * braking_mps2);
        let points = arcs_m.iter().zip(&self.points).skip(from);
        points
            .take_while(|(at_m, _)| **at_m <= arc_m + ahead_m)
            .map(|(at_m, point)| {
                let way_m = (at_m - arc_m).max(0.0);
                (point.bend_mps * point.bend_mps + 2.0 * braking_mps2 * way_m).sqrt()
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// Another road user of a box and velocity, where it is in the way of a vehicle `width_m` wide
    /// that is at `own_m` of the line; `None` beside the line.
    pub(super) fn seen(
        &self,
        outline: &OrientedBox,
        velocity_mps: DVec2,
        width_m: f64,
        own_m: f64,
    ) -> Option<Seen> {
        let (at_m, yaw_rad) = self.pose_at(own_m);
        let apart_m = outline.center_m - at_m;
        // Along the line it is as far as straight on, or a little farther.
        let straight_m = apart_m.length();
        let (near_m, far_m) = (straight_m - AROUND_M, BENT * straight_m + AROUND_M);
        let (from_m, to_m) = match apart_m.dot(DVec2::from_angle(yaw_rad)) >= 0.0 {
            true => (own_m + near_m, own_m + far_m),
            false => (own_m - far_m, own_m - near_m),
        };
        let foot = self.line.project_within(outline.center_m, from_m, to_m);
        let ahead = DVec2::from_angle(foot.heading_rad);
        let apart_m = outline.center_m - foot.point.truncate();
        let (along_m, left_m) = (apart_m.dot(ahead), ahead.perp_dot(apart_m));
        let radius_m = outline.half_length_m.hypot(outline.half_width_m);
        if left_m.abs() > radius_m + width_m || along_m.abs() > radius_m + 1.0 {
            return None;
        }
        // How far its box reaches along the line and across it.
        let turn = DVec2::from_angle(outline.yaw_rad - foot.heading_rad).abs();
        let half_m = outline.half_length_m * turn.x + outline.half_width_m * turn.y;
        let half_width_m = outline.half_length_m * turn.y + outline.half_width_m * turn.x;
        if left_m.abs() >= half_width_m + 0.5 * width_m + BESIDE_M {
            return None;
        }
        let middle_m = foot.arc_m + along_m;
        Some(Seen {
            rear_m: middle_m - half_m,
            front_m: middle_m + half_m,
            speed_mps: velocity_mps.dot(ahead).max(0.0),
        })
    }
}

/// A line for a vehicle that never moves, on no lane.
fn stub(state: &VehicleState, points: &mut Vec<LinePoint>) -> Polyline {
    let point = LinePoint {
        yaw_rad: state.yaw_rad,
        bend_mps: 0.0,
    };
    *points = vec![point; 2];
    let end_m = state.position_m + SPACING_M * state.ahead();
    let line = Polyline::new([state.position_m, end_m].map(|point| point.extend(0.0)));
    // Farther out than a meter can be told, any line is as good.
    line.or_else(|| Polyline::new([DVec3::ZERO, DVec3::X]))
        .expect("two points, a meter apart")
}

/// States at the poses of a track: speeds along the heading and accelerations are differences of
/// the poses before and after.
fn states(agent: &TrackedAgent) -> Vec<VehicleState> {
    let last = agent.poses.len() - 1;
    let around = |at: usize| (at.saturating_sub(1), (at + 1).min(last));
    let place = |at: usize| DVec2::new(agent.poses[at][0], agent.poses[at][1]);
    let mut states: Vec<VehicleState> = (0..=last)
        .map(|at| {
            let (from, to) = around(at);
            let yaw_rad = agent.poses[at][2];
            let way_m = place(to) - place(from);
            let speed_mps = match from == to {
                true => 0.0,
                false => {
                    let passed_s = agent.times_s[to] - agent.times_s[from];
                    way_m.dot(DVec2::from_angle(yaw_rad)) / passed_s
                }
            };
            VehicleState {
                position_m: place(at),
                yaw_rad,
                speed_mps: speed_mps.max(0.0),
                acceleration_mps2: 0.0,
            }
        })
        .collect();
    let speeds_mps: Vec<f64> = states.iter().map(|state| state.speed_mps).collect();
    for (at, state) in states.iter_mut().enumerate() {
        let (from, to) = around(at);
        if from != to {
            let passed_s = agent.times_s[to] - agent.times_s[from];
            state.acceleration_mps2 = (speeds_mps[to] - speeds_mps[from]) / passed_s;
        }
    }
    states
}

/// Points and headings beyond the end of a track, along the lanes straight on, as far to the side
/// of their middle as the track ends.
fn onward(map: &LaneMap, index: &LaneIndex, last: &VehicleState) -> Vec<(DVec2, f64)> {
    let near = index.lanes_near(last.position_m, ON_LANE_M);
    let along = near.into_iter().find(|point| {
        let turn_rad = wrapped(point.foot.heading_rad - last.yaw_rad);
        map.lanes[point.lane].kind == LaneKind::Driving && turn_rad.abs() <= ALONG_RAD
    });
    let Some(start) = along else {
        return Vec::new();
    };
    let spot = LaneSpot {
        lane: start.lane,
        at_m: start.foot.arc_m,
    };
    let (lanes, end) = straight_on(map, spot, ONWARD_M);
    let mut points: Vec<(DVec2, f64)> = Vec::new();
    let mut from_m = spot.at_m + ONWARD_STEP_M;
    for (at, lane) in lanes.iter().enumerate() {
        let Some(line) = index.line(*lane) else {
            break;
        };
        let is_last = at + 1 == lanes.len();
        let to_m = if is_last { end.at_m } else { line.length_m() };
        while from_m < to_m {
            let yaw_rad = line.heading_at(from_m);
            let left = DVec2::from_angle(yaw_rad).perp();
            let point_m = line.at(from_m).truncate() + start.foot.lateral_m * left;
            points.push((point_m, yaw_rad));
            from_m += ONWARD_STEP_M;
        }
        from_m -= to_m;
    }
    // Insides of bends fold where the line is beside its lane.
    let mut before_m = last.position_m;
    points.retain(|(point_m, yaw_rad)| {
        let is_ahead = (*point_m - before_m).dot(DVec2::from_angle(*yaw_rad)) > 0.1;
        if is_ahead {
            before_m = *point_m;
        }
        is_ahead
    });
    points
}
