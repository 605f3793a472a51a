//! Drivers of agents that are networks in ONNX files, run by rten on the CPU.

use std::path::{Path, PathBuf};

use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::traffic::SteerableAgent;
use decouplegs_scene::episode::AgentCommand;
use glam::DVec2;
use rten::{Dimension, Model, NodeId, Value};

use super::{AgentDriver, AgentsInfo, AgentsObservation};
use crate::planner::PlannerError;

/// Numbers that a network is told of a vehicle.
const FEATURES: usize = 13;
/// Distance that stands for none, meters.
const NONE_M: f64 = 100.0;

/// A network with one input of [N, 13] and one output of [N, 1] or [N, 2], 32-bit floats.
///
/// A row of the input is a vehicle: speed, acceleration, gap to the leader (at most 100 m, which is
/// also that of none), speed of the leader less the own (0 without one), 1 with a leader and 0
/// without, offset from the way, heading against the way, curvatures of the way about 5 m, 15 m and
/// 30 m ahead, speed limit (0 where none is told), distance to a stop line that is not green (at
/// most 100 m, also for none), length. A row of the output is its acceleration, and its curvature,
/// without which it keeps to its way.
pub struct Onnx {
    path: PathBuf,
    model: Model,
    input: NodeId,
    output: NodeId,
}

impl Onnx {
    /// Reads the network at `path`.
    ///
    /// # Errors
    /// A sentence, if it cannot be read, or has other inputs or outputs.
    pub fn open(path: &Path) -> Result<Self, PlannerError> {
        let fault = |what: String| PlannerError(format!("{}: {what}", path.display()));
        let bytes = std::fs::read(path)
            .map_err(|error| fault(format!("cannot be read: {error}; expected an ONNX file")))?;
        let model = Model::load(bytes)
            .map_err(|error| fault(format!("is no network that can be run: {error}")))?;
        let (&[input], &[output]) = (model.input_ids(), model.output_ids()) else {
            return Err(fault(format!(
                "has {} inputs and {} outputs; expected one of each",
                model.input_ids().len(),
                model.output_ids().len()
            )));
        };
        let shape_of = |node: NodeId| model.node_info(node).and_then(|info| info.shape());
        check_shape(shape_of(input).as_deref(), FEATURES..=FEATURES)
            .map_err(|found| fault(format!("has an input of {found}; expected [N, {FEATURES}]")))?;
        check_shape(shape_of(output).as_deref(), 1..=2).map_err(|found| {
            fault(format!(
                "has an output of {found}; expected [N, 1] or [N, 2]"
            ))
        })?;
        Ok(Self {
            path: path.to_owned(),
            model,
            input,
            output,
        })
    }

    fn fault(&self, what: &str) -> PlannerError {
        PlannerError(format!("{}: {what}", self.path.display()))
    }
}

/// Checks a shape that a file tells, [N, columns]; one that it does not tell is checked when it is
/// run. The error is the shape.
fn check_shape(
    shape: Option<&[Dimension]>,
    columns: std::ops::RangeInclusive<usize>,
) -> Result<(), String> {
    let Some(shape) = shape else {
        return Ok(());
    };
    let fits = match shape {
        [rows, Dimension::Fixed(found)] => {
            columns.contains(found) && matches!(rows, Dimension::Symbolic(_))
        }
        [Dimension::Symbolic(_), Dimension::Symbolic(_)] => true,
        _ => false,
    };
    if fits {
        return Ok(());
    }
    let sizes = shape.iter().map(|dimension| match dimension {
        Dimension::Fixed(size) => size.to_string(),
        Dimension::Symbolic(name) => name.clone(),
    });
    Err(format!("[{}]", sizes.collect::<Vec<_>>().join(", ")))
}

/// Row of the input for a vehicle.
fn features(agent: &SteerableAgent) -> [f32; FEATURES] {
    let leader = agent.leader;
    let gap_m = leader.map_or(NONE_M, |leader| leader.gap_m.min(NONE_M));
    let closing_mps = leader.map_or(0.0, |leader| leader.speed_mps - agent.state.speed_mps);
    let row = [
        agent.state.speed_mps,
        agent.state.acceleration_mps2,
        gap_m,
        closing_mps,
        f64::from(u8::from(leader.is_some())),
        agent.offset_m,
        agent.turn_rad,
        curvature(&agent.way_m, 1),
        curvature(&agent.way_m, 3),
        curvature(&agent.way_m, 6),
        agent.limit_mps.unwrap_or(0.0),
        agent.stop_m.map_or(NONE_M, |stop_m| stop_m.min(NONE_M)),
        agent.size.length_m,
    ];
    row.map(|number| number as f32)
}

/// Turn of the way from before to behind its point `at`, over the length of the two parts, 1/m.
fn curvature(way_m: &[DVec2], at: usize) -> f64 {
    let Some(&[a, b, c]) = way_m.get(at - 1..=at + 1) else {
        return 0.0;
    };
    let turn_rad = wrapped((c - b).to_angle() - (b - a).to_angle());
    2.0 * turn_rad / (a.distance(b) + b.distance(c)).max(1e-6)
}

impl AgentDriver for Onnx {
    fn name(&self) -> String {
        let file = self.path.file_name().unwrap_or_default();
        file.to_string_lossy().into_owned()
    }

    fn begin(&mut self, _info: &AgentsInfo<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn commands(
        &mut self,
        observation: &AgentsObservation,
    ) -> Result<Vec<AgentCommand>, PlannerError> {
        let count = observation.agents.len();
        if count == 0 {
            return Ok(Vec::new());
        }
        let rows: Vec<f32> = observation.agents.iter().flat_map(features).collect();
        let input = Value::from_shape(&[count, FEATURES], rows)
            .map_err(|error| self.fault(&format!("takes no input: {error}")))?;
        let outputs = self
            .model
            .run(vec![(self.input, input.into())], &[self.output], None)
            .map_err(|error| self.fault(&format!("cannot be run: {error}")))?;
        let output = outputs.into_iter().next();
        let output = output.and_then(|value| value.into_shape_vec::<f32, 2>().ok());
        let Some(([rows, columns @ 1..=2], numbers)) =
            output.filter(|([rows, _], _)| *rows == count)
        else {
            return Err(self.fault(&format!(
                "answered with another shape; expected [{count}, 1] or [{count}, 2]"
            )));
        };
        debug_assert_eq!(numbers.len(), rows * columns);
        let answers = observation.agents.iter().zip(numbers.chunks_exact(columns));
        let commands = answers.map(|(agent, numbers)| AgentCommand {
            agent: agent.agent,
            acceleration_mps2: f64::from(numbers[0]),
            curvature_per_m: numbers.get(1).copied().map(f64::from),
        });
        Ok(commands.collect())
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_drive::traffic::{AgentLeader, DrivenBy};
    use decouplegs_scene::{VehicleSize, VehicleState};

    use super::*;

    /// A network of [N, 13] and [N, 2]: half of the speed of the leader less the own, and a
    /// hundredth of the offset to the right. MatMul of ONNX 17, as the package onnx writes it.
    const MODEL: &str = "080812003ab7010a110a01760a017712016122064d61744d756c1201672a73080d08021001420177\
        4a680000000000000000000000000000000000000000000000000000003f00000000000000000000\
        0000000000000ad723bc000000000000000000000000000000000000000000000000000000000000\
        00000000000000000000000000000000000000000000000000005a140a0176120f0a0d080112090a\
        0312014e0a02080d62140a0161120f0a0d080112090a0312014e0a02080242040a001011";

    fn bytes() -> Vec<u8> {
        let digits: String = MODEL.chars().filter(|c| !c.is_whitespace()).collect();
        let byte = |at: usize| u8::from_str_radix(&digits[at..at + 2], 16).unwrap();
        (0..digits.len()).step_by(2).map(byte).collect()
    }

    fn seen(agent: usize, offset_m: f64, leader_mps: Option<f64>) -> SteerableAgent {
        let leader = |speed_mps| AgentLeader {
            agent: None,
            gap_m: 20.0,
            speed_mps,
        };
        SteerableAgent {
            agent,
            state: VehicleState {
                speed_mps: 10.0,
                ..VehicleState::default()
            },
            size: VehicleSize::CAR,
            driven_by: DrivenBy::Model,
            way_m: (0..21)
                .map(|at| DVec2::new(5.0 * f64::from(at), 0.0))
                .collect(),
            offset_m,
            turn_rad: 0.0,
            limit_mps: None,
            leader: leader_mps.map(leader),
            stop_m: None,
        }
    }

    #[test]
    fn a_network_commands_all_vehicles() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("halves.onnx");
        std::fs::write(&path, bytes()).unwrap();
        let mut network = Onnx::open(&path).unwrap();
        assert_eq!(network.name(), "halves.onnx");
        let mut observation = AgentsObservation {
            step: 0,
            time_s: 0.0,
            ego: None,
            agents: vec![seen(3, 0.5, Some(7.0)), seen(5, 0.0, None)],
            others: Vec::new(),
            stop_lines: Vec::new(),
        };
        let commands = network.commands(&observation).unwrap();
        let told = |at: usize| (commands[at].agent, commands[at].acceleration_mps2);
        assert_eq!((told(0), told(1)), ((3, -1.5), (5, 0.0)));
        let curvature_per_m = commands[0].curvature_per_m.unwrap();
        assert!((curvature_per_m + 0.005).abs() < 1e-7, "{curvature_per_m}");
        observation.agents.clear();
        assert!(network.commands(&observation).unwrap().is_empty());
    }

    #[test]
    fn files_that_are_no_such_network_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let refusal = |name: &str, bytes: Option<&[u8]>| {
            let path = folder.path().join(name);
            if let Some(bytes) = bytes {
                std::fs::write(&path, bytes).unwrap();
            }
            let reason = Onnx::open(&path).err().unwrap().to_string();
            assert!(reason.contains(name), "{reason}");
            reason
        };
        assert!(refusal("absent.onnx", None).contains("expected an ONNX file"));
        assert!(refusal("noise.onnx", Some(b"no network")).contains("no network that can be run"));
        let whole = bytes();
        assert!(refusal("cut.onnx", Some(&whole[..60])).contains("no network"));
        // The number of columns of the input, in the type that it tells.
        let mut other = whole.clone();
        let at = other
            .windows(3)
            .rposition(|three| three == [0x02, 0x08, 0x0d])
            .unwrap();
        other[at + 2] = 5;
        let reason = refusal("five.onnx", Some(&other));
        assert!(
            reason.contains("has an input of [N, 5]; expected [N, 13]"),
            "{reason}"
        );
    }
}
