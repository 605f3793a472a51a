//! Scenarios that can be won: a planner that knows everything shows it by winning them.

use std::sync::Arc;

use decouplegs_drive::score::EpisodeScore;
use decouplegs_scene::Scenario;

use crate::episode::{EpisodeError, Site, drive_egos};
use crate::planner::{LaneFollow, Planner};

/// Share of a scenario's time that the planner must have to spare.
pub const MARGIN: f64 = 0.1;

/// True if the planner `lane-follow` brings every ego to the end of its route in `scenario` without
/// a fault, among the traffic of the scenario, with [`MARGIN`] of the time to spare.
///
/// # Errors
/// Returns an error if `scenario` does not fit `site`.
pub fn is_winnable(scenario: &Scenario, site: &Arc<Site>) -> Result<bool, EpisodeError> {
    let mut hurried = scenario.clone();
    let steps = (1.0 - MARGIN) * f64::from(scenario.steps());
    hurried.duration_s = scenario.step_s * steps.floor().max(1.0);
    let mut planners = vec![LaneFollow::default(); scenario.egos.count()];
    let planners = planners
        .iter_mut()
        .map(|planner| planner as &mut dyn Planner);
    let mut planners: Vec<&mut dyn Planner> = planners.collect();
    let drivers = (planners.as_mut_slice(), None);
    let driven = drive_egos(&hurried, site, None, drivers, &mut ())?;
    let mut egos = driven.episode.egos();
    Ok(egos.all(|ego| EpisodeScore::new(ego).success))
}
