//! An episode that the caller steps through: its world in motion, and the record of what
//! happened.

use std::sync::Arc;

use decouplegs_drive::score::EpisodeScore;
use decouplegs_scene::episode::{
    AgentCommand, DrawnBy, Episode, EpisodeEnd, EpisodeHead, EpisodeStep, LOG_VERSION,
    PlannerRecord, ReadingRecord,
};
use decouplegs_scene::{Invalid, Motion, Plan, Pose, Scenario};

use super::simulation::EgoView;
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

/// Plan of an ego for a step.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Plan to drive.
    pub plan: Plan,
    /// Hashes of the readings that it was made from.
    pub readings: Vec<ReadingRecord>,
    /// True if it is not the planner's own plan.
    pub warm_up: bool,
}

/// One episode, step by step. It owns all that it needs: [`super::drive`] goes through one with a
/// planner, and others go through one when they please.
pub struct Rollout {
    simulation: Simulation,
    episode: Episode,
    /// Commands of the next step.
    commands: Vec<AgentCommand>,
    next_step: u32,
}

impl Rollout {
    /// `scenario` at its start, of one ego.
    ///
    /// # Errors
    /// Returns an error if it does not fit `site`, or has several egos.
    pub fn new(
        scenario: &Scenario,
        site: &Arc<Site>,
        metadata: EpisodeMetadata,
    ) -> Result<Self, EpisodeError> {
        Self::with_egos(scenario, site, vec![metadata])
    }

    /// `scenario` at its start, with the planner and the renderer of each ego.
    ///
    /// # Errors
    /// Returns an error if it does not fit `site`, or has another number of egos.
    pub fn with_egos(
        scenario: &Scenario,
        site: &Arc<Site>,
        metadata: Vec<EpisodeMetadata>,
    ) -> Result<Self, EpisodeError> {
        let egos = scenario.egos.count();
        if metadata.len() != egos {
            return Err(EpisodeError::Unfit {
                scenario: scenario.name.clone(),
                reason: format!(
                    "it has {egos} egos, and {} planners drive: expected a planner for each",
                    metadata.len()
                ),
            });
        }
        let simulation = Simulation::new(scenario, site)?;
        // The scenario may be that of a log, whose lights have changed.
        let mut scenario = scenario.clone();
        let lights = scenario.lights.iter_mut();
        lights.for_each(|light| light.changes.clear());
        let begun = |(ego, metadata)| begun(&simulation.view(ego), scenario.for_ego(ego), metadata);
        let mut episodes = metadata.into_iter().enumerate().map(begun);
        let mut episode = episodes.next().expect("a scenario has an ego");
        episode.others = episodes.collect();
        Ok(Self {
            simulation,
            episode,
            commands: Vec::new(),
            next_step: 0,
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
        self.next_step
    }

    /// Reason of the end of the first ego, if it has ended.
    #[must_use]
    pub fn end(&self) -> Option<&EpisodeEnd> {
        self.simulation.end()
    }

    /// True if all egos have ended.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.simulation.is_over()
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

    /// Drives `plan` of the only ego for a step, made from readings whose hashes are `readings`,
    /// and with `warm_up` not by the planner. Nothing moves any more when it is over.
    pub fn step(
        &mut self,
        plan: Plan,
        readings: Vec<ReadingRecord>,
        warm_up: bool,
    ) -> &EpisodeStep {
        let step = self.next_step();
        self.step_egos(vec![Some(Answer {
            plan,
            readings,
            warm_up,
        })]);
        &self.episode.steps[step as usize]
    }

    /// Drives the plans of all egos for a step, in the order of the scenario; `None` for those that
    /// have ended. Nothing moves any more when it is over.
    pub fn step_egos(&mut self, answers: Vec<Option<Answer>>) {
        let step = self.next_step;
        self.next_step += 1;
        let plan = |answer: &Option<Answer>| answer.as_ref().map(|answer| answer.plan.clone());
        let plans: Vec<Option<Plan>> = answers.iter().map(plan).collect();
        let plans: Vec<Option<&Plan>> = plans.iter().map(Option::as_ref).collect();
        let instants = self.simulation.advance_with(&plans, |_| {});
        let handovers = self.simulation.take_handovers();
        let lights = self.simulation.take_light_changes();
        let commands = std::mem::take(&mut self.commands);
        let commands = self.simulation.obeyed(commands);
        for (ego, (answer, instants)) in answers.into_iter().zip(instants).enumerate() {
            let Some(answer) = answer else { continue };
            self.episode.ego_mut(ego).push(EpisodeStep {
                step,
                readings: answer.readings,
                plan: answer.plan,
                warm_up: answer.warm_up,
                instants,
                handovers: handovers.clone(),
                commands: commands.clone(),
                lights: lights.clone(),
            });
        }
        self.note_ends();
    }

    /// Adds the hashes of the readings of a step, which were made after it. Returns the step.
    pub(super) fn set_readings(&mut self, step: u32, readings: Vec<ReadingRecord>) -> &EpisodeStep {
        let step = &mut self.episode.steps[step as usize];
        step.readings = readings;
        step
    }

    /// Ends ego `ego` because its planner failed.
    pub fn fail(&mut self, ego: usize, reason: String) {
        self.simulation.fail(ego, reason);
        self.note_ends();
    }

    fn note_ends(&mut self) {
        for ego in 0..self.simulation.ego_count() {
            if let Some(end) = self.simulation.view(ego).end() {
                self.episode.ego_mut(ego).end = end.clone();
            }
        }
    }

    /// Meters along the route where the ego had come farthest, and how long the route is.
    #[must_use]
    pub fn progress_m(&self) -> (f64, f64) {
        (
            self.simulation.view(0).progress_m(),
            self.simulation.view(0).route().length_m(),
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
        self.simulation.view(0).show(world)
    }
}

/// Record of an episode of one ego at its start.
fn begun(view: &EgoView<'_>, scenario: Scenario, metadata: EpisodeMetadata) -> Episode {
    let signs = view.simulation().signs().lines().iter();
    let head = EpisodeHead {
        log_version: LOG_VERSION,
        version: env!("CARGO_PKG_VERSION").into(),
        scenario,
        planner: metadata.planner,
        drawn_by: metadata.drawn_by,
        route_m: view.route_m(),
        agent_sizes: view.agent_sizes(),
        stop_lines: view.stop_lines().copied().collect(),
        sign_lines: signs.map(|line| line.record).collect(),
        agent_driver: metadata.agent_driver,
    };
    Episode {
        head,
        start: view.instant(),
        steps: Vec::new(),
        end: EpisodeEnd::Time,
        others: Vec::new(),
    }
}
