//! Drivers of agents in another process: the same protocol, with other words.

use decouplegs_drive::idm::BRAKING_MPS2;
use decouplegs_drive::traffic::{SteerableAgent, body};
use decouplegs_scene::episode::{AgentCommand, StopLineRecord};
use decouplegs_scene::{LaneKind, LightColor, RoadUser, VehicleSize, VehicleState};
use glam::{DVec2, DVec3};
use serde_json::{Value, json};

use super::message::{self, Answer};
use super::session::Session;
use super::{Timeouts, Transport};
use crate::planner::PlannerError;
use crate::planner::agents::{AgentDriver, AgentsInfo, AgentsObservation};

/// Program in the sentences about it.
const WHO: &str = "the external driver of agents";

/// A driver of agents outside this program. What it does wrong is an error with a sentence; its
/// process is ended then with all that it started.
#[derive(Debug)]
pub struct ExternalAgents {
    transport: Transport,
    timeouts: Timeouts,
    name: String,
    /// None after a failure, until the next episode begins.
    session: Option<Session>,
}

impl ExternalAgents {
    /// Starts or connects to the driver and has it introduce itself.
    ///
    /// # Errors
    /// A sentence, if it cannot be started or reached, or does not introduce itself in time and
    /// form.
    pub fn open(transport: Transport, timeouts: Timeouts) -> Result<Self, PlannerError> {
        let (session, name) = opened(&transport, &timeouts)?;
        Ok(Self {
            transport,
            timeouts,
            name,
            session: Some(session),
        })
    }

    /// The answer to a question; a session that does not have one is over.
    fn ask(&mut self, question: &Value) -> Result<Answer, PlannerError> {
        let time = self.timeouts.answer;
        let lost = || PlannerError(format!("{WHO} was lost"));
        let answer = self
            .session
            .as_mut()
            .ok_or_else(lost)?
            .ask(question, &[], time);
        if answer.is_err() {
            self.session = None;
        }
        answer
    }

    /// An answer of another kind.
    fn refused(&mut self, answer: &Answer, asked: &str, expected: &str) -> PlannerError {
        if let Answer::Fail(reason) = answer {
            return PlannerError(format!("{WHO} failed: {reason}"));
        }
        let word = answer.word();
        let what = format!("answered `{asked}` with {word}; expected {expected} or fail");
        match self.session.take() {
            Some(mut session) => session.broken(&what),
            None => PlannerError(format!("{WHO} {what}")),
        }
    }
}

/// A new session, and the name of the driver.
fn opened(transport: &Transport, timeouts: &Timeouts) -> Result<(Session, String), PlannerError> {
    let (mut session, answer) = Session::greeted(transport, timeouts, &hello(), WHO)?;
    match answer {
        Answer::AgentsHello(name) => Ok((session, name)),
        Answer::Hello(_) => Err(session.broken(
            "introduced itself as a planner; expected \"drives\": \"agents\" in its hello",
        )),
        Answer::Fail(reason) => Err(PlannerError(format!("{WHO} failed: {reason}"))),
        other => Err(session.broken(&format!(
            "answered hello with {}; expected hello",
            other.word()
        ))),
    }
}

impl AgentDriver for ExternalAgents {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn begin(&mut self, info: &AgentsInfo<'_>) -> Result<(), PlannerError> {
        if !self.session.as_mut().is_some_and(Session::is_open) {
            self.session = None;
            let (mut session, name) = opened(&self.transport, &self.timeouts)?;
            if name != self.name {
                return Err(session.broken(
                    "introduced itself in another way than before; expected the same name",
                ));
            }
            self.session = Some(session);
        }
        match self.ask(&begin(info))? {
            Answer::Ready => Ok(()),
            other => Err(self.refused(&other, "begin", "ready")),
        }
    }

    fn commands(
        &mut self,
        observation: &AgentsObservation,
    ) -> Result<Vec<AgentCommand>, PlannerError> {
        let step = observation.step;
        match self.ask(&observe(observation))? {
            Answer::Commands {
                step: answered,
                commands,
            } if answered == u64::from(step) => Ok(commands),
            other => Err(self.refused(&other, "observe", &format!("commands for step {step}"))),
        }
    }
}

/// First message to a driver of agents.
fn hello() -> Value {
    let mut hello = message::hello();
    hello["drives"] = "agents".into();
    hello
}

fn plane(points: &[DVec3]) -> Vec<[f64; 2]> {
    points.iter().map(|point| [point.x, point.y]).collect()
}

/// Message before an episode.
fn begin(info: &AgentsInfo<'_>) -> Value {
    let lane = |(index, lane): (usize, &decouplegs_scene::Lane)| {
        json!({
            "lane": index, "id": lane.id, "line_m": plane(&lane.centerline), "limit_mps": lane.speed_limit_mps,
            "successors": lane.successors, "left": lane.left_neighbor, "right": lane.right_neighbor,
        })
    };
    let lanes = info.lanes.lanes.iter().enumerate();
    let lanes = lanes.filter(|(_, lane)| lane.kind == LaneKind::Driving);
    let agent = |(index, (name, kind, size)): (usize, &(&str, RoadUser, VehicleSize))| {
        json!({
            "agent": index, "name": name, "kind": kind.name(), "size_m": size.to_array(),
            "curvature_max_per_m": body::curvature_per_m_max(size.length_m),
        })
    };
    json!({
        "type": "begin", "drives": "agents", "scenario": info.scenario, "seed": info.seed, "step_s": info.step_s,
        "limits": {
            "braking_mps2": BRAKING_MPS2, "acceleration_mps2": body::ACCELERATION_MPS2_MAX,
            "lateral_mps2": body::LATERAL_MPS2_MAX, "speed_mps": body::SPEED_MPS_MAX,
        },
        "lanes": lanes.map(lane).collect::<Vec<_>>(),
        "agents": info.agents.iter().enumerate().map(agent).collect::<Vec<_>>(),
        "bytes": 0,
    })
}

fn state(state: &VehicleState) -> Value {
    json!({
        "position_m": state.position_m.to_array(), "yaw_rad": state.yaw_rad, "speed_mps": state.speed_mps,
        "acceleration_mps2": state.acceleration_mps2,
    })
}

fn agent(agent: &SteerableAgent) -> Value {
    let mut told = state(&agent.state);
    told["agent"] = agent.agent.into();
    told["driven_by"] = agent.driven_by.name().into();
    told["size_m"] = json!(agent.size.to_array());
    told["offset_m"] = agent.offset_m.into();
    told["turn_rad"] = agent.turn_rad.into();
    told["limit_mps"] = agent.limit_mps.into();
    told["stop_m"] = agent.stop_m.into();
    told["way_m"] = agent
        .way_m
        .iter()
        .map(|point: &DVec2| json!([point.x, point.y]))
        .collect();
    told["leader"] = agent.leader.map_or(Value::Null, |leader| {
        json!({ "agent": leader.agent, "gap_m": leader.gap_m, "speed_mps": leader.speed_mps })
    });
    told
}

/// Message at a step.
fn observe(observation: &AgentsObservation) -> Value {
    let ego = observation.ego.map(|(ego, size)| {
        let mut told = state(&ego);
        told["size_m"] = json!(size.to_array());
        told
    });
    let other = |(index, seen): &(usize, VehicleState)| {
        let mut told = state(seen);
        told["agent"] = (*index).into();
        told
    };
    let stop_line = |(line, color): &(StopLineRecord, LightColor)| {
        let [right_m, left_m] = line.ends_m.map(|end_m| end_m.to_array());
        json!({ "right_m": right_m, "left_m": left_m, "color": color.name() })
    };
    json!({
        "type": "observe", "step": observation.step, "time_s": observation.time_s, "ego": ego,
        "agents": observation.agents.iter().map(agent).collect::<Vec<_>>(),
        "others": observation.others.iter().map(other).collect::<Vec<_>>(),
        "stop_lines": observation.stop_lines.iter().map(stop_line).collect::<Vec<_>>(),
        "bytes": 0,
    })
}

/// Reads an answer with commands.
///
/// # Errors
/// Returns the end of a sentence that begins with the driver's name.
pub(super) fn commands(message: &Value) -> Result<Answer, String> {
    let step = message["step"]
        .as_u64()
        .ok_or("sent commands without the `step` they are for")?;
    let all = message["commands"]
        .as_array()
        .ok_or("sent commands without `commands`, a list")?;
    let command = |value: &Value| {
        let parts = value
            .as_array()
            .filter(|parts| matches!(parts.len(), 2 | 3))?;
        let curvature_per_m = match parts.get(2) {
            None | Some(Value::Null) => None,
            Some(curvature) => Some(curvature.as_f64()?),
        };
        Some(AgentCommand {
            agent: usize::try_from(parts[0].as_u64()?).ok()?,
            acceleration_mps2: parts[1].as_f64()?,
            curvature_per_m,
        })
    };
    let mut commands = Vec::with_capacity(all.len());
    for (index, value) in all.iter().enumerate() {
        commands.push(command(value).ok_or_else(|| {
            format!(
                "sent a command, number {index}, that is not [agent, m/s^2] or [agent, m/s^2, 1/m]"
            )
        })?);
    }
    Ok(Answer::Commands { step, commands })
}
