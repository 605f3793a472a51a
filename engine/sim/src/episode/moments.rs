//! Worlds of an episode at all its moments, from its log.

use std::sync::Arc;

use decouplegs_scene::episode::{Episode, EpisodeStep};
use decouplegs_scene::{Motion, Plan, Pose, Scenario};
use decouplegs_session::{Scene, SessionError, World};

use super::replay::check_version;
use super::{EpisodeError, Simulation, Site};

/// World of an episode at a moment.
#[derive(Clone)]
pub struct Moment {
    /// Time since the start of the episode, seconds.
    pub time_s: f64,
    /// Step that begins at this moment; `None` between steps and at the end.
    pub step: Option<u32>,
    /// Agents, lamps and signs.
    pub world: World,
    /// Pose of the middle of the ego's box, world coordinates.
    pub ego: Pose,
    /// Motion of the ego.
    pub motion: Motion,
}

/// Moments of an episode, in the order of time: the start, and the end of each sub-step.
pub struct Moments {
    moments: Vec<Moment>,
    departs_s: Option<f64>,
    simulation: Simulation,
    world: World,
}

impl Moments {
    /// The start of `scenario` in `site`, whose copy on the device is `scene`.
    ///
    /// # Errors
    /// Returns an error if the scenario does not fit `site`, or if `scene` has not the agents'
    /// assets.
    pub fn begin(
        scenario: &Scenario,
        site: &Arc<Site>,
        scene: &Arc<Scene>,
    ) -> Result<Self, EpisodeError> {
        let simulation = Simulation::new(scenario, site)?;
        let mut world = World::empty(scene);
        Ok(Self {
            moments: vec![moment(&simulation, &mut world)?],
            departs_s: None,
            simulation,
            world,
        })
    }

    /// All moments of `episode`.
    ///
    /// # Errors
    /// Returns an error if the log is of another version, and those of [`Moments::begin`].
    pub fn from_episode(
        episode: &Episode,
        site: &Arc<Site>,
        scene: &Arc<Scene>,
    ) -> Result<Self, EpisodeError> {
        check_version(episode)?;
        let mut moments = Self::begin(&episode.head.scenario, site, scene)?;
        let start = moments.simulation.instant();
        if start.told_like(&episode.start) != episode.start {
            moments.departs_s = Some(0.0);
        }
        for step in &episode.steps {
            moments.add_with(step, &episode.plans_at(step.step))?;
        }
        Ok(moments)
    }

    /// Adds the moments of `step` of the only ego, which follows those that were added before.
    ///
    /// # Errors
    /// Returns an error if the scene has not the agents' assets.
    pub fn add(&mut self, step: &EpisodeStep) -> Result<(), EpisodeError> {
        self.add_with(step, &[Some(&step.plan)])
    }

    /// Adds the moments of `step` of the first ego, in which all egos drive `plans`.
    fn add_with(
        &mut self,
        step: &EpisodeStep,
        plans: &[Option<&Plan>],
    ) -> Result<(), EpisodeError> {
        let Self {
            moments,
            simulation,
            world,
            ..
        } = self;
        if let Some(last) = moments.last_mut() {
            last.step = Some(step.step);
        }
        let begins_s = simulation.time_s();
        let mut failed = None;
        let all = simulation.advance_with(plans, |simulation| {
            // Others may drive on in the step in which the first ego ended.
            if !simulation.view(0).is_here() {
                return;
            }
            match moment(simulation, world) {
                Ok(moment) => moments.push(moment),
                Err(error) => failed = Some(error),
            }
        });
        let instants = &all[0];
        let mut pairs = instants.iter().zip(&step.instants);
        let first = pairs.find(|(now, logged)| now.told_like(logged) != **logged);
        let is_other = first.is_some() || instants.len() != step.instants.len();
        if self.departs_s.is_none() && is_other {
            self.departs_s = Some(first.map_or(begins_s, |(now, _)| now.time_s));
        }
        failed.map_or(Ok(()), |error| Err(error.into()))
    }

    /// The moments, at least one.
    #[must_use]
    pub fn as_slice(&self) -> &[Moment] {
        &self.moments
    }

    /// Time of the first moment at which a vehicle is not where the log says, seconds; `None` where
    /// all move as in the log, to the last bit.
    #[must_use]
    pub fn departs_s(&self) -> Option<f64> {
        self.departs_s
    }
}

fn moment(simulation: &Simulation, world: &mut World) -> Result<Moment, SessionError> {
    let (ego, motion) = simulation.view(0).show(world)?;
    Ok(Moment {
        time_s: simulation.time_s(),
        step: None,
        world: world.clone(),
        ego,
        motion,
    })
}
