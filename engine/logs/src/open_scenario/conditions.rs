//! Triggers: conditions in groups, of which one has to hold as a whole.

use std::sync::Arc;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::excerpt;
use decouplegs_scene::LightColor;
use decouplegs_scene::story::{Direction, Edge, Rule, State};

use super::Skipped;
use super::catalogs::Catalogs;
use super::measure::{Measure, Target};
use super::parameters::Node;
use super::positions;
use super::signals;

/// Most groups of a trigger, most conditions of a group, and most entities of a condition.
const GROUPS_MAX: usize = 64;

/// Conditions in groups: it is met when all conditions of one of them hold. Without groups it is
/// met at once.
pub type Trigger = Vec<Vec<Condition>>;

/// A condition.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// Line in the file, from 1.
    pub line: u32,
    /// Change of its truth that counts.
    pub edge: Edge,
    /// Time by which its truth counts later, seconds.
    pub delay_s: f64,
    /// Statement that holds or not.
    pub when: When,
}

/// Statement of a condition.
#[derive(Clone, Debug, PartialEq)]
pub enum When {
    /// Time since the start.
    Time {
        /// Comparison with the value.
        rule: Rule,
        /// Time, seconds.
        value_s: f64,
    },
    /// Value of entities.
    Value {
        /// Names of the entities.
        of: Vec<String>,
        /// True if it is to hold for all of them.
        all: bool,
        /// Measured value.
        measure: Measure,
        /// Comparison with the value.
        rule: Rule,
        /// Value that it is compared with.
        value: f64,
    },
    /// State of events.
    Events {
        /// Numbers of events in [`super::OpenScenario::events`].
        events: Arc<[usize]>,
        /// State that they are to have.
        state: State,
    },
    /// Value of a variable or parameter.
    Variable {
        /// Name in the file.
        variable: String,
        /// Comparison with the value.
        rule: Rule,
        /// Value that it is compared with.
        value: String,
    },
    /// Color of a traffic signal.
    Signal {
        /// Id of the signal in the map.
        signal: String,
        /// Color that it is to have.
        color: LightColor,
    },
    /// Phase of a controller of traffic signals.
    Phase {
        /// Name of the controller.
        controller: String,
        /// Name of the phase that it is to be in.
        phase: String,
    },
    /// A statement that is always true, or never.
    Always(bool),
}

/// Reference to a part of the storyboard, its events unknown until all of it is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StateReference {
    pub kind: String,
    pub name: String,
}

/// Names of parts of the storyboard, and what their events are.
pub(super) type Parts<'a> = &'a dyn Fn(&StateReference) -> Option<Arc<[usize]>>;

/// Context in which conditions are read.
#[derive(Clone, Copy)]
pub(super) struct Context<'a, 'r> {
    pub catalogs: &'a Catalogs<'r>,
    pub parts: Parts<'a>,
    /// Names of the entities of an event, for conditions that name none.
    pub actors: &'a [String],
}

/// The trigger in `holder`, or one that is met at once if there is none. `None` if it cannot be
/// expressed: `skipped` says why.
pub(super) fn read(
    holder: Option<Node>,
    context: Context,
    skipped: &mut Skipped,
) -> Result<Option<Trigger>, DecodeError> {
    let Some(holder) = holder else {
        return Ok(Some(Trigger::new()));
    };
    let mut trigger = Trigger::new();
    let (mut groups, mut has_lost) = (0, false);
    for group in holder.all("ConditionGroup") {
        groups += 1;
        let mut conditions = Vec::new();
        for condition in group.all("Condition") {
            conditions.push(read_condition(condition, context, skipped)?);
        }
        if groups > GROUPS_MAX || conditions.len() > GROUPS_MAX {
            skipped.add(
                group,
                &format!("more than {GROUPS_MAX} groups or conditions are not read"),
            );
            return Ok(None);
        }
        match conditions.into_iter().collect::<Option<Vec<Condition>>>() {
            // Nothing has to happen: it is met at once.
            Some(conditions) if conditions.is_empty() => return Ok(Some(Trigger::new())),
            Some(conditions) => trigger.push(conditions),
            None => has_lost = true,
        }
    }
    Ok((!has_lost || !trigger.is_empty()).then_some(trigger))
}

/// A `<Condition>`; `None` if it is of a kind that is not read.
fn read_condition(
    condition: Node,
    context: Context,
    skipped: &mut Skipped,
) -> Result<Option<Condition>, DecodeError> {
    let edge = match condition.attribute("conditionEdge")?.as_deref() {
        Some("rising") => Edge::Rising,
        Some("falling") => Edge::Falling,
        Some("risingOrFalling") => Edge::Either,
        _ => Edge::None,
    };
    let delay_s = condition.number_or("delay", 0.0)?.max(0.0);
    let when = if let Some(by_value) = condition.first("ByValueCondition") {
        let Some(kind) = by_value.elements().next() else {
            return Err(by_value.fault("it is empty; expected a condition"));
        };
        by_value_kind(kind, context, skipped)?
    } else if let Some(by_entity) = condition.first("ByEntityCondition") {
        of_entities(by_entity, context, skipped)?
    } else {
        return Err(condition.fault("it is empty; expected a condition"));
    };
    let line = condition.line();
    Ok(when.map(|when| Condition {
        line,
        edge,
        delay_s,
        when,
    }))
}

fn of_entities(
    by_entity: Node,
    context: Context,
    skipped: &mut Skipped,
) -> Result<Option<When>, DecodeError> {
    let triggering = by_entity.needed("TriggeringEntities")?;
    let mut of: Vec<String> = Vec::new();
    for entity in triggering.all("EntityRef") {
        of.push(entity.needed_attribute("entityRef")?.into_owned());
    }
    if of.is_empty() {
        of = context.actors.to_vec();
    }
    if of.len() > GROUPS_MAX {
        skipped.add(
            triggering,
            &format!("more than {GROUPS_MAX} entities are not read"),
        );
        return Ok(None);
    }
    let holder = by_entity.needed("EntityCondition")?;
    let Some(kind) = holder.elements().next() else {
        return Err(holder.fault("it is empty; expected a condition"));
    };
    let Some((measure, rule, value)) = by_entity_kind(kind, context.catalogs, skipped)? else {
        return Ok(None);
    };
    let all = triggering.is("triggeringEntitiesRule", "all")?;
    Ok(Some(When::Value {
        of,
        all,
        measure,
        rule,
        value,
    }))
}

fn by_value_kind(
    kind: Node,
    context: Context,
    skipped: &mut Skipped,
) -> Result<Option<When>, DecodeError> {
    match kind.name() {
        "SimulationTimeCondition" => Ok(Some(When::Time {
            rule: rule(kind)?,
            value_s: kind.number("value")?,
        })),
        "StoryboardElementStateCondition" => state(kind, context, skipped),
        "ParameterCondition" | "VariableCondition" => {
            let attribute = match kind.name() {
                "ParameterCondition" => "parameterRef",
                _ => "variableRef",
            };
            let name = kind
                .element()
                .needed_attribute(attribute)?
                .trim_start_matches('$');
            let name = name.to_owned();
            if kind.name() == "ParameterCondition" {
                let value = kind.parameter(&name)?;
                skipped.variables.entry(name.clone()).or_insert(value);
            }
            if !skipped.variables.contains_key(&name) {
                skipped.add(
                    kind,
                    &format!("the variable {} is not declared", excerpt(&name)),
                );
                return Ok(None);
            }
            Ok(Some(When::Variable {
                variable: name,
                rule: rule(kind)?,
                value: kind.needed_attribute("value")?.into_owned(),
            }))
        }
        "TrafficSignalCondition" => {
            let state = kind.needed_attribute("state")?;
            let signal = kind.needed_attribute("name")?.into_owned();
            let color = signals::known(kind, &state, skipped);
            Ok(color.map(|color| When::Signal { signal, color }))
        }
        "TrafficSignalControllerCondition" => {
            let named = signals::phase(kind, skipped)?;
            Ok(named.map(|(controller, phase)| When::Phase { controller, phase }))
        }
        _ => {
            skipped.add(kind, "conditions of this kind are not read");
            Ok(None)
        }
    }
}

fn state(kind: Node, context: Context, skipped: &mut Skipped) -> Result<Option<When>, DecodeError> {
    let reference = StateReference {
        kind: kind.needed_attribute("storyboardElementType")?.into_owned(),
        name: kind.needed_attribute("storyboardElementRef")?.into_owned(),
    };
    // All but events and actions begin with their act, whenever their events do.
    let is_event = matches!(reference.kind.as_str(), "event" | "action");
    let state = match &*kind.needed_attribute("state")? {
        "startTransition" if is_event => State::Begun,
        "startTransition" => State::ActBegun,
        "runningState" if is_event => State::Runs,
        "runningState" => State::ActRuns,
        "endTransition" | "stopTransition" => State::Ended,
        "completeState" => State::Over,
        "standbyState" if is_event => State::Waits,
        "standbyState" => State::ActWaits,
        _ => {
            skipped.add(kind, "the state skipTransition is not read");
            return Ok(None);
        }
    };
    let Some(events) = (context.parts)(&reference) else {
        let StateReference { kind: part, name } = &reference;
        skipped.add(
            kind,
            &format!("the storyboard has no {part} {} with events", excerpt(name)),
        );
        return Ok(None);
    };
    Ok(Some(When::Events { events, state }))
}

/// Measure, rule and value of an entity condition; `None` if it is of a kind that is not read.
fn by_entity_kind(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<(Measure, Rule, f64)>, DecodeError> {
    let other = || kind.needed_attribute("entityRef").map(String::from);
    let between_boxes = || kind.truth("freespace");
    let from = |measure: Measure, value: f64| Ok(Some((measure, Rule::GreaterOrEqual, value)));
    // Those without a rule.
    match kind.name() {
        "TraveledDistanceCondition" => {
            return from(Measure::Traveled, kind.number("value")?);
        }
        "StandStillCondition" => {
            return from(Measure::Standing, kind.number("duration")?);
        }
        "EndOfRoadCondition" => return from(Measure::AtEnd, kind.number("duration")?),
        "OffroadCondition" => return from(Measure::OffRoad, kind.number("duration")?),
        "RelativeClearanceCondition" => return clearance(kind).map(Some),
        "AngleCondition" | "RelativeAngleCondition" => {
            return turn(kind, skipped);
        }
        "ReachPositionCondition" => {
            let Some(place) = positions::read(kind.needed("Position")?, catalogs, skipped)? else {
                return Ok(None);
            };
            let measure = Measure::Distance {
                to: Target::Place(place),
                direction: Direction::Straight,
                between_boxes: false,
            };
            return Ok(Some((
                measure,
                Rule::LessOrEqual,
                kind.number("tolerance")?,
            )));
        }
        "CollisionCondition" => {
            let mut with = Vec::new();
            for entity in kind.all("EntityRef") {
                with.push(entity.needed_attribute("entityRef")?.into_owned());
            }
            // A kind of others counts as all of them.
            return from(Measure::Touched { with }, 1.0);
        }
        _ => {}
    }
    let measure = match kind.name() {
        "SpeedCondition" => Measure::Speed,
        "AccelerationCondition" => Measure::Acceleration,
        "RelativeSpeedCondition" => Measure::RelativeSpeed { to: other()? },
        "RelativeDistanceCondition" => Measure::Distance {
            to: Target::Entity(other()?),
            direction: direction(kind)?,
            between_boxes: between_boxes()?,
        },
        "DistanceCondition" => {
            let Some(place) = positions::read(kind.needed("Position")?, catalogs, skipped)? else {
                return Ok(None);
            };
            Measure::Distance {
                to: Target::Place(place),
                direction: direction(kind)?,
                between_boxes: between_boxes()?,
            }
        }
        "TimeHeadwayCondition" => Measure::Headway {
            to: other()?,
            direction: ahead(direction(kind)?),
            between_boxes: between_boxes()?,
        },
        "TimeToCollisionCondition" => {
            let Some(to) = collision_target(kind, catalogs, skipped)? else {
                return Ok(None);
            };
            Measure::TimeToCollision {
                to,
                direction: direction(kind)?,
                between_boxes: between_boxes()?,
            }
        }
        _ => {
            skipped.add(kind, "conditions of this kind are not read");
            return Ok(None);
        }
    };
    Ok(Some((measure, rule(kind)?, kind.number("value")?)))
}

/// Entity or place of a `<TimeToCollisionCondition>`; `None` for a place that is not read.
fn collision_target(
    kind: Node,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Target>, DecodeError> {
    let target = kind.needed("TimeToCollisionConditionTarget")?;
    if let Some(entity) = target.first("EntityRef") {
        let name = entity.needed_attribute("entityRef")?;
        return Ok(Some(Target::Entity(name.into_owned())));
    }
    let place = positions::read(target.needed("Position")?, catalogs, skipped)?;
    Ok(place.map(Target::Place))
}

/// An `<RelativeClearanceCondition>`: no other is in the area.
fn clearance(kind: Node) -> Result<(Measure, Rule, f64), DecodeError> {
    let mut with = Vec::new();
    for entity in kind.all("EntityRef") {
        with.push(entity.needed_attribute("entityRef")?.into_owned());
    }
    let lanes = match kind.first("RelativeLaneRange") {
        Some(range) => [
            positions::lanes(range.number_or("from", -100.0)?),
            positions::lanes(range.number_or("to", 100.0)?),
        ],
        None => [0, 0],
    };
    let measure = Measure::Near {
        with,
        ahead_m: kind.number_or("distanceForward", 0.0)?,
        behind_m: kind.number_or("distanceBackward", 0.0)?,
        lanes,
        between_boxes: kind.truth("freeSpace")? || kind.truth("freespace")?,
    };
    Ok((measure, Rule::Less, 1.0))
}

/// An `<AngleCondition>` about a heading.
fn turn(kind: Node, skipped: &mut Skipped) -> Result<Option<(Measure, Rule, f64)>, DecodeError> {
    let is_heading = kind
        .attribute("angleType")?
        .is_none_or(|angle| angle == "heading");
    if !is_heading || kind.name() != "AngleCondition" {
        skipped.add(kind, "only angles of headings are read");
        return Ok(None);
    }
    let measure = Measure::Turn {
        heading_rad: kind.number("angle")?,
        is_relative: !kind.is("coordinateSystem", "world")?,
    };
    Ok(Some((
        measure,
        Rule::LessOrEqual,
        kind.number("angleTolerance")?,
    )))
}

/// Rule of a condition.
fn rule(kind: Node) -> Result<Rule, DecodeError> {
    Ok(match kind.needed_attribute("rule")?.as_ref() {
        "lessThan" => Rule::Less,
        "lessOrEqual" => Rule::LessOrEqual,
        "greaterThan" => Rule::Greater,
        "greaterOrEqual" => Rule::GreaterOrEqual,
        "equalTo" => Rule::Equal,
        "notEqualTo" => Rule::NotEqual,
        other => {
            return Err(kind.fault(format!(
                "the rule {} is unknown; expected lessThan, lessOrEqual, greaterThan, greaterOrEqual, equalTo or \
                 notEqualTo",
                excerpt(other)
            )));
        }
    })
}

fn direction(kind: Node) -> Result<Direction, DecodeError> {
    let system = kind.attribute("coordinateSystem")?;
    let on_lanes = matches!(system.as_deref(), Some("lane" | "road" | "trajectory"));
    Ok(match kind.attribute("relativeDistanceType")?.as_deref() {
        Some("longitudinal") if on_lanes => Direction::AlongLanes,
        Some("longitudinal") => Direction::Ahead,
        Some("lateral") if on_lanes => Direction::AcrossLanes,
        Some("lateral") => Direction::Beside,
        _ if kind.truth("alongRoute")? => Direction::AlongLanes,
        _ => Direction::Straight,
    })
}

/// Direction of a headway, which is never that of a straight line.
fn ahead(direction: Direction) -> Direction {
    match direction {
        Direction::Straight => Direction::Ahead,
        direction => direction,
    }
}
