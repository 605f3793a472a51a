//! An episode that is driven step by step, with its planner, while a viewer shows it.

use std::sync::Arc;

use decouplegs_scene::episode::{Episode, EpisodeStep};
use decouplegs_scene::{Plan, Scenario};

use super::{EpisodeError, ObservationRenderer, Rollout, Site, begun, one_step};
use crate::planner::Planner;

/// Episode with its planner and the renderer of what that sees. It goes on when it is asked to, and
/// is the episode that [`super::drive`] would drive, to the last bit.
pub struct LiveEpisode {
    rollout: Rollout,
    planner: Box<dyn Planner>,
    renderer: ObservationRenderer,
}

impl LiveEpisode {
    /// `scenario` at its start.
    ///
    /// # Errors
    /// Returns an error if the scenario does not fit `site`. A planner that fails ends the episode.
    pub fn begin(
        scenario: &Scenario,
        site: &Arc<Site>,
        mut planner: Box<dyn Planner>,
        renderer: ObservationRenderer,
    ) -> Result<Self, EpisodeError> {
        let mut rollout = begun(scenario, site, Some(&renderer), &*planner)?;
        super::introduce(&mut rollout, &mut *planner, Some(&renderer));
        Ok(Self {
            rollout,
            planner,
            renderer,
        })
    }

    /// Drives the next step; `None` when the episode is over, or the planner failed just now.
    ///
    /// # Errors
    /// Returns an error if the device fails.
    pub fn step(&mut self) -> Result<Option<&EpisodeStep>, EpisodeError> {
        if self.is_over() {
            return Ok(None);
        }
        let before = self.episode().steps.len();
        let renderer = Some(&mut self.renderer);
        one_step(&mut self.rollout, renderer, &mut *self.planner, &mut ())?;
        Ok(self.episode().steps.get(before))
    }

    /// Other plans that the planner considered at the last step.
    #[must_use]
    pub fn alternatives(&self) -> &[Plan] {
        self.planner.alternatives()
    }

    /// True if it has ended.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.rollout.end().is_some()
    }

    /// Record so far.
    #[must_use]
    pub fn episode(&self) -> &Episode {
        self.rollout.episode()
    }
}
