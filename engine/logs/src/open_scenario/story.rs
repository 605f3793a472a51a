//! The storyboard: what entities do at the start, and actions with their triggers.

use std::collections::HashMap;
use std::sync::Arc;

use decouplegs_asset::DecodeError;

use super::catalogs::Catalogs;
use super::conditions::{self, Measure, Rule, StateReference};
use super::parameters::Node;
use super::speed_profile::{self, Part};
use super::{
    Action, Entity, Event, Position, Skipped, StoryEvent, TargetLane, TargetSpeed, Transition,
    positions, routes,
};

/// Content of the storyboard, the events of its entities left out.
pub(super) struct Story {
    /// Time at which it stops, seconds.
    pub stop_time_s: Option<f64>,
    /// Events of the storyboard.
    pub events: Vec<StoryEvent>,
}

/// Reads the storyboard into `entities`.
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
        events: Vec::new(),
        parts: HashMap::new(),
        starts: HashMap::new(),
    };
    if let Some(actions) = storyboard.needed("Init")?.first("Actions") {
        reader.init(actions, skipped)?;
    }
    // Conditions may be about events that come later: their parts are known first.
    for story in storyboard.all("Story") {
        for act in story.all("Act") {
            for group in act.all("ManeuverGroup") {
                reader.list(&[story, act, group], skipped)?;
            }
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
    let mut next = 0;
    for act in storyboard.all("Story").flat_map(|story| story.all("Act")) {
        for group in act.all("ManeuverGroup") {
            reader.group(act, group, &mut next, &states, skipped)?;
        }
    }
    reader.start_on_trajectories(skipped);
    let Some(stop) = storyboard.first("StopTrigger") else {
        return Ok(Story {
            stop_time_s: None,
            events: reader.events,
        });
    };
    let read = conditions::read(&[stop], "", catalogs, &states, skipped);
    let stages = recovered(stop, read, skipped).map_or_else(Vec::new, |read| read.stages);
    let mut stop_time_s: Option<f64> = None;
    for group in stages.iter().flatten() {
        match group.as_slice() {
            [one] if one.measure == Measure::Time && one.rule == Rule::Above => {
                let at_s = one.value + one.delay_s;
                if at_s > 0.0 {
                    stop_time_s = Some(stop_time_s.map_or(at_s, |found| found.min(at_s)));
                }
            }
            _ => skipped.add(stop, "only a time stops an episode"),
        }
    }
    Ok(Story {
        stop_time_s,
        events: reader.events,
    })
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
    events: Vec<StoryEvent>,
    /// Events of each part of the storyboard, by its kind and name.
    parts: HashMap<(String, String), Vec<usize>>,
    /// First points of the first trajectories of entities, by entity.
    starts: HashMap<usize, Position>,
}

impl Reader<'_, '_> {
    fn named(&mut self, name: &str) -> Option<&mut Entity> {
        self.by_name
            .get(name)
            .map(|&index| &mut self.entities[index])
    }

    /// Remembers the first point of an entity's trajectory, if `action` is one.
    fn note_start(&mut self, name: &str, private: Node, action: &Action) {
        let Action::Path { points, .. } = action else {
            return;
        };
        let follows = private
            .first("RoutingAction")
            .is_some_and(|routing| routing.first("FollowTrajectoryAction").is_some());
        if let (true, Some(first), Some(&index)) = (follows, points.first(), self.by_name.get(name))
        {
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
        for private in actions.elements() {
            if private.name() != "Private" {
                skipped.add(private, "only actions of entities are read");
                continue;
            }
            let name = private.needed_attribute("entityRef")?;
            let Some(&index) = self.by_name.get(&*name) else {
                skipped.add(private, "its entity is not read");
                continue;
            };
            for action in private.all("PrivateAction") {
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
                let read = read_action(action, catalogs, skipped)?;
                if let Some(read) = &read {
                    self.note_start(&name, action, read);
                }
                let entity = &mut self.entities[index];
                match read {
                    Some(Action::Speed { target, .. }) => entity.speed = Some(target),
                    Some(Action::Path { points, .. }) => entity.route = points,
                    // Positions at the start were read before.
                    Some(Action::Teleport(_)) => {}
                    Some(Action::ChangeLane(_)) => {
                        skipped.add(action, "a lane change at the start is not read");
                    }
                    None => {}
                }
            }
        }
        Ok(())
    }

    /// Lists the events of a maneuver group, by the parts that they are in: story, act and group.
    fn list(&mut self, within: &[Node; 3], skipped: &mut Skipped) -> Result<(), DecodeError> {
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
        each_maneuver(group, catalogs, skipped, |maneuver, _| {
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
                });
            }
            Ok(())
        })
    }

    /// Reads the actions of a maneuver group. `next` is the number of its first event.
    fn group(
        &mut self,
        act: Node,
        group: Node,
        next: &mut usize,
        states: &dyn Fn(&StateReference) -> Option<Arc<[usize]>>,
        skipped: &mut Skipped,
    ) -> Result<(), DecodeError> {
        let is_repeated = matches!(
            group.number_or("maximumExecutionCount", 1.0),
            Ok(count) if count > 1.0
        );
        if is_repeated {
            skipped.add(group, "it is executed once");
        }
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
                if self.events[number].actors.is_empty() {
                    skipped.add(event, "it has no actor by name");
                }
                let triggers: Vec<Node> = [act, event]
                    .into_iter()
                    .filter_map(|part| part.first("StartTrigger"))
                    .collect();
                for action in event.all("Action") {
                    let read = self.action(action, number, &triggers, states, skipped);
                    if let Err(fault) = read {
                        skipped.fault(action, &fault);
                    }
                }
            }
            Ok(())
        })
    }

    fn action(
        &mut self,
        action: Node,
        number: usize,
        triggers: &[Node],
        states: &dyn Fn(&StateReference) -> Option<Arc<[usize]>>,
        skipped: &mut Skipped,
    ) -> Result<(), DecodeError> {
        let Some(private) = action.first("PrivateAction") else {
            skipped.add(action, "only actions of entities are read");
            return Ok(());
        };
        let parts = match speed_profile::read(private, skipped)? {
            Some(parts) => parts,
            None => {
                let Some(action) = read_action(private, self.catalogs, skipped)? else {
                    return Ok(());
                };
                let (begin_s, duration_s) = (0.0, duration_s(private, &action)?);
                vec![Part {
                    action,
                    begin_s,
                    duration_s,
                }]
            }
        };
        for actor in self.events[number].actors.clone() {
            for part in &parts {
                self.note_start(&actor, private, &part.action);
            }
            let found = conditions::read(triggers, &actor, self.catalogs, states, skipped)?;
            let Some(trigger) = found else { continue };
            let Some(entity) = self.named(&actor) else {
                skipped.add(action, "its actor is not read");
                continue;
            };
            entity.events.extend(parts.iter().map(|part| Event {
                line: action.line(),
                number,
                trigger: speed_profile::later(&trigger, action.line(), part.begin_s),
                action: part.action.clone(),
                duration_s: part.duration_s,
            }));
        }
        Ok(())
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
    let turns_only = match &by {
        Position::RelativeLane {
            lanes,
            along: positions::Along::Road(along_m) | positions::Along::Lane(along_m),
            offset_m,
            ..
        } => *lanes == 0 && *along_m == 0.0 && *offset_m == 0.0,
        Position::RelativeRoad { ds_m, dt_m, .. } => *ds_m == 0.0 && *dt_m == 0.0,
        Position::RelativeEntity { offset_m, .. } => offset_m.length() == 0.0,
        _ => false,
    };
    if matches!(before, Position::After { .. }) {
        skipped.add(teleport, "only the first place relative to itself is read");
        return before;
    }
    if !turns_only {
        return Position::After {
            before: Box::new(before),
            by: Box::new(by),
        };
    }
    skipped.add(
        teleport,
        "it turns the entity where it stands: its heading is that of its lane",
    );
    before
}

/// The action in a `<PrivateAction>`; `None` if it is of a kind that is not read.
fn read_action(
    private: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Action>, DecodeError> {
    let Some(kind) = private.elements().next() else {
        return Err(private.fault("it is empty; expected an action"));
    };
    let inner = kind.elements().next();
    match (kind.name(), inner.map(Node::name), inner) {
        ("LongitudinalAction", Some("SpeedAction"), Some(speed)) => {
            let Some(target) = speed_of(speed.needed("SpeedActionTarget")?)? else {
                skipped.add(speed, "the target speed is of a kind that is not read");
                return Ok(None);
            };
            let transition = transition(speed.first("SpeedActionDynamics"))?;
            Ok(Some(Action::Speed { target, transition }))
        }
        ("LateralAction", Some("LaneChangeAction"), Some(change)) => {
            let target = change.needed("LaneChangeTarget")?;
            let lane = if let Some(absolute) = target.first("AbsoluteTargetLane") {
                TargetLane::Absolute(positions::lanes(absolute.number("value")?))
            } else {
                let relative = target.needed("RelativeTargetLane")?;
                TargetLane::Relative {
                    entity: relative.needed_attribute("entityRef")?.into_owned(),
                    lanes: positions::lanes(relative.number("value")?),
                }
            };
            Ok(Some(Action::ChangeLane(lane)))
        }
        ("TeleportAction", _, Some(place)) if place.name() == "Position" => {
            Ok(positions::read(place, catalogs, skipped)?.map(Action::Teleport))
        }
        ("RoutingAction", Some(_), Some(routing)) => path(routing, catalogs, skipped),
        _ => {
            skipped.add(inner.unwrap_or(kind), "actions of this kind are not read");
            Ok(None)
        }
    }
}

/// Duration of `action`, the one in `private`, where its dynamics or its trajectory give it.
fn duration_s(private: Node, action: &Action) -> Result<Option<f64>, DecodeError> {
    let of = |transition: Transition| match transition {
        Transition::Step => Some(0.0),
        Transition::Time(time_s) => Some(time_s),
        Transition::Rate(_) | Transition::Distance(_) => None,
    };
    Ok(match action {
        Action::Speed { transition, .. } => of(*transition),
        Action::Teleport(_) => Some(0.0),
        Action::ChangeLane(_) => {
            let change = private
                .first("LateralAction")
                .and_then(|lateral| lateral.first("LaneChangeAction"));
            let dynamics = change.and_then(|change| change.first("LaneChangeActionDynamics"));
            of(transition(dynamics)?)
        }
        Action::Path { times_s, .. } => {
            times_s.as_ref().and_then(|times_s| times_s.last().copied())
        }
    })
}

fn speed_of(target: Node) -> Result<Option<TargetSpeed>, DecodeError> {
    if let Some(absolute) = target.first("AbsoluteTargetSpeed") {
        return Ok(Some(TargetSpeed::Absolute(absolute.number("value")?)));
    }
    let Some(relative) = target.first("RelativeTargetSpeed") else {
        return Ok(None);
    };
    let value = relative.number("value")?;
    let is_factor = relative.is("speedTargetValueType", "factor")?;
    Ok(Some(TargetSpeed::Relative {
        entity: relative.needed_attribute("entityRef")?.into_owned(),
        factor: if is_factor { value } else { 1.0 },
        plus_mps: if is_factor { 0.0 } else { value },
    }))
}

fn transition(dynamics: Option<Node>) -> Result<Transition, DecodeError> {
    let Some(dynamics) = dynamics else {
        return Ok(Transition::Step);
    };
    if dynamics.is("dynamicsShape", "step")? {
        return Ok(Transition::Step);
    }
    let value = dynamics.number_or("value", 0.0)?;
    Ok(match dynamics.attribute("dynamicsDimension")?.as_deref() {
        _ if value <= 0.0 => Transition::Step,
        Some("rate") => Transition::Rate(value),
        Some("distance") => Transition::Distance(value),
        _ => Transition::Time(value),
    })
}

/// Positions of a routing action.
fn path(
    routing: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Action>, DecodeError> {
    let points = match routing.name() {
        "AcquirePositionAction" => {
            let mut points = Vec::new();
            for place in routing.all("Position") {
                match positions::read(place, catalogs, skipped)? {
                    Some(position) => points.push(position),
                    None => return Ok(None),
                }
            }
            Some(points)
        }
        "AssignRouteAction" => routes::route(routing, catalogs, skipped)?,
        "FollowTrajectoryAction" => {
            let holder = routing.first("TrajectoryRef").unwrap_or(routing);
            let Some(read) = routes::trajectory(holder, catalogs, skipped)? else {
                return Ok(None);
            };
            let times_s: Option<Vec<f64>> = read.iter().map(|(_, time_s)| *time_s).collect();
            return Ok(Some(Action::Path {
                points: read.into_iter().map(|(position, _)| position).collect(),
                times_s,
            }));
        }
        _ => {
            skipped.add(routing, "actions of this kind are not read");
            None
        }
    };
    Ok(points
        .filter(|points| !points.is_empty())
        .map(|points| Action::Path {
            points,
            times_s: None,
        }))
}
