//! Straight on at the speed it has: what every other planner has to beat.

use decouplegs_scene::plan::Plan;
use glam::DVec2;

use super::cadence::plan_through;
use super::{EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError};

/// Planner that asks for nothing and keeps its speed and heading.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConstantVelocity;

impl Planner for ConstantVelocity {
    fn name(&self) -> String {
        "constant-velocity".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest::default()
    }

    fn uses_readings(&self) -> bool {
        false
    }

    fn begin(&mut self, _: &EpisodeInfo) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        plan_through(|time_s| DVec2::new(observation.ego.speed_mps * time_s, 0.0))
    }
}
