//! The moments of our own planners' plans.

use decouplegs_scene::plan::{Plan, PlanPoint};
use glam::DVec2;

use super::PlannerError;

/// Interval between points of a plan, seconds: half a control step, so that each step passes two.
pub(super) const SPACING_S: f64 = 0.25;
/// Horizon of a plan, seconds: the time that a car at 50 km/h needs to stop with comfort.
pub(super) const HORIZON_S: f64 = 4.0;

/// Samples a plan from `place_at`: a time in seconds to a position in the ego's frame, in meters.
///
/// # Errors
/// Returns an error if a position is not finite or too far away.
pub fn plan_through(mut place_at: impl FnMut(f64) -> DVec2) -> Result<Plan, PlannerError> {
    let count = (HORIZON_S / SPACING_S).round() as u32;
    let points = (1..=count).map(|at| {
        let time_s = f64::from(at) * SPACING_S;
        PlanPoint {
            time_s,
            position_m: place_at(time_s),
        }
    });
    Plan::new(points.collect()).map_err(|error| PlannerError(error.into()))
}
