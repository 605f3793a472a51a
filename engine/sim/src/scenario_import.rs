//! Scenarios from OpenSCENARIO files.
//!
//! The ego is the entity named `Ego` or `Hero` (any case), otherwise the one whose property `type`
//! is `ego_vehicle`, otherwise the first vehicle on a driving lane; the planner drives it, so its
//! own actions other than a route are skipped. Its route is the shortest way through the waypoints
//! of its route that lie ahead of it, otherwise straight on, as far as it drives at its cruise
//! speed until the file's stop time (20 s if it has none).
//! The others do what the file says, and nothing else: they are the actors of a story.

mod actions;
mod cast;
mod lights;
mod locate;
mod map_search;
mod story;
#[cfg(test)]
mod story_tests;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::path::Path;

use decouplegs_asset::maps::{MapFormat, open_drive};
use decouplegs_asset::{AssetError, DecodeError, read_bytes, read_map};
use decouplegs_drive::route::{LaneSpot, lanes_between, straight_on};
use decouplegs_logs::open_scenario::{Action, Entity, OpenScenario, Position, TargetSpeed};
use decouplegs_logs::read_open_scenario;
use decouplegs_logs::scenario_file::DURATION_S_MAX;
use decouplegs_scene::scenario::{Drivers, EgoTask, Place};
use decouplegs_scene::story::{Actor, Dynamics, Who};
use decouplegs_scene::{Egos, LaneMap, Obstacle, ObstacleKind, RoadUser, Scenario, Story};
use glam::DVec2;

use self::locate::{Located, Locator, Place as Found};
use self::story::Counts;
use crate::names::{UniqueNames, scenario_name};

/// A scenario, and what of its file it does not express.
#[derive(Clone, Debug)]
pub struct ImportedScenario {
    /// The scenario. Its place is the map by its whole path, with one splat: their number is not in
    /// the file.
    pub scenario: Scenario,
    /// Lanes of its map.
    pub map: LaneMap,
    /// Objects of the file that stand, which are to be obstacles of the place.
    pub obstacles: Vec<Obstacle>,
    /// Name of the entity that the planner drives.
    pub ego: String,
    /// Number of the storyboard's events that are about others than the ego, and have an effect
    /// here.
    pub events: usize,
    /// Number of those of which each action is driven.
    pub events_driven: usize,
    /// Number of events about others that do nothing which is shown here, as lamps.
    pub events_unseen: usize,
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

/// Reads the OpenSCENARIO file at `path` and its map, or `map` instead, and makes a scenario of
/// them.
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`], or [`AssetError::Decode`] with the element
/// at fault.
pub fn import_open_scenario(
    path: &Path,
    map: Option<&Path>,
) -> Result<ImportedScenario, AssetError> {
    let file = read_open_scenario(path)?;
    let fault = |reason: String| AssetError::Decode {
        path: path.to_owned(),
        format: "OpenSCENARIO",
        source: DecodeError::Malformed(reason),
    };
    let map_file = map
        .or(file.map.as_deref())
        .ok_or_else(|| fault("it names no map (<LogicFile>); give one with --map".into()))?;
    let found = match map {
        None if !map_file.exists() => Some(map_search::above(path, map_file).ok_or_else(|| {
            fault(format!(
                "its map {} is not there; give another with --map",
                map_file.display()
            ))
        })?),
        _ => None,
    };
    let named_map = map_file;
    let map_file = found.as_deref().unwrap_or(map_file);
    let (map, roads) = read_network(map_file)?;
    let name = scenario_name(&path.file_stem().map_or("scenario".into(), |stem| {
        stem.to_string_lossy().into_owned()
    }));
    let locator = Locator::new(&map, roads.as_ref(), &file.entities);
    let map_path = std::fs::canonicalize(map_file).unwrap_or_else(|_| map_file.to_owned());
    let located = locator.all();
    let import = Import {
        file: &file,
        map: &map,
        ego: ego_index(&file.entities, &located).map_err(&fault)?,
        located,
        locator,
    };
    let read = import.scenario(name, &map_path).map_err(fault)?;
    let (scenario, obstacles, mut skipped, counts) = read;
    if found.is_some() {
        skipped.push(format!(
            "its map {} is not there: {} is read instead",
            named_map.display(),
            map_path.display()
        ));
    }
    let ego = file.entities[import.ego].name.clone();
    Ok(ImportedScenario {
        scenario,
        map,
        obstacles,
        ego,
        events: counts.events,
        events_driven: counts.driven,
        events_unseen: counts.unseen,
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
    located: Vec<Found>,
    /// Index of the entity that the planner drives.
    ego: usize,
}

impl Import<'_> {
    fn scenario(
        &self,
        name: String,
        map_path: &Path,
    ) -> Result<(Scenario, Vec<Obstacle>, Vec<String>, Counts), String> {
        let mut skipped = self.file.skipped.clone();
        let ego = self.ego;
        let stop_s = self.file.stop_time_s.unwrap_or(Scenario::DURATION_S);
        let stop_s = stop_s.clamp(1.0, DURATION_S_MAX);
        let task = self.ego_task(ego, stop_s, &mut skipped)?;
        let duration_s = (TIME_FACTOR * stop_s + TIME_PLUS_S).min(DURATION_S_MAX);
        let mut scenario = Scenario {
            name,
            level: None,
            seed: 1,
            drivers: Drivers::default(),
            duration_s,
            step_s: Scenario::STEP_S,
            place: Place::Roads {
                map: map_path.to_owned(),
                probe: None,
                exposure_ev: 0.0,
                air: self.air(),
                obstacles: None,
                background: 1,
                agent_splats: 1,
            },
            ego: task,
            egos: Egos::default(),
            agents: Vec::new(),
            pedestrians: Vec::new(),
            lights: self.lights(&mut skipped),
            signs: self.map.signs.clone(),
            story: Story::default(),
        };
        let mut obstacles = Vec::new();
        let mut names = UniqueNames::default();
        let mut assets = [0; RoadUser::ALL.len()];
        let (mut actors, mut whos) = (Vec::new(), HashMap::from([(ego, Who::EGO)]));
        for (index, entity) in self.file.entities.iter().enumerate() {
            if index == ego {
                continue;
            }
            let added = self.added(entity);
            let located = match (&self.located[index], &added) {
                (Ok(located), _) | (Err(_), Some(located)) => located,
                (Err(reason), None) => {
                    skipped.push(format!("{}: it is left out: {reason}", entity.name));
                    continue;
                }
            };
            let Some(kind) = entity.kind else {
                let ahead = DVec2::from_angle(located.heading_rad);
                obstacles.push(Obstacle {
                    kind: ObstacleKind::Captured,
                    center_m: located.point_m + entity.center_m * ahead,
                    yaw_rad: located.heading_rad,
                    length_m: entity.size.length_m,
                    width_m: entity.size.width_m,
                });
                continue;
            };
            let asset = &mut assets[kind as usize];
            whos.insert(index, Who(actors.len() + 1));
            actors.push(Actor {
                name: names.give(scenario_name(&entity.name)),
                asset: *asset,
                is_hidden: self.located[index].is_err(),
                ..self.actor(index, kind, located)
            });
            *asset += 1;
        }
        let (story, counts) = self.story(actors, &whos, &scenario.lights, &mut skipped);
        scenario.story = story;
        Ok((scenario, obstacles, skipped, counts))
    }

    /// The place where an entity without one at the start is added to the episode.
    fn added(&self, entity: &Entity) -> Option<Located> {
        let tasks = self.file.events.iter().flat_map(|event| &event.tasks);
        let mut own = tasks.filter(|task| task.actor == entity.name);
        let is_added = own.clone().any(|task| task.action == Action::Show(true));
        own.find_map(|task| match &task.action {
            Action::Teleport(place) if is_added => self.locator.locate(place, &self.located).ok(),
            _ => None,
        })
    }

    /// An actor without name and asset.
    fn actor(&self, index: usize, kind: RoadUser, located: &Located) -> Actor {
        let entity = &self.file.entities[index];
        // A change of speed at the start begins from a stand.
        let changes = self.file.init.iter().any(|task| {
            let is_change = |dynamics: &Dynamics| *dynamics != Dynamics::STEP;
            task.actor == entity.name
                && matches!(&task.action, Action::Speed { dynamics, .. } if is_change(dynamics))
        });
        Actor {
            name: String::new(),
            kind,
            asset: 0,
            size_m: entity.size.to_array(),
            center_m: entity.center_m,
            point_m: located.point_m.to_array(),
            heading_rad: located.heading_rad,
            lane: located
                .lane
                .map(|spot| self.map.lanes[spot.lane].id.clone()),
            speed_mps: if changes { 0.0 } else { self.speed_mps(index) },
            is_hidden: false,
            limits: entity.limits,
        }
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
        let located = self.located[index]
            .as_ref()
            .map_err(|reason| format!("{}: it cannot start: {reason}", entity.name))?;
        let start = self.center(entity, located).ok_or_else(|| {
            format!(
                "{}: its position is on no driving lane of the map; `decouplegs map` lists the lanes",
                entity.name
            )
        })?;
        if located.is_against(&self.locator.index) {
            skipped.push(format!(
                "{}: it heads against the direction of its lane; it starts along it",
                entity.name
            ));
        }
        let route = self.ego_route(entity, skipped);
        let speed_mps = self.speed_mps(index).clamp(0.0, 100.0);
        let cruise_mps = if speed_mps >= CRUISE_MPS_MIN {
            speed_mps
        } else {
            let limit_mps = self.map.lanes[start.lane].speed_limit_mps;
            limit_mps.unwrap_or(CRUISE_MPS).min(100.0)
        };
        let (mut lanes, mut end) = (vec![start.lane], start);
        for waypoint in route {
            let place = self
                .locator
                .locate(waypoint, &self.located)
                .map_err(|reason| format!("{}: a waypoint of its route: {reason}", entity.name))?;
            let Some(spot) = place.spot else {
                skipped.push(format!(
                    "{}: a waypoint of its route is on no driving lane; it is left out",
                    entity.name
                ));
                continue;
            };
            // A route may begin where the ego starts, or behind it.
            if end == start && self.is_passed(start, spot) || spot == end {
                continue;
            }
            let onward = self.way_to(end, spot).ok_or_else(|| {
                let id = |spot: LaneSpot| &self.map.lanes[spot.lane].id;
                format!(
                    "{}: no way leads from lane {} to its waypoint on lane {}",
                    entity.name,
                    id(end),
                    id(spot)
                )
            })?;
            lanes.extend(onward.0.into_iter().skip(1));
            end = onward.1;
        }
        if end == start {
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
            start_pose: None,
        })
    }

    /// Waypoints of the ego: those that it has at the start, or the first that it gets.
    fn ego_route(&self, ego: &Entity, skipped: &mut Vec<String>) -> &[Position] {
        let mut route: &[Position] = &self.file.entities[self.ego].route;
        for task in self.file.events.iter().flat_map(|event| &event.tasks) {
            match &task.action {
                _ if task.actor != ego.name => {}
                Action::Route(points) | Action::Follow { points, .. } if route.is_empty() => {
                    route = points;
                }
                Action::Unseen => {}
                _ => skipped.push(format!(
                    "line {}: the planner drives {}, so its action is skipped",
                    task.line, ego.name
                )),
            }
        }
        route
    }

    /// True if `spot` lies on the way that leads to `start`, nearer than any way from there.
    fn is_passed(&self, start: LaneSpot, spot: LaneSpot) -> bool {
        let length_m = |from: LaneSpot, to: LaneSpot| -> Option<f64> {
            let lanes = lanes_between(self.map, from, to)?;
            let before = lanes[..lanes.len() - 1].windows(1).zip(&lanes[1..]);
            let lanes_m: f64 = before
                .filter(|(lane, next)| self.map.lanes[lane[0]].successors.contains(next))
                .map(|(lane, _)| self.locator.length_m(lane[0]))
                .sum();
            Some(lanes_m + to.at_m - from.at_m)
        };
        if spot.lane == start.lane && spot.at_m <= start.at_m {
            return true;
        }
        match (length_m(spot, start), length_m(start, spot)) {
            (Some(behind_m), Some(ahead_m)) => behind_m < ahead_m,
            (behind_m, _) => behind_m.is_some(),
        }
    }

    /// Lanes to `to`, and its place; to a lane beside it, also of the other direction, where no way
    /// leads to its own.
    fn way_to(&self, from: LaneSpot, to: LaneSpot) -> Option<(Vec<usize>, LaneSpot)> {
        // A lane beside, changed to at once, leads no way back.
        let leads = |lanes: &Vec<usize>, to: LaneSpot| {
            let mut pairs = lanes.windows(2);
            pairs.any(|pair| self.map.lanes[pair[0]].successors.contains(&pair[1]))
                || to.at_m > from.at_m
        };
        let way = |to: LaneSpot| lanes_between(self.map, from, to).filter(|lanes| leads(lanes, to));
        if let Some(lanes) = way(to) {
            return Some((lanes, to));
        }
        let beside = self.locator.lanes_beside(to).into_iter();
        beside
            .filter_map(|spot| Some((way(spot)?, spot)))
            .min_by_key(|(lanes, _)| lanes.len())
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
                ..
            }) => {
                let other = self.locator.find(entity);
                match other.and_then(|other| self.file.entities[other].speed.as_ref()) {
                    Some(TargetSpeed::Absolute(speed_mps)) => speed_mps * factor + plus_mps,
                    _ => *plus_mps,
                }
            }
        }
    }
}

/// Index of the entity that the planner drives.
fn ego_index(entities: &[Entity], located: &[Found]) -> Result<usize, String> {
    let is_vehicle =
        |entity: &&Entity| entity.kind.is_some_and(|kind| kind != RoadUser::Pedestrian);
    let named = |name: &str| {
        entities
            .iter()
            .position(|entity| entity.name.eq_ignore_ascii_case(name) && is_vehicle(&entity))
    };
    named("ego")
        .or_else(|| named("hero"))
        .or_else(|| {
            let mut entities = entities.iter();
            entities.position(|entity| entity.is_ego && is_vehicle(&entity))
        })
        .or_else(|| {
            // The planner needs a lane: a vehicle beside the road is the last choice.
            let mut placed = entities.iter().zip(located);
            placed.position(|(entity, located)| {
                is_vehicle(&entity) && located.as_ref().is_ok_and(|place| place.spot.is_some())
            })
        })
        .or_else(|| entities.iter().position(|entity| is_vehicle(&entity)))
        .ok_or_else(|| "it has no vehicle; expected one that the planner drives".into())
}
