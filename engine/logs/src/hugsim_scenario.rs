//! Scenario files of HUGSIM (YAML), as its benchmark has them.
//!
//! Followed is hyzhou404/HUGSIM at 62c690d of November 2025: `configs/benchmark` for the files,
//! `sim/utils/plan.py` and `sim/utils/agent_controller.py` for what they mean. Places are seen from
//! the first front camera: `right_m` and `ahead_m`; headings are to the left where above zero, as
//! its planners drive, whatever the comments there say.

use std::path::Path;

use decouplegs_asset::{AssetError, DecodeError, read_bytes};
use serde_json::Value;

use crate::yaml;

/// Size of a file, at most, bytes.
const BYTES_MAX: usize = 1 << 20;
/// Agents of a scenario, at most.
const AGENTS_MAX: usize = 256;
/// Distances, speeds and angles are no larger.
const NUMBER_MAX: f64 = 1e6;

/// A scenario of HUGSIM.
#[derive(Clone, Debug, PartialEq)]
pub struct HugsimScenario {
    /// Name of the scene that it was made for.
    pub scene: String,
    /// Level and number, such as `hard_00`.
    pub mode: String,
    /// The ego at the start.
    pub ego: HugsimState,
    /// Other vehicles.
    pub agents: Vec<HugsimAgent>,
    /// True if agents are to follow the lanes of a map.
    pub has_map: bool,
}

/// Vehicle at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HugsimState {
    /// Middle of the vehicle, right of the first front camera, meters.
    pub right_m: f64,
    /// Middle of the vehicle, ahead of it, meters.
    pub ahead_m: f64,
    /// Heading against that camera's, to the left where above zero, radians.
    pub yaw_rad: f64,
    /// Speed, m/s.
    pub speed_mps: f64,
}

/// Other vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct HugsimAgent {
    /// State at the start.
    pub state: HugsimState,
    /// Name of its model among those of 3DRealCar.
    pub model: String,
    /// Planner that drives it.
    pub planner: HugsimPlanner,
}

/// Planner of a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub enum HugsimPlanner {
    /// Straight on, at one speed.
    Constant,
    /// The way of a recorded vehicle.
    Recorded {
        /// Name of the recorded vehicle.
        track: String,
        /// Factor on its speed.
        rate: f64,
    },
    /// The intelligent driver model along the lanes of the map.
    Idm {
        /// Speed on a free road, m/s.
        speed_mps: f64,
    },
    /// The way that leads nearest to where the ego will be.
    Attack {
        /// Steps of 0.1 s that it looks ahead.
        steps: u32,
        /// Steps of the simulation between plans.
        every: u32,
        /// Number of best ways among which it chooses.
        best: u32,
    },
}

/// Reads the scenario of HUGSIM at `path`.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Decode`] with the key at fault.
pub fn read_hugsim_scenario(path: &Path) -> Result<HugsimScenario, AssetError> {
    let bytes = read_bytes(path)?;
    decode(&bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "scenario of HUGSIM",
        source,
    })
}

/// The scenario in the bytes of a file.
///
/// # Errors
/// Returns an error with the line of the YAML, or the key, that is at fault.
pub fn decode(bytes: &[u8]) -> Result<HugsimScenario, DecodeError> {
    if bytes.len() > BYTES_MAX {
        return Err(malformed(format!(
            "{} bytes; expected at most {BYTES_MAX}",
            bytes.len()
        )));
    }
    let text = std::str::from_utf8(bytes).map_err(|_| malformed("it is no UTF-8 text".into()))?;
    let file = yaml::parse(text)?;
    let list = file
        .get("plan_list")
        .and_then(Value::as_array)
        .ok_or_else(|| {
            malformed("it has no list plan_list: expected a scenario of HUGSIM".into())
        })?;
    if list.len() > AGENTS_MAX {
        let count = list.len();
        return Err(malformed(format!(
            "plan_list: {count} vehicles, at most {AGENTS_MAX}"
        )));
    }
    let [right_m, ahead_m] = match file.get("start_ab") {
        None => [0.0; 2],
        Some(value) => numbers(value, "start_ab")?,
    };
    // Degrees about x, y and z of a world whose y looks down: the second turns to the right.
    let [_, turn_deg, _] = match file.get("start_euler") {
        None => [0.0; 3],
        Some(value) => numbers(value, "start_euler")?,
    };
    let speed_mps = match file.get("start_velo") {
        None => 0.0,
        Some(value) => number(value, "start_velo")?,
    };
    let agent = |(index, value): (usize, &Value)| agent(value, &format!("plan_list[{index}]"));
    Ok(HugsimScenario {
        scene: text_of(&file, "scene_name")?,
        mode: text_of(&file, "mode")?,
        ego: HugsimState {
            right_m,
            ahead_m,
            yaw_rad: -turn_deg.to_radians(),
            speed_mps,
        },
        agents: list
            .iter()
            .enumerate()
            .map(agent)
            .collect::<Result<_, _>>()?,
        has_map: file.get("load_HD_map").and_then(Value::as_bool) == Some(true),
    })
}

fn malformed(reason: String) -> DecodeError {
    DecodeError::Malformed(reason)
}

fn number(value: &Value, field: &str) -> Result<f64, DecodeError> {
    let number = value.as_f64().filter(|number| number.abs() <= NUMBER_MAX);
    number.ok_or_else(|| malformed(format!("{field}: expected a number, found {value}")))
}

fn numbers<const N: usize>(value: &Value, field: &str) -> Result<[f64; N], DecodeError> {
    let list = value.as_array().filter(|list| list.len() == N);
    let list = list.ok_or_else(|| malformed(format!("{field}: expected {N} numbers")))?;
    let mut numbers = [0.0; N];
    for (number_at, value) in numbers.iter_mut().zip(list) {
        *number_at = number(value, field)?;
    }
    Ok(numbers)
}

fn text_of(file: &Value, key: &str) -> Result<String, DecodeError> {
    let text = file.get(key).and_then(Value::as_str);
    text.map(str::to_owned)
        .ok_or_else(|| malformed(format!("{key}: expected a text")))
}

/// The vehicle of an entry of `plan_list`: right, ahead, height, heading, speed, model, planner and
/// its parameters.
fn agent(entry: &Value, field: &str) -> Result<HugsimAgent, DecodeError> {
    let entry = entry.as_array().filter(|entry| entry.len() == 8);
    let [
        right,
        ahead,
        _height,
        yaw,
        speed,
        model,
        planner,
        parameters,
    ] = entry.map(Vec::as_slice).unwrap_or_default()
    else {
        return Err(malformed(format!(
            "{field}: expected 8 values: right, ahead, height, heading, speed, model, planner and its parameters"
        )));
    };
    let parameter = |key: &str, otherwise: f64| match parameters.get(key) {
        None => Ok(otherwise),
        Some(value) => number(value, &format!("{field}: {key}")),
    };
    let count = |key: &str, otherwise: f64| {
        let value = parameter(key, otherwise)?;
        let is_count = value.fract() == 0.0 && (1.0..=10_000.0).contains(&value);
        is_count.then_some(value as u32).ok_or_else(|| {
            malformed(format!(
                "{field}: {key} is {value}; expected a count from 1"
            ))
        })
    };
    let planner = match planner.as_str() {
        Some("ConstantPlanner") => HugsimPlanner::Constant,
        Some("UnicyclePlanner") => {
            let rate = parameter("speed", 1.0)?;
            if rate <= 0.0 {
                return Err(malformed(format!(
                    "{field}: speed is {rate}; expected more than 0"
                )));
            }
            HugsimPlanner::Recorded {
                track: text_of(parameters, "uc_id")
                    .map_err(|error| malformed(format!("{field}: {error}")))?,
                rate,
            }
        }
        Some("IDM") => HugsimPlanner::Idm {
            speed_mps: parameter("v0", 30.0)?,
        },
        Some("AttackPlanner") => HugsimPlanner::Attack {
            steps: count("pred_steps", 20.0)?,
            every: count("ATTACK_FREQ", 3.0)?,
            best: count("best_k", 1.0)?,
        },
        _ => {
            return Err(malformed(format!(
                "{field}: planner {planner}; there are ConstantPlanner, UnicyclePlanner, IDM and AttackPlanner"
            )));
        }
    };
    Ok(HugsimAgent {
        state: HugsimState {
            right_m: number(right, field)?,
            ahead_m: number(ahead, field)?,
            yaw_rad: number(yaw, field)?,
            speed_mps: number(speed, field)?,
        },
        model: model.as_str().unwrap_or_default().to_owned(),
        planner,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Entries in the form of its benchmark; the values are our own.
    const TEXT: &str = include_str!("../../asset/fuzz/seeds/hugsim_scenario/four.yaml");

    #[test]
    fn entries_are_read() {
        let scenario = decode(TEXT.as_bytes()).unwrap();
        assert_eq!(
            (scenario.scene.as_str(), scenario.mode.as_str()),
            ("scene-0383", "extreme_00")
        );
        let ego = scenario.ego;
        assert_eq!([ego.right_m, ego.ahead_m, ego.speed_mps], [1.0, 2.0, 1.0]);
        assert!(
            (ego.yaw_rad + std::f64::consts::FRAC_PI_2).abs() < 1e-12,
            "to the right"
        );
        let first = &scenario.agents[0];
        let state = first.state;
        assert_eq!(
            [state.right_m, state.ahead_m, state.yaw_rad, state.speed_mps],
            [2.5, 12.0, 0.1, 3.0]
        );
        assert_eq!(
            (first.model.as_str(), &first.planner),
            ("car_a", &HugsimPlanner::Constant)
        );
        let planners: Vec<_> = scenario.agents[1..]
            .iter()
            .map(|agent| &agent.planner)
            .collect();
        let attack = HugsimPlanner::Attack {
            steps: 20,
            every: 10,
            best: 2,
        };
        let recorded = HugsimPlanner::Recorded {
            track: "6e298f45".into(),
            rate: 0.5,
        };
        assert_eq!(
            planners,
            [&attack, &recorded, &HugsimPlanner::Idm { speed_mps: 8.0 }]
        );
    }

    #[test]
    fn faults_name_the_key() {
        for (from, to, reason) in [
            ("plan_list", "plans", "no list plan_list"),
            (
                "ConstantPlanner",
                "Cautious",
                "plan_list[0]: planner \"Cautious\"; there are",
            ),
            ("best_k: 2", "best_k: 0.5", "plan_list[1]: best_k is 0.5"),
            ("speed: 0.5", "speed: 0", "plan_list[2]: speed is 0"),
            ("uc_id: 6e298f45, ", "", "plan_list[2]: uc_id"),
            ("  - 12.0\n", "", "plan_list[0]: expected 8 values"),
            ("12.0", "twelve", "plan_list[0]: expected a number"),
            (
                "start_ab: [1.0, 2.0]",
                "start_ab: [1.0]",
                "start_ab: expected 2 numbers",
            ),
            (
                "start_velo: 1",
                "start_velo: 1e300",
                "start_velo: expected a number",
            ),
            ("scene_name", "scene", "scene_name: expected a text"),
        ] {
            assert!(TEXT.contains(from), "{from}");
            let error = decode(TEXT.replacen(from, to, 1).as_bytes()).unwrap_err();
            assert!(error.to_string().contains(reason), "{to}: {error}");
        }
    }
}
