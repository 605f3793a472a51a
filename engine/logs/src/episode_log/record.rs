//! Records as JSON: what serde sees, and what of an [`Episode`](decouplegs_scene::Episode) it
//! stands for.

use decouplegs_scene::episode::{
    AgentCommand, CommandRecord, DrawnBy, EpisodeTick, HandoverRecord, LightChangeRecord,
    PlannerRecord, ROAD_VERSION, ReadingRecord, StopLineRecord,
};
use decouplegs_scene::{
    EpisodeEnd, EpisodeHead, EpisodeStep, LightChange, LightColor, LightCourse, Obstacle,
    ObstacleKind, Plan, PlanPoint, VehicleSize,
};
use glam::DVec2;
use serde::{Deserialize, Serialize};

use super::FORMAT;
use super::egos::OtherEndForm;
use super::instant::{InstantForm, LANES_VERSION, instant, instant_form};
use crate::scenario_file;

/// Index, right end and left end of a stop line.
pub(super) type LineForm = (usize, [f64; 2], [f64; 2]);

/// Fields of the first line that are the same in all versions.
#[derive(Deserialize)]
pub(super) struct FormatForm {
    pub(super) format: String,
    pub(super) version: u32,
}

/// The first line.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct HeadForm {
    format: String,
    version: u32,
    program: String,
    scenario: String,
    pub(super) planner: PlannerForm,
    pub(super) drawn_by: Option<DrawnByForm>,
    pub(super) route_m: Vec<[f64; 2]>,
    agent_sizes_m: Vec<[f64; 3]>,
    /// Index of the light, right end, left end.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) stop_lines: Vec<LineForm>,
    /// Index of the sign, right end, left end.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    sign_lines: Vec<LineForm>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    agent_driver: Option<String>,
    pub(super) start: InstantForm,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PlannerForm {
    name: String,
    cameras: Vec<String>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    lidars: Vec<String>,
    #[serde(default, skip_serializing_if = "is_false")]
    localization: bool,
    privileged: bool,
}

/// True for the first ego, whose number is left out.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_first(ego: &usize) -> bool {
    *ego == 0
}

/// True for `false`, which is left out.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes references")]
fn is_false(flag: &bool) -> bool {
    !flag
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct DrawnByForm {
    device: String,
    width_px: u32,
    height_px: u32,
    every: u32,
    #[serde(default, skip_serializing_if = "is_false")]
    f_theta: bool,
}

/// A line of a step.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StepForm {
    /// Ego of the line, from 0.
    #[serde(default, skip_serializing_if = "is_first")]
    pub(super) ego: usize,
    step: u32,
    /// Sensor and hash in 32 hex digits.
    images: Vec<(String, String)>,
    /// Time, x and y.
    plan: Vec<[f64; 3]>,
    #[serde(default, skip_serializing_if = "is_false")]
    warm_up: bool,
    instants: Vec<InstantForm>,
    /// Agent and time.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    handovers: Vec<(usize, f64)>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    commands: Vec<CommandForm>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    lights: Vec<LightChangeForm>,
}

/// Index of a light, time, and course.
type LightChangeForm = (usize, f64, CourseForm);

/// A color, or the position in the cycle at time 0.
#[derive(Deserialize, Serialize)]
#[serde(untagged)]
enum CourseForm {
    Held(LightColor),
    OffsetS(f64),
}

fn light_form(record: &LightChangeRecord) -> LightChangeForm {
    let course = match record.change.course {
        LightCourse::Held(color) => CourseForm::Held(color),
        LightCourse::Cycle { offset_s } => CourseForm::OffsetS(offset_s),
    };
    (record.light, record.change.time_s, course)
}

fn light_change((light, time_s, course): LightChangeForm) -> LightChangeRecord {
    let course = match course {
        CourseForm::Held(color) => LightCourse::Held(color),
        CourseForm::OffsetS(offset_s) => LightCourse::Cycle { offset_s },
    };
    let change = LightChange { time_s, course };
    LightChangeRecord { light, change }
}

/// Agent, acceleration, curvature, and whether it was limited.
type CommandForm = (usize, f64, Option<f64>, bool);

fn command_form(record: &CommandRecord) -> CommandForm {
    let AgentCommand {
        agent,
        acceleration_mps2,
        curvature_per_m,
    } = record.command;
    (agent, acceleration_mps2, curvature_per_m, record.is_limited)
}

fn command((agent, acceleration_mps2, curvature_per_m, is_limited): CommandForm) -> CommandRecord {
    CommandRecord {
        command: AgentCommand {
            agent,
            acceleration_mps2,
            curvature_per_m,
        },
        is_limited,
    }
}

/// The last line.
#[derive(Deserialize, Serialize)]
#[serde(tag = "end", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum EndForm {
    RouteDone {},
    Collision {
        agent: usize,
    },
    Obstacle {
        kind: String,
        center_m: [f64; 2],
        yaw_rad: f64,
        size_m: [f64; 2],
    },
    OffRoad {},
    OffRoute {},
    Story {},
    Time {},
    Planner {
        reason: String,
    },
}

/// Any line but those of heads. A step has a `step`, an end has an `end`; both have an `ego` where
/// it is not the first.
pub(super) enum Record {
    Step(StepForm),
    End(usize, EndForm),
}

impl Record {
    pub(super) fn parse(payload: &str) -> Result<Self, String> {
        let json_error =
            |error: serde_json::Error| format!("is no record of a step or an end: {error}");
        if payload.starts_with("{\"end\"") {
            let end = serde_json::from_str(payload);
            return end.map(|end| Self::End(0, end)).map_err(json_error);
        }
        if payload.starts_with("{\"ego\"") && payload.contains(",\"end\":{\"end\"") {
            let end: Result<OtherEndForm, _> = serde_json::from_str(payload);
            return end
                .map(|OtherEndForm { ego, end }| Self::End(ego, end))
                .map_err(json_error);
        }
        serde_json::from_str(payload)
            .map(Self::Step)
            .map_err(json_error)
    }
}

/// JSON of one line. Numbers are as short as they can be while every bit comes back.
pub(super) fn to_json(form: &impl Serialize) -> String {
    serde_json::to_string(form).expect("numbers and text, which JSON can hold")
}

fn planner_form(record: PlannerRecord) -> PlannerForm {
    let PlannerRecord {
        name,
        cameras,
        lidars,
        localization,
        privileged,
    } = record;
    PlannerForm {
        name,
        cameras,
        lidars,
        localization,
        privileged,
    }
}

pub(super) fn planner_record(form: PlannerForm) -> PlannerRecord {
    let PlannerForm {
        name,
        cameras,
        lidars,
        localization,
        privileged,
    } = form;
    PlannerRecord {
        name,
        cameras,
        lidars,
        localization,
        privileged,
    }
}

fn drawn_by_form(record: DrawnBy) -> DrawnByForm {
    let DrawnBy {
        device,
        width_px,
        height_px,
        every,
        f_theta,
    } = record;
    DrawnByForm {
        device,
        width_px,
        height_px,
        every,
        f_theta,
    }
}

pub(super) fn drawn_by(form: DrawnByForm) -> DrawnBy {
    let DrawnByForm {
        device,
        width_px,
        height_px,
        every,
        f_theta,
    } = form;
    DrawnBy {
        device,
        width_px,
        height_px,
        every,
        f_theta,
    }
}

fn line_form(line: &StopLineRecord) -> LineForm {
    let [right_m, left_m] = line.ends_m.map(|end_m| end_m.to_array());
    (line.index, right_m, left_m)
}

pub(super) fn line((index, right_m, left_m): LineForm) -> StopLineRecord {
    StopLineRecord {
        index,
        ends_m: [right_m, left_m].map(DVec2::from_array),
    }
}

impl HeadForm {
    /// # Errors
    /// A sentence, when no file can say its scenario.
    pub(super) fn from_head(head: &EpisodeHead, start: &EpisodeTick) -> Result<Self, String> {
        let EpisodeHead {
            log_version,
            version,
            scenario,
            planner,
            drawn_by,
            route_m,
            agent_sizes,
            stop_lines,
            sign_lines,
            agent_driver,
        } = head;
        Ok(Self {
            format: FORMAT.into(),
            version: *log_version,
            program: version.clone(),
            scenario: scenario_file::to_toml(scenario)
                .map_err(|error| format!("its scenario: {error}"))?,
            planner: planner_form(planner.clone()),
            drawn_by: drawn_by.clone().map(drawn_by_form),
            route_m: route_m.iter().map(DVec2::to_array).collect(),
            agent_sizes_m: agent_sizes.iter().map(|size| size.to_array()).collect(),
            stop_lines: stop_lines.iter().map(line_form).collect(),
            sign_lines: sign_lines.iter().map(line_form).collect(),
            agent_driver: agent_driver.clone(),
            start: instant_form(start, *log_version),
        })
    }

    /// # Errors
    /// A sentence, when its scenario is none.
    pub(super) fn into_head(self) -> Result<(EpisodeHead, EpisodeTick), String> {
        if !self.start.is_of(self.version) {
            return Err(format!(
                "its start is not that of version {}: lanes are told from version {LANES_VERSION} on, positions on them from version {ROAD_VERSION} on",
                self.version
            ));
        }
        let scenario = scenario_file::parse(&self.scenario)
            .map_err(|error| format!("its scenario, {error}"))?;
        let head = EpisodeHead {
            log_version: self.version,
            version: self.program,
            scenario,
            planner: planner_record(self.planner),
            drawn_by: self.drawn_by.map(drawn_by),
            route_m: self.route_m.into_iter().map(DVec2::from_array).collect(),
            agent_sizes: self
                .agent_sizes_m
                .into_iter()
                .map(VehicleSize::from_array)
                .collect(),
            stop_lines: self.stop_lines.into_iter().map(line).collect(),
            sign_lines: self.sign_lines.into_iter().map(line).collect(),
            agent_driver: self.agent_driver,
        };
        Ok((head, instant(self.start)))
    }
}

impl StepForm {
    /// The form of `step` in a log of `version`.
    pub(super) fn from_step(step: &EpisodeStep, version: u32) -> Self {
        let EpisodeStep {
            step,
            readings,
            plan,
            warm_up,
            instants,
            handovers,
            commands,
            lights,
        } = step;
        Self {
            ego: 0,
            step: *step,
            images: readings
                .iter()
                .map(|reading| (reading.sensor.clone(), format!("{:032x}", reading.hash)))
                .collect(),
            plan: plan
                .points()
                .iter()
                .map(|point| [point.time_s, point.position_m.x, point.position_m.y])
                .collect(),
            warm_up: *warm_up,
            instants: instants
                .iter()
                .map(|instant| instant_form(instant, version))
                .collect(),
            handovers: handovers
                .iter()
                .map(|handover| (handover.agent, handover.time_s))
                .collect(),
            commands: commands.iter().map(command_form).collect(),
            lights: lights.iter().map(light_form).collect(),
        }
    }

    /// The form of a line of ego `ego` where lines before have told the agents at the first `told`
    /// moments, and the changes of the world if `has_world`.
    pub(super) fn of_ego(mut self, ego: usize, told: usize, has_world: bool) -> Self {
        self.ego = ego;
        if has_world {
            self.handovers.clear();
            self.commands.clear();
            self.lights.clear();
        }
        let shortened = |(index, instant): (usize, InstantForm)| match index < told {
            true => instant.without_agents(),
            false => instant,
        };
        let instants = self.instants.into_iter().enumerate();
        self.instants = instants.map(shortened).collect();
        self
    }

    /// # Errors
    /// A sentence, when a hash or the plan is none.
    pub(super) fn into_step(self) -> Result<EpisodeStep, String> {
        let reading = |(sensor, hash): (String, String)| match u128::from_str_radix(&hash, 16) {
            Ok(bits) => Ok(ReadingRecord { sensor, hash: bits }),
            Err(_) => Err(format!(
                "the reading of {sensor:?} has the hash {hash:?}; expected 32 hex digits"
            )),
        };
        let handover = |(agent, time_s): (usize, f64)| HandoverRecord { agent, time_s };
        let point = |[time_s, x, y]: [f64; 3]| PlanPoint {
            time_s,
            position_m: DVec2::new(x, y),
        };
        Ok(EpisodeStep {
            step: self.step,
            readings: self
                .images
                .into_iter()
                .map(reading)
                .collect::<Result<_, _>>()?,
            plan: Plan::new(self.plan.into_iter().map(point).collect())?,
            warm_up: self.warm_up,
            instants: self.instants.into_iter().map(instant).collect(),
            handovers: self.handovers.into_iter().map(handover).collect(),
            commands: self.commands.into_iter().map(command).collect(),
            lights: self.lights.into_iter().map(light_change).collect(),
        })
    }
}

impl EndForm {
    pub(super) fn from_end(end: &EpisodeEnd) -> Self {
        match end {
            EpisodeEnd::RouteDone => Self::RouteDone {},
            EpisodeEnd::Collision { agent } => Self::Collision { agent: *agent },
            EpisodeEnd::Obstacle { obstacle } => Self::Obstacle {
                kind: obstacle.kind.name().into(),
                center_m: obstacle.center_m.to_array(),
                yaw_rad: obstacle.yaw_rad,
                size_m: [obstacle.length_m, obstacle.width_m],
            },
            EpisodeEnd::OffRoad => Self::OffRoad {},
            EpisodeEnd::OffRoute => Self::OffRoute {},
            EpisodeEnd::Story => Self::Story {},
            EpisodeEnd::Time => Self::Time {},
            EpisodeEnd::Planner { reason } => Self::Planner {
                reason: reason.clone(),
            },
        }
    }

    /// # Errors
    /// A sentence, when there is no such kind of obstacle.
    pub(super) fn into_end(self) -> Result<EpisodeEnd, String> {
        Ok(match self {
            Self::RouteDone {} => EpisodeEnd::RouteDone,
            Self::Collision { agent } => EpisodeEnd::Collision { agent },
            Self::Obstacle {
                kind,
                center_m,
                yaw_rad,
                size_m: [length_m, width_m],
            } => {
                let names = ObstacleKind::ALL.map(ObstacleKind::name).join(", ");
                let known = ObstacleKind::by_name(&kind)
                    .ok_or_else(|| format!("an obstacle of kind {kind:?}; expected {names}"))?;
                let obstacle = Obstacle {
                    kind: known,
                    center_m: DVec2::from_array(center_m),
                    yaw_rad,
                    length_m,
                    width_m,
                };
                EpisodeEnd::Obstacle { obstacle }
            }
            Self::OffRoad {} => EpisodeEnd::OffRoad,
            Self::OffRoute {} => EpisodeEnd::OffRoute,
            Self::Story {} => EpisodeEnd::Story,
            Self::Time {} => EpisodeEnd::Time,
            Self::Planner { reason } => EpisodeEnd::Planner { reason },
        })
    }
}
