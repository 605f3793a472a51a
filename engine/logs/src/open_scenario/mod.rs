//! ASAM OpenSCENARIO XML (`.xosc`, versions 1.0 to 1.3): the part of a file that scenarios here can
//! express.
//!
//! Read are parameters with their default values, the road network's file, phases of traffic
//! signals, vehicles and pedestrians with their boxes (also from catalogs), and from the
//! storyboard: positions, speeds, routes, trajectories of pedestrians, changes of speed and lane,
//! and triggers by time or by the distance of two entities. Everything else is listed in
//! [`OpenScenario::skipped`], one sentence per element, with its line.
//!
//! The reader is our own: the crate `openscenario-rs` is under the GPL, which this project is not.
//!
//! Values and units are those of the file: meters, seconds, radians. The reference point of an
//! entity is the center of its rear axle; [`Entity::center_m`] is the way from there to the middle
//! of its box.

mod entities;
mod parameters;
mod positions;
mod signals;
mod story;

use std::path::{Path, PathBuf};

use decouplegs_scene::{LightPhase, RoadUser, VehicleSize};

use decouplegs_asset::read_bytes;
use decouplegs_asset::xml::{self, Element};
use decouplegs_asset::{AssetError, DecodeError};

pub use positions::Position;

/// Content of an OpenSCENARIO file.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenScenario {
    /// File of the road network.
    pub map: PathBuf,
    /// Vehicles and pedestrians, in the order of the file.
    pub entities: Vec<Entity>,
    /// Phases of the map's traffic signals.
    pub signals: Vec<SignalPhases>,
    /// Time at which the storyboard stops, seconds.
    pub stop_time_s: Option<f64>,
    /// Elements that were not read or could not be expressed, one sentence each.
    pub skipped: Vec<String>,
}

/// Phases of a traffic signal, repeated from time 0 on.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalPhases {
    /// Id of the signal in the map.
    pub signal: String,
    /// Colors and their durations.
    pub phases: Vec<LightPhase>,
    /// Position in the cycle at time 0, seconds.
    pub offset_s: f64,
}

/// A vehicle or pedestrian.
#[derive(Clone, Debug, PartialEq)]
pub struct Entity {
    /// Name in the file.
    pub name: String,
    /// Kind of road user.
    pub kind: RoadUser,
    /// Size of the box.
    pub size: VehicleSize,
    /// Offset from the reference point to the middle of the box, meters forward.
    pub center_m: f64,
    /// Position at the start; `None` if the file gives none.
    pub position: Option<Position>,
    /// Speed at the start; `None` if the file gives none.
    pub speed: Option<TargetSpeed>,
    /// Waypoints of its route, the start not included; empty if the file gives none.
    pub route: Vec<Position>,
    /// Actions of the storyboard, in the order of the file.
    pub events: Vec<Event>,
}

/// An action and its trigger.
#[derive(Clone, Debug, PartialEq)]
pub struct Event {
    /// Line of the action in the file, from 1.
    pub line: u32,
    /// Condition that starts it.
    pub trigger: EventTrigger,
    /// Action of the entity.
    pub action: Action,
}

/// Condition that starts an action.
#[derive(Clone, Debug, PartialEq)]
pub enum EventTrigger {
    /// Time after the start, seconds.
    Time(f64),
    /// Two entities are close to each other.
    Distance {
        /// Names of the two.
        entities: [String; 2],
        /// Largest distance, meters.
        distance_m: f64,
        /// True if the distance is between their boxes, not their reference points.
        between_boxes: bool,
    },
}

/// A speed.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetSpeed {
    /// Speed, m/s.
    Absolute(f64),
    /// The speed of another entity, times a factor, plus a difference.
    Relative {
        /// Name of the other entity.
        entity: String,
        /// Factor of that speed.
        factor: f64,
        /// Difference, m/s.
        plus_mps: f64,
    },
}

/// Lane that a vehicle changes to.
#[derive(Clone, Debug, PartialEq)]
pub enum TargetLane {
    /// Id of the OpenDRIVE lane.
    Absolute(i64),
    /// Lanes to the left of an entity, negative to the right.
    Relative {
        /// Name of the entity.
        entity: String,
        /// Lanes to its left.
        lanes: i64,
    },
}

/// Duration of a change of speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Transition {
    /// Change at once.
    Step,
    /// Duration, seconds.
    Time(f64),
    /// Change per second, m/s^2.
    Rate(f64),
    /// Distance driven meanwhile, meters.
    Distance(f64),
}

/// Action of an entity.
#[derive(Clone, Debug, PartialEq)]
pub enum Action {
    /// Has another speed from then on.
    Speed {
        /// The new speed.
        target: TargetSpeed,
        /// Duration of the change.
        transition: Transition,
    },
    /// Changes lanes.
    ChangeLane(TargetLane),
    /// Goes along a route or trajectory.
    Path(Vec<Position>),
}

/// Reads the OpenSCENARIO file at `path`, and the catalogs that it refers to.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Decode`] with the line and element at fault.
pub fn read_open_scenario(path: &Path) -> Result<OpenScenario, AssetError> {
    let bytes = read_bytes(path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let read = |file: &Path| read_bytes(&folder.join(file)).ok();
    let mut scenario = decode(&bytes, read).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "OpenSCENARIO",
        source,
    })?;
    scenario.map = folder.join(scenario.map);
    Ok(scenario)
}

/// Reads a scenario from the bytes of its file. `read` returns the bytes of a catalog, whose path
/// is relative to the file, or `None` if there is no such file.
///
/// # Errors
/// A [`DecodeError`] that names the line and element at fault.
pub fn decode(
    bytes: &[u8],
    read: impl Fn(&Path) -> Option<Vec<u8>>,
) -> Result<OpenScenario, DecodeError> {
    let text = parameters::substituted(bytes)?;
    let document = xml::parse(text.as_bytes())?;
    let root = Element::root(&document, "OpenSCENARIO")?;
    if let Some(header) = root.first("FileHeader") {
        let major = header.number_or("revMajor", 1.0)?;
        if major != 1.0 {
            return Err(header.fault(format!("version {major}; versions 1.0 to 1.3 are read")));
        }
    }
    let mut skipped = Skipped::default();
    let network = root.needed("RoadNetwork")?;
    let logic = network.needed("LogicFile")?;
    let map = PathBuf::from(logic.needed_attribute("filepath")?.replace('\\', "/"));
    let signals = signals::read(network, &mut skipped)?;
    let mut entities = entities::read(root, &read, &mut skipped)?;
    let stop_time_s = story::read(root.needed("Storyboard")?, &mut entities, &mut skipped)?;
    Ok(OpenScenario {
        map,
        entities,
        signals,
        stop_time_s,
        skipped: skipped.sentences(),
    })
}

/// Sentences listed at most; further ones are counted.
const SKIPPED_MAX: usize = 1000;

/// Elements that are not read.
#[derive(Default)]
struct Skipped {
    sentences: Vec<String>,
    count: usize,
}

impl Skipped {
    /// Adds a sentence about an element.
    fn add(&mut self, element: Element, reason: &str) {
        self.count += 1;
        if self.sentences.len() < SKIPPED_MAX {
            let (line, name) = (element.line(), xml::excerpt(element.name()));
            self.sentences
                .push(format!("line {line}, <{name}>: {reason}"));
        }
    }

    fn sentences(mut self) -> Vec<String> {
        if self.count > self.sentences.len() {
            let more = self.count - self.sentences.len();
            self.sentences.push(format!("and {more} more"));
        }
        self.sentences
    }
}
