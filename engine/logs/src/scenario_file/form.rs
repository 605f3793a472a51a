//! The TOML form of a scenario: what serde sees, and how a [`Scenario`] is made of it.

use decouplegs_scene::scenario::{
    Behavior, DriverKind, Drivers, LaneSide, Maneuver, Place, TrafficAgent, Trigger,
};
use decouplegs_scene::{Air, Level, Pedestrian, RoadUser, Scenario, Story, VehicleSize, Weather};
use glam::DVec2;
use serde::{Deserialize, Serialize};
use toml::Spanned;

use super::VERSION;
use super::check::{Fault, Table, check};
use super::ego::{EgoForm, egos};
use super::seed::Seed;
use super::when::{AfterForm, WhenForm};
use decouplegs_asset::SceneError;
use decouplegs_asset::toml_text::{Checker, syntax_error};
use decouplegs_asset::traffic_light_form::LightForm;
use decouplegs_asset::traffic_sign_form::SignForm;

/// Tables keep their place in the text so that a complaint can name its line.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ScenarioForm {
    pub(super) version: u32,
    pub(super) name: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) level: Option<String>,
    pub(super) seed: Seed,
    // Files with drivers of kinds read as they did before there were others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) drivers: Option<String>,
    #[serde(default = "default_duration_s")]
    pub(super) duration_s: f64,
    #[serde(default = "default_step_s")]
    pub(super) step_s: f64,
    pub(super) place: PlaceForm,
    pub(super) ego: Spanned<EgoForm>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) other_ego: Vec<Spanned<EgoForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) agent: Vec<Spanned<AgentForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) light: Vec<Spanned<LightForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) pedestrian: Vec<Spanned<PedestrianForm>>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) sign: Vec<Spanned<SignForm>>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) story: Option<Story>,
}

fn default_duration_s() -> f64 {
    Scenario::DURATION_S
}

fn default_step_s() -> f64 {
    Scenario::STEP_S
}

#[derive(Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum PlaceForm {
    Street(Spanned<StreetForm>),
    Roads(Spanned<RoadsForm>),
    Scene(Spanned<SceneForm>),
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct StreetForm {
    pub(super) weather: String,
    pub(super) background: usize,
    pub(super) agent_splats: usize,
    pub(super) seed: Seed,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RoadsForm {
    pub(super) map: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) probe: Option<String>,
    #[serde(default)]
    pub(super) exposure_ev: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) weather: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) visibility_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) obstacles: Option<String>,
    pub(super) background: usize,
    pub(super) agent_splats: usize,
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SceneForm {
    pub(super) scene: String,
    pub(super) map: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) obstacles: Option<String>,
}

pub(super) fn default_size_m() -> [f64; 3] {
    VehicleSize::CAR.to_array()
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct AgentForm {
    pub(super) name: String,
    // Files with cars alone read as they did before there were other kinds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) kind: Option<String>,
    pub(super) asset: usize,
    #[serde(default = "default_size_m")]
    pub(super) size_m: [f64; 3],
    pub(super) lane: String,
    pub(super) at_m: f64,
    pub(super) speed_mps: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) cruise_mps: Option<f64>,
    #[serde(default = "default_driver")]
    pub(super) driver: String,
    #[serde(default = "default_changes_lanes")]
    pub(super) changes_lanes: bool,
    // Older files have `behaviour`.
    #[serde(default, alias = "behaviour", skip_serializing_if = "Vec::is_empty")]
    pub(super) behavior: Vec<Spanned<BehaviorForm>>,
}

fn default_driver() -> String {
    DriverKind::Normal.name().to_owned()
}

fn default_changes_lanes() -> bool {
    true
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct PedestrianForm {
    pub(super) name: String,
    pub(super) asset: usize,
    #[serde(default = "default_pedestrian_size_m")]
    pub(super) size_m: [f64; 3],
    pub(super) path_m: Vec<[f64; 2]>,
    #[serde(default = "default_walk_mps")]
    pub(super) speed_mps: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) at_time_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) near_ego_m: Option<f64>,
    #[serde(default = "default_waits_for_gap")]
    pub(super) waits_for_gap: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) when: Option<WhenForm>,
}

fn default_pedestrian_size_m() -> [f64; 3] {
    VehicleSize::PEDESTRIAN.to_array()
}

fn default_walk_mps() -> f64 {
    1.4
}

fn default_waits_for_gap() -> bool {
    true
}

#[derive(Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BehaviorForm {
    pub(super) maneuver: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) at_time_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) near_ego_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) deceleration_mps2: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) amplitude_m: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) duration_s: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) speed_mps: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) point_m: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) when: Option<WhenForm>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) after: Option<AfterForm>,
}

/// Reads and checks `text`.
pub(super) fn parse(text: &str) -> Result<Scenario, SceneError> {
    let form: ScenarioForm = toml::from_str(text).map_err(|error| syntax_error(text, &error))?;
    let complaint = |fault: Fault| {
        let start = match fault.table {
            Table::Top | Table::Story => 0..0,
            Table::Place => match &form.place {
                PlaceForm::Street(street) => street.span(),
                PlaceForm::Roads(roads) => roads.span(),
                PlaceForm::Scene(scene) => scene.span(),
            },
            Table::Ego => form.ego.span(),
            Table::OtherEgo(other) => form.other_ego[other].span(),
            Table::Light(light) => form.light[light].span(),
            Table::Sign(sign) => form.sign[sign].span(),
            Table::Pedestrian(walker) => form.pedestrian[walker].span(),
            Table::Agent(agent) => form.agent[agent].span(),
            Table::Behavior(agent, behavior) => {
                form.agent[agent].get_ref().behavior[behavior].span()
            }
        };
        Checker { text }.error(&start, &fault.table.to_string(), fault.field, fault.reason)
    };
    let scenario = scenario(&form).map_err(complaint)?;
    check(&scenario).map_err(complaint)?;
    Ok(scenario)
}

fn scenario(form: &ScenarioForm) -> Result<Scenario, Fault> {
    if form.version != VERSION {
        let reason = format!(
            "{} is not read; this program reads version {VERSION}",
            form.version
        );
        return Err(Fault::new(Table::Top, "version", reason));
    }
    let level = |name: &String| {
        named(
            name,
            Level::by_name,
            &Level::ALL.map(Level::name),
            Table::Top,
            "level",
        )
    };
    let drivers = |name: &String| {
        let names = Drivers::ALL.map(Drivers::name);
        named(name, Drivers::by_name, &names, Table::Top, "drivers")
    };
    Ok(Scenario {
        name: form.name.clone(),
        level: form.level.as_ref().map(level).transpose()?,
        seed: form.seed.0,
        drivers: form
            .drivers
            .as_ref()
            .map(drivers)
            .transpose()?
            .unwrap_or_default(),
        duration_s: form.duration_s,
        step_s: form.step_s,
        place: place(&form.place)?,
        ego: form.ego.get_ref().task(),
        egos: egos(form),
        agents: form
            .agent
            .iter()
            .enumerate()
            .map(|(at, form)| agent(at, form.get_ref()))
            .collect::<Result<_, _>>()?,
        lights: form
            .light
            .iter()
            .enumerate()
            .map(|(at, form)| {
                let light = form.get_ref().light();
                light.map_err(|fault| Fault::new(Table::Light(at), fault.field, fault.reason))
            })
            .collect::<Result<_, _>>()?,
        signs: form
            .sign
            .iter()
            .enumerate()
            .map(|(at, form)| {
                let sign = form.get_ref().sign();
                sign.map_err(|fault| Fault::new(Table::Sign(at), fault.field, fault.reason))
            })
            .collect::<Result<_, _>>()?,
        pedestrians: form
            .pedestrian
            .iter()
            .enumerate()
            .map(|(at, form)| pedestrian(at, form.get_ref()))
            .collect::<Result<_, _>>()?,
        story: form.story.clone().unwrap_or_default(),
    })
}

/// Value with the name `name`.
fn named<T>(
    name: &str,
    by_name: impl Fn(&str) -> Option<T>,
    names: &[&str],
    table: Table,
    field: &'static str,
) -> Result<T, Fault> {
    by_name(name).ok_or_else(|| {
        Fault::new(
            table,
            field,
            format!("'{name}' is unknown; there are {}", names.join(", ")),
        )
    })
}

fn weather_named(name: &str) -> Result<Weather, Fault> {
    let names = Weather::ALL.map(Weather::name);
    named(name, Weather::by_name, &names, Table::Place, "weather")
}

fn place(form: &PlaceForm) -> Result<Place, Fault> {
    Ok(match form {
        PlaceForm::Street(form) => {
            let StreetForm {
                weather,
                background,
                agent_splats,
                seed,
            } = form.get_ref();
            Place::Street {
                weather: weather_named(weather)?,
                background: *background,
                agent_splats: *agent_splats,
                seed: seed.0,
            }
        }
        PlaceForm::Roads(form) => {
            let RoadsForm {
                map,
                probe,
                exposure_ev,
                weather,
                visibility_m,
                obstacles,
                background,
                agent_splats,
            } = form.get_ref();
            Place::Roads {
                map: map.into(),
                probe: probe.as_ref().map(Into::into),
                exposure_ev: *exposure_ev,
                air: Air {
                    weather: weather.as_deref().map(weather_named).transpose()?,
                    visibility_m: *visibility_m,
                },
                obstacles: obstacles.as_ref().map(Into::into),
                background: *background,
                agent_splats: *agent_splats,
            }
        }
        PlaceForm::Scene(form) => {
            let SceneForm {
                scene,
                map,
                obstacles,
            } = form.get_ref();
            Place::Scene {
                scene: scene.into(),
                map: map.into(),
                obstacles: obstacles.as_ref().map(Into::into),
            }
        }
    })
}

fn agent(at: usize, form: &AgentForm) -> Result<TrafficAgent, Fault> {
    let drivers = DriverKind::ALL.map(DriverKind::name);
    let kinds = RoadUser::ON_LANES.map(RoadUser::name);
    let on_lanes = |name: &str| RoadUser::by_name(name).filter(|kind| kinds.contains(&kind.name()));
    let behaviors = form.behavior.iter().enumerate();
    Ok(TrafficAgent {
        name: form.name.clone(),
        kind: match &form.kind {
            None => RoadUser::Car,
            Some(name) => named(name, on_lanes, &kinds, Table::Agent(at), "kind")?,
        },
        asset: form.asset,
        size: VehicleSize::from_array(form.size_m),
        lane: form.lane.clone(),
        at_m: form.at_m,
        speed_mps: form.speed_mps,
        cruise_mps: form.cruise_mps,
        driver: named(
            &form.driver,
            DriverKind::by_name,
            &drivers,
            Table::Agent(at),
            "driver",
        )?,
        changes_lanes: form.changes_lanes,
        behaviors: behaviors
            .map(|(index, form)| behavior(form.get_ref(), Table::Behavior(at, index)))
            .collect::<Result<_, _>>()?,
    })
}

fn pedestrian(at: usize, form: &PedestrianForm) -> Result<Pedestrian, Fault> {
    Ok(Pedestrian {
        name: form.name.clone(),
        asset: form.asset,
        size: VehicleSize::from_array(form.size_m),
        path_m: form.path_m.iter().copied().map(DVec2::from_array).collect(),
        speed_mps: form.speed_mps,
        start: trigger(
            (form.at_time_s, form.near_ego_m, form.when.as_ref()),
            Table::Pedestrian(at),
        )?,
        waits_for_gap: form.waits_for_gap,
    })
}

fn trigger(
    keys: (Option<f64>, Option<f64>, Option<&WhenForm>),
    table: Table,
) -> Result<Trigger, Fault> {
    match keys {
        (Some(time_s), None, None) => Ok(Trigger::Time { time_s }),
        (None, Some(distance_m), None) => Ok(Trigger::NearEgo { distance_m }),
        (None, None, Some(form)) => form.trigger(table),
        _ => {
            let reason = "give one of 'at_time_s', 'near_ego_m' and 'when'".into();
            Err(Fault::new(table, "at_time_s", reason))
        }
    }
}

fn behavior(form: &BehaviorForm, table: Table) -> Result<Behavior, Fault> {
    let keys = (form.at_time_s, form.near_ego_m, form.when.as_ref());
    let trigger = match (&form.after, keys) {
        (None, keys) => trigger(keys, table)?,
        (Some(after), (None, None, None)) => after.trigger(table)?,
        _ => {
            let reason = "give one of 'at_time_s', 'near_ego_m', 'when' and 'after'".into();
            return Err(Fault::new(table, "after", reason));
        }
    };
    let name = form.maneuver.as_str();
    let needed = |field: &'static str, value: Option<f64>| {
        value.ok_or_else(|| Fault::new(table, field, format!("a maneuver '{name}' needs it")))
    };
    let foreign = |field: &'static str, value: Option<f64>| match value {
        Some(_) => Err(Fault::new(
            table,
            field,
            format!("a maneuver '{name}' has none"),
        )),
        None => Ok(()),
    };
    if name != "cruise" {
        foreign("speed_mps", form.speed_mps)?;
    }
    if name != "teleport" {
        foreign("point_m", form.point_m.map(|[x_m, _]| x_m))?;
    }
    let of_no_duration = || {
        foreign("amplitude_m", form.amplitude_m)?;
        foreign("deceleration_mps2", form.deceleration_mps2)?;
        foreign("duration_s", form.duration_s)
    };
    let maneuver = match name {
        "brake" => {
            foreign("amplitude_m", form.amplitude_m)?;
            let deceleration_mps2 = needed("deceleration_mps2", form.deceleration_mps2)?;
            Maneuver::Brake {
                deceleration_mps2,
                duration_s: needed("duration_s", form.duration_s)?,
            }
        }
        "cut_in" => {
            of_no_duration()?;
            Maneuver::CutIn
        }
        "change_left" | "change_right" => {
            of_no_duration()?;
            let side = if name == "change_left" {
                LaneSide::Left
            } else {
                LaneSide::Right
            };
            Maneuver::ChangeLane { side }
        }
        "cruise" => {
            of_no_duration()?;
            Maneuver::Cruise {
                speed_mps: needed("speed_mps", form.speed_mps)?,
            }
        }
        "teleport" => {
            of_no_duration()?;
            let Some(point_m) = form.point_m else {
                let reason = format!("a maneuver '{name}' needs it");
                return Err(Fault::new(table, "point_m", reason));
            };
            Maneuver::Teleport {
                point_m: DVec2::from_array(point_m),
            }
        }
        "swerve" => {
            foreign("deceleration_mps2", form.deceleration_mps2)?;
            let amplitude_m = needed("amplitude_m", form.amplitude_m)?;
            Maneuver::Swerve {
                amplitude_m,
                duration_s: needed("duration_s", form.duration_s)?,
            }
        }
        _ => {
            return Err(Fault::new(
                table,
                "maneuver",
                format!(
                    "'{name}' is unknown; there are brake, cut_in, swerve, cruise, change_left, change_right, teleport"
                ),
            ));
        }
    };
    Ok(Behavior { trigger, maneuver })
}
