//! The storyboard: what entities do at the start, and actions with their triggers.

use std::collections::HashMap;

use super::{
    Action, Entity, Event, EventTrigger, Skipped, TargetLane, TargetSpeed, Transition, positions,
};
use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::Element;

/// Entities by name.
struct Cast<'a> {
    entities: &'a mut [Entity],
    by_name: HashMap<String, usize>,
}

impl Cast<'_> {
    fn named(&mut self, name: &str) -> Option<&mut Entity> {
        self.by_name
            .get(name)
            .map(|&index| &mut self.entities[index])
    }
}

/// Reads the storyboard into `entities`. Returns the time at which it stops.
pub(super) fn read(
    storyboard: Element,
    entities: &mut [Entity],
    skipped: &mut Skipped,
) -> Result<Option<f64>, DecodeError> {
    let names = entities.iter().enumerate();
    let by_name = names
        .map(|(index, entity)| (entity.name.clone(), index))
        .collect();
    let mut cast = Cast { entities, by_name };
    if let Some(actions) = storyboard.needed("Init")?.first("Actions") {
        read_init(actions, &mut cast, skipped)?;
    }
    for act in storyboard.all("Story").flat_map(|story| story.all("Act")) {
        for group in act.all("ManeuverGroup") {
            read_group(act, group, &mut cast, skipped)?;
        }
    }
    let Some(stop) = storyboard.first("StopTrigger") else {
        return Ok(None);
    };
    match conditions(&[stop], "", skipped)? {
        Some(EventTrigger::Time(time_s)) if time_s > 0.0 => Ok(Some(time_s)),
        Some(EventTrigger::Distance { .. }) => {
            skipped.add(stop, "only a time stops an episode");
            Ok(None)
        }
        _ => Ok(None),
    }
}

fn read_init(actions: Element, cast: &mut Cast, skipped: &mut Skipped) -> Result<(), DecodeError> {
    for private in actions.elements() {
        if private.name() != "Private" {
            skipped.add(private, "only actions of entities are read");
            continue;
        }
        let Some(entity) = cast.named(private.needed_attribute("entityRef")?) else {
            skipped.add(private, "its entity is not read");
            continue;
        };
        for action in private.all("PrivateAction") {
            if let Some(teleport) = action.first("TeleportAction") {
                entity.position = positions::read(teleport.needed("Position")?, skipped)?;
                continue;
            }
            match read_action(action, skipped)? {
                Some(Action::Speed { target, .. }) => entity.speed = Some(target),
                Some(Action::Path(route)) => entity.route = route,
                Some(Action::ChangeLane(_)) => {
                    skipped.add(action, "a lane change at the start is not read");
                }
                None => {}
            }
        }
    }
    Ok(())
}

fn read_group(
    act: Element,
    group: Element,
    cast: &mut Cast,
    skipped: &mut Skipped,
) -> Result<(), DecodeError> {
    if group.number_or("maximumExecutionCount", 1.0)? > 1.0 {
        skipped.add(group, "it is executed once");
    }
    for reference in group.all("CatalogReference") {
        skipped.add(reference, "maneuvers of catalogs are not read");
    }
    let actors = group.needed("Actors")?;
    let actors: Vec<&str> = actors
        .all("EntityRef")
        .map(|actor| actor.needed_attribute("entityRef"))
        .collect::<Result<_, _>>()?;
    for event in group
        .all("Maneuver")
        .flat_map(|maneuver| maneuver.all("Event"))
    {
        if actors.is_empty() {
            skipped.add(event, "it has no actor by name");
        }
        let triggers: Vec<Element> = [act, event]
            .into_iter()
            .filter_map(|element| element.first("StartTrigger"))
            .collect();
        for action in event.all("Action") {
            let Some(private) = action.first("PrivateAction") else {
                skipped.add(action, "only actions of entities are read");
                continue;
            };
            let Some(read) = read_action(private, skipped)? else {
                continue;
            };
            for &actor in &actors {
                let Some(trigger) = conditions(&triggers, actor, skipped)? else {
                    continue;
                };
                let Some(entity) = cast.named(actor) else {
                    skipped.add(action, "its actor is not read");
                    continue;
                };
                entity.events.push(Event {
                    line: action.line(),
                    trigger,
                    action: read.clone(),
                });
            }
        }
    }
    Ok(())
}

/// The action in a `<PrivateAction>`; `None` if it is of a kind that is not read.
fn read_action(private: Element, skipped: &mut Skipped) -> Result<Option<Action>, DecodeError> {
    let Some(kind) = private.elements().next() else {
        return Err(private.fault("it is empty; expected an action"));
    };
    let inner = kind.elements().next();
    match (kind.name(), inner.map(Element::name), inner) {
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
                TargetLane::Absolute(absolute.number("value")?.clamp(-1000.0, 1000.0) as i64)
            } else {
                let relative = target.needed("RelativeTargetLane")?;
                TargetLane::Relative {
                    entity: relative.needed_attribute("entityRef")?.to_owned(),
                    lanes: relative.number("value")?.clamp(-1000.0, 1000.0) as i64,
                }
            };
            Ok(Some(Action::ChangeLane(lane)))
        }
        ("RoutingAction", Some(_), Some(routing)) => path(routing, skipped),
        _ => {
            skipped.add(inner.unwrap_or(kind), "actions of this kind are not read");
            Ok(None)
        }
    }
}

fn speed_of(target: Element) -> Result<Option<TargetSpeed>, DecodeError> {
    if let Some(absolute) = target.first("AbsoluteTargetSpeed") {
        return Ok(Some(TargetSpeed::Absolute(absolute.number("value")?)));
    }
    let Some(relative) = target.first("RelativeTargetSpeed") else {
        return Ok(None);
    };
    let value = relative.number("value")?;
    let is_factor = relative.attribute("speedTargetValueType") == Some("factor");
    Ok(Some(TargetSpeed::Relative {
        entity: relative.needed_attribute("entityRef")?.to_owned(),
        factor: if is_factor { value } else { 1.0 },
        plus_mps: if is_factor { 0.0 } else { value },
    }))
}

fn transition(dynamics: Option<Element>) -> Result<Transition, DecodeError> {
    let Some(dynamics) = dynamics else {
        return Ok(Transition::Step);
    };
    if dynamics.attribute("dynamicsShape") == Some("step") {
        return Ok(Transition::Step);
    }
    let value = dynamics.number_or("value", 0.0)?;
    Ok(match dynamics.attribute("dynamicsDimension") {
        _ if value <= 0.0 => Transition::Step,
        Some("rate") => Transition::Rate(value),
        Some("distance") => Transition::Distance(value),
        _ => Transition::Time(value),
    })
}

/// Positions of a routing action.
fn path(routing: Element, skipped: &mut Skipped) -> Result<Option<Action>, DecodeError> {
    let positions: Vec<Element> = match routing.name() {
        "AcquirePositionAction" => routing.all("Position").collect(),
        "AssignRouteAction" => match routing.first("Route") {
            Some(route) => route
                .all("Waypoint")
                .filter_map(|waypoint| waypoint.first("Position"))
                .collect(),
            None => Vec::new(),
        },
        "FollowTrajectoryAction" => {
            let trajectory = routing
                .first("TrajectoryRef")
                .unwrap_or(routing)
                .first("Trajectory");
            let line = trajectory
                .and_then(|trajectory| trajectory.first("Shape"))
                .and_then(|shape| shape.first("Polyline"));
            match line {
                Some(line) => line
                    .all("Vertex")
                    .filter_map(|vertex| vertex.first("Position"))
                    .collect(),
                None => Vec::new(),
            }
        }
        _ => Vec::new(),
    };
    if positions.is_empty() {
        skipped.add(routing, "it has no positions that are read");
        return Ok(None);
    }
    let mut read = Vec::new();
    for position in positions {
        match positions::read(position, skipped)? {
            Some(position) => read.push(position),
            None => return Ok(None),
        }
    }
    Ok(Some(Action::Path(read)))
}

/// Single condition that `triggers` amount to, for an action of `actor`; `None` if they cannot be
/// expressed.
fn conditions(
    triggers: &[Element],
    actor: &str,
    skipped: &mut Skipped,
) -> Result<Option<EventTrigger>, DecodeError> {
    let mut time_s = 0.0f64;
    let mut distance = None;
    for trigger in triggers {
        let mut groups = trigger.all("ConditionGroup");
        let Some(group) = groups.next() else { continue };
        if groups.next().is_some() {
            skipped.add(*trigger, "only one group of conditions is read");
            return Ok(None);
        }
        for condition in group.all("Condition") {
            match read_condition(condition, actor)? {
                Some(EventTrigger::Time(at_s)) => time_s = time_s.max(at_s),
                Some(found) if distance.is_none() => distance = Some((condition, found)),
                _ => {
                    skipped.add(condition, "the condition cannot be expressed");
                    return Ok(None);
                }
            }
        }
    }
    match distance {
        Some((condition, _)) if time_s > 0.0 => {
            skipped.add(
                condition,
                "a time and a distance together cannot be expressed",
            );
            Ok(None)
        }
        Some((_, found)) => Ok(Some(found)),
        None => Ok(Some(EventTrigger::Time(time_s))),
    }
}

/// A `<Condition>`; `None` if it is of a kind that is not read.
fn read_condition(condition: Element, actor: &str) -> Result<Option<EventTrigger>, DecodeError> {
    let delay_s = condition.number_or("delay", 0.0)?;
    let by_value = condition.first("ByValueCondition");
    if let Some(time) = by_value.and_then(|value| value.first("SimulationTimeCondition")) {
        let is_from = matches!(
            time.attribute("rule"),
            Some("greaterThan" | "greaterOrEqual" | "equalTo")
        );
        let at_s = (time.number("value")? + delay_s).max(0.0);
        return Ok(is_from.then_some(EventTrigger::Time(at_s)));
    }
    let Some(by_entity) = condition.first("ByEntityCondition") else {
        return Ok(None);
    };
    let mut triggering = by_entity
        .needed("TriggeringEntities")?
        .all("EntityRef")
        .map(|entity| entity.needed_attribute("entityRef"));
    let entity = triggering.next().transpose()?.unwrap_or(actor);
    let kind = by_entity
        .needed("EntityCondition")?
        .first("RelativeDistanceCondition");
    let (Some(kind), None, true) = (kind, triggering.next(), delay_s == 0.0) else {
        return Ok(None);
    };
    let is_straight = matches!(
        kind.attribute("relativeDistanceType"),
        Some("cartesianDistance" | "euclidianDistance" | "euclideanDistance")
    );
    let is_less = matches!(kind.attribute("rule"), Some("lessThan" | "lessOrEqual"));
    if !is_straight || !is_less {
        return Ok(None);
    }
    Ok(Some(EventTrigger::Distance {
        entities: [
            entity.to_owned(),
            kind.needed_attribute("entityRef")?.to_owned(),
        ],
        distance_m: kind.number("value")?.max(0.0),
        between_boxes: kind.attribute("freespace") == Some("true"),
    }))
}
