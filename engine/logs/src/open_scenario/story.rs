//! The storyboard: what entities do at the start, and actions with their triggers.

use std::collections::HashMap;
use std::sync::Arc;

use decouplegs_asset::DecodeError;
use decouplegs_scene::story::Priority;

use super::actions::{self, Action};
use super::catalogs::Catalogs;
use super::conditions::{self, Context, StateReference, Trigger, When};
use super::environment::{self, Environment};
use super::parameters::Node;
use super::{Entity, Position, Skipped, StoryAct, StoryEvent, StoryTask, positions};

/// Content of the storyboard.
pub(super) struct Story {
    /// Time at which it stops, seconds.
    pub stop_time_s: Option<f64>,
    /// Conditions other than a time at which it stops.
    pub stop: Trigger,
    /// Light and air at the start.
    pub environment: Option<Environment>,
    /// Actions at the start that take time.
    pub init: Vec<StoryTask>,
    /// Acts of the storyboard.
    pub acts: Vec<StoryAct>,
    /// Events of the storyboard.
    pub events: Vec<StoryEvent>,
}

/// Reads the storyboard; positions, speeds and routes at the start into `entities`.
pub(super) fn read(
    storyboard: Node,
    entities: &mut [Entity],
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Story, DecodeError> {
    let names = entities.iter().enumerate();
    let by_name = names
        .map(|(index, entity)| (entity.name.clone(), index))
        .collect();
    let mut reader = Reader {
        entities,
        by_name,
        catalogs,
        init: Vec::new(),
        environment: None,
        events: Vec::new(),
        parts: HashMap::new(),
        starts: HashMap::new(),
        maneuvers: 0,
    };
    if let Some(actions) = storyboard.needed("Init")?.first("Actions") {
        reader.init(actions, skipped)?;
    }
    // Conditions may be about events that come later: their parts are known first.
    let mut acts = 0;
    for story in storyboard.all("Story") {
        for act in story.all("Act") {
            for group in act.all("ManeuverGroup") {
                reader.list(&[story, act, group], acts, skipped)?;
            }
            acts += 1;
        }
    }
    let parts: HashMap<(String, String), Arc<[usize]>> = std::mem::take(&mut reader.parts)
        .into_iter()
        .map(|(part, events)| (part, Arc::from(events)))
        .collect();
    let states = |reference: &StateReference| {
        // A name may be qualified by those of the parts that it is in.
        let name = reference.name.rsplit("::").next().unwrap_or_default();
        parts
            .get(&(reference.kind.clone(), name.to_owned()))
            .cloned()
    };
    let context = Context {
        catalogs,
        parts: &states,
        actors: &[],
    };
    let (mut next, mut acts) = (0, Vec::new());
    for act in storyboard.all("Story").flat_map(|story| story.all("Act")) {
        let start = conditions::read(act.first("StartTrigger"), context, skipped);
        let stop = match act.first("StopTrigger") {
            Some(stop) => recovered(
                stop,
                conditions::read(Some(stop), context, skipped),
                skipped,
            ),
            None => None,
        };
        acts.push(StoryAct {
            start: recovered(act, start, skipped),
            stop: stop.unwrap_or_default(),
        });
        for group in act.all("ManeuverGroup") {
            reader.group(group, &mut next, context, skipped)?;
        }
    }
    reader.start_on_trajectories(skipped);
    let Reader {
        init,
        environment,
        events,
        ..
    } = reader;
    let (stop_time_s, stop) = stop_of(storyboard, context, skipped);
    Ok(Story {
        stop_time_s,
        stop,
        environment,
        init,
        acts,
        events,
    })
}

/// Time at which the storyboard stops, seconds, and the other conditions of its stop. One alone
/// that asks for a time is the former.
fn stop_of(storyboard: Node, context: Context, skipped: &mut Skipped) -> (Option<f64>, Trigger) {
    let Some(stop) = storyboard.first("StopTrigger") else {
        return (None, Trigger::new());
    };
    let read = conditions::read(Some(stop), context, skipped);
    let mut trigger: Trigger = recovered(stop, read, skipped).unwrap_or_default();
    let mut first_s: Option<f64> = None;
    trigger.retain(|group| match group.as_slice() {
        [one] => match one.when {
            When::Time { value_s, .. } => {
                let at_s = value_s + one.delay_s;
                if at_s > 0.0 {
                    first_s = Some(first_s.map_or(at_s, |found_s| found_s.min(at_s)));
                }
                false
            }
            _ => true,
        },
        // A group without conditions asks for nothing.
        _ => !group.is_empty(),
    });
    (first_s, trigger)
}

/// The value that was read, or `None` with a sentence: a fault of one event does not keep a file
/// from being driven.
fn recovered<T>(
    node: Node,
    read: Result<Option<T>, DecodeError>,
    skipped: &mut Skipped,
) -> Option<T> {
    read.unwrap_or_else(|fault| {
        skipped.fault(node, &fault);
        None
    })
}

struct Reader<'a, 'r> {
    entities: &'a mut [Entity],
    by_name: HashMap<String, usize>,
    catalogs: &'a Catalogs<'r>,
    init: Vec<StoryTask>,
    environment: Option<Environment>,
    events: Vec<StoryEvent>,
    /// Events of each part of the storyboard, by its kind and name.
    parts: HashMap<(String, String), Vec<usize>>,
    /// First points of the first trajectories of entities, by entity.
    starts: HashMap<usize, Position>,
    /// Number of maneuvers so far.
    maneuvers: usize,
}

impl Reader<'_, '_> {
    /// Remembers the first point of an entity's trajectory, if `action` is one.
    fn note_start(&mut self, name: &str, action: &Action) {
        let Action::Follow { points, .. } = action else {
            return;
        };
        if let (Some(first), Some(&index)) = (points.first(), self.by_name.get(name)) {
            self.starts.entry(index).or_insert_with(|| first.clone());
        }
    }

    /// Puts entities without a position at the first points of their trajectories, where these
    /// count from no entity that has none.
    fn start_on_trajectories(&mut self, skipped: &mut Skipped) {
        for (index, entity) in self.entities.iter_mut().enumerate() {
            if entity.position.is_some() {
                continue;
            }
            let Some(start) = self.starts.remove(&index) else {
                continue;
            };
            if start.other() == Some(&*entity.name) {
                continue;
            }
            skipped.push(format!(
                "{}: the file gives it no position; it starts at the first point of its trajectory",
                entity.name
            ));
            entity.position = Some(start);
        }
    }

    fn init(&mut self, actions: Node, skipped: &mut Skipped) -> Result<(), DecodeError> {
        let catalogs = self.catalogs;
        for holder in actions.elements() {
            if let Some(action) = holder.first("EnvironmentAction") {
                let read = environment::read(action, catalogs, skipped);
                self.environment = recovered(action, read, skipped).or(self.environment.take());
                continue;
            }
            if holder.name() == "GlobalAction" {
                let read = actions::read(holder, catalogs, skipped)?;
                self.add_init(holder, "", read.unwrap_or_default());
                continue;
            }
            if holder.name() != "Private" {
                skipped.add(holder, "only actions of entities are read");
                continue;
            }
            let name = holder.needed_attribute("entityRef")?;
            let Some(&index) = self.by_name.get(&*name) else {
                skipped.add(holder, "its entity is not read");
                continue;
            };
            for action in holder.all("PrivateAction") {
                if let Some(teleport) = action.first("TeleportAction") {
                    let place = teleport.needed("Position")?;
                    let Some(position) = positions::read(place, catalogs, skipped)? else {
                        continue;
                    };
                    let entity = &mut self.entities[index];
                    // A place relative to where it is already turns or moves it.
                    match (position.other() == Some(&*name), entity.position.take()) {
                        (true, Some(before)) => {
                            entity.position = Some(moved(before, position, teleport, skipped));
                        }
                        _ => entity.position = Some(position),
                    }
                    continue;
                }
                let Some(mut read) = actions::read(action, catalogs, skipped)? else {
                    continue;
                };
                let entity = &mut self.entities[index];
                for (_, one) in &mut read {
                    one.name_own(&name);
                    match one {
                        // The speed at the start is also that of who does not follow its change.
                        Action::Speed { target, .. } => entity.speed = Some(target.clone()),
                        Action::Route(points) => entity.route.clone_from(points),
                        Action::Follow { points, .. } if entity.route.is_empty() => {
                            entity.route.clone_from(points);
                        }
                        _ => {}
                    }
                }
                self.add_init(action, &name, read);
            }
        }
        Ok(())
    }

    fn add_init(&mut self, holder: Node, name: &str, read: Vec<(Option<String>, Action)>) {
        for (of, action) in read {
            let actor = of.unwrap_or_else(|| name.to_owned());
            self.note_start(&actor, &action);
            let line = holder.line();
            self.init.push(StoryTask {
                line,
                actor,
                action,
            });
        }
    }

    /// Lists the events of a maneuver group, by the parts that they are in: story, act and group.
    fn list(
        &mut self,
        within: &[Node; 3],
        act: usize,
        skipped: &mut Skipped,
    ) -> Result<(), DecodeError> {
        let group = within[2];
        let mut actors = Vec::new();
        for actor in group.needed("Actors")?.all("EntityRef") {
            actors.push(actor.needed_attribute("entityRef")?.into_owned());
        }
        let kinds = ["story", "act", "maneuverGroup", "maneuver"];
        let mut names = Vec::new();
        for part in within {
            names.push(part.attribute("name")?.unwrap_or_default().into_owned());
        }
        let catalogs = self.catalogs;
        let executions = count(group);
        each_maneuver(group, catalogs, skipped, |maneuver, _| {
            self.maneuvers += 1;
            names.truncate(3);
            names.push(maneuver.attribute("name")?.unwrap_or_default().into_owned());
            for event in maneuver.all("Event") {
                let number = self.events.len();
                let name = event.attribute("name")?.unwrap_or_default().into_owned();
                let mut parts: Vec<(&str, String)> = kinds
                    .into_iter()
                    .zip(names.iter().cloned())
                    .chain([("event", name.clone())])
                    .collect();
                for action in event.all("Action") {
                    parts.push((
                        "action",
                        action.attribute("name")?.unwrap_or_default().into(),
                    ));
                }
                for (kind, name) in parts {
                    self.parts
                        .entry((kind.to_owned(), name))
                        .or_default()
                        .push(number);
                }
                self.events.push(StoryEvent {
                    line: event.line(),
                    name,
                    actors: actors.clone(),
                    act,
                    maneuver: self.maneuvers,
                    priority: match event.attribute("priority")?.as_deref() {
                        Some("skip") => Priority::Skip,
                        Some("parallel") => Priority::Parallel,
                        _ => Priority::Override,
                    },
                    // A group that is executed again does its events again.
                    executions: executions.saturating_mul(count(event)),
                    start: None,
                    tasks: Vec::new(),
                    lost: 0,
                });
            }
            Ok(())
        })
    }

    /// Reads the triggers and actions of a maneuver group. `next` is the number of its first event.
    fn group(
        &mut self,
        group: Node,
        next: &mut usize,
        context: Context,
        skipped: &mut Skipped,
    ) -> Result<(), DecodeError> {
        for reference in group.all("CatalogReference") {
            let found = self
                .catalogs
                .with_entry(reference, skipped, |_, _| Ok(()))?;
            if found.is_none() {
                skipped.add(reference, "the catalog of its maneuver was not found");
            }
        }
        let catalogs = self.catalogs;
        each_maneuver(group, catalogs, skipped, |maneuver, skipped| {
            for event in maneuver.all("Event") {
                let number = *next;
                *next += 1;
                let actors = self.events[number].actors.clone();
                let context = Context {
                    actors: &actors,
                    ..context
                };
                let trigger = conditions::read(event.first("StartTrigger"), context, skipped);
                self.events[number].start = recovered(event, trigger, skipped);
                for action in event.all("Action") {
                    let read = self.action(action, number, &actors, skipped);
                    if let Err(fault) = &read {
                        skipped.fault(action, fault);
                    }
                    if !matches!(read, Ok(true)) {
                        self.events[number].lost += 1;
                    }
                }
            }
            Ok(())
        })
    }

    /// Adds an action to an event; false if it is of a kind that is not read.
    fn action(
        &mut self,
        action: Node,
        number: usize,
        actors: &[String],
        skipped: &mut Skipped,
    ) -> Result<bool, DecodeError> {
        let kinds = ["PrivateAction", "GlobalAction", "UserDefinedAction"];
        let Some(holder) = kinds.into_iter().find_map(|kind| action.first(kind)) else {
            return Err(action.fault("it is empty; expected an action"));
        };
        let Some(read) = actions::read(holder, self.catalogs, skipped)? else {
            return Ok(false);
        };
        let line = action.line();
        for (of, action) in read {
            let of: Vec<String> = match of {
                Some(of) => vec![of],
                None if holder.name() == "PrivateAction" => actors.to_vec(),
                None => vec![String::new()],
            };
            for actor in of {
                let mut action = action.clone();
                action.name_own(&actor);
                self.note_start(&actor, &action);
                self.events[number].tasks.push(StoryTask {
                    line,
                    actor,
                    action,
                });
            }
        }
        Ok(true)
    }
}

/// Calls `read` with each maneuver of a group, in the order of the file: its own, then those of
/// catalogs.
fn each_maneuver(
    group: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
    mut read: impl FnMut(Node, &mut Skipped) -> Result<(), DecodeError>,
) -> Result<(), DecodeError> {
    for maneuver in group.all("Maneuver") {
        read(maneuver, skipped)?;
    }
    for reference in group.all("CatalogReference") {
        catalogs.with_entry(reference, skipped, &mut read)?;
    }
    Ok(())
}

/// `before`, moved by `by`, a position relative to the entity itself.
fn moved(before: Position, by: Position, teleport: Node, skipped: &mut Skipped) -> Position {
    if matches!(before, Position::After { .. }) {
        skipped.add(teleport, "only the first place relative to itself is read");
        return before;
    }
    Position::After {
        before: Box::new(before),
        by: Box::new(by),
    }
}

/// Most executions of an event.
const EXECUTIONS_MAX: f64 = 1e6;

/// Number of times that a group or an event is executed.
fn count(part: Node) -> u32 {
    let found = part.number_or("maximumExecutionCount", 1.0);
    found.map_or(1, |count| count.clamp(1.0, EXECUTIONS_MAX) as u32)
}
