//! Open loop: what a planner would have answered along a log, given other images. Nothing it
//! answers is driven.

use std::sync::Arc;

use decouplegs_scene::episode::Episode;
use decouplegs_scene::{Plan, Rig};

use super::site::Site;
use super::{EpisodeError, Simulation, episode_info};
use crate::planner::{Observation, Planner, Reading};

/// Images of a step, four bytes per pixel, one per camera of the rig.
pub type Images = Vec<Vec<u8>>;

/// Shows `planner` the images that `images_of` has of each step, the ego moving as in `episode`.
/// Its answers, `None` where it had none.
///
/// # Errors
/// Returns an error if the scenario does not fit the site, or `images_of` fails.
pub fn plans<E: From<EpisodeError>>(
    episode: &Episode,
    site: &Arc<Site>,
    rig: &Rig,
    planner: &mut dyn Planner,
    mut images_of: impl FnMut(u32) -> Result<Images, E>,
) -> Result<Vec<Option<Plan>>, E> {
    let scenario = &episode.head.scenario;
    let mut simulation = Simulation::new(scenario, site)?;
    let info = episode_info(&simulation.view(0), Some(rig));
    let begun = planner.begin(&info).is_ok();
    let mut driven = vec![simulation.instant()];
    let mut answers = Vec::with_capacity(episode.steps.len());
    for step in &episode.steps {
        let images = images_of(step.step)?;
        let readings: Vec<Reading> = rig
            .cameras()
            .zip(&images)
            .map(|(camera, rgba)| Reading::image(camera, rgba))
            .collect();
        let sees = planner.sees();
        let view = simulation.view(0);
        let privileged = sees.privileged.then(|| view.privileged());
        let localization = sees.localization.then(|| view.localization(&driven));
        let observation = Observation {
            step: step.step,
            time_s: simulation.time_s(),
            readings: &readings,
            ego: view.motion(),
            guidance: view.guidance(),
            localization: localization.as_ref(),
            privileged: privileged.as_ref(),
        };
        answers.push(if begun {
            planner.plan(&observation).ok()
        } else {
            None
        });
        let plans = episode.plans_at(step.step);
        driven = simulation.advance_with(&plans, |_| {}).swap_remove(0);
    }
    Ok(answers)
}
