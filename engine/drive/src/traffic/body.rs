//! A vehicle that another program drives: a kinematic bicycle within what tires and steering allow.
//!
//! Its rear axle moves where the vehicle points, and its axles lie symmetrically about the middle
//! of the box (Rajamani, "Vehicle Dynamics and Control", 2012, section 2.2).

use decouplegs_scene::episode::AgentCommand;
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::idm::{BRAKING_MPS2, advance};
use crate::polyline::wrapped;

/// Hardest acceleration, m/s^2.
pub const ACCELERATION_MPS2_MAX: f64 = 4.0;
/// Acceleration across the heading that tires hold on a dry road, m/s^2.
pub const LATERAL_MPS2_MAX: f64 = 8.0;
/// Highest speed, m/s.
pub const SPEED_MPS_MAX: f64 = 70.0;
/// Largest angle of the front wheels, radians, and its fastest change, radians per second: those of
/// the ego.
const STEER_RAD_MAX: f64 = 0.6;
const STEER_RATE_RADPS_MAX: f64 = 0.8;
/// Distance between the axles in shares of the length.
const WHEELBASE_SHARE: f64 = 0.6;
/// Look-ahead of pure pursuit (Coulter, 1992): seconds at the own speed, and at least meters.
const LOOK_AHEAD_S: f64 = 0.8;
const LOOK_AHEAD_M_MIN: f64 = 4.0;
/// Differences below this are rounding.
const SAME: f64 = 1e-9;

/// Largest curvature of the way of the rear axle of a vehicle `length_m` long, 1/m.
#[must_use]
pub fn curvature_per_m_max(length_m: f64) -> f64 {
    STEER_RAD_MAX.tan() / wheelbase_m(length_m)
}

fn wheelbase_m(length_m: f64) -> f64 {
    (WHEELBASE_SHARE * length_m).max(0.1)
}

/// Parts of what was asked for that were more than a vehicle can do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Limited {
    pub acceleration: bool,
    pub curvature: bool,
}

/// A vehicle in free motion.
#[derive(Clone, Copy, Debug)]
pub(super) struct Body {
    pub state: VehicleState,
    wheelbase_m: f64,
    steer_rad: f64,
}

impl Body {
    /// A vehicle in `state` on a way of a curvature.
    pub(super) fn new(state: VehicleState, size: &VehicleSize, curvature_per_m: f64) -> Self {
        let wheelbase_m = wheelbase_m(size.length_m);
        let steer_rad = (curvature_per_m * wheelbase_m).atan();
        Self {
            state: VehicleState {
                speed_mps: state.speed_mps.clamp(0.0, SPEED_MPS_MAX),
                ..state
            },
            wheelbase_m,
            steer_rad: steer_rad.clamp(-STEER_RAD_MAX, STEER_RAD_MAX),
        }
    }

    /// Position of the rear axle.
    pub(super) fn rear_axle_m(&self) -> DVec2 {
        self.state.position_m - 0.5 * self.wheelbase_m * self.state.ahead()
    }

    /// Distance along the way from beside the middle of the box to where it steers, meters.
    pub(super) fn look_ahead_m(&self) -> f64 {
        (LOOK_AHEAD_S * self.state.speed_mps).max(LOOK_AHEAD_M_MIN)
    }

    /// Curvature that leads the rear axle to a point, 1/m.
    pub(super) fn curvature_to(&self, target_m: DVec2) -> f64 {
        let apart_m = DVec2::from_angle(-self.state.yaw_rad).rotate(target_m - self.rear_axle_m());
        2.0 * apart_m.y / apart_m.length_squared().max(1.0)
    }

    /// Moves for `dt_s` at an acceleration and a curvature.
    pub(super) fn advance(
        &mut self,
        acceleration_mps2: f64,
        curvature_per_m: f64,
        dt_s: f64,
    ) -> Limited {
        let speed_mps = self.state.speed_mps;
        let faster_mps2 = (SPEED_MPS_MAX - speed_mps) / dt_s;
        let possible_mps2 =
            acceleration_mps2.clamp(-BRAKING_MPS2, ACCELERATION_MPS2_MAX.min(faster_mps2));
        let (moved_m, after_mps) = advance(speed_mps, possible_mps2, dt_s);
        let wanted_rad = (curvature_per_m * self.wheelbase_m).atan();
        let step_rad = STEER_RATE_RADPS_MAX * dt_s;
        let grip_per_m = LATERAL_MPS2_MAX / speed_mps.max(after_mps).powi(2).max(1e-6);
        let grip_rad = (grip_per_m * self.wheelbase_m).atan().min(STEER_RAD_MAX);
        self.steer_rad = wanted_rad
            .clamp(self.steer_rad - step_rad, self.steer_rad + step_rad)
            .clamp(-grip_rad, grip_rad);
        let turn_rad = moved_m * self.steer_rad.tan() / self.wheelbase_m;
        // The chord of the arc.
        let half_rad = 0.5 * turn_rad;
        let chord_m = match half_rad.abs() < 1e-6 {
            true => moved_m,
            false => moved_m * half_rad.sin() / half_rad,
        };
        let mean = DVec2::from_angle(self.state.yaw_rad + half_rad);
        let rear_m = self.rear_axle_m() + chord_m * mean;
        let yaw_rad = wrapped(self.state.yaw_rad + turn_rad);
        self.state = VehicleState {
            position_m: rear_m + 0.5 * self.wheelbase_m * DVec2::from_angle(yaw_rad),
            yaw_rad,
            speed_mps: after_mps,
            acceleration_mps2: (after_mps - speed_mps) / dt_s,
        };
        Limited {
            acceleration: (possible_mps2 - acceleration_mps2).abs() > SAME,
            curvature: (self.steer_rad - wanted_rad).abs() > SAME,
        }
    }

    /// Carries out a command for `dt_s`, by `keeps_per_m` where it tells no curvature. True if it
    /// was more than the vehicle can do.
    pub(super) fn obey(&mut self, command: &AgentCommand, keeps_per_m: f64, dt_s: f64) -> bool {
        let curvature_per_m = command.curvature_per_m.unwrap_or(keeps_per_m);
        let limited = self.advance(command.acceleration_mps2, curvature_per_m, dt_s);
        limited.acceleration || limited.curvature && command.curvature_per_m.is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.1;

    fn car(speed_mps: f64) -> Body {
        let state = VehicleState {
            speed_mps,
            ..VehicleState::default()
        };
        Body::new(state, &VehicleSize::CAR, 0.0)
    }

    #[test]
    fn the_rear_axle_drives_a_circle_of_the_curvature() {
        let mut car = car(5.0);
        // The wheels need a while to turn.
        for _ in 0..20 {
            car.advance(0.0, 0.1, DT_S);
        }
        let (rear_m, yaw_rad) = (car.rear_axle_m(), car.state.yaw_rad);
        let center_m = rear_m + 10.0 * DVec2::from_angle(yaw_rad).perp();
        for step in 1..=80 {
            assert_eq!(
                car.advance(0.0, 0.1, DT_S),
                Limited::default(),
                "step {step}"
            );
            assert!((car.rear_axle_m().distance(center_m) - 10.0).abs() < 1e-9);
            let turned_rad = wrapped(car.state.yaw_rad - yaw_rad - 0.05 * f64::from(step));
            assert!(turned_rad.abs() < 1e-9, "{turned_rad}");
        }
    }

    #[test]
    fn nothing_moves_faster_or_turns_sharper_than_physics_allow() {
        for (acceleration_mps2, curvature_per_m) in [
            (50.0, 0.0),
            (-50.0, 0.0),
            (0.0, 5.0),
            (0.0, -5.0),
            (9.0, 1.0),
        ] {
            let mut car = car(15.0);
            let mut was_limited = false;
            for _ in 0..100 {
                let before = car;
                was_limited |=
                    car.advance(acceleration_mps2, curvature_per_m, DT_S) != Limited::default();
                let change_mps2 = (car.state.speed_mps - before.state.speed_mps) / DT_S;
                assert!(change_mps2 <= ACCELERATION_MPS2_MAX + 1e-9);
                assert!(change_mps2 >= -BRAKING_MPS2 - 1e-9);
                assert!((0.0..=SPEED_MPS_MAX).contains(&car.state.speed_mps));
                let turned_rad = wrapped(car.state.yaw_rad - before.state.yaw_rad);
                let mean_mps = 0.5 * (car.state.speed_mps + before.state.speed_mps);
                let lateral_mps2 = (turned_rad / DT_S * mean_mps).abs();
                assert!(lateral_mps2 <= LATERAL_MPS2_MAX + 1e-9, "{lateral_mps2}");
                let moved_m = car.rear_axle_m().distance(before.rear_axle_m());
                assert!(
                    moved_m <= mean_mps * DT_S + 1e-9,
                    "a teleport of {moved_m} m"
                );
                let sharpest = curvature_per_m_max(VehicleSize::CAR.length_m);
                assert!(turned_rad.abs() <= sharpest * mean_mps * DT_S + 1e-9);
            }
            assert!(was_limited, "{acceleration_mps2} {curvature_per_m}");
        }
        // What is possible is done as it was said.
        let mut car = car(15.0);
        assert_eq!(car.advance(1.5, 0.001, DT_S), Limited::default());
        assert!((car.state.speed_mps - 15.15).abs() < 1e-12);
    }

    #[test]
    fn pure_pursuit_comes_to_a_line_and_stays_there() {
        let mut car = car(12.0);
        car.state.position_m.y = 1.5;
        for _ in 0..100 {
            let target_m = DVec2::new(car.state.position_m.x + car.look_ahead_m(), 0.0);
            car.advance(0.0, car.curvature_to(target_m), DT_S);
            assert!(car.state.position_m.y > -0.3, "{:?}", car.state);
        }
        assert!(car.state.position_m.y.abs() < 0.05, "{:?}", car.state);
        assert!(car.state.yaw_rad.abs() < 0.01, "{:?}", car.state);
    }
}
