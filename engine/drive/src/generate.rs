//! Generator of the scenarios of a level: start and route of the ego, other vehicles, light, and
//! disturbances.
//!
//! Everything follows from a seed and an index. Numbers are round (centimeters, tenths of a meter a
//! second), so that a person can read and change what comes out. At the start
//! - no vehicles overlap, and each is wholly on one lane and off all places where other lanes cross
//!   or merge;
//! - all vehicles can stop: behind the vehicle ahead if that brakes as hard as it can, with a
//!   second to react; before a crossing where others go first; before the end of a road;
//! - the ego's route is some 100 to 180 m, shorter where lanes end or allow less, and takes 13 s at
//!   most on a free road; where no such route is, as on car parks, it is driven at the limit of its
//!   slowest lane, for 75 s at most;
//! - from Medium on a slower vehicle drives 15 to 40 m ahead of the ego, so that keeping one's
//!   speed is not enough.

mod behaviors;
mod ego_start;
mod light;
mod lights;
mod placement;
mod random;
mod reference;
mod road_users;
mod roads;
mod rules;
mod safe_speed;

use std::sync::Arc;

use decouplegs_scene::scenario::{Drivers, EgoTask, TrafficAgent};
use decouplegs_scene::{
    Egos, Invalid, LaneMap, Level, Scenario, Story, TrafficLight, TrafficSign, VehicleSize,
    VehicleState,
};
use glam::DVec2;

pub use ego_start::Area;
pub use light::{PlaceOptions, Sky};
pub use road_users::RoadUserAsset;
pub use rules::{Difficulty, NEAR_M, agents_near, weathers};

use crate::obstacles::Obstacles;
use crate::other_egos::with_egos;
use crate::road_graph::RoadGraph;
use crate::traffic::{Traffic, TrafficError};
use crate::view_support::ViewSupport;
use ego_start::{EgoStart, Wishes};
use placement::Placement;
use random::Stream;
use road_users::Assets;
use roads::Roads;
use rules::LevelRequirements;

/// Number of starts of the ego that are tried.
const TRIES: u64 = 240;
/// Number of tries with all wishes of the level, and the least number before a crossing is given
/// up.
const TRIES_WITH_ALL: u64 = 100;
const TRIES_BEFORE_CROSSING: u64 = 180;
/// The synthetic street shows details within this of its origin, and little beyond, meters.
const STREET_RADIUS_M: f64 = 105.0;

/// Random stream of a scenario's numbers, by use.
const FOR_LIGHT: u64 = 0;
const FOR_TRAFFIC: u64 = 1;
const FOR_TRIES: u64 = 2;
const FOR_LIGHTS: u64 = 3;
const FOR_PEDESTRIANS: u64 = 4;
const FOR_REPLACEMENTS: u64 = 5;

/// Reason why no scenario can be generated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum GenerateError {
    /// The map, or the size of an asset, cannot be used.
    #[error("no scenarios can be made: {0}")]
    Roads(String),
    /// No assets were given.
    #[error(
        "no scenarios can be made without assets for agents to show; expected the size of at least one"
    )]
    NoAssets,
    /// The ego finds no way.
    #[error(
        "scenario {name}: in {tries} tries no place was found where an ego can start and drive on for {least_m} m at 3 km/h or more; expected longer {}",
        if *is_limited { "driving lanes along the views that the scene was seen from (`seen_from` in its [recording])" } else { "driving lanes" }
    )]
    NoRoute {
        /// Name of the scenario.
        name: String,
        /// Number of starts that were tried.
        tries: u64,
        /// Least length of a route, meters.
        least_m: f64,
        /// True if routes are limited to where the place was seen from.
        is_limited: bool,
    },
    /// Too few agents fit.
    #[error(
        "scenario {name}: expected {least} to {most} agents within 50 m of the ego, all with room to stop; found room for {found} at most, \
         in {tries} tries; take a larger map or an easier level"
    )]
    NoRoom {
        /// Name of the scenario.
        name: String,
        /// Least number of agents of the level.
        least: usize,
        /// Largest number of agents of the level.
        most: usize,
        /// The most that were put near an ego with room for all to stop.
        found: usize,
        /// Number of starts that were tried.
        tries: u64,
    },
}

/// Makes scenarios in one place.
pub struct Generator<'a> {
    roads: Roads<'a>,
    place: PlaceOptions,
    area: Option<Area>,
    assets: Assets,
    has_lights: bool,
    difficulty: Difficulty,
}

impl<'a> Generator<'a> {
    /// A generator for `place`, whose lanes are `map` and whose agents show `assets` of these
    /// sizes, in the order of [`TrafficAgent::asset`]. Egos on the synthetic street stay where it
    /// has details.
    ///
    /// # Errors
    /// [`GenerateError::Roads`] and [`GenerateError::NoAssets`].
    pub fn new(
        map: &'a LaneMap,
        place: PlaceOptions,
        assets: &[VehicleSize],
    ) -> Result<Self, GenerateError> {
        if assets.is_empty() {
            return Err(GenerateError::NoAssets);
        }
        assets.iter().try_for_each(check_size)?;
        let largest = largest(assets.iter().copied());
        let roads = Roads::new(map, largest).map_err(GenerateError::Roads)?;
        let street = matches!(place, PlaceOptions::Street { .. });
        let area = street.then_some(Area {
            center_m: DVec2::ZERO,
            radius_m: STREET_RADIUS_M,
        });
        Ok(Self {
            roads,
            place,
            area,
            assets: Assets::cars(assets),
            has_lights: true,
            difficulty: Difficulty::default(),
        })
    }

    /// Limits routes to those that start and end within `area`: where a captured scene has been
    /// seen.
    #[must_use]
    pub fn within(self, area: Area) -> Self {
        Self {
            area: Some(area),
            ..self
        }
    }

    /// Limits routes to places and headings from which a captured scene was seen.
    #[must_use]
    pub fn seen_from(mut self, support: Arc<ViewSupport>) -> Self {
        self.roads.limit_to(support);
        self
    }

    /// Adds trucks, buses, cyclists and pedestrians that show `assets`, among `obstacles`, into
    /// which no pedestrian walks.
    ///
    /// # Errors
    /// [`GenerateError::Roads`].
    pub fn with_road_users(
        mut self,
        assets: &[RoadUserAsset],
        obstacles: Arc<Obstacles>,
    ) -> Result<Self, GenerateError> {
        assets
            .iter()
            .try_for_each(|asset| check_size(&asset.size))?;
        self.assets.mixed(assets, obstacles);
        let largest = largest(self.assets.vehicle_sizes());
        let has_lights = self.has_lights;
        let support = self.roads.support();
        self.roads = Roads::new(self.roads.map, largest).map_err(GenerateError::Roads)?;
        if let Some(support) = support {
            self.roads.limit_to(support);
        }
        if !has_lights {
            self.roads.ignore_lights();
        }
        Ok(self)
    }

    /// Takes parts of the difficulty from other levels than a scenario's own.
    #[must_use]
    pub fn with_difficulty(self, difficulty: Difficulty) -> Self {
        Self { difficulty, ..self }
    }

    /// Leaves out the traffic lights of the map.
    #[must_use]
    pub fn without_lights(mut self) -> Self {
        self.has_lights = false;
        self.roads.ignore_lights();
        self
    }

    /// Scenario `index` of `level`, called for instance `hard_0007`.
    ///
    /// # Errors
    /// [`GenerateError::NoRoute`] and [`GenerateError::NoRoom`], where the map is too small for the
    /// level.
    pub fn scenario(&self, level: Level, seed: u64, index: u32) -> Result<Scenario, GenerateError> {
        self.scenario_instead(level, seed, index, 0)
    }

    /// Scenario `replacement` of those that may stand in the place of scenario `index` of `level`,
    /// under its name. The one with the number 0 is that scenario itself.
    ///
    /// # Errors
    /// The errors of [`Self::scenario`].
    pub fn scenario_instead(
        &self,
        level: Level,
        seed: u64,
        index: u32,
        replacement: u32,
    ) -> Result<Scenario, GenerateError> {
        let of_level = Stream::new(seed).split(level as u64);
        let own = of_level.split(u64::from(index));
        let stream = match replacement {
            0 => own,
            _ => own.split(FOR_REPLACEMENTS).split(u64::from(replacement)),
        };
        self.generate(level, format!("{}_{index:04}", level.name()), &stream)
    }

    /// `scenario` with `count` egos: cars of its traffic become egos, whose routes stay where this
    /// generator's routes stay.
    ///
    /// # Errors
    /// The errors of [`with_egos`].
    pub fn with_egos(&self, scenario: &Scenario, count: usize) -> Result<Scenario, Invalid> {
        with_egos(scenario, self.roads.map, count, &|route| {
            let in_area_m = self.area.map_or(f64::INFINITY, |area| area.along_m(route));
            in_area_m.min(self.roads.seen_m(route))
        })
    }

    /// The scenario `name` of `level` that the random numbers of `stream` make.
    fn generate(
        &self,
        level: Level,
        name: String,
        stream: &Stream,
    ) -> Result<Scenario, GenerateError> {
        let rules = LevelRequirements::new(level, self.difficulty);
        let (least, most) = rules.near;
        let (mut found, mut routes) = (0, 0_u32);
        // Places without a route at the speeds of towns are tried again at any speed.
        for number in 0..2 * TRIES {
            if number >= TRIES && routes > 0 {
                break;
            }
            let random = stream.split(FOR_TRIES).split(number);
            let wishes = self.wishes(number);
            let Some(start) =
                ego_start::choose(&self.roads, self.area, &rules, &random.split(0), wishes)
            else {
                continue;
            };
            routes += 1;
            let placement =
                Placement::new(&self.roads, &rules, &start, &self.assets, random.split(1));
            let vehicles = match placement.fill((least, most)) {
                Ok(vehicles) => vehicles,
                Err(placement::TooFew(near)) => {
                    found = found.max(near);
                    continue;
                }
            };
            let mut agents =
                behaviors::agents(self.roads.map, &rules, &start, &vehicles, &random.split(2));
            // Short enough to be read, and a whole number in any format.
            let traffic_seed = stream.split(FOR_TRAFFIC).bits() >> 32;
            if self.assets.are_mixed() {
                let near = self.fit(&mut agents, &start, traffic_seed);
                if near < least {
                    found = found.max(near);
                    continue;
                }
            }
            if !self.begins_as_told(&agents, traffic_seed) {
                continue;
            }
            let lights = self.lights(&mut stream.split(FOR_LIGHTS));
            return Ok(Scenario {
                name,
                level: Some(level),
                seed: traffic_seed,
                drivers: Drivers::default(),
                duration_s: rules.time.budget_s(reference::with_lights(
                    &self.roads,
                    &start,
                    &lights,
                )),
                step_s: Scenario::STEP_S,
                place: self.place.lit_for(level, &mut stream.split(FOR_LIGHT)),
                agents,
                pedestrians: self.assets.pedestrians(
                    &self.roads,
                    &rules,
                    &start,
                    &mut stream.split(FOR_PEDESTRIANS),
                ),
                signs: self.signs(&lights),
                story: Story::default(),
                lights,
                egos: Egos::default(),
                ego: EgoTask {
                    speed_mps: vehicles[0].speed_mps,
                    ..start.task
                },
            });
        }
        Err(match routes {
            0 => GenerateError::NoRoute {
                name,
                tries: 2 * TRIES,
                least_m: ego_start::route_m_min(self.roads.is_limited()),
                is_limited: self.roads.is_limited(),
            },
            _ => GenerateError::NoRoom {
                name,
                least,
                most,
                found,
                tries: TRIES,
            },
        })
    }

    /// Wishes for a start of a number: fewer the more were tried.
    fn wishes(&self, number: u64) -> Wishes {
        let turn = number % TRIES;
        Wishes {
            crossing: turn < TRIES_BEFORE_CROSSING,
            beside: turn < TRIES_WITH_ALL && self.roads.has_lanes_beside,
            slow: number >= TRIES,
        }
    }

    /// Removes agents that traffic does not accept, and lowers the speeds of others to those that
    /// it accepts, but never those of the vehicle ahead of the ego. Long vehicles make crossings
    /// long: a vehicle between two ways over a crossing could not leave it. Returns the number of
    /// agents within [`NEAR_M`] of the ego.
    fn fit(&self, agents: &mut Vec<TrafficAgent>, start: &EgoStart, seed: u64) -> usize {
        let ego_m = start.route.pose_at(0.0).0.truncate();
        loop {
            match Traffic::new(self.roads.graph.clone(), agents, seed) {
                Ok(traffic) => {
                    for (agent, state) in agents.iter_mut().zip(traffic.states()) {
                        if let Some(state) = state.filter(|_| agent.name != behaviors::LEAD) {
                            agent.speed_mps = agent.speed_mps.min(down_to_tenth(state.speed_mps));
                        }
                    }
                    let places = traffic.states().iter().flatten();
                    let is_near =
                        |state: &&VehicleState| state.position_m.distance(ego_m) <= NEAR_M;
                    return places.filter(is_near).count();
                }
                Err(TrafficError::Overlap { first, second }) => {
                    let leaves = if second == behaviors::LEAD {
                        first
                    } else {
                        second
                    };
                    agents.retain(|agent| agent.name != leaves);
                }
                Err(_) => return 0,
            }
        }
    }

    /// Programs of the lights of the map, or none where they are left out.
    fn lights(&self, random: &mut Stream) -> Vec<TrafficLight> {
        match self.has_lights {
            true => lights::programs(self.roads.map, &self.roads.graph, random),
            false => Vec::new(),
        }
    }

    /// Signs of the map on lanes without a traffic light: others count where lights are out.
    fn signs(&self, lights: &[TrafficLight]) -> Vec<TrafficSign> {
        let lines = || lights.iter().flat_map(|light| &light.stop_lines);
        let has_light = |sign: &TrafficSign| lines().any(|line| line.lane == sign.line.lane);
        let signs = self.roads.map.signs.iter();
        signs
            .filter(|sign| !has_light(sign))
            .map(|sign| {
                let mut sign = sign.clone();
                sign.line.at_m = to_centimeter(sign.line.at_m);
                sign
            })
            .collect()
    }

    /// True if traffic accepts the agents at their positions and speeds: it checks more of
    /// crossings than the generator.
    fn begins_as_told(&self, agents: &[TrafficAgent], seed: u64) -> bool {
        let traffic = Traffic::new(self.roads.graph.clone(), agents, seed);
        let as_fast = |(state, agent): (&VehicleState, &TrafficAgent)| {
            (state.speed_mps - agent.speed_mps).abs() < 1e-6
        };
        traffic.is_ok_and(|traffic| traffic.states().iter().flatten().zip(agents).all(as_fast))
    }
}

fn check_size(size: &VehicleSize) -> Result<(), GenerateError> {
    if is_a_vehicle(size) {
        return Ok(());
    }
    let [length_m, width_m, height_m] = size.to_array();
    Err(GenerateError::Roads(format!(
        "an asset is {length_m} by {width_m} by {height_m} m; expected 0.5 to 25 by 0.3 to 4 by 0.1 to 10 m"
    )))
}

/// The least box that holds all of `sizes` and a car.
fn largest(sizes: impl Iterator<Item = VehicleSize>) -> VehicleSize {
    sizes.fold(RoadGraph::VEHICLE, |largest, size| VehicleSize {
        length_m: largest.length_m.max(size.length_m),
        width_m: largest.width_m.max(size.width_m),
        height_m: largest.height_m.max(size.height_m),
    })
}

/// True if traffic takes an agent of this size.
fn is_a_vehicle(size: &VehicleSize) -> bool {
    (0.5..=25.0).contains(&size.length_m)
        && (0.3..=4.0).contains(&size.width_m)
        && (0.1..=10.0).contains(&size.height_m)
}

fn to_centimeter(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

fn to_tenth(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

/// Rounded so that what was safe stays safe.
fn down_to_tenth(value: f64) -> f64 {
    // A speed that came out of rounding is itself again.
    ((value.max(0.0) * 10.0 + 1e-6).floor()) / 10.0
}
