//! An episode that the caller steps through: its world in motion, and the record of what
//! happened.

use std::sync::Arc;

use decouplegs_drive::score::EpisodeScore;
use decouplegs_scene::episode::{
    AgentCommand, DrawnBy, Episode, EpisodeEnd, EpisodeHead, EpisodeStep, LOG_VERSION,
    PlannerRecord, ReadingRecord,
};
use decouplegs_scene::{Invalid, Motion, Plan, Pose, Scenario};

use super::{EpisodeError, Simulation, Site};
use decouplegs_session::{SessionError, World};

/// Planner and renderer of an episode, for its log.
#[derive(Clone, Debug, Default)]
pub struct EpisodeMetadata {
    /// Planner that drives.
    pub planner: PlannerRecord,
    /// Renderer of its observations, if any.
    pub drawn_by: Option<DrawnBy>,
    /// Name of the program that drives agents, if one does.
    pub agent_driver: Option<String>,
}

/// One episode, step by step. It owns all that it needs: [`super::drive`] goes through one with a
/// planner, and others go through one when they please.
pub struct Rollout {
    simulation: Simulation,
    episode: Episode,
    /// Commands of the next step.
    commands: Vec<AgentCommand>,
}

impl Rollout {
    /// `scenario` at its start.
    ///
    /// # Errors
    /// Returns an error if it does not fit `site`.
    pub fn new(
        scenario: &Scenario,
        site: &Arc<Site>,
        metadata: EpisodeMetadata,
    ) -> Result<Self, EpisodeError> {
        let simulation = Simulation::new(scenario, site)?;
        // The scenario may be that of a log, whose lights have changed.
        let mut scenario = scenario.clone();
        let lights = scenario.lights.iter_mut();
        lights.for_each(|light| light.changes.clear());
        let head = EpisodeHead {
            log_version: LOG_VERSION,
            version: env!("CARGO_PKG_VERSION").into(),
            scenario,
            planner: metadata.planner,
            drawn_by: metadata.drawn_by,
            route_m: simulation.route_m(),
            agent_sizes: simulation.agent_sizes().to_vec(),
            stop_lines: simulation.stop_lines().copied().collect(),
            sign_lines: simulation
                .signs()
                .lines()
                .iter()
                .map(|line| line.record)
                .collect(),
            agent_driver: metadata.agent_driver,
        };
        let start = simulation.instant();
        Ok(Self {
            simulation,
            episode: Episode {
                head,
                start,
                steps: Vec::new(),
                end: EpisodeEnd::Time,
            },
            commands: Vec::new(),
        })
    }

    /// State of the vehicles.
    #[must_use]
    pub fn simulation(&self) -> &Simulation {
        &self.simulation
    }

    /// Record so far. Its end is that of an episode whose time is over as long as [`Rollout::end`]
    /// is none.
    #[must_use]
    pub fn episode(&self) -> &Episode {
        &self.episode
    }

    /// Converts into the record of the episode.
    #[must_use]
    pub fn into_episode(self) -> Episode {
        self.episode
    }

    /// The step that comes next, from 0.
    #[must_use]
    pub fn next_step(&self) -> u32 {
        self.episode.steps.len() as u32
    }

    /// Reason of the end, if it has ended.
    #[must_use]
    pub fn end(&self) -> Option<&EpisodeEnd> {
        self.simulation.end()
    }

    /// Sets the commands of agents for the next step. Who has none is driven by the model.
    ///
    /// # Errors
    /// A sentence, if an agent takes no commands now, has two, or a number is not finite.
    pub fn command(&mut self, mut commands: Vec<AgentCommand>) -> Result<(), Invalid> {
        commands.sort_by_key(|command| command.agent);
        self.simulation.command(&commands)?;
        self.commands = commands;
        Ok(())
    }

    /// Drives `plan` for a step, made from readings whose hashes are `readings`, and with `warm_up`
    /// not by the planner. Nothing moves any more when it is over.
    pub fn step(
        &mut self,
        plan: Plan,
        readings: Vec<ReadingRecord>,
        warm_up: bool,
    ) -> &EpisodeStep {
        let step = self.next_step();
        let instants = self.simulation.advance(&plan);
        let handovers = self.simulation.take_handovers();
        let lights = self.simulation.take_light_changes();
        let commands = std::mem::take(&mut self.commands);
        let commands = self.simulation.obeyed(commands);
        self.episode.push(EpisodeStep {
            step,
            readings,
            plan,
            warm_up,
            instants,
            handovers,
            commands,
            lights,
        });
        self.note_end();
        &self.episode.steps[step as usize]
    }

    /// Adds the hashes of the readings of a step, which were made after it. Returns the step.
    pub(super) fn set_readings(&mut self, step: u32, readings: Vec<ReadingRecord>) -> &EpisodeStep {
        let step = &mut self.episode.steps[step as usize];
        step.readings = readings;
        step
    }

    /// Ends it because the planner failed.
    pub fn fail(&mut self, reason: String) {
        self.simulation.fail(reason);
        self.note_end();
    }

    fn note_end(&mut self) {
        if let Some(end) = self.simulation.end() {
            self.episode.end = end.clone();
        }
    }

    /// Meters along the route where the ego had come farthest, and how long the route is.
    #[must_use]
    pub fn progress_m(&self) -> (f64, f64) {
        (
            self.simulation.progress_m(),
            self.simulation.route().length_m(),
        )
    }

    /// Score so far.
    #[must_use]
    pub fn score(&self) -> EpisodeScore {
        EpisodeScore::new(&self.episode)
    }

    /// Puts the agents into `world` as they stand now, and takes out all others. Returns the ego's
    /// pose and motion.
    ///
    /// # Errors
    /// Returns an error if the scene of `world` has not the assets.
    pub fn show(&self, world: &mut World) -> Result<(Pose, Motion), SessionError> {
        self.simulation.show(world)
    }
}
