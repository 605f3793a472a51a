//! Steering and acceleration as a plan: what an ego would drive that is steered by hand.

use decouplegs_scene::{Plan, PlanPoint};

use super::{Ego, PART_S};

/// Interval between points, seconds: a vehicle bends no faster.
const POINT_S: f64 = 0.1;

impl Ego {
    /// The way of this ego for `horizon_s` seconds (30 at most) with its wheels turned towards
    /// `steer_rad`, to the left where above zero, and `acceleration_mps2` kept up, both within what
    /// it can do. It does not reverse.
    ///
    /// In sharp bends the ego that follows it gains some speed with every new plan, about 2 % at
    /// 0.4 rad: positions of a plan are of the middle of the box, which is faster there than the
    /// rear axle.
    ///
    /// An episode that is steered by hand is so still one of plans, and its log replays.
    ///
    /// # Errors
    /// A sentence, when a number is not finite or the horizon not above zero.
    pub fn plan_under(
        &self,
        steer_rad: f64,
        acceleration_mps2: f64,
        horizon_s: f64,
    ) -> Result<Plan, String> {
        if !(steer_rad.is_finite() && acceleration_mps2.is_finite()) {
            return Err(format!(
                "steering by {steer_rad} rad at {acceleration_mps2} m/s2; expected finite numbers"
            ));
        }
        if !(horizon_s > 0.0 && horizon_s <= Plan::HORIZON_S_MAX) {
            return Err(format!(
                "a plan for {horizon_s} s; expected more than 0, at most {}",
                Plan::HORIZON_S_MAX
            ));
        }
        let mut ego = Self {
            path: None,
            profile: None,
            ..self.clone()
        };
        let steer_rad = steer_rad.clamp(-self.options.steer_max_rad, self.options.steer_max_rad);
        let acceleration_mps2 = acceleration_mps2.clamp(
            -self.options.braking_max_mps2,
            self.options.acceleration_max_mps2,
        );
        let turn_max_rad = self.options.steer_rate_max_radps * PART_S;
        let parts = (POINT_S / PART_S).round() as usize;
        let count = (horizon_s / POINT_S - 1e-6).ceil() as usize;
        let points = (1..=count).map(|number| {
            for _ in 0..parts {
                let turned_rad =
                    ego.steer_rad + (steer_rad - ego.steer_rad).clamp(-turn_max_rad, turn_max_rad);
                ego.advance(PART_S, acceleration_mps2, turned_rad);
            }
            PlanPoint {
                time_s: (number as f64 * POINT_S).min(horizon_s),
                position_m: self.state.to_local(ego.state.position_m),
            }
        });
        Ok(Plan::new(points.collect())?)
    }
}
