//! Drivers of agents: other programs, or networks, that drive the vehicles of the traffic in place
//! of the driver model.
//!
//! One driver drives all vehicles of an episode. It is told the map once, and at each step the
//! state of all vehicles, their ways and who leads them; it answers with an acceleration and a
//! curvature for as many as it likes. All others are driven by the model, or follow their tracks.

mod choice;
#[cfg(feature = "onnx")]
mod onnx;

use decouplegs_drive::traffic::SteerableAgent;
use decouplegs_scene::episode::{AgentCommand, StopLineRecord};
use decouplegs_scene::{
    Episode, LaneMap, LightColor, RoadUser, Scenario, VehicleSize, VehicleState,
};

use crate::planner::PlannerError;

pub use choice::AgentDriverChoice;
#[cfg(feature = "onnx")]
pub use onnx::Onnx;

/// Facts of an episode that a driver of agents is told before it begins.
#[derive(Clone, Debug)]
pub struct AgentsInfo<'a> {
    /// Name of the scenario.
    pub scenario: &'a str,
    /// Seed of the scenario.
    pub seed: u64,
    /// Time for which a command lasts, seconds.
    pub step_s: f64,
    /// Lanes of the place.
    pub lanes: &'a LaneMap,
    /// Names, kinds and sizes of all agents, in the order of the scenario.
    pub agents: Vec<(&'a str, RoadUser, VehicleSize)>,
}

impl<'a> AgentsInfo<'a> {
    /// Facts of `scenario` on `lanes`.
    #[must_use]
    pub fn new(scenario: &'a Scenario, lanes: &'a LaneMap) -> Self {
        let sizes = scenario.agent_sizes().into_iter().enumerate();
        let agents = sizes.map(|(index, size)| {
            let (name, kind, _) = scenario.agent(index);
            (name, kind, size)
        });
        Self {
            scenario: &scenario.name,
            seed: scenario.seed,
            step_s: scenario.step_s,
            agents: agents.collect(),
            lanes,
        }
    }
}

/// Traffic as a driver of agents sees it at a step.
#[derive(Clone, Debug)]
pub struct AgentsObservation {
    /// Number of the step, from 0.
    pub step: u32,
    /// Time since the start, seconds.
    pub time_s: f64,
    /// The ego, if there is one.
    pub ego: Option<(VehicleState, VehicleSize)>,
    /// Vehicles that take commands, in ascending order.
    pub agents: Vec<SteerableAgent>,
    /// Other agents that are there: pedestrians and actors of a story.
    pub others: Vec<(usize, VehicleState)>,
    /// Stop lines of all traffic lights, with the color that each shows.
    pub stop_lines: Vec<(StopLineRecord, LightColor)>,
}

/// Driver of agents.
pub trait AgentDriver: Send {
    /// Name in logs and reports.
    fn name(&self) -> String;

    /// Prepares for a new episode. Nothing of the episode before may be kept.
    ///
    /// # Errors
    /// A sentence, if it cannot drive.
    fn begin(&mut self, info: &AgentsInfo<'_>) -> Result<(), PlannerError>;

    /// Commands for the next step, in any order; none for those whom others shall drive.
    ///
    /// # Errors
    /// A sentence, if it has no answer, or none in time.
    fn commands(
        &mut self,
        observation: &AgentsObservation,
    ) -> Result<Vec<AgentCommand>, PlannerError>;
}

/// Commands of a log.
pub(crate) struct LoggedCommands<'a> {
    episode: &'a Episode,
    name: &'a str,
}

impl<'a> LoggedCommands<'a> {
    /// Commands of `episode`, if another program drove agents in it.
    pub(crate) fn of_episode(episode: &'a Episode) -> Option<Self> {
        let name = episode.head.agent_driver.as_deref()?;
        Some(Self { episode, name })
    }
}

impl AgentDriver for LoggedCommands<'_> {
    fn name(&self) -> String {
        self.name.to_owned()
    }

    fn begin(&mut self, _info: &AgentsInfo<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn commands(
        &mut self,
        observation: &AgentsObservation,
    ) -> Result<Vec<AgentCommand>, PlannerError> {
        let step = self.episode.steps.get(observation.step as usize);
        let commands = step.into_iter().flat_map(|step| &step.commands);
        Ok(commands.map(|record| record.command).collect())
    }
}
