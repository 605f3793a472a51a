//! Agents that another program drives: what it is told, and its commands.

use decouplegs_drive::traffic::EgoBox;
use decouplegs_scene::Invalid;
use decouplegs_scene::episode::{AgentCommand, CommandRecord};

use super::Simulation;
use crate::planner::agents::AgentsObservation;

impl Simulation {
    /// Traffic as a driver of agents sees it before step `step`.
    #[must_use]
    pub fn agents_observation(&self, step: u32) -> AgentsObservation {
        let there = |ego: usize| Some((self.ego_state(ego)?, self.egos[ego].task.size));
        let egos: Vec<EgoBox> = (0..self.egos.len()).map(there).collect();
        let agents = self.traffic.steerable(&egos);
        let takes = |index: &usize| {
            agents
                .binary_search_by_key(index, |agent| agent.agent)
                .is_ok()
        };
        let states = self.agents_for(0).into_iter().enumerate();
        let others = states.filter_map(|(index, state)| Some((index, state?)));
        let lines = self.lights().lines().iter();
        AgentsObservation {
            step,
            time_s: self.time_s(),
            ego: egos[0],
            others: others.filter(|(index, _)| !takes(index)).collect(),
            stop_lines: lines
                .map(|line| {
                    (
                        line.record,
                        self.lights().color_at(line.record.index, self.time_s()),
                    )
                })
                .collect(),
            agents,
        }
    }

    /// Sets the commands of agents for the next step.
    ///
    /// # Errors
    /// A sentence, if an agent takes no commands now, has two, or a number is not finite.
    pub fn command(&mut self, commands: &[AgentCommand]) -> Result<(), Invalid> {
        self.traffic.steer(commands)
    }

    /// Records of `commands`, which were carried out in the last step, and are over.
    pub fn obeyed(&mut self, commands: Vec<AgentCommand>) -> Vec<CommandRecord> {
        if commands.is_empty() {
            return Vec::new();
        }
        let limited = self.traffic.take_limited();
        // No commands are always good ones.
        let _ = self.traffic.steer(&[]);
        let record = |command: AgentCommand| CommandRecord {
            is_limited: limited.binary_search(&command.agent).is_ok(),
            command,
        };
        commands.into_iter().map(record).collect()
    }
}
