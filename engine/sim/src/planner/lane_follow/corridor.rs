//! The strip of road ahead of the ego, and the vehicles that will be on it at which time.

use decouplegs_drive::polyline::{Polyline, wrapped};
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

/// Length of the line before and behind the route, meters, so that a vehicle beyond an end is not
/// taken to be at it.
const BEYOND_M: f64 = 120.0;
/// Length of the route behind the ego and ahead of it along which agents are looked for, meters.
const BEHIND_M: f64 = 60.0;
const AHEAD_M: f64 = 160.0;
/// Width that has to be free on each side of the ego's box, meters: less than there is between cars
/// in lanes of 3 m.
const SIDE_M: f64 = 0.25;
/// Largest difference from the route's heading at which a vehicle counts as driving along it,
/// radians.
const ALONG_RAD: f64 = std::f64::consts::FRAC_PI_6;
/// A vehicle along the route stays along it within this of its middle, meters: two lanes.
/// Beyond, it is on another road.
const ROAD_HALF_WIDTH_M: f64 = 8.0;
/// A lane change is over by then, seconds: no vehicle drifts sideways for longer.
const DRIFT_S: f64 = 3.0;

/// The ego's route as a strip.
#[derive(Debug)]
pub(super) struct Corridor {
    line: Polyline,
    half_width_m: f64,
    /// Position of the ego along the line, meters.
    pub(super) ego_arc_m: f64,
    /// Distance of the ego to the left of the line, meters.
    pub(super) ego_lateral_m: f64,
}

/// Interval of the line that an agent occupies at a moment, meters along and to the left of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span {
    pub(super) rear_m: f64,
    pub(super) front_m: f64,
    /// Speed along the line, below zero if oncoming.
    pub(super) speed_mps: f64,
    /// True if a part of it is on the strip.
    pub(super) inside: bool,
}

/// Predicted path of an agent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PredictedPath {
    /// Path with the route.
    Along,
    /// Path against the route.
    Against,
    /// Path over the route, or on another road.
    Across,
}

impl Corridor {
    /// The strip about `route_m` for an ego at `ego`, which was `last_arc_m` along it when last
    /// seen. `None` where the route is no line.
    pub(super) fn new(
        route_m: &[DVec2],
        ego: DVec2,
        width_m: f64,
        last_arc_m: Option<f64>,
    ) -> Option<Self> {
        let within = Polyline::new(route_m.iter().map(|point| point.extend(0.0)))?;
        let length_m = within.length_m();
        let (first, last) = (within.heading_at(0.0), within.heading_at(length_m));
        let before = within.at(0.0) - (DVec2::from_angle(first) * BEYOND_M).extend(0.0);
        let behind = within.at(length_m) + (DVec2::from_angle(last) * BEYOND_M).extend(0.0);
        let line = Polyline::new(
            std::iter::once(before)
                .chain(within.points().iter().copied())
                .chain([behind]),
        )?;
        // A route that crosses itself is left where it was met.
        let foot = match last_arc_m {
            Some(arc_m) => line.project_within(ego, arc_m - 10.0, arc_m + BEHIND_M),
            None => line.project(ego),
        };
        Some(Self {
            line,
            half_width_m: 0.5 * width_m + SIDE_M,
            ego_arc_m: foot.arc_m,
            ego_lateral_m: foot.lateral_m,
        })
    }

    /// The position `arc_m` along the line and `lateral_m` to its left.
    pub(super) fn place(&self, arc_m: f64, lateral_m: f64) -> DVec2 {
        let across = DVec2::from_angle(self.line.heading_at(arc_m)).perp();
        self.line.at(arc_m).truncate() + across * lateral_m
    }

    /// Curvature of the line at `arc_m`, radians per meter.
    pub(super) fn curvature_at(&self, arc_m: f64) -> f64 {
        let turn_rad = self.line.heading_at(arc_m + 1.0) - self.line.heading_at(arc_m - 1.0);
        wrapped(turn_rad).abs() / 2.0
    }

    /// Predicted path of the agent, and the interval of the line that it occupies at each of
    /// `times_s` at a constant velocity: along the road if it is on the ego's, else straight on.
    /// Who brakes goes on braking.
    pub(super) fn spans(
        &self,
        agent: &VehicleState,
        size: &VehicleSize,
        times_s: &[f64],
    ) -> (PredictedPath, Vec<Span>) {
        let foot = self.project(agent.position_m);
        let turned_rad = wrapped(agent.yaw_rad - foot.heading_rad);
        let on_our_road = foot.lateral_m.abs() < ROAD_HALF_WIDTH_M
            && foot.distance_m < foot.lateral_m.abs() + 1.0;
        let way = match turned_rad.abs() {
            turned if turned < ALONG_RAD && on_our_road => PredictedPath::Along,
            turned if turned > std::f64::consts::PI - ALONG_RAD && on_our_road => {
                PredictedPath::Against
            }
            _ => PredictedPath::Across,
        };
        let spans = times_s.iter().map(|&time_s| {
            if way == PredictedPath::Across {
                let position = agent.position_m + agent.velocity() * time_s;
                let foot = self.project(position);
                return self.span(
                    foot.arc_m,
                    foot.lateral_m,
                    wrapped(agent.yaw_rad - foot.heading_rad),
                    agent.speed_mps,
                    size,
                );
            }
            let (travel_m, speed_mps) = travel(agent, time_s);
            let drift_m = agent.speed_mps * turned_rad.sin() * time_s.min(DRIFT_S);
            self.span(
                foot.arc_m + travel_m * turned_rad.cos(),
                foot.lateral_m + drift_m,
                turned_rad,
                speed_mps,
                size,
            )
        });
        (way, spans.collect())
    }

    /// Place on the line, near the ego.
    pub(super) fn project(&self, position: DVec2) -> decouplegs_drive::polyline::Foot {
        self.line.project_within(
            position,
            self.ego_arc_m - BEHIND_M,
            self.ego_arc_m + AHEAD_M,
        )
    }

    /// The span of a box turned by `turned_rad` against the line.
    fn span(
        &self,
        arc_m: f64,
        lateral_m: f64,
        turned_rad: f64,
        speed_mps: f64,
        size: &VehicleSize,
    ) -> Span {
        let (sin, cos) = turned_rad.sin_cos();
        let half_extent_m = 0.5 * (size.length_m * cos.abs() + size.width_m * sin.abs());
        let half_width_m = 0.5 * (size.length_m * sin.abs() + size.width_m * cos.abs());
        Span {
            rear_m: arc_m - half_extent_m,
            front_m: arc_m + half_extent_m,
            speed_mps: speed_mps * cos,
            inside: lateral_m.abs() < half_width_m + self.half_width_m,
        }
    }
}

/// Distance and speed of `agent` after `time_s`: it keeps its speed, or goes on braking until it
/// stands.
fn travel(agent: &VehicleState, time_s: f64) -> (f64, f64) {
    let braking_mps2 = (-agent.acceleration_mps2).max(0.0);
    let speed_mps = (agent.speed_mps - braking_mps2 * time_s).max(0.0);
    let moving_s = if speed_mps > 0.0 || braking_mps2 == 0.0 {
        time_s
    } else {
        agent.speed_mps / braking_mps2
    };
    (0.5 * (agent.speed_mps + speed_mps) * moving_s, speed_mps)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMES_S: [f64; 3] = [0.0, 2.0, 4.0];

    fn straight() -> Corridor {
        Corridor::new(
            &[DVec2::ZERO, DVec2::new(200.0, 0.0)],
            DVec2::new(10.0, 0.5),
            2.0,
            None,
        )
        .unwrap()
    }

    fn agent(x: f64, y: f64, yaw_rad: f64, speed_mps: f64) -> VehicleState {
        VehicleState {
            position_m: DVec2::new(x, y),
            yaw_rad,
            speed_mps,
            acceleration_mps2: 0.0,
        }
    }

    #[test]
    fn who_is_where_on_the_strip_is_told_in_time() {
        let corridor = straight();
        assert!(
            (corridor.ego_arc_m - 130.0).abs() < 1e-9
                && (corridor.ego_lateral_m - 0.5).abs() < 1e-9
        );
        let spans_of = |state| corridor.spans(&state, &VehicleSize::CAR, &TIMES_S);
        let (way, ahead) = spans_of(agent(40.0, 0.0, 0.0, 5.0));
        assert_eq!(
            (way, ahead.iter().filter(|span| span.inside).count()),
            (PredictedPath::Along, 3)
        );
        assert!((ahead[2].rear_m - (160.0 + 20.0 - 2.25)).abs() < 1e-9);
        let (_, beside) = spans_of(agent(40.0, 3.5, 0.0, 5.0));
        assert!(
            beside.iter().all(|span| !span.inside),
            "the next lane is free"
        );
        let (_, drifting) = spans_of(agent(40.0, 3.5, -0.12, 10.0));
        assert_eq!(
            drifting.iter().map(|span| span.inside).collect::<Vec<_>>(),
            [false, true, true],
            "a cut-in is foreseen"
        );
        let (way, crossing) = spans_of(agent(60.0, -10.0, std::f64::consts::FRAC_PI_2, 5.0));
        assert_eq!(way, PredictedPath::Across);
        assert_eq!(
            crossing.iter().map(|span| span.inside).collect::<Vec<_>>(),
            [false, true, false]
        );
        let (way, coming) = spans_of(agent(80.0, 0.0, std::f64::consts::PI, 5.0));
        assert!(
            way == PredictedPath::Against
                && coming[1].front_m < coming[0].front_m
                && coming[0].speed_mps < -4.9
        );
    }

    #[test]
    fn who_is_beyond_an_end_of_the_route_is_not_at_it() {
        let corridor = straight();
        let (_, spans) = corridor.spans(&agent(-30.0, 0.0, 0.0, 0.0), &VehicleSize::CAR, &TIMES_S);
        assert!((spans[0].front_m - (90.0 + 2.25)).abs() < 1e-9);
    }

    #[test]
    fn who_brakes_stops_and_stays() {
        let braking = VehicleState {
            acceleration_mps2: -5.0,
            ..agent(0.0, 0.0, 0.0, 10.0)
        };
        assert_eq!(travel(&braking, 1.0), (7.5, 5.0));
        assert_eq!(travel(&braking, 4.0), (10.0, 0.0));
        assert_eq!(travel(&agent(0.0, 0.0, 0.0, 3.0), 2.0), (6.0, 3.0));
    }
}
