//! Way of a vehicle ahead, and who is on it first.

use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use crate::oriented_box::OrientedBox;
use crate::polyline::{Polyline, wrapped};

/// Part of the way that is examined, from behind the vehicle's middle to ahead of it, meters, and
/// the spacing of its points.
const BEHIND_M: f64 = 10.0;
const AHEAD_M: f64 = 130.0;
const SPACING_M: f64 = 4.0;
/// Room beside a vehicle that it wants to pass through, meters.
const BESIDE_M: f64 = 0.15;

/// Road user ahead on a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentLeader {
    /// Index of the agent in the scenario; `None` is the ego.
    pub agent: Option<usize>,
    /// Distance from the front of the vehicle to the rear of the one ahead, meters along the way;
    /// below zero where they are beside each other.
    pub gap_m: f64,
    /// Speed along the way, m/s; who comes towards one counts as standing.
    pub speed_mps: f64,
}

/// Road user that others see: its index among the agents, `None` for the ego, and its box.
pub(super) type SeenUser = (Option<usize>, VehicleState, VehicleSize);

/// Way of one vehicle near it.
#[derive(Clone, Debug)]
pub(super) struct WayAhead {
    line: Polyline,
    /// Place of the vehicle's middle on the line, meters.
    own_m: f64,
}

impl WayAhead {
    /// The way whose points `place` tells, by meters ahead of the vehicle; `None` where they
    /// make no line.
    pub(super) fn new(place: impl Fn(f64) -> DVec2) -> Option<Self> {
        let count = ((BEHIND_M + AHEAD_M) / SPACING_M) as u32;
        let points = (0..=count).map(|at| place(SPACING_M * f64::from(at) - BEHIND_M));
        let line = Polyline::new(points.map(|point| point.extend(0.0)))?;
        let own_m = line.project(place(0.0)).arc_m;
        Some(Self { line, own_m })
    }

    /// First of `others` on the way of a vehicle of `size` in `state`, which is `own` among them.
    pub(super) fn leader(
        &self,
        own: usize,
        (state, size): (&VehicleState, &VehicleSize),
        others: &[SeenUser],
    ) -> Option<AgentLeader> {
        let seen = others.iter().filter_map(|(agent, other, other_size)| {
            let apart_m = other.position_m - state.position_m;
            let lengths_m = other_size.length_m + size.length_m;
            let is_near = apart_m.length() <= AHEAD_M && apart_m.dot(state.ahead()) > -lengths_m;
            if *agent == Some(own) || !is_near {
                return None;
            }
            let outline = OrientedBox::for_vehicle(other, other_size);
            let foot = self.line.project(outline.center_m);
            let turn_rad = wrapped(outline.yaw_rad - foot.heading_rad);
            let turn = DVec2::from_angle(turn_rad).abs();
            let half_m = outline.half_length_m * turn.x + outline.half_width_m * turn.y;
            let half_width_m = outline.half_length_m * turn.y + outline.half_width_m * turn.x;
            // Beyond the ends of the line the distance counts, too.
            let is_beside = foot.distance_m >= half_width_m + 0.5 * size.width_m + BESIDE_M;
            if is_beside || foot.arc_m <= self.own_m {
                return None;
            }
            Some(AgentLeader {
                agent: *agent,
                gap_m: foot.arc_m - half_m - self.own_m - 0.5 * size.length_m,
                speed_mps: (other.speed_mps * turn_rad.cos()).max(0.0),
            })
        });
        seen.min_by(|a, b| a.gap_m.total_cmp(&b.gap_m))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn user(agent: usize, x_m: f64, y_m: f64, yaw_rad: f64) -> SeenUser {
        let state = VehicleState {
            position_m: DVec2::new(x_m, y_m),
            yaw_rad,
            speed_mps: 4.0,
            ..VehicleState::default()
        };
        (Some(agent), state, VehicleSize::CAR)
    }

    #[test]
    fn the_nearest_on_the_way_leads() {
        // A quarter of a circle to the left, 60 m about (0, 60).
        let place = |ahead_m: f64| {
            let turned_rad = ahead_m / 60.0;
            DVec2::new(60.0 * turned_rad.sin(), 60.0 - 60.0 * turned_rad.cos())
        };
        let way = WayAhead::new(place).unwrap();
        let size = VehicleSize::CAR;
        let (_, own, _) = user(0, 0.0, 0.0, 0.0);
        let at = |agent: usize, ahead_m: f64, left_m: f64| {
            let yaw_rad = ahead_m / 60.0;
            let point_m = place(ahead_m) + left_m * DVec2::from_angle(yaw_rad).perp();
            user(agent, point_m.x, point_m.y, yaw_rad)
        };
        let others = [
            at(0, 0.0, 0.0),
            at(1, 60.0, 0.3),
            at(2, 30.0, 0.0),
            at(3, 15.0, 3.5),
            at(4, -9.0, 0.0),
        ];
        let leader = way.leader(0, (&own, &size), &others).unwrap();
        assert_eq!(leader.agent, Some(2));
        let gap_m = 30.0 - size.length_m;
        assert!((leader.gap_m - gap_m).abs() < 0.1, "{leader:?}");
        assert!((leader.speed_mps - 4.0).abs() < 0.01, "{leader:?}");
        assert_eq!(way.leader(0, (&own, &size), &others[3..]), None);
        // One across the way leads with its side, and does not move along.
        let (_, across, _) = user(5, 12.0, 1.2, 0.5 * std::f64::consts::PI);
        let leader = way
            .leader(0, (&own, &size), &[(None, across, size)])
            .unwrap();
        assert_eq!(leader.agent, None);
        assert!(leader.speed_mps < 1.0, "{leader:?}");
    }
}
