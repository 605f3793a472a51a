//! Writes a [`Scenario`] as the text of its file.

use std::path::Path;

use decouplegs_scene::scenario::{
    Behavior, Drivers, LaneSide, Maneuver, Place, TrafficAgent, Trigger,
};
use decouplegs_scene::{Level, Pedestrian, RoadUser, Scenario, Story};
use glam::DVec2;
use toml::Spanned;

use super::VERSION;
use super::check::check;
use super::ego::{EgoForm, other_forms};
use super::form::{
    AgentForm, BehaviorForm, PedestrianForm, PlaceForm, RoadsForm, ScenarioForm, SceneForm,
    StreetForm,
};
use super::seed::Seed;
use super::when::{AfterForm, WhenForm};
use decouplegs_asset::EncodeError;
use decouplegs_asset::traffic_light_form::LightForm;
use decouplegs_asset::traffic_sign_form::SignForm;

/// Comment at the top of a scenario file, for people who edit it.
const HEADING: &str = "\
# A scenario: where an episode takes place, what the ego is to do there and who else is on the road.
# Meters, seconds; vehicles are length, width, height; places on lanes are meters along. Change what you like and drive it again:
# the same file gives the same episode. What each key means, and its limits: engine/asset/scenario-file.md.
";

pub(super) fn to_toml(scenario: &Scenario) -> Result<String, EncodeError> {
    check(scenario).map_err(|fault| {
        let key = format!("{}.{}", fault.table, fault.field);
        EncodeError(format!("{}: {}", key.trim_start_matches('.'), fault.reason))
    })?;
    let form = ScenarioForm {
        version: VERSION,
        name: scenario.name.clone(),
        level: scenario.level.map(Level::name).map(str::to_owned),
        seed: Seed(scenario.seed),
        drivers: (scenario.drivers != Drivers::default())
            .then(|| scenario.drivers.name().to_owned()),
        duration_s: scenario.duration_s,
        step_s: scenario.step_s,
        place: place_form(&scenario.place)?,
        ego: spanless(EgoForm::new(&scenario.ego, &scenario.egos.own)),
        other_ego: other_forms(scenario),
        agent: scenario
            .agents
            .iter()
            .map(|agent| spanless(agent_form(agent)))
            .collect(),
        light: scenario
            .lights
            .iter()
            .map(|light| spanless(LightForm::from_light(light)))
            .collect(),
        sign: scenario
            .signs
            .iter()
            .map(|sign| spanless(SignForm::from_sign(sign)))
            .collect(),
        pedestrian: scenario
            .pedestrians
            .iter()
            .map(|walker| spanless(pedestrian_form(walker)))
            .collect(),
        story: (scenario.story != Story::default()).then(|| scenario.story.clone()),
    };
    let body = toml::to_string(&form).map_err(|error| EncodeError(error.to_string()))?;
    Ok(format!("{HEADING}{body}"))
}

pub(super) fn spanless<T>(value: T) -> Spanned<T> {
    Spanned::new(0..0, value)
}

fn path_text(path: &Path) -> Result<String, EncodeError> {
    let text = path.to_str().map(str::to_owned);
    text.ok_or_else(|| {
        EncodeError(format!(
            "the path {} is not Unicode, which TOML needs; rename it",
            path.display()
        ))
    })
}

fn place_form(place: &Place) -> Result<PlaceForm, EncodeError> {
    Ok(match place {
        Place::Street {
            weather,
            background,
            agent_splats,
            seed,
        } => PlaceForm::Street(spanless(StreetForm {
            weather: weather.name().to_owned(),
            background: *background,
            agent_splats: *agent_splats,
            seed: Seed(*seed),
        })),
        Place::Roads {
            map,
            probe,
            exposure_ev,
            air,
            obstacles,
            background,
            agent_splats,
        } => PlaceForm::Roads(spanless(RoadsForm {
            map: path_text(map)?,
            probe: probe.as_deref().map(path_text).transpose()?,
            exposure_ev: *exposure_ev,
            weather: air.weather.map(|weather| weather.name().to_owned()),
            visibility_m: air.visibility_m,
            obstacles: obstacles.as_deref().map(path_text).transpose()?,
            background: *background,
            agent_splats: *agent_splats,
        })),
        Place::Scene {
            scene,
            map,
            obstacles,
        } => PlaceForm::Scene(spanless(SceneForm {
            scene: path_text(scene)?,
            map: path_text(map)?,
            obstacles: obstacles.as_deref().map(path_text).transpose()?,
        })),
    })
}

fn agent_form(agent: &TrafficAgent) -> AgentForm {
    AgentForm {
        name: agent.name.clone(),
        kind: (agent.kind != RoadUser::Car).then(|| agent.kind.name().to_owned()),
        asset: agent.asset,
        size_m: agent.size.to_array(),
        lane: agent.lane.clone(),
        at_m: agent.at_m,
        speed_mps: agent.speed_mps,
        cruise_mps: agent.cruise_mps,
        driver: agent.driver.name().to_owned(),
        changes_lanes: agent.changes_lanes,
        behavior: agent
            .behaviors
            .iter()
            .map(|behavior| spanless(behavior_form(behavior)))
            .collect(),
    }
}

fn pedestrian_form(walker: &Pedestrian) -> PedestrianForm {
    let (at_time_s, near_ego_m, when) = trigger_form(walker.start);
    PedestrianForm {
        name: walker.name.clone(),
        asset: walker.asset,
        size_m: walker.size.to_array(),
        path_m: walker.path_m.iter().map(DVec2::to_array).collect(),
        speed_mps: walker.speed_mps,
        at_time_s,
        near_ego_m,
        waits_for_gap: walker.waits_for_gap,
        when,
    }
}

/// `at_time_s`, `near_ego_m` and `when`.
fn trigger_form(trigger: Trigger) -> (Option<f64>, Option<f64>, Option<WhenForm>) {
    match trigger {
        Trigger::Time { time_s } => (Some(time_s), None, None),
        Trigger::NearEgo { distance_m } => (None, Some(distance_m), None),
        Trigger::Measured(measured) => (None, None, Some(WhenForm::new(&measured))),
        // Behaviors alone have it, in a table of its own.
        Trigger::After(_) => (None, None, None),
    }
}

fn behavior_form(behavior: &Behavior) -> BehaviorForm {
    let (at_time_s, near_ego_m, when) = trigger_form(behavior.trigger);
    let form = BehaviorForm {
        at_time_s,
        near_ego_m,
        when,
        after: match &behavior.trigger {
            Trigger::After(after) => Some(AfterForm::new(after)),
            _ => None,
        },
        ..BehaviorForm::default()
    };
    match behavior.maneuver {
        Maneuver::Brake {
            deceleration_mps2,
            duration_s,
        } => BehaviorForm {
            maneuver: "brake".into(),
            deceleration_mps2: Some(deceleration_mps2),
            duration_s: Some(duration_s),
            ..form
        },
        Maneuver::CutIn => BehaviorForm {
            maneuver: "cut_in".into(),
            ..form
        },
        Maneuver::Swerve {
            amplitude_m,
            duration_s,
        } => BehaviorForm {
            maneuver: "swerve".into(),
            amplitude_m: Some(amplitude_m),
            duration_s: Some(duration_s),
            ..form
        },
        Maneuver::Cruise { speed_mps } => BehaviorForm {
            maneuver: "cruise".into(),
            speed_mps: Some(speed_mps),
            ..form
        },
        Maneuver::Teleport { point_m } => BehaviorForm {
            maneuver: "teleport".into(),
            point_m: Some(point_m.to_array()),
            ..form
        },
        Maneuver::ChangeLane { side } => BehaviorForm {
            maneuver: match side {
                LaneSide::Left => "change_left".into(),
                LaneSide::Right => "change_right".into(),
            },
            ..form
        },
    }
}
