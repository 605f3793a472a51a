//! Checks of a scenario: names, and numbers in ranges that have a meaning.

use std::collections::HashSet;
use std::fmt::{self, Display};
use std::ops::RangeInclusive;
use std::path::Path;

use decouplegs_scene::scenario::{
    After, Behavior, EgoTask, Maneuver, Measure, Measured, Place, TrafficAgent, Trigger,
};
use decouplegs_scene::{Pedestrian, RoadUser, Scenario, TrafficLight, TrafficSign, VehicleSize};

use super::ego::check_egos;
use super::story::check_story;
use decouplegs_asset::traffic_light_form::{self, LIGHTS_MAX, Least};
use decouplegs_asset::traffic_sign_form::{self, SIGNS_MAX};

/// Most agents of a scenario, pedestrians included.
pub const AGENTS_MAX: usize = 10_000;

/// Longest episode, seconds.
pub const DURATION_S_MAX: f64 = 3600.0;

/// Shortest time from one plan to the next, seconds.
pub const STEP_S_MIN: f64 = 0.02;

/// Longest time from one plan to the next, seconds.
pub const STEP_S_MAX: f64 = 5.0;

/// Letters of a name or a lane's id: a name is a part of file names.
const NAME_BYTES_MAX: usize = 100;
const LANE_BYTES_MAX: usize = 1000;

/// Lanes of a route.
const ROUTE_LANES_MAX: usize = 10_000;

/// Limits of measured values, their points and what is taken off distances.
const LIMITS: RangeInclusive<f64> = -1e6..=1e6;
const POINT_M: RangeInclusive<f64> = -1e7..=1e7;
const LESS_M: RangeInclusive<f64> = 0.0..=1000.0;

/// Behaviors of an agent.
const BEHAVIORS_MAX: usize = 100;

/// Splats of a background and of an agent: beyond what devices hold.
const BACKGROUND_SPLATS_MAX: usize = 200_000_000;
const AGENT_SPLATS_MAX: usize = 10_000_000;

/// Assets have numbers below this.
pub(super) const ASSETS_MAX: usize = 65_536;

const ALONG_M: RangeInclusive<f64> = 0.0..=1e6;
const SPEED_MPS: RangeInclusive<f64> = 0.0..=100.0;
/// Shortest and longest side of a vehicle.
const SIDE_M: RangeInclusive<f64> = 0.1..=100.0;
/// Points of a pedestrian's path, their distances, and walking speeds.
const PATH_POINTS_MAX: usize = 1000;
const PATH_STEP_M: RangeInclusive<f64> = 0.01..=1000.0;
const WALK_MPS: RangeInclusive<f64> = 0.1..=8.0;
const EXPOSURE_EV: RangeInclusive<f64> = -20.0..=20.0;
const VISIBILITY_M: RangeInclusive<f64> = 1.0..=1e6;
const NEAR_EGO_M: RangeInclusive<f64> = 0.0..=10_000.0;
const DECELERATION_MPS2: RangeInclusive<f64> = 0.01..=20.0;
const AMPLITUDE_M: RangeInclusive<f64> = -20.0..=20.0;
const MANEUVER_S: RangeInclusive<f64> = 0.01..=DURATION_S_MAX;

/// A table of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Table {
    Top,
    Place,
    Ego,
    OtherEgo(usize),
    Light(usize),
    Agent(usize),
    Behavior(usize, usize),
    Pedestrian(usize),
    Sign(usize),
    Story,
}

impl Display for Table {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Top => Ok(()),
            Self::Place => formatter.write_str("place"),
            Self::Ego => formatter.write_str("ego"),
            Self::OtherEgo(other) => write!(formatter, "other_ego[{other}]"),
            Self::Light(light) => write!(formatter, "light[{light}]"),
            Self::Sign(sign) => write!(formatter, "sign[{sign}]"),
            Self::Pedestrian(walker) => write!(formatter, "pedestrian[{walker}]"),
            Self::Story => formatter.write_str("story"),
            Self::Agent(agent) => write!(formatter, "agent[{agent}]"),
            Self::Behavior(agent, behavior) => {
                write!(formatter, "agent[{agent}].behavior[{behavior}]")
            }
        }
    }
}

/// Error and its location.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) table: Table,
    pub(super) field: &'static str,
    pub(super) reason: String,
}

impl Fault {
    pub(super) fn new(table: Table, field: &'static str, reason: String) -> Self {
        Self {
            table,
            field,
            reason,
        }
    }
}

/// First fault of `scenario`, if any.
pub(super) fn check(scenario: &Scenario) -> Result<(), Fault> {
    let top = Table::Top;
    check_name(top, &scenario.name)?;
    within(
        top,
        "duration_s",
        scenario.duration_s,
        &(STEP_S_MIN..=DURATION_S_MAX),
    )?;
    within(top, "step_s", scenario.step_s, &(STEP_S_MIN..=STEP_S_MAX))?;
    check_place(&scenario.place)?;
    let mut names = HashSet::new();
    check_egos(scenario, &mut names)?;
    if scenario.agent_count() > AGENTS_MAX {
        let reason = format!(
            "{} agents; expected at most {AGENTS_MAX}",
            scenario.agent_count()
        );
        let table = match scenario.agents.len() {
            vehicles if vehicles > AGENTS_MAX => Table::Agent(AGENTS_MAX),
            vehicles if vehicles + scenario.pedestrians.len() > AGENTS_MAX => {
                Table::Pedestrian(AGENTS_MAX - vehicles)
            }
            _ => Table::Story,
        };
        return Err(Fault::new(table, "name", reason));
    }
    for (index, agent) in scenario.agents.iter().enumerate() {
        check_agent(Table::Agent(index), agent)?;
        if !names.insert(agent.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", agent.name);
            return Err(Fault::new(Table::Agent(index), "name", reason));
        }
        if agent.behaviors.len() > BEHAVIORS_MAX {
            let reason = format!(
                "{} behaviors; expected at most {BEHAVIORS_MAX}",
                agent.behaviors.len()
            );
            return Err(Fault::new(
                Table::Behavior(index, BEHAVIORS_MAX),
                "maneuver",
                reason,
            ));
        }
        for (at, behavior) in agent.behaviors.iter().enumerate() {
            check_behavior(Table::Behavior(index, at), behavior)?;
            if let Trigger::After(after) = behavior.trigger {
                check_after(
                    Table::Behavior(index, at),
                    at,
                    &after,
                    agent.behaviors.len(),
                )?;
            }
        }
    }
    for (index, walker) in scenario.pedestrians.iter().enumerate() {
        let table = Table::Pedestrian(index);
        check_pedestrian(table, walker)?;
        if !names.insert(walker.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", walker.name);
            return Err(Fault::new(table, "name", reason));
        }
    }
    check_story(&scenario.story, &mut names)?;
    check_lights(&scenario.lights, &scenario.story.named_lights())?;
    check_signs(&scenario.signs)
}

fn check_signs(signs: &[TrafficSign]) -> Result<(), Fault> {
    if signs.len() > SIGNS_MAX {
        let reason = format!("{} signs; expected at most {SIGNS_MAX}", signs.len());
        return Err(Fault::new(Table::Sign(SIGNS_MAX), "kind", reason));
    }
    for (index, sign) in signs.iter().enumerate() {
        traffic_sign_form::check(sign)
            .map_err(|fault| Fault::new(Table::Sign(index), fault.field, fault.reason))?;
    }
    Ok(())
}

fn check_lights(lights: &[TrafficLight], named: &HashSet<&str>) -> Result<(), Fault> {
    let at = Table::Light;
    if lights.len() > LIGHTS_MAX {
        let reason = format!("{} lights; expected at most {LIGHTS_MAX}", lights.len());
        return Err(Fault::new(at(LIGHTS_MAX), "name", reason));
    }
    let mut names = HashSet::new();
    for (index, light) in lights.iter().enumerate() {
        let least = match named.contains(&*light.name) {
            true => Least::OF_STORY,
            false => Least::OF_SCENARIO,
        };
        traffic_light_form::check(light, least)
            .map_err(|fault| Fault::new(at(index), fault.field, fault.reason))?;
        if !names.insert(light.name.as_str()) {
            let reason = format!("'{}' is taken; names must differ", light.name);
            return Err(Fault::new(at(index), "name", reason));
        }
    }
    Ok(())
}

pub(super) fn within<T: PartialOrd + Display>(
    table: Table,
    field: &'static str,
    value: T,
    range: &RangeInclusive<T>,
) -> Result<(), Fault> {
    if range.contains(&value) {
        return Ok(());
    }
    let (first, last) = (range.start(), range.end());
    let reason = format!("{value} is out of range; expected {first} to {last}");
    Err(Fault::new(table, field, reason))
}

pub(super) fn check_name(table: Table, name: &str) -> Result<(), Fault> {
    let is_safe = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_';
    if (1..=NAME_BYTES_MAX).contains(&name.len()) && name.bytes().all(is_safe) {
        return Ok(());
    }
    let shown: String = name.chars().take(NAME_BYTES_MAX).collect();
    let reason = format!(
        "'{shown}' names files; expected 1 to {NAME_BYTES_MAX} letters (a to z), digits, '-' and '_'"
    );
    Err(Fault::new(table, "name", reason))
}

fn check_path(field: &'static str, path: &Path) -> Result<(), Fault> {
    if path.as_os_str().is_empty() {
        return Err(Fault::new(
            Table::Place,
            field,
            "is empty; expected the path of a file".into(),
        ));
    }
    Ok(())
}

fn check_place(place: &Place) -> Result<(), Fault> {
    let splats = |background: usize, agent_splats: usize| {
        within(
            Table::Place,
            "background",
            background,
            &(1..=BACKGROUND_SPLATS_MAX),
        )?;
        within(
            Table::Place,
            "agent_splats",
            agent_splats,
            &(1..=AGENT_SPLATS_MAX),
        )
    };
    match place {
        Place::Street {
            background,
            agent_splats,
            ..
        } => splats(*background, *agent_splats),
        Place::Roads {
            map,
            probe,
            exposure_ev,
            air,
            obstacles,
            background,
            agent_splats,
        } => {
            check_path("map", map)?;
            obstacles
                .as_deref()
                .map_or(Ok(()), |obstacles| check_path("obstacles", obstacles))?;
            probe
                .as_deref()
                .map_or(Ok(()), |probe| check_path("probe", probe))?;
            within(Table::Place, "exposure_ev", *exposure_ev, &EXPOSURE_EV)?;
            if let Some(visibility_m) = air.visibility_m {
                within(Table::Place, "visibility_m", visibility_m, &VISIBILITY_M)?;
            }
            splats(*background, *agent_splats)
        }
        Place::Scene {
            scene,
            map,
            obstacles,
        } => {
            check_path("scene", scene)?;
            check_path("map", map)?;
            obstacles
                .as_deref()
                .map_or(Ok(()), |obstacles| check_path("obstacles", obstacles))
        }
    }
}

pub(super) fn check_size(table: Table, size: VehicleSize) -> Result<(), Fault> {
    size.to_array()
        .into_iter()
        .try_for_each(|side_m| within(table, "size_m", side_m, &SIDE_M))
}

fn check_lane(table: Table, field: &'static str, lane: &str) -> Result<(), Fault> {
    if (1..=LANE_BYTES_MAX).contains(&lane.len()) {
        return Ok(());
    }
    let reason = format!(
        "a lane's id of {} bytes; expected 1 to {LANE_BYTES_MAX}",
        lane.len()
    );
    Err(Fault::new(table, field, reason))
}

pub(super) fn check_ego(table: Table, ego: &EgoTask) -> Result<(), Fault> {
    if !(1..=ROUTE_LANES_MAX).contains(&ego.route.len()) {
        let reason = format!("{} lanes; expected 1 to {ROUTE_LANES_MAX}", ego.route.len());
        return Err(Fault::new(table, "route", reason));
    }
    ego.route
        .iter()
        .try_for_each(|lane| check_lane(table, "route", lane))?;
    within(table, "start_m", ego.start_m, &ALONG_M)?;
    within(table, "end_m", ego.end_m, &ALONG_M)?;
    if ego.route.len() == 1 && ego.end_m <= ego.start_m {
        let reason = format!(
            "{} m does not lie beyond the start at {} m of the only lane",
            ego.end_m, ego.start_m
        );
        return Err(Fault::new(table, "end_m", reason));
    }
    within(table, "speed_mps", ego.speed_mps, &SPEED_MPS)?;
    within(table, "cruise_mps", ego.cruise_mps, &SPEED_MPS)?;
    for number in ego.start_pose.iter().flatten() {
        within(table, "start_pose", *number, &POINT_M)?;
    }
    check_size(table, ego.size)
}

fn check_agent(table: Table, agent: &TrafficAgent) -> Result<(), Fault> {
    check_name(table, &agent.name)?;
    if agent.kind == RoadUser::Pedestrian {
        let reason = "a pedestrian has a path instead of a lane; expected [[pedestrian]]";
        return Err(Fault::new(table, "kind", reason.into()));
    }
    within(table, "asset", agent.asset, &(0..=ASSETS_MAX - 1))?;
    check_size(table, agent.size)?;
    check_lane(table, "lane", &agent.lane)?;
    within(table, "at_m", agent.at_m, &ALONG_M)?;
    within(table, "speed_mps", agent.speed_mps, &SPEED_MPS)?;
    agent.cruise_mps.map_or(Ok(()), |speed_mps| {
        within(table, "cruise_mps", speed_mps, &SPEED_MPS)
    })
}

fn check_pedestrian(table: Table, walker: &Pedestrian) -> Result<(), Fault> {
    check_name(table, &walker.name)?;
    within(table, "asset", walker.asset, &(0..=ASSETS_MAX - 1))?;
    check_size(table, walker.size)?;
    within(table, "path_m", walker.path_m.len(), &(2..=PATH_POINTS_MAX))?;
    for pair in walker.path_m.windows(2) {
        let step_m = pair[0].distance(pair[1]);
        if !PATH_STEP_M.contains(&step_m) {
            let (least, most) = (PATH_STEP_M.start(), PATH_STEP_M.end());
            let reason =
                format!("points {step_m} m apart; expected {least} to {most} m between neighbors");
            return Err(Fault::new(table, "path_m", reason));
        }
    }
    within(table, "speed_mps", walker.speed_mps, &WALK_MPS)?;
    if matches!(walker.start, Trigger::After(_)) {
        let reason = "a pedestrian has no behaviors to wait for";
        return Err(Fault::new(table, "at_time_s", reason.into()));
    }
    check_trigger(table, walker.start)
}

/// Checks that behavior `at` waits for another one of the `count` that its agent has.
fn check_after(table: Table, at: usize, after: &After, count: usize) -> Result<(), Fault> {
    if after.behavior >= count || after.behavior == at {
        let reason = format!(
            "behavior {} of {count}; expected the number of another behavior of the agent, from 1",
            after.behavior.saturating_add(1)
        );
        return Err(Fault::new(table, "after", reason));
    }
    let times_s = 0.0..=DURATION_S_MAX;
    for (key, value) in [("from_s", after.from_s), ("delay_s", after.delay_s)] {
        if !times_s.contains(&value) {
            let reason = format!("{key} {value} is out of range; expected 0 to {DURATION_S_MAX}");
            return Err(Fault::new(table, "after", reason));
        }
    }
    Ok(())
}

fn check_trigger(table: Table, trigger: Trigger) -> Result<(), Fault> {
    match trigger {
        Trigger::Time { time_s } => within(table, "at_time_s", time_s, &(0.0..=DURATION_S_MAX)),
        Trigger::NearEgo { distance_m } => within(table, "near_ego_m", distance_m, &NEAR_EGO_M),
        Trigger::Measured(measured) => check_measured(table, &measured),
        // Its behaviors are known to the agent alone.
        Trigger::After(_) => Ok(()),
    }
}

fn check_measured(table: Table, measured: &Measured) -> Result<(), Fault> {
    let times_s = 0.0..=DURATION_S_MAX;
    let limit = if measured.is_above { "above" } else { "below" };
    let mut values = vec![
        ("from_s", measured.from_s, &times_s),
        ("delay_s", measured.delay_s, &times_s),
        ("less_m", measured.less_m, &LESS_M),
        (limit, measured.value, &LIMITS),
    ];
    if let Measure::DistanceTo { point_m } = measured.measure {
        values.extend(point_m.to_array().map(|value| ("point_m", value, &POINT_M)));
    }
    match values
        .iter()
        .find(|(_, value, range)| !range.contains(value))
    {
        Some((key, value, range)) => {
            let (least, most) = (range.start(), range.end());
            let reason = format!("{key} {value} is out of range; expected {least} to {most}");
            Err(Fault::new(table, "when", reason))
        }
        None => Ok(()),
    }
}

fn check_behavior(table: Table, behavior: &Behavior) -> Result<(), Fault> {
    check_trigger(table, behavior.trigger)?;
    match behavior.maneuver {
        Maneuver::Brake {
            deceleration_mps2,
            duration_s,
        } => {
            within(
                table,
                "deceleration_mps2",
                deceleration_mps2,
                &DECELERATION_MPS2,
            )?;
            within(table, "duration_s", duration_s, &MANEUVER_S)
        }
        Maneuver::CutIn | Maneuver::ChangeLane { .. } => Ok(()),
        Maneuver::Teleport { point_m } => {
            within(table, "point_m", point_m.x, &POINT_M)?;
            within(table, "point_m", point_m.y, &POINT_M)
        }
        Maneuver::Cruise { speed_mps } => within(table, "speed_mps", speed_mps, &SPEED_MPS),
        Maneuver::Swerve {
            amplitude_m,
            duration_s,
        } => {
            within(table, "amplitude_m", amplitude_m, &AMPLITUDE_M)?;
            within(table, "duration_s", duration_s, &MANEUVER_S)
        }
    }
}
