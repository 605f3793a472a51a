//! ASAM OpenSCENARIO XML (`.xosc`, versions 1.0 to 1.3): the part of a file that scenarios here can
//! express.
//!
//! Read are parameters, expressions and catalogs, the road network's file, phases of traffic
//! signals, vehicles, pedestrians and other objects with their boxes, and from the storyboard:
//! positions, speeds, routes, trajectories, changes of speed and lane, and triggers. A value is
//! evaluated when it is needed: one that nobody reads cannot refuse a file. Everything else is
//! listed in [`OpenScenario::skipped`], one sentence per element, with its line; an event at fault
//! is listed there too.
//!
//! The reader is our own: the crate `openscenario-rs` is under the GPL, which this project is not.
//!
//! Values and units are those of the file: meters, seconds, radians. The reference point of an
//! entity is the center of its rear axle; [`Entity::center_m`] is the way from there to the middle
//! of its box.

mod actions;
mod catalogs;
mod conditions;
mod curves;
mod entities;
mod environment;
mod expression;
mod global_actions;
mod measure;
mod parameters;
mod positions;
mod profiles;
mod routes;
mod signals;
mod story;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use decouplegs_scene::story::{Limits, Priority};
use decouplegs_scene::{LightPhase, RoadUser, VehicleSize};

use decouplegs_asset::read_bytes;
use decouplegs_asset::xml::{self, Element};
use decouplegs_asset::{AssetError, DecodeError};

use catalogs::Catalogs;
use parameters::{Assignments, Node, Parameters};

pub use actions::{Action, TargetLane, TargetSpeed};
pub use conditions::{Condition, Trigger, When};
pub use environment::Environment;
pub use measure::{Measure, Target};
pub use positions::{Along, Heading, Position};

/// Content of an OpenSCENARIO file.
#[derive(Clone, Debug, PartialEq)]
pub struct OpenScenario {
    /// File of the road network; `None` if the file names none.
    pub map: Option<PathBuf>,
    /// Vehicles, pedestrians and other objects, in the order of the file.
    pub entities: Vec<Entity>,
    /// Phases of the map's traffic signals.
    pub signals: Vec<SignalPhases>,
    /// Controllers of these signals.
    pub controllers: Vec<SignalController>,
    /// Light and air at the start; `None` if the file does not tell them.
    pub environment: Option<Environment>,
    /// Time at which the storyboard stops, seconds.
    pub stop_time_s: Option<f64>,
    /// Conditions other than a time at which the storyboard stops; empty if there are none.
    pub stop: Trigger,
    /// Actions at the start, besides positions.
    pub init: Vec<StoryTask>,
    /// Acts of the storyboard, in the order of the file.
    pub acts: Vec<StoryAct>,
    /// Events of the storyboard, in the order of the file.
    pub events: Vec<StoryEvent>,
    /// Variables, and parameters that conditions ask for, with their values at the start.
    pub variables: Vec<(String, String)>,
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

/// A controller of traffic signals.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SignalController {
    /// Name in the file.
    pub name: String,
    /// Names of its phases and their durations, seconds.
    pub phases: Vec<(String, f64)>,
    /// Position in the cycle at time 0, seconds.
    pub offset_s: f64,
    /// Ids of its signals in the map.
    pub signals: Vec<String>,
}

/// An act of the storyboard.
#[derive(Clone, Debug, PartialEq)]
pub struct StoryAct {
    /// Conditions of its begin; `None` if they cannot be expressed.
    pub start: Option<Trigger>,
    /// Conditions of its end; it stops for none if there are none.
    pub stop: Trigger,
}

/// An event of the storyboard, its actions read or not.
#[derive(Clone, Debug, PartialEq)]
pub struct StoryEvent {
    /// Line in the file, or in its catalog, from 1.
    pub line: u32,
    /// Name in the file.
    pub name: String,
    /// Names of the entities that it is about.
    pub actors: Vec<String>,
    /// Index of its act.
    pub act: usize,
    /// Number of its maneuver.
    pub maneuver: usize,
    /// Treatment of the other events of its maneuver.
    pub priority: Priority,
    /// Number of times that it can happen.
    pub executions: u32,
    /// Conditions of its begin; `None` if they cannot be expressed.
    pub start: Option<Trigger>,
    /// Actions that are read, one for each entity.
    pub tasks: Vec<StoryTask>,
    /// Number of actions that are not read.
    pub lost: usize,
}

/// An action of an entity.
#[derive(Clone, Debug, PartialEq)]
pub struct StoryTask {
    /// Line in the file, from 1.
    pub line: u32,
    /// Name of the entity; empty for actions that are about none.
    pub actor: String,
    /// Action that is done.
    pub action: Action,
}

/// A vehicle, a pedestrian or another object.
#[derive(Clone, Debug, PartialEq)]
pub struct Entity {
    /// Name in the file.
    pub name: String,
    /// Kind of road user; `None` for an object that stands.
    pub kind: Option<RoadUser>,
    /// Size of the box.
    pub size: VehicleSize,
    /// Offset from the reference point to the middle of the box, meters forward.
    pub center_m: f64,
    /// True if a property `type` of the value `ego_vehicle` says that it is the ego.
    pub is_ego: bool,
    /// Position at the start; `None` if the file gives none.
    pub position: Option<Position>,
    /// Speed at the start; `None` if the file gives none.
    pub speed: Option<TargetSpeed>,
    /// Waypoints of its route, the start not included; empty if the file gives none.
    pub route: Vec<Position>,
    /// Limits of its changes of speed.
    pub limits: Limits,
}

impl OpenScenario {
    /// Ids of the signals that conditions or actions name.
    #[must_use]
    pub fn named_signals(&self) -> BTreeSet<&str> {
        let actions = self.tasks().filter_map(|task| match &task.action {
            Action::Signal { signal, .. } => Some(&**signal),
            _ => None,
        });
        let conditions = self
            .conditions()
            .filter_map(|condition| match &condition.when {
                When::Signal { signal, .. } => Some(&**signal),
                _ => None,
            });
        actions.chain(conditions).collect()
    }

    /// True if a condition or an action names a controller of signals.
    #[must_use]
    pub fn names_controllers(&self) -> bool {
        let mut tasks = self.tasks();
        let mut conditions = self.conditions();
        tasks.any(|task| matches!(task.action, Action::Phase { .. }))
            || conditions.any(|condition| matches!(condition.when, When::Phase { .. }))
    }

    fn tasks(&self) -> impl Iterator<Item = &StoryTask> {
        let events = self.events.iter().flat_map(|event| &event.tasks);
        self.init.iter().chain(events)
    }

    fn conditions(&self) -> impl Iterator<Item = &Condition> {
        let acts = self.acts.iter().flat_map(|act| {
            let start = act.start.as_ref();
            start.into_iter().chain([&act.stop])
        });
        let events = self.events.iter().filter_map(|event| event.start.as_ref());
        acts.chain(events).chain([&self.stop]).flatten().flatten()
    }
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
    scenario.map = scenario.map.map(|map| folder.join(map));
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
    let document = xml::parse(bytes)?;
    let root = Element::root(&document, "OpenSCENARIO")?;
    let parameters = Parameters::new(root, Assignments::new());
    let root = Node::new(root, &parameters);
    if let Some(header) = root.first("FileHeader") {
        let major = header.number_or("revMajor", 1.0)?;
        if major != 1.0 {
            return Err(header.fault(format!("version {major}; versions 1.0 to 1.3 are read")));
        }
    }
    let mut skipped = Skipped::default();
    let catalogs = Catalogs::new(root, &read)?;
    let network = root.first("RoadNetwork");
    let map = match network.and_then(|network| network.first("LogicFile")) {
        Some(logic) => Some(
            logic
                .needed_attribute("filepath")?
                .replace('\\', "/")
                .into(),
        ),
        None => None,
    };
    let map = map.filter(|map: &PathBuf| !map.as_os_str().is_empty());
    let signals = match network {
        Some(network) => signals::read(network, &mut skipped)?,
        None => signals::Signals::default(),
    };
    let controllers = signals.controllers.iter();
    skipped.controllers = controllers.map(|known| known.name.clone()).collect();
    let declared = root.first("VariableDeclarations");
    let declared = declared
        .iter()
        .flat_map(|list| list.all("VariableDeclaration"));
    for variable in declared {
        let name = variable.element().needed_attribute("name")?.to_owned();
        let value = variable
            .attribute("value")?
            .unwrap_or_default()
            .into_owned();
        skipped.variables.insert(name, value);
    }
    let mut entities = entities::read(root, &catalogs, &mut skipped)?;
    let storyboard = root.needed("Storyboard")?;
    let story = story::read(storyboard, &mut entities, &catalogs, &mut skipped)?;
    Ok(OpenScenario {
        map,
        entities,
        signals: signals.phases,
        controllers: signals.controllers,
        environment: story.environment,
        stop_time_s: story.stop_time_s,
        stop: story.stop,
        init: story.init,
        acts: story.acts,
        events: story.events,
        variables: std::mem::take(&mut skipped.variables).into_iter().collect(),
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
    /// The catalog that is read, if one is.
    catalog: Option<String>,
    /// Nesting of positions on routes.
    nesting: u32,
    /// Points of routes and trajectories that were read.
    points: usize,
    /// Values of variables, and of parameters that conditions ask for, by name.
    variables: BTreeMap<String, String>,
    /// Names of the controllers of traffic signals.
    controllers: BTreeSet<String>,
}

impl Skipped {
    /// Adds a sentence about an element.
    fn add(&mut self, element: Node, reason: &str) {
        let (line, name) = (element.line(), xml::excerpt(element.name()));
        self.push(format!("line {line}, <{name}>: {reason}"));
    }

    /// Adds a fault that ends what `element` says, not the reading of the file.
    fn fault(&mut self, element: Node, fault: &DecodeError) {
        self.add(element, &format!("it is lost: {fault}"));
    }

    fn push(&mut self, sentence: String) {
        self.count += 1;
        if self.sentences.len() < SKIPPED_MAX {
            self.sentences.push(match &self.catalog {
                Some(catalog) => format!("in the catalog {catalog}, {sentence}"),
                None => sentence,
            });
        }
    }

    /// Says that what follows is in a catalog, or not. Returns what was said before.
    fn within(&mut self, catalog: Option<String>) -> Option<String> {
        std::mem::replace(&mut self.catalog, catalog)
    }

    /// Counts points of routes; false if there are more than `most` now.
    fn counts_points(&mut self, count: usize, most: usize) -> bool {
        self.points += count;
        self.points <= most
    }

    fn sentences(mut self) -> Vec<String> {
        if self.count > self.sentences.len() {
            let more = self.count - self.sentences.len();
            self.sentences.push(format!("and {more} more"));
        }
        self.sentences
    }
}
