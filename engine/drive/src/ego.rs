//! The ego vehicle: a kinematic bicycle that tracks a plan.
//!
//! Both wheels of an axle are one wheel, and none slips: the rear axle moves where the vehicle
//! points, and turns about the position that the front wheels' angle tells (Rajamani, "Vehicle
//! Dynamics and Control", 2012, section 2.2). The axles lie symmetrically about the middle of the
//! box, which is what positions are of. Steering is pure pursuit (Coulter, "Implementation of the
//! Pure Pursuit Path Tracking Algorithm", 1992), solved for the middle of the box and not for the
//! rear axle: the middle would otherwise run outside of every bend. Speed is that of the plan plus
//! a correction in proportion to how far the ego lies behind or ahead of it.

use decouplegs_scene::{Plan, VehicleSize, VehicleState};
use glam::DVec2;

use crate::polyline::wrapped;

mod controls;
mod path;
mod speed;

use path::PlannedPath;
use speed::SpeedProfile;

/// Longest part of a step, seconds. The controls are set anew at each part: steps of 0.1 s and 0.01
/// s then agree.
const PART_S: f64 = 0.01;
/// Speed below which the turn of a moved ego says nothing about its wheels, m/s.
const STEERED_MPS_MIN: f64 = 0.1;
/// Longest step, seconds.
const STEP_S_MAX: f64 = 60.0;
/// Time within which speed errors are corrected, seconds.
const SPEED_TIME_S: f64 = 0.25;
/// Speed gain per meter that the ego is behind its plan, 1/s.
const POSITION_GAIN_PER_S: f64 = 1.0;
/// Deceleration without a plan or after its end: gentle, as nothing is known to be ahead.
const IDLE_BRAKING_MPS2: f64 = 2.0;
/// Least deceleration with which the last of the speed is taken off, m/s^2: an exponential approach
/// would creep forever.
const HALTING_MPS2: f64 = 1.0;
/// Distance behind and ahead of the last position on the path within which the nearest one is
/// searched, meters.
const SEARCH_M: f64 = 5.0;

/// Limits of the ego vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EgoOptions {
    /// Distance between the axles, meters; `None`: 0.6 of the vehicle's length.
    pub wheelbase_m: Option<f64>,
    /// Largest angle of the front wheels, radians.
    pub steer_max_rad: f64,
    /// Fastest change of that angle, radians per second.
    pub steer_rate_max_radps: f64,
    /// Hardest acceleration, m/s^2.
    pub acceleration_max_mps2: f64,
    /// Hardest braking, above zero, m/s^2.
    pub braking_max_mps2: f64,
    /// Look-ahead time of pure pursuit along the path, seconds.
    pub look_ahead_s: f64,
    /// Least look-ahead distance of pure pursuit, meters.
    pub look_ahead_m_min: f64,
}

impl Default for EgoOptions {
    /// A family car. It turns on a circle of 8 m (with a wheelbase of 2.7 m), from side to side in
    /// 1.5 s.
    fn default() -> Self {
        Self {
            wheelbase_m: None,
            steer_max_rad: 0.6,
            steer_rate_max_radps: 0.8,
            acceleration_max_mps2: 3.0,
            braking_max_mps2: 8.0,
            look_ahead_s: 0.5,
            look_ahead_m_min: 2.5,
        }
    }
}

/// A vehicle that follows plans.
#[derive(Clone, Debug)]
pub struct Ego {
    options: EgoOptions,
    wheelbase_m: f64,
    state: VehicleState,
    steer_rad: f64,
    /// The way of the last plan that led anywhere.
    path: Option<PlannedPath>,
    /// Arc length of the ego on the path, meters.
    path_arc_m: f64,
    profile: Option<SpeedProfile>,
    /// Time since the plan's observation, seconds.
    plan_age_s: f64,
    /// Distance driven since the plan's observation, meters along the path.
    driven_m: f64,
}

impl Ego {
    /// An ego that stands or drives as `state` says, its wheels straight, with no plan yet: until
    /// [`Ego::follow`] it brakes gently.
    #[must_use]
    pub fn new(state: VehicleState, size: VehicleSize, options: EgoOptions) -> Self {
        let wheelbase_m = options.wheelbase_m.unwrap_or(0.6 * size.length_m).max(0.1);
        let state = VehicleState {
            speed_mps: state.speed_mps.max(0.0),
            ..state
        };
        Self {
            options,
            wheelbase_m,
            state,
            steer_rad: 0.0,
            path: None,
            path_arc_m: 0.0,
            profile: None,
            plan_age_s: 0.0,
            driven_m: 0.0,
        }
    }

    /// State of the ego; the acceleration is the mean of the last step.
    #[must_use]
    pub fn state(&self) -> VehicleState {
        self.state
    }

    /// Angle of its front wheels, to the left where above zero.
    #[must_use]
    pub fn steer_rad(&self) -> f64 {
        self.steer_rad
    }

    /// Rate of its heading.
    #[must_use]
    pub fn yaw_rate_radps(&self) -> f64 {
        self.yaw_rate_at(self.state.speed_mps, self.steer_rad)
    }

    /// Rate of its heading at another speed, with other steering.
    #[must_use]
    pub fn yaw_rate_at(&self, speed_mps: f64, steer_rad: f64) -> f64 {
        speed_mps * steer_rad.tan() / self.wheelbase_m
    }

    /// Distance from the rear axle to the middle of the box, meters.
    #[must_use]
    pub fn rear_axle_to_middle_m(&self) -> f64 {
        0.5 * self.wheelbase_m
    }

    /// Acceleration towards the middle of the ego's bend, to the left where above zero. It is
    /// reported and limited by nothing.
    #[must_use]
    pub fn lateral_acceleration_mps2(&self) -> f64 {
        self.state.speed_mps * self.yaw_rate_radps()
    }

    /// Takes `plan` as made now, from here. Of a plan that turns back, the part before that is
    /// driven and the rest is a halt: the ego never reverses. A plan that leads nowhere is a halt
    /// on the way of the plan before.
    pub fn follow(&mut self, plan: &Plan) {
        let (path, arcs_m) = PlannedPath::from_plan(plan, &self.state);
        let times = plan.points().iter().map(|point| point.time_s);
        self.profile = Some(SpeedProfile::new(times.zip(arcs_m), self.state.speed_mps));
        if path.is_some() {
            (self.path, self.path_arc_m) = (path, 0.0);
        }
        (self.plan_age_s, self.driven_m) = (0.0, 0.0);
    }

    /// Drives on for `dt_s` seconds, 60 at most; what is not above zero is no time. Where the plan
    /// is over, a halt goes on as one, and otherwise the ego brakes gently along the way that the
    /// plan had at its end.
    pub fn step(&mut self, dt_s: f64) {
        if dt_s.is_nan() || dt_s <= 0.0 {
            return;
        }
        let dt_s = dt_s.min(STEP_S_MAX);
        // Steps that are a multiple of a part, but for rounding, shall not have one more.
        let parts = (dt_s / PART_S - 1e-6).ceil().max(1.0);
        let speed_before_mps = self.state.speed_mps;
        for _ in 0..parts as usize {
            self.part(dt_s / parts);
        }
        self.state.acceleration_mps2 = (self.state.speed_mps - speed_before_mps) / dt_s;
    }

    /// Moves to `state` as if it had driven there, turning at `yaw_rate_radps`, with no regard to
    /// any plan. The angle of the wheels is the one that turns so.
    pub fn move_to(&mut self, state: VehicleState, yaw_rate_radps: f64) {
        self.state = state;
        let steer_max_rad = self.options.steer_max_rad;
        let steer_rad = (yaw_rate_radps * self.wheelbase_m).atan2(state.speed_mps);
        // Standing wheels tell nothing.
        if state.speed_mps > STEERED_MPS_MIN {
            self.steer_rad = steer_rad.clamp(-steer_max_rad, steer_max_rad);
        }
    }

    fn part(&mut self, dt_s: f64) {
        let acceleration_mps2 = self.wanted_acceleration(dt_s).clamp(
            -self.options.braking_max_mps2,
            self.options.acceleration_max_mps2,
        );
        let steer_max_rad = self.options.steer_max_rad;
        let turn_max_rad = self.options.steer_rate_max_radps * dt_s;
        let wanted_rad = self.wanted_steer().clamp(-steer_max_rad, steer_max_rad);
        let steer_rad =
            self.steer_rad + (wanted_rad - self.steer_rad).clamp(-turn_max_rad, turn_max_rad);
        self.advance(dt_s, acceleration_mps2, steer_rad);
        self.plan_age_s += dt_s;
    }

    /// Acceleration requested by the speed profile, before limits.
    fn wanted_acceleration(&self, dt_s: f64) -> f64 {
        let speed_mps = self.state.speed_mps;
        let halt = |mps2: f64| -mps2.min(speed_mps / dt_s);
        let Some(profile) = &self.profile else {
            return halt(IDLE_BRAKING_MPS2);
        };
        let wanted = profile.at(self.plan_age_s);
        if wanted.rests {
            // What is missing to the plan's last position is not caught up with: that would be
            // creeping.
            let overshoot_m = (self.driven_m - wanted.arc_m).max(0.0);
            return halt(
                ((speed_mps + POSITION_GAIN_PER_S * overshoot_m) / SPEED_TIME_S).max(HALTING_MPS2),
            );
        }
        if self.plan_age_s > profile.end_s() {
            return halt(IDLE_BRAKING_MPS2);
        }
        let speed_error_mps =
            wanted.speed_mps + POSITION_GAIN_PER_S * (wanted.arc_m - self.driven_m) - speed_mps;
        wanted.acceleration_mps2 + speed_error_mps / SPEED_TIME_S
    }

    /// The angle of the wheels with which the middle of the box comes to the position that pure
    /// pursuit aims at.
    ///
    /// With the axles half a wheelbase L before and behind it, the middle moves aslant by b, where
    /// tan b = tan(steer) / 2, on a circle of curvature 2 sin b / L. A position at distance d and
    /// bearing a lies on that circle where 2 sin(a - b) / d is the same curvature, which gives tan
    /// b = L sin a / (d + L cos a).
    fn wanted_steer(&self) -> f64 {
        let Some(path) = &self.path else {
            return self.steer_rad;
        };
        let look_ahead_m =
            (self.options.look_ahead_s * self.state.speed_mps).max(self.options.look_ahead_m_min);
        let goal = self.state.to_local(path.at(self.path_arc_m + look_ahead_m));
        let (distance_m, wheelbase_m) = (goal.length(), self.wheelbase_m);
        if goal.x <= 0.0 || distance_m < 0.1 {
            // No arc forward leads there.
            return self.options.steer_max_rad * goal.y.signum();
        }
        let tan_slip = wheelbase_m * goal.y / (distance_m * distance_m + wheelbase_m * goal.x);
        (2.0 * tan_slip).atan()
    }

    /// Moves on an arc: exactly so for an angle of the wheels that does not change, and with the
    /// middle one otherwise.
    fn advance(&mut self, dt_s: f64, acceleration_mps2: f64, steer_rad: f64) {
        let speed_mps = self.state.speed_mps;
        let end_mps = (speed_mps + acceleration_mps2 * dt_s).max(0.0);
        // Where it comes to rest within the time, it moves only until then.
        let moving_s = if end_mps > 0.0 || acceleration_mps2 >= 0.0 {
            dt_s
        } else {
            speed_mps / -acceleration_mps2
        };
        let distance_m = 0.5 * (speed_mps + end_mps) * moving_s;
        let turn_rad = distance_m * (0.5 * (self.steer_rad + steer_rad)).tan() / self.wheelbase_m;
        let half_rad = 0.5 * turn_rad;
        let chord = if half_rad.abs() < 1e-6 {
            1.0
        } else {
            half_rad.sin() / half_rad
        };
        let to_rear = self.rear_axle_to_middle_m();
        let rear_m = self.state.position_m - self.state.ahead() * to_rear
            + DVec2::from_angle(self.state.yaw_rad + half_rad) * (chord * distance_m);
        self.state.yaw_rad = wrapped(self.state.yaw_rad + turn_rad);
        self.state.position_m = rear_m + self.state.ahead() * to_rear;
        self.state.speed_mps = end_mps;
        self.state.acceleration_mps2 = acceleration_mps2;
        self.steer_rad = steer_rad;
        self.note_progress(distance_m);
    }

    fn note_progress(&mut self, distance_m: f64) {
        let Some(path) = &self.path else {
            self.driven_m += distance_m;
            return;
        };
        let before_m = self.path_arc_m;
        self.path_arc_m = path
            .project(self.state.position_m, before_m, SEARCH_M)
            .max(before_m);
        self.driven_m += self.path_arc_m - before_m;
    }
}
