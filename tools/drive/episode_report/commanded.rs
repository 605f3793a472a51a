//! Agents that another program drove, in reports.

use decouplegs::drive::score::{AgentContact, CommandedAgents};
use decouplegs::scene::Scenario;
use serde_json::{Value, json};

use super::Scored;

/// Sentence on all episodes in which another program drove agents; empty without such.
pub fn text(scored: &[Scored]) -> String {
    let told: Vec<&CommandedAgents> = scored
        .iter()
        .filter_map(|scored| scored.commanded.as_ref())
        .collect();
    let Some(first) = told.first() else {
        return String::new();
    };
    let sum = |count: fn(&CommandedAgents) -> usize| told.iter().map(|one| count(one)).sum();
    let [agents, commands, limited, contacts]: [usize; 4] = [
        sum(|one| one.agents.len()),
        sum(|one| one.commands),
        sum(|one| one.limited),
        sum(|one| one.contacts.len()),
    ];
    format!(
        "agents: {} drove {agents} vehicles in {} episodes by {commands} commands, {limited} of them more than a vehicle can do; they touched other agents {contacts} times\n",
        first.driver,
        told.len()
    )
}

/// Agents that were driven in an episode.
pub fn to_json(commanded: &CommandedAgents, scenario: &Scenario) -> Value {
    let name = |agent: usize| scenario.agent(agent).0.to_owned();
    let contact = |contact: &AgentContact| json!({ "time_s": contact.time_s, "agents": contact.agents.map(name) });
    json!({
        "driver": commanded.driver,
        "vehicles": commanded.agents.iter().copied().map(name).collect::<Vec<_>>(),
        "commands": commanded.commands,
        "limited": commanded.limited,
        "contacts": commanded.contacts.iter().map(contact).collect::<Vec<_>>(),
    })
}
