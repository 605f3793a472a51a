//! Order of records: steps count up, time increases, every moment has all agents, numbers are
//! finite.

use decouplegs_scene::episode::{EpisodeTick, ROAD_VERSION};
use decouplegs_scene::{EpisodeEnd, EpisodeHead, EpisodeStep, LightCourse, VehicleState};

use super::instant::LANES_VERSION;

/// Position in the sequence of records of a log. Writer and reader ask the same one, so that what
/// is written can be read.
#[derive(Clone, Debug)]
pub(super) struct Sequence {
    version: u32,
    agents: usize,
    /// Number of traffic lights, and the time of the last change of one.
    lights: usize,
    lights_changed_s: f64,
    next_step: u32,
    time_s: f64,
}

impl Sequence {
    /// Checks the first line and starts the sequence.
    pub(super) fn new(head: &EpisodeHead, start: &EpisodeTick) -> Result<Self, String> {
        if head.route_m.len() < 2 {
            return Err(format!(
                "a route of {} points; expected at least 2",
                head.route_m.len()
            ));
        }
        let sizes = head.agent_sizes.iter().flat_map(|size| size.to_array());
        if !(head.route_m.iter().all(|point| point.is_finite())
            && sizes.into_iter().all(f64::is_finite))
        {
            return Err("the route or an agent's size has a number that is not finite".into());
        }
        let agents = head.agent_sizes.len();
        if agents != head.scenario.agent_count() {
            return Err(format!(
                "{agents} agents have a size; the scenario has {}",
                head.scenario.agent_count()
            ));
        }
        let lines = [
            ("light", &head.stop_lines, head.scenario.lights.len()),
            ("sign", &head.sign_lines, head.scenario.signs.len()),
        ];
        for (what, lines, count) in lines {
            for line in lines {
                let (index, length_m) = (line.index, line.ends_m[0].distance(line.ends_m[1]));
                if index >= count || !(1e-3..1e3).contains(&length_m) {
                    return Err(format!(
                        "a stop line of {what} {index}, {length_m} m long; expected one of {count} {what}s and 0.001 to 1000 m"
                    ));
                }
            }
        }
        let sequence = Self {
            version: head.log_version,
            agents,
            lights: head.scenario.lights.len(),
            lights_changed_s: f64::NEG_INFINITY,
            next_step: 0,
            time_s: start.time_s,
        };
        sequence
            .check_instant(start)
            .map_err(|reason| format!("the start {reason}"))?;
        Ok(sequence)
    }

    /// Version of the log.
    pub(super) fn version(&self) -> u32 {
        self.version
    }

    /// Checks that `step` may follow.
    pub(super) fn step(&mut self, step: &EpisodeStep) -> Result<(), String> {
        if step.step != self.next_step {
            return Err(format!(
                "step {}; expected step {}",
                step.step, self.next_step
            ));
        }
        for (index, instant) in step.instants.iter().enumerate() {
            self.check_instant(instant)
                .map_err(|reason| format!("instant {index} of step {} {reason}", step.step))?;
            if instant.time_s <= self.time_s {
                let (found_s, before_s) = (instant.time_s, self.time_s);
                return Err(format!(
                    "instant {index} of step {} is at {found_s} s, not after {before_s} s",
                    step.step
                ));
            }
            self.time_s = instant.time_s;
        }
        for handover in &step.handovers {
            if handover.agent >= self.agents || !handover.time_s.is_finite() {
                return Err(format!(
                    "step {} hands over agent {} of {} at {} s",
                    step.step, handover.agent, self.agents, handover.time_s
                ));
            }
        }
        for record in &step.lights {
            let offset_s = match record.change.course {
                LightCourse::Held(_) => 0.0,
                LightCourse::Cycle { offset_s } => offset_s,
            };
            let (at_s, count) = (record.change.time_s, self.lights);
            let is_told = record.light < count && offset_s.is_finite() && at_s.is_finite();
            if !is_told || at_s < self.lights_changed_s {
                return Err(format!(
                    "step {} changes light {} of {count} at {at_s} s; expected finite numbers in the order of times",
                    step.step, record.light
                ));
            }
            self.lights_changed_s = at_s;
        }
        let mut before = None;
        for record in &step.commands {
            let command = &record.command;
            let numbers = [
                command.acceleration_mps2,
                command.curvature_per_m.unwrap_or(0.0),
            ];
            let is_told = command.agent < self.agents && numbers.into_iter().all(f64::is_finite);
            if !is_told || before.is_some_and(|agent| agent >= command.agent) {
                return Err(format!(
                    "step {} commands agent {} of {}; expected finite numbers for agents in ascending order",
                    step.step, command.agent, self.agents
                ));
            }
            before = Some(command.agent);
        }
        self.next_step = self
            .next_step
            .checked_add(1)
            .ok_or("more steps than have a number")?;
        Ok(())
    }

    /// Checks that `end` may follow.
    pub(super) fn end(&self, end: &EpisodeEnd) -> Result<(), String> {
        match end {
            EpisodeEnd::Collision { agent } if *agent >= self.agents => Err(format!(
                "a collision with agent {agent} of {}, which count from 0",
                self.agents
            )),
            EpisodeEnd::Obstacle { obstacle } => {
                let numbers = [obstacle.yaw_rad, obstacle.length_m, obstacle.width_m];
                let finite =
                    obstacle.center_m.is_finite() && numbers.into_iter().all(f64::is_finite);
                if finite {
                    Ok(())
                } else {
                    Err("the obstacle has a number that is not finite".into())
                }
            }
            _ => Ok(()),
        }
    }

    fn check_instant(&self, instant: &EpisodeTick) -> Result<(), String> {
        if instant.lanes.is_some() && self.version < LANES_VERSION {
            return Err(format!(
                "tells of lanes, which logs before version {LANES_VERSION} do not; this is version {}",
                self.version
            ));
        }
        if instant.road.is_some() != (self.version >= ROAD_VERSION) {
            return Err(format!(
                "tells of the position on the road, or does not; logs do from version {ROAD_VERSION} on, and this is version {}",
                self.version
            ));
        }
        if instant.agents.len() != self.agents {
            return Err(format!(
                "has {} agents; expected {}",
                instant.agents.len(),
                self.agents
            ));
        }
        let finite = |state: &VehicleState| {
            let VehicleState {
                position_m,
                yaw_rad,
                speed_mps,
                acceleration_mps2,
            } = *state;
            position_m.is_finite()
                && [yaw_rad, speed_mps, acceleration_mps2]
                    .into_iter()
                    .all(f64::is_finite)
        };
        let lanes = instant.lanes.iter();
        let lanes = lanes.flat_map(|lanes| [lanes.against_mps].into_iter().chain(lanes.limit_mps));
        let offset = instant.road.and_then(|road| road.lane);
        let offset = offset.map(|lane| [lane.lateral_m, lane.half_width_m]);
        let all_finite = offset.into_iter().flatten().all(f64::is_finite)
            && instant.time_s.is_finite()
            && lanes.into_iter().all(f64::is_finite)
            && instant.steer_rad.is_finite()
            && std::iter::once(&instant.ego)
                .chain(instant.agents.iter().flatten())
                .all(finite);
        if all_finite {
            Ok(())
        } else {
            Err("has a number that is not finite".into())
        }
    }
}
