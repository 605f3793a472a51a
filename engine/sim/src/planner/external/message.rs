//! Messages of the protocol, as in `planner-protocol.md`.

use decouplegs_scene::LightColor;
use decouplegs_scene::episode::{AgentCommand, StopLineRecord};
use decouplegs_scene::lidar::PointFrame;
use decouplegs_scene::plan::{Plan, PlanPoint};
use decouplegs_scene::{LidarSweep, Pose, Sensor, SignKind, VehicleSize, VehicleState};
use glam::DVec2;
use serde_json::{Value, json};

use super::agents;

use crate::planner::{
    Cameras, EpisodeInfo, Frame, KnownAgent, Localization, LocatedEgo, Observation,
    ObservationRequest, Privileged, images, sweeps,
};

/// The version of the protocol. Another one is refused.
pub(super) const PROTOCOL: u64 = 1;
/// Longest name of a planner and longest reason, characters.
const NAME_CHARS_MAX: usize = 64;
const REASON_CHARS_MAX: usize = 400;

/// Self-description of a planner.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Introduction {
    pub(super) name: String,
    pub(super) sees: ObservationRequest,
}

/// Message of a planner.
#[derive(Debug, PartialEq)]
pub(super) enum Answer {
    Hello(Introduction),
    Ready,
    Plan {
        step: u64,
        plan: Plan,
    },
    /// Name of a driver of agents.
    AgentsHello(String),
    /// Commands of a driver of agents.
    Commands {
        step: u64,
        commands: Vec<AgentCommand>,
    },
    /// The planner cannot go on, for this reason.
    Fail(String),
}

impl Answer {
    /// The word for it in the protocol.
    pub(super) const fn word(&self) -> &'static str {
        match self {
            Self::Hello(_) | Self::AgentsHello(_) => "hello",
            Self::Commands { .. } => "commands",
            Self::Ready => "ready",
            Self::Plan { .. } => "plan",
            Self::Fail(_) => "fail",
        }
    }

    /// Parses an answer from one line.
    ///
    /// # Errors
    /// Returns the end of a sentence that begins with the planner's name.
    pub(super) fn from_line(line: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(line)
            .map_err(|_| format!("sent a line that is not UTF-8: {}", beginning(line)))?;
        let message: Value = serde_json::from_str(text).map_err(|error| {
            let hint = if text.contains("NaN") || text.contains("Infinity") {
                " (NaN and Infinity are not JSON)"
            } else {
                ""
            };
            format!(
                "sent a line that is not JSON: {error}{hint}: {}",
                beginning(line)
            )
        })?;
        if message["bytes"].as_u64().unwrap_or(0) != 0 {
            return Err("announced bytes after its line; expected none from a planner".into());
        }
        match message["type"].as_str() {
            Some("hello") if message["drives"] == "agents" => {
                speaker(&message).map(Self::AgentsHello)
            }
            Some("commands") => agents::commands(&message),
            Some("hello") => introduction(&message).map(Self::Hello),
            Some("ready") => Ok(Self::Ready),
            Some("plan") => plan(&message),
            Some("fail") => Ok(Self::Fail(printable(
                message["reason"].as_str().unwrap_or("no reason given"),
                REASON_CHARS_MAX,
            ))),
            _ => Err(format!(
                "sent a message whose `type` is not hello, ready, plan or fail, nor commands: {}",
                beginning(line)
            )),
        }
    }
}

/// Name of a planner or driver that speaks the protocol.
fn speaker(message: &Value) -> Result<String, String> {
    if message["protocol"].as_u64() != Some(PROTOCOL) {
        let spoken = if message["protocol"].is_null() {
            "none".into()
        } else {
            printable(&message["protocol"].to_string(), 20)
        };
        return Err(format!("speaks protocol {spoken}; expected {PROTOCOL}"));
    }
    let name = message["name"]
        .as_str()
        .filter(|name| !name.is_empty())
        .ok_or("said hello without a `name`")?;
    Ok(printable(name, NAME_CHARS_MAX))
}

fn introduction(message: &Value) -> Result<Introduction, String> {
    let name = speaker(message)?;
    let cameras = match message["cameras"].as_str() {
        Some("none") => Cameras::None,
        Some("front") => Cameras::Front,
        Some("all") => Cameras::All,
        _ => return Err("said hello without `cameras`; expected none, front or all".into()),
    };
    let lidars = match message.get("lidars").map(|lidars| lidars.as_str()) {
        None | Some(Some("none")) => false,
        Some(Some("all")) => true,
        Some(_) => return Err("said hello with other `lidars` than none or all".into()),
    };
    let localization = match message.get("localization").map(Value::as_bool) {
        None => false,
        Some(Some(wanted)) => wanted,
        Some(None) => return Err("said hello with other `localization` than true or false".into()),
    };
    let privileged = message["privileged"]
        .as_bool()
        .ok_or("said hello without `privileged`; expected true or false")?;
    Ok(Introduction {
        name,
        sees: ObservationRequest {
            cameras,
            lidars,
            localization,
            privileged,
        },
    })
}

fn plan(message: &Value) -> Result<Answer, String> {
    let step = message["step"]
        .as_u64()
        .ok_or("sent a plan without the `step` it is for")?;
    let points = message["points"]
        .as_array()
        .ok_or("sent a plan without `points`")?;
    let point = |(index, point): (usize, &Value)| {
        let numbers: Vec<f64> = point.as_array()?.iter().map_while(Value::as_f64).collect();
        let [time_s, x, y] = <[f64; 3]>::try_from(numbers)
            .ok()
            .filter(|_| point.as_array().is_some_and(|all| all.len() == 3))?;
        Some((
            index,
            PlanPoint {
                time_s,
                position_m: DVec2::new(x, y),
            },
        ))
    };
    let mut read = Vec::with_capacity(points.len());
    for (index, value) in points.iter().enumerate() {
        let (_, point) = point((index, value)).ok_or_else(|| {
            format!(
                "sent a plan whose point {index} is not [seconds, meters ahead, meters to the left]"
            )
        })?;
        read.push(point);
    }
    let plan = Plan::new(read).map_err(|fault| format!("sent what is no plan: {fault}"))?;
    Ok(Answer::Plan { step, plan })
}

/// The first of `text`'s characters, those that a terminal would obey replaced.
fn printable(text: &str, chars_max: usize) -> String {
    text.chars()
        .take(chars_max)
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect()
}

/// Start of a line, quoted.
pub(super) fn beginning(line: &[u8]) -> String {
    let shown = &line[..line.len().min(80)];
    let more = if shown.len() < line.len() { "..." } else { "" };
    format!("{:?}{more}", String::from_utf8_lossy(shown))
}

/// First message to a planner.
pub(super) fn hello() -> Value {
    json!({ "type": "hello", "protocol": PROTOCOL, "engine": concat!("decouplegs ", env!("CARGO_PKG_VERSION")), "bytes": 0 })
}

fn wxyz(pose: &Pose) -> [f64; 4] {
    let turned = pose.rotation;
    [turned.w, turned.x, turned.y, turned.z]
}

/// Message before an episode.
pub(super) fn begin(info: &EpisodeInfo) -> Value {
    let (mut cameras, mut lidars) = (Vec::new(), Vec::new());
    for sensor in &info.sensors {
        match sensor {
            Sensor::Camera(camera) => {
                let (k, pose) = (camera.intrinsics, camera.rig_from_camera);
                cameras.push(json!({
                    "name": camera.name, "width_px": k.width_px, "height_px": k.height_px,
                    "fx_px": k.fx_px, "fy_px": k.fy_px, "cx_px": k.cx_px, "cy_px": k.cy_px,
                    "position_m": pose.translation.to_array(), "rotation_wxyz": wxyz(&pose),
                }));
            }
            Sensor::Lidar(lidar) => {
                let (model, pose) = (&lidar.model, lidar.rig_from_lidar);
                lidars.push(json!({
                    "name": lidar.name, "sensor": model.name, "rings": model.rings(), "columns": model.columns(),
                    "sweep_s": model.sweep_s, "range_m": model.range_m,
                    "position_m": pose.translation.to_array(), "rotation_wxyz": wxyz(&pose),
                }));
            }
        }
    }
    let mut message = json!({
        "type": "begin", "scenario": info.scenario, "step_s": info.step_s, "ego_size_m": info.ego_size.to_array(),
        "cameras": cameras, "bytes": 0,
    });
    if !lidars.is_empty() {
        message["lidars"] = lidars.into();
    }
    message
}

/// Bytes of a point in the protocol.
const POINT_BYTES: usize = 24;

/// The points of a sweep as the protocol has them, in the frame of the ego at the step.
pub(super) fn points(sweep: &LidarSweep) -> Vec<u8> {
    let frame = PointFrame::EgoAt(sweep.lidar.model.sweep_s);
    let points = sweep.points(frame);
    let mut bytes = Vec::with_capacity(POINT_BYTES * points.len());
    for point in &points {
        let [x, y, z] = point.position_m.as_vec3().to_array();
        for value in [x, y, z, point.measured.intensity] {
            bytes.extend(value.to_le_bytes());
        }
        bytes.extend(point.beam.offset_ns().to_le_bytes());
        for value in [point.beam.ring, point.beam.laser] {
            bytes.extend(value.to_le_bytes());
        }
    }
    bytes
}

/// Message at a step. The images follow the line in the order of `frames`, the points of sweeps
/// after them.
pub(super) fn observe(observation: &Observation) -> Value {
    let (ego, guidance) = (observation.ego, observation.guidance);
    let frame = |frame: Frame| {
        let k = frame.camera.intrinsics;
        json!({ "camera": frame.camera.name, "width_px": k.width_px, "height_px": k.height_px, "bytes": frame.rgba.len() })
    };
    let sweep = |sweep: &LidarSweep| {
        let count = sweep.returns.len();
        json!({ "lidar": sweep.lidar.name, "points": count, "bytes": POINT_BYTES * count })
    };
    let sweeps_sent: Vec<Value> = sweeps(observation.readings).map(sweep).collect();
    let image_bytes: usize = images(observation.readings)
        .map(|frame| frame.rgba.len())
        .sum();
    let points: usize = sweeps(observation.readings)
        .map(|sweep| sweep.returns.len())
        .sum();
    let mut message = json!({
        "type": "observe", "step": observation.step, "time_s": observation.time_s,
        "ego": {
            "speed_mps": ego.speed_mps, "acceleration_mps2": ego.acceleration_mps2,
            "steer_rad": ego.steer_rad, "yaw_rate_radps": ego.yaw_rate_radps,
        },
        "guidance": {
            "turn": guidance.turn.name(), "distance_m": guidance.distance_m, "angle_rad": guidance.angle_rad,
            "length_m": guidance.length_m, "cruise_mps": guidance.cruise_mps,
        },
        "frames": images(observation.readings).map(frame).collect::<Vec<_>>(),
        "privileged": observation.privileged.map(privileged),
        "bytes": image_bytes + POINT_BYTES * points,
    });
    if !sweeps_sent.is_empty() {
        message["sweeps"] = sweeps_sent.into();
    }
    if let Some(known) = observation.localization {
        message["localization"] = localization(known);
    }
    message
}

fn localization(known: &Localization) -> Value {
    let located = |located: &LocatedEgo| {
        json!({
            "time_s": located.time_s, "position_m": located.pose.translation.to_array(), "rotation_wxyz": wxyz(&located.pose),
            "yaw_rad": located.state.yaw_rad, "speed_mps": located.motion.speed_mps,
            "acceleration_mps2": located.motion.acceleration_mps2, "yaw_rate_radps": located.motion.yaw_rate_radps,
        })
    };
    json!({
        "path": known.path.iter().map(located).collect::<Vec<_>>(),
        "route_m": known.route_m.iter().map(|point| point.to_array()).collect::<Vec<_>>(),
    })
}

fn privileged(known: &Privileged) -> Value {
    json!({
        "ego": vehicle(&known.ego, &known.ego_size),
        "route_m": known.route_m.iter().map(|position| position.to_array()).collect::<Vec<_>>(),
        "agents": known.agents.iter().map(agent).collect::<Vec<_>>(),
        "stop_lines": known.stop_lines.iter().map(stop_line).collect::<Vec<_>>(),
        "signs": known.signs.iter().map(sign).collect::<Vec<_>>(),
    })
}

fn stop_line((line, color): &(StopLineRecord, LightColor)) -> Value {
    let [right_m, left_m] = line.ends_m.map(|end_m| end_m.to_array());
    json!({ "right_m": right_m, "left_m": left_m, "color": color.name() })
}

fn sign((line, kind): &(StopLineRecord, SignKind)) -> Value {
    let [right_m, left_m] = line.ends_m.map(|end_m| end_m.to_array());
    json!({ "right_m": right_m, "left_m": left_m, "kind": kind.name() })
}

fn agent(KnownAgent { kind, state, size }: &KnownAgent) -> Value {
    let mut told = vehicle(state, size);
    told["kind"] = kind.name().into();
    told
}

fn vehicle(state: &VehicleState, size: &VehicleSize) -> Value {
    json!({
        "position_m": state.position_m.to_array(), "yaw_rad": state.yaw_rad, "speed_mps": state.speed_mps,
        "acceleration_mps2": state.acceleration_mps2, "size_m": size.to_array(),
    })
}

/// Last message to a planner.
pub(super) fn end() -> Value {
    json!({ "type": "end", "bytes": 0 })
}
