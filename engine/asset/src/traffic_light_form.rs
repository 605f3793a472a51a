//! Text form of a traffic light, the same in scenario files and lane files.

use decouplegs_scene::{LightColor, LightPhase, StopLine, TrafficLight};
use serde::{Deserialize, Serialize};

use crate::DecodeError;
use crate::xml::excerpt;

/// Most lights of a file, stop lines of a light and phases of a cycle.
pub const LIGHTS_MAX: usize = 10_000;
const LINES_MAX: usize = 1_000;
const PHASES_MAX: usize = 100;
/// Most successors that a stop line names.
const TOWARDS_MAX: usize = 100;
/// Shortest and longest phase, seconds.
const PHASE_S: std::ops::RangeInclusive<f64> = 0.1..=3600.0;
/// Largest distance along a lane, meters, and offset, seconds.
const ALONG_M_MAX: f64 = 1e6;
const OFFSET_S_MAX: f64 = 1e6;
/// Most bytes of a name or a lane's id.
const NAME_BYTES_MAX: usize = 1000;

#[derive(Deserialize, Serialize)]
#[serde(untagged)]
enum LineForm {
    All(String, f64),
    Towards(String, f64, Vec<String>),
}

impl LineForm {
    fn from_line(line: &StopLine) -> Self {
        let lane = line.lane.clone();
        match &line.towards[..] {
            [] => Self::All(lane, line.at_m),
            towards => Self::Towards(lane, line.at_m, towards.to_vec()),
        }
    }

    fn line(&self) -> StopLine {
        let (lane, at_m, towards) = match self {
            Self::All(lane, at_m) => (lane, at_m, Vec::new()),
            Self::Towards(lane, at_m, towards) => (lane, at_m, towards.clone()),
        };
        StopLine {
            lane: lane.clone(),
            at_m: *at_m,
            towards,
        }
    }
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct LightForm {
    name: String,
    /// Lane, meters along it, and the successors that it is for where it is not for all.
    stop_lines: Vec<LineForm>,
    /// Color and seconds.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    phases: Vec<(String, f64)>,
    #[serde(default)]
    offset_s: f64,
}

impl LightForm {
    pub fn from_light(light: &TrafficLight) -> Self {
        let phase = |phase: &LightPhase| (phase.color.name().to_owned(), phase.duration_s);
        Self {
            name: light.name.clone(),
            stop_lines: light.stop_lines.iter().map(LineForm::from_line).collect(),
            phases: light.phases.iter().map(phase).collect(),
            offset_s: light.offset_s,
        }
    }

    /// The light. Its numbers are not checked.
    ///
    /// # Errors
    /// Returns an error that names the field and the color that is unknown.
    pub fn light(&self) -> Result<TrafficLight, Fault> {
        let phase = |(name, duration_s): &(String, f64)| {
            let color = LightColor::by_name(name).ok_or_else(|| Fault {
                field: "phases",
                reason: format!("the color '{name}' is unknown; there are green, yellow, red"),
            })?;
            Ok(LightPhase {
                color,
                duration_s: *duration_s,
            })
        };
        Ok(TrafficLight {
            name: self.name.clone(),
            stop_lines: self.stop_lines.iter().map(LineForm::line).collect(),
            phases: self.phases.iter().map(phase).collect::<Result<_, _>>()?,
            offset_s: self.offset_s,
            changes: Vec::new(),
        })
    }
}

/// Field of a light that is wrong, and the reason.
pub struct Fault {
    pub field: &'static str,
    pub reason: String,
}

/// The lights of a map that have a stop line.
///
/// # Errors
/// Returns an error that names the light at fault, or their number.
pub fn checked(mut lights: Vec<TrafficLight>) -> Result<Vec<TrafficLight>, DecodeError> {
    lights.retain(|light| !light.stop_lines.is_empty());
    if lights.len() > LIGHTS_MAX {
        return Err(DecodeError::Malformed(format!(
            "{} traffic lights; expected at most {LIGHTS_MAX}",
            lights.len()
        )));
    }
    for light in &lights {
        check(light, Least::OF_MAP).map_err(|fault| {
            let (name, reason) = (excerpt(&light.name), fault.reason);
            DecodeError::Malformed(format!("traffic light {name}: {}: {reason}", fault.field))
        })?;
    }
    Ok(lights)
}

/// Least that a light has.
#[derive(Clone, Copy)]
pub struct Least {
    stop_lines: usize,
    phases: usize,
}

impl Least {
    /// Light of a map, which may leave its phases to others.
    pub const OF_MAP: Self = Self {
        stop_lines: 1,
        phases: 0,
    };
    /// Light of a scenario.
    pub const OF_SCENARIO: Self = Self {
        stop_lines: 1,
        phases: 1,
    };
    /// Light of a scenario that its story names, with or without stop lines.
    pub const OF_STORY: Self = Self {
        stop_lines: 0,
        phases: 1,
    };
}

/// First fault of a light, if any.
pub fn check(light: &TrafficLight, least: Least) -> Result<(), Fault> {
    let fault = |field, reason: String| Err(Fault { field, reason });
    let name_bytes = light.name.len();
    if !(1..=NAME_BYTES_MAX).contains(&name_bytes) {
        let reason = format!("{name_bytes} bytes; expected 1 to {NAME_BYTES_MAX}");
        return fault("name", reason);
    }
    let counts = [
        (
            "stop_lines",
            light.stop_lines.len(),
            least.stop_lines,
            LINES_MAX,
        ),
        ("phases", light.phases.len(), least.phases, PHASES_MAX),
    ];
    for (field, count, least, most) in counts {
        if !(least..=most).contains(&count) {
            return fault(
                field,
                format!("{count} of them; expected {least} to {most}"),
            );
        }
    }
    for line in &light.stop_lines {
        check_line(line).or_else(|reason| fault("stop_lines", reason))?;
    }
    for phase in &light.phases {
        if !PHASE_S.contains(&phase.duration_s) {
            let (from, to) = (PHASE_S.start(), PHASE_S.end());
            let reason = format!("{} s; expected {from} to {to}", phase.duration_s);
            return fault("phases", reason);
        }
    }
    if !(-OFFSET_S_MAX..=OFFSET_S_MAX).contains(&light.offset_s) {
        let reason = format!(
            "{} s; expected {} to {OFFSET_S_MAX}",
            light.offset_s, -OFFSET_S_MAX
        );
        return fault("offset_s", reason);
    }
    Ok(())
}

/// Fault of a line, if any.
pub fn check_line(line: &StopLine) -> Result<(), String> {
    if !(0.0..=ALONG_M_MAX).contains(&line.at_m) {
        let at_m = line.at_m;
        return Err(format!(
            "a line {at_m} m along; expected 0 to {ALONG_M_MAX}"
        ));
    }
    if line.towards.len() > TOWARDS_MAX {
        return Err(format!(
            "a line towards {} lanes; expected at most {TOWARDS_MAX}",
            line.towards.len()
        ));
    }
    for bytes in [&line.lane]
        .into_iter()
        .chain(&line.towards)
        .map(String::len)
    {
        if !(1..=NAME_BYTES_MAX).contains(&bytes) {
            return Err(format!(
                "a lane's id of {bytes} bytes; expected 1 to {NAME_BYTES_MAX}"
            ));
        }
    }
    Ok(())
}
