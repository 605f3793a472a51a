//! Scenarios from OpenSCENARIO files.
//!
//! The ego is the entity named `Ego` or `Hero` (any case), otherwise the first vehicle; the planner
//! drives it, so its own actions other than a route are skipped. Its route is the shortest way
//! through the waypoints of its route, otherwise straight on, as far as it drives at
//! its cruise speed until the file's stop time (20 s if it has none).
//! Vehicles keep the speeds and lanes that the file gives them as far as traffic rules and other
//! vehicles allow: they follow by IDM, yield at crossings and choose their ways there by the seed.

mod actions;
mod locate;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use decouplegs_asset::maps::{MapFormat, open_drive};
use decouplegs_asset::{AssetError, DecodeError, read_bytes, read_map};
use decouplegs_drive::route::{LaneSpot, lanes_between, straight_on};
use decouplegs_logs::open_scenario::{Action, Entity, OpenScenario, SignalPhases, TargetSpeed};
use decouplegs_logs::read_open_scenario;
use decouplegs_logs::scenario_file::DURATION_S_MAX;
use decouplegs_scene::scenario::{DriverKind, EgoTask, Place, TrafficAgent};
use decouplegs_scene::{LaneMap, RoadUser, Scenario, TrafficLight};

use self::locate::{Located, Locator};

/// A scenario, and what of its file it does not express.
#[derive(Clone, Debug)]
pub struct ImportedScenario {
    /// The scenario. Its place is the map by its whole path, with one splat: their number is not in
    /// the file.
    pub scenario: Scenario,
    /// Lanes of its map.
    pub map: LaneMap,
    /// Elements that are skipped or approximated, one sentence each.
    pub skipped: Vec<String>,
}

/// Speed of an ego without an initial speed on a lane without a limit, m/s.
const CRUISE_MPS: f64 = 50.0 / 3.6;
/// Slower initial speeds are no cruise speeds, m/s.
const CRUISE_MPS_MIN: f64 = 1.0;
/// Time limit as a factor on the stop time of the file, and seconds that are added. An ego that
/// others slow down can still arrive.
const TIME_FACTOR: f64 = 1.5;
const TIME_PLUS_S: f64 = 15.0;

/// Reads the OpenSCENARIO file at `path` and its map, and makes a scenario of them.
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`], or [`AssetError::Decode`] with the element
/// at fault.
pub fn import_open_scenario(path: &Path) -> Result<ImportedScenario, AssetError> {
    let file = read_open_scenario(path)?;
    let fault = |reason: String| AssetError::Decode {
        path: path.to_owned(),
        format: "OpenSCENARIO",
        source: DecodeError::Malformed(reason),
    };
    let (map, roads) = read_network(&file.map)?;
    let name = names_of(path.file_stem().map_or("scenario".into(), |stem| {
        stem.to_string_lossy().into_owned()
    }));
    let locator = Locator::new(&map, roads.as_ref(), &file.entities);
    let map_path = std::fs::canonicalize(&file.map).unwrap_or_else(|_| file.map.clone());
    let import = Import {
        file: &file,
        map: &map,
        located: locator.all(),
        locator,
    };
    let (scenario, skipped) = import.scenario(name, &map_path).map_err(fault)?;
    Ok(ImportedScenario {
        scenario,
        map,
        skipped,
    })
}

/// The lanes of a map, and positions on its roads if it is an OpenDRIVE file.
fn read_network(path: &Path) -> Result<(LaneMap, Option<open_drive::RoadPositions>), AssetError> {
    let bytes = read_bytes(path)?;
    if MapFormat::detect(&bytes) != Ok(MapFormat::OpenDrive) {
        return Ok((read_map(path)?, None));
    }
    let (map, roads) =
        open_drive::decode_with_positions(&bytes).map_err(|source| AssetError::Decode {
            path: path.to_owned(),
            format: MapFormat::OpenDrive.name(),
            source,
        })?;
    Ok((map, Some(roads)))
}

/// A file and the places of its entities.
struct Import<'a> {
    file: &'a OpenScenario,
    map: &'a LaneMap,
    locator: Locator<'a>,
    /// Places of the entities at the start, `None` where they are unknown.
    located: Vec<Option<Located>>,
}

impl Import<'_> {
    fn scenario(&self, name: String, map_path: &Path) -> Result<(Scenario, Vec<String>), String> {
        let mut skipped = self.file.skipped.clone();
        let ego = self.ego_index()?;
        let stop_s = self.file.stop_time_s.unwrap_or(Scenario::DURATION_S);
        let stop_s = stop_s.clamp(1.0, DURATION_S_MAX);
        let task = self.ego_task(ego, stop_s, &mut skipped)?;
        let duration_s = (TIME_FACTOR * stop_s + TIME_PLUS_S).min(DURATION_S_MAX);
        let mut scenario = Scenario {
            name,
            level: None,
            seed: 1,
            duration_s,
            step_s: Scenario::STEP_S,
            place: Place::Roads {
                map: map_path.to_owned(),
                probe: None,
                exposure_ev: 0.0,
                background: 1,
                agent_splats: 1,
            },
            ego: task,
            agents: Vec::new(),
            pedestrians: Vec::new(),
            lights: self.lights(&mut skipped),
            signs: self.map.signs.clone(),
        };
        let mut names = UniqueNames::default();
        let mut assets = [0; RoadUser::ALL.len()];
        for (index, entity) in self.file.entities.iter().enumerate() {
            if index == ego {
                continue;
            }
            let Some(located) = &self.located[index] else {
                skipped.push(format!(
                    "{}: it has no position that is on the map",
                    entity.name
                ));
                continue;
            };
            let name = names.give(names_of(entity.name.clone()));
            let asset = &mut assets[entity.kind as usize];
            if entity.kind == RoadUser::Pedestrian {
                let mut walker = self.pedestrian(index, ego, &mut skipped);
                (walker.name, walker.asset) = (name, *asset);
                scenario.pedestrians.push(walker);
            } else if let Some(spot) = self.center(entity, located) {
                let mut agent = self.vehicle(entity, spot);
                (agent.name, agent.asset) = (name, *asset);
                agent.behaviors = self.behaviors(index, ego, &mut skipped);
                scenario.agents.push(agent);
            } else {
                skipped.push(format!("{}: it stands on no driving lane", entity.name));
                continue;
            }
            *asset += 1;
        }
        Ok((scenario, skipped))
    }

    fn ego_index(&self) -> Result<usize, String> {
        let entities = &self.file.entities;
        let is_vehicle = |entity: &&Entity| entity.kind != RoadUser::Pedestrian;
        let named = |name: &str| {
            entities
                .iter()
                .position(|entity| entity.name.eq_ignore_ascii_case(name) && is_vehicle(&entity))
        };
        named("ego")
            .or_else(|| named("hero"))
            .or_else(|| entities.iter().position(|entity| is_vehicle(&entity)))
            .ok_or_else(|| "it has no vehicle; expected one that the planner drives".into())
    }

    /// Middle of a vehicle's box on its lane, or on the lanes after it.
    fn center(&self, entity: &Entity, located: &Located) -> Option<LaneSpot> {
        let spot = located.spot?;
        let at_m = spot.at_m + entity.center_m;
        if at_m < 0.0 {
            return Some(LaneSpot { at_m: 0.0, ..spot });
        }
        Some(straight_on(self.map, LaneSpot { at_m: 0.0, ..spot }, at_m).1)
    }

    fn ego_task(
        &self,
        index: usize,
        stop_s: f64,
        skipped: &mut Vec<String>,
    ) -> Result<EgoTask, String> {
        let entity = &self.file.entities[index];
        let start = self.located[index]
            .as_ref()
            .and_then(|located| self.center(entity, located))
            .ok_or_else(|| {
                format!(
                    "{}: its position is on no driving lane of the map; `decouplegs map` lists the lanes",
                    entity.name
                )
            })?;
        let mut route = entity.route.as_slice();
        for event in &entity.events {
            match &event.action {
                Action::Path(path) if route.is_empty() => route = path,
                _ => skipped.push(format!(
                    "line {}: the planner drives {}, so its action is skipped",
                    event.line, entity.name
                )),
            }
        }
        let speed_mps = self.speed_mps(index).clamp(0.0, 100.0);
        let cruise_mps = if speed_mps >= CRUISE_MPS_MIN {
            speed_mps
        } else {
            let limit_mps = self.map.lanes[start.lane].speed_limit_mps;
            limit_mps.unwrap_or(CRUISE_MPS).min(100.0)
        };
        let (mut lanes, mut end) = (vec![start.lane], start);
        for waypoint in route {
            let spot = self
                .locator
                .locate(waypoint, &self.located)
                .and_then(|located| located.spot)
                .ok_or_else(|| format!("{}: a waypoint is on no driving lane", entity.name))?;
            let onward = lanes_between(self.map, end, spot).ok_or_else(|| {
                let id = |spot: LaneSpot| &self.map.lanes[spot.lane].id;
                format!(
                    "{}: no way leads from lane {} to its waypoint on lane {}",
                    entity.name,
                    id(end),
                    id(spot)
                )
            })?;
            lanes.extend(onward.into_iter().skip(1));
            end = spot;
        }
        if route.is_empty() {
            let travel_m = cruise_mps * stop_s;
            (lanes, end) = straight_on(self.map, start, travel_m);
        }
        Ok(EgoTask {
            route: lanes
                .iter()
                .map(|&lane| self.map.lanes[lane].id.clone())
                .collect(),
            start_m: start.at_m,
            end_m: end.at_m,
            speed_mps,
            cruise_mps,
            size: entity.size,
            follows_recording: false,
        })
    }

    /// A vehicle without name, asset and behaviors.
    fn vehicle(&self, entity: &Entity, spot: LaneSpot) -> TrafficAgent {
        let speed_mps = self.speed_of(entity.speed.as_ref()).clamp(0.0, 70.0);
        TrafficAgent {
            name: String::new(),
            kind: entity.kind,
            asset: 0,
            size: entity.size,
            lane: self.map.lanes[spot.lane].id.clone(),
            at_m: spot.at_m,
            speed_mps,
            cruise_mps: Some(speed_mps),
            driver: DriverKind::Normal,
            changes_lanes: false,
            behaviors: Vec::new(),
        }
    }

    /// Speed of an entity at the start, m/s.
    fn speed_mps(&self, index: usize) -> f64 {
        self.speed_of(self.file.entities[index].speed.as_ref())
    }

    /// A target speed, m/s; relative to the speed that the other has at the start.
    fn speed_of(&self, speed: Option<&TargetSpeed>) -> f64 {
        match speed {
            None => 0.0,
            Some(TargetSpeed::Absolute(speed_mps)) => *speed_mps,
            Some(TargetSpeed::Relative {
                entity,
                factor,
                plus_mps,
            }) => {
                let other = self.locator.find(entity);
                match other.and_then(|other| self.file.entities[other].speed.as_ref()) {
                    Some(TargetSpeed::Absolute(speed_mps)) => speed_mps * factor + plus_mps,
                    _ => *plus_mps,
                }
            }
        }
    }

    /// Lights of the map with the phases of the file. Without phases there, the map's own count.
    fn lights(&self, skipped: &mut Vec<String>) -> Vec<TrafficLight> {
        let signals = self.file.signals.iter();
        let by_id: HashMap<&str, &SignalPhases> = signals
            .map(|signal| (signal.signal.as_str(), signal))
            .collect();
        let mut lights = Vec::new();
        for light in &self.map.lights {
            match by_id.get(light.name.as_str()) {
                Some(signal) => lights.push(TrafficLight {
                    phases: signal.phases.clone(),
                    offset_s: signal.offset_s,
                    ..light.clone()
                }),
                None if light.phases.is_empty() => skipped.push(format!(
                    "the traffic light {} has no phases: vehicles ignore it",
                    light.name
                )),
                None => lights.push(light.clone()),
            }
        }
        lights.retain(|light| !light.stop_lines.is_empty());
        lights
    }
}

/// Letters of a name that scenarios can have.
fn names_of(text: String) -> String {
    let letter = |letter: char| match letter {
        'a'..='z' | 'A'..='Z' | '0'..='9' | '-' | '_' => letter,
        _ => '_',
    };
    let name: String = text.chars().map(letter).take(80).collect();
    if name.is_empty() { "_".into() } else { name }
}

/// Names of which no two are the same.
#[derive(Default)]
struct UniqueNames {
    taken: HashSet<String>,
    /// Number that the next equal name tries first: many equal names take linear time.
    next_number: HashMap<String, u32>,
}

impl UniqueNames {
    /// `name`, with a number where it is taken.
    fn give(&mut self, name: String) -> String {
        let number = self.next_number.entry(name.clone()).or_insert(1);
        loop {
            let candidate = match *number {
                1 => name.clone(),
                number => format!("{name}_{number}"),
            };
            *number += 1;
            if self.taken.insert(candidate.clone()) {
                return candidate;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_get_numbers_in_linear_time() {
        let mut names = UniqueNames::default();
        let given = ["a", "a_2", "a", "a", "b"].map(|name| names.give(name.into()));
        assert_eq!(given, ["a", "a_2", "a_3", "a_4", "b"]);
        // Trying all numbers for each name would take hours.
        let last = (0..300_000).map(|_| names.give("c".into())).last();
        assert_eq!(last.as_deref(), Some("c_300000"));
    }
}
