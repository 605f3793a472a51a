//! Agents that another program drove, as the log of an episode tells of them.

use std::collections::BTreeSet;

use decouplegs_scene::Episode;

use crate::oriented_box::OrientedBox;

/// Contact between two agents, of which another program drove one or both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AgentContact {
    /// First moment at which they overlap, seconds since the start.
    pub time_s: f64,
    /// Indices of both in the scenario, in ascending order.
    pub agents: [usize; 2],
}

/// Agents that another program drove.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandedAgents {
    /// Name of the program.
    pub driver: String,
    /// Agents that had a command at least once, in ascending order.
    pub agents: Vec<usize>,
    /// Number of commands.
    pub commands: usize,
    /// Number of commands that were more than a vehicle can do.
    pub limited: usize,
    /// Contacts of these agents with other agents. Those with the ego are its infractions.
    pub contacts: Vec<AgentContact>,
}

impl CommandedAgents {
    /// Agents that the log of `episode` tells of; `None` where no other program drove agents.
    #[must_use]
    pub fn new(episode: &Episode) -> Option<Self> {
        let driver = episode.head.agent_driver.clone()?;
        let (mut agents, mut touching) = (BTreeSet::new(), BTreeSet::new());
        let (mut commands, mut limited, mut contacts) = (0, 0, Vec::new());
        for step in &episode.steps {
            commands += step.commands.len();
            let all = step.commands.iter();
            limited += all.clone().filter(|record| record.is_limited).count();
            agents.extend(all.map(|record| record.command.agent));
            for tick in &step.instants {
                let sizes = &episode.head.agent_sizes;
                let boxes: Vec<Option<OrientedBox>> = tick
                    .agents
                    .iter()
                    .zip(sizes)
                    .map(|(state, size)| Some(OrientedBox::for_vehicle(state.as_ref()?, size)))
                    .collect();
                let before = std::mem::take(&mut touching);
                for &one in &agents {
                    let Some(own) = &boxes[one] else {
                        continue;
                    };
                    for (other, outline) in boxes.iter().enumerate() {
                        let pair = [one.min(other), one.max(other)];
                        let touches = outline.as_ref().is_some_and(|other| other.overlaps(own));
                        if one == other || !touches || !touching.insert(pair) {
                            continue;
                        }
                        if !before.contains(&pair) {
                            let time_s = tick.time_s;
                            contacts.push(AgentContact {
                                time_s,
                                agents: pair,
                            });
                        }
                    }
                }
            }
        }
        Some(Self {
            driver,
            agents: agents.into_iter().collect(),
            commands,
            limited,
            contacts,
        })
    }
}
