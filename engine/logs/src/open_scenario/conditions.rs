//! Triggers: conditions in groups, of which one has to hold as a whole.

use std::sync::Arc;

use decouplegs_asset::DecodeError;
use decouplegs_asset::xml::{excerpt, finite};

use super::Skipped;
use super::catalogs::Catalogs;
use super::parameters::Node;
use super::positions::{self, Position};

/// Most groups that alternatives of a trigger lead to, and most conditions of a group.
const GROUPS_MAX: usize = 64;

/// Trigger of an event: stages that are reached one after the other, of acts first. A stage
/// without groups is reached at once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EventTrigger {
    /// The stages.
    pub stages: Vec<Stage>,
}

/// Groups of conditions: it is reached when all conditions of one of them hold.
pub type Stage = Vec<Vec<Condition>>;

/// A condition: a measured value is below or above another.
#[derive(Clone, Debug, PartialEq)]
pub struct Condition {
    /// Line in the file, from 1.
    pub line: u32,
    /// The measured value.
    pub measure: Measure,
    /// Comparison with the value.
    pub rule: Rule,
    /// Value that it is compared with, in the unit of the measure.
    pub value: f64,
    /// Time that passes from then on, seconds.
    pub delay_s: f64,
}

/// Comparison of a measured value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Values up to it hold.
    Below,
    /// Values from it on hold.
    Above,
    /// Values like it hold, within what a step changes.
    Equal,
}

/// Direction in which a distance is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Straight line.
    Straight,
    /// Part along the entity's heading, or along its lane.
    Longitudinal,
    /// Part across it.
    Lateral,
}

/// Other end of a distance.
#[derive(Clone, Debug, PartialEq)]
pub enum Target {
    /// An entity, by name.
    Entity(String),
    /// A place.
    Place(Position),
}

/// A value that conditions are about.
#[derive(Clone, Debug, PartialEq)]
pub enum Measure {
    /// Time since the start, seconds.
    Time,
    /// Speed of an entity, m/s.
    Speed {
        /// Name of the entity.
        of: String,
    },
    /// Acceleration of an entity, m/s^2.
    Acceleration {
        /// Name of the entity.
        of: String,
    },
    /// Difference of the speeds of two entities, m/s.
    RelativeSpeed {
        /// Name of the entity.
        of: String,
        /// Name of the one that is subtracted.
        to: String,
    },
    /// Way that an entity has gone since the start, meters.
    Traveled {
        /// Name of the entity.
        of: String,
    },
    /// Time for which an entity stands, seconds.
    Standing {
        /// Name of the entity.
        of: String,
    },
    /// Distance, meters.
    Distance {
        /// Name of the entity that it is measured from.
        of: String,
        /// Other end.
        to: Target,
        /// Direction in which it is measured.
        direction: Direction,
        /// True if it is measured between boxes, not reference points.
        between_boxes: bool,
    },
    /// Distance over the speed of the entity, seconds.
    Headway {
        /// Name of the entity that is behind.
        of: String,
        /// Name of the one ahead.
        to: String,
        /// True if the distance is measured between boxes.
        between_boxes: bool,
    },
    /// Distance over the speed at which it shrinks, seconds.
    TimeToCollision {
        /// Name of the entity.
        of: String,
        /// Entity or place that it would collide with.
        to: Target,
        /// True if the distance is measured between boxes.
        between_boxes: bool,
    },
    /// Time since the first of events began, or since all are over, seconds.
    Event {
        /// Numbers of the events in [`super::OpenScenario::events`].
        events: Arc<[usize]>,
        /// True if it counts from their end.
        has_ended: bool,
    },
}

/// Reference to a part of the storyboard, its events unknown until all of it is read.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct StateReference {
    pub kind: String,
    pub name: String,
}

/// A condition as it is read.
pub(super) enum Read {
    /// One that can be met.
    Condition(Condition),
    /// A condition about the state of a part of the storyboard.
    State(StateReference, Condition),
    /// One that is met or not from the start.
    Constant(bool),
}

/// Makes a trigger of elements that hold one group or more each. `None` if it cannot be expressed:
/// `skipped` says why.
pub(super) fn read(
    triggers: &[Node],
    actor: &str,
    catalogs: &Catalogs,
    states: &dyn Fn(&StateReference) -> Option<Arc<[usize]>>,
    skipped: &mut Skipped,
) -> Result<Option<EventTrigger>, DecodeError> {
    let mut stages = Vec::new();
    for trigger in triggers {
        match stage(*trigger, actor, catalogs, states, skipped)? {
            Some(stage) if stage.is_empty() => {}
            Some(stage) => stages.push(stage),
            None => return Ok(None),
        }
    }
    Ok(Some(EventTrigger { stages }))
}

fn stage(
    trigger: Node,
    actor: &str,
    catalogs: &Catalogs,
    states: &dyn Fn(&StateReference) -> Option<Arc<[usize]>>,
    skipped: &mut Skipped,
) -> Result<Option<Stage>, DecodeError> {
    let mut stage: Stage = Vec::new();
    let (mut has_groups, mut has_lost) = (false, false);
    for group in trigger.all("ConditionGroup") {
        has_groups = true;
        let mut alternatives: Stage = vec![Vec::new()];
        let mut is_possible = true;
        for condition in group.all("Condition") {
            let Some(read) = read_condition(condition, actor, catalogs, skipped)? else {
                is_possible = false;
                has_lost = true;
                break;
            };
            let mut next: Stage = Vec::new();
            for all in read {
                let mut conditions = Vec::new();
                let mut holds = true;
                for one in all {
                    match one {
                        Read::Condition(condition) => conditions.push(condition),
                        Read::Constant(is_met) => holds &= is_met,
                        Read::State(reference, mut one) => {
                            let Some(found) = states(&reference) else {
                                skipped.add(
                                    condition,
                                    &format!(
                                        "the storyboard has no {} {} with events",
                                        reference.kind,
                                        excerpt(&reference.name)
                                    ),
                                );
                                (is_possible, has_lost) = (false, true);
                                continue;
                            };
                            if let Measure::Event { events, .. } = &mut one.measure {
                                *events = found;
                            }
                            conditions.push(one);
                        }
                    }
                }
                if !holds {
                    continue;
                }
                for before in &alternatives {
                    let joined = before.iter().chain(&conditions).cloned().collect();
                    next.push(joined);
                }
            }
            if next.len() > GROUPS_MAX || next.iter().any(|all| all.len() > GROUPS_MAX) {
                skipped.add(
                    group,
                    &format!("more than {GROUPS_MAX} alternatives or conditions are not read"),
                );
                return Ok(None);
            }
            alternatives = next;
        }
        if !is_possible {
            continue;
        }
        if alternatives.iter().any(Vec::is_empty) {
            // Nothing has to happen: the stage is reached at once.
            return Ok(Some(Vec::new()));
        }
        stage.extend(alternatives);
    }
    if stage.len() > GROUPS_MAX {
        skipped.add(
            trigger,
            &format!("more than {GROUPS_MAX} groups are not read"),
        );
        return Ok(None);
    }
    if has_groups && stage.is_empty() {
        if !has_lost {
            skipped.add(trigger, "its conditions are never met");
        }
        return Ok(None);
    }
    Ok(Some(stage))
}

/// Alternatives of a `<Condition>`, each a list of conditions that hold together; `None` if it is
/// of a kind that is not read.
fn read_condition(
    condition: Node,
    actor: &str,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<Vec<Vec<Read>>>, DecodeError> {
    if condition.is("conditionEdge", "falling")? {
        skipped.add(condition, "a condition that ceases to hold is not read");
        return Ok(None);
    }
    let delay_s = condition.number_or("delay", 0.0)?.max(0.0);
    let simple = |measure: Measure, rule: Rule, value: f64| {
        Read::Condition(Condition {
            line: condition.line(),
            measure,
            rule,
            value,
            delay_s,
        })
    };
    let unknown = |skipped: &mut Skipped, kind: Node| {
        skipped.add(kind, "conditions of this kind are not read");
        Ok(None)
    };
    if let Some(by_value) = condition.first("ByValueCondition") {
        let Some(kind) = by_value.elements().next() else {
            return Err(by_value.fault("it is empty; expected a condition"));
        };
        return match kind.name() {
            "SimulationTimeCondition" => {
                let at_s = kind.number("value")?;
                let rule = match rule(kind)? {
                    // Time passes every value once.
                    Some(Rule::Equal) => Some(Rule::Above),
                    rule => rule,
                };
                match rule {
                    Some(rule) => Ok(Some(vec![vec![simple(Measure::Time, rule, at_s)]])),
                    None => unknown(skipped, kind),
                }
            }
            "StoryboardElementStateCondition" => state(kind, condition.line(), delay_s, skipped),
            "ParameterCondition" => {
                let is_met = parameter_condition(kind)?;
                Ok(Some(vec![vec![Read::Constant(is_met)]]))
            }
            _ => unknown(skipped, kind),
        };
    }
    let Some(by_entity) = condition.first("ByEntityCondition") else {
        return Err(condition.fault("it is empty; expected a condition"));
    };
    let triggering = by_entity.needed("TriggeringEntities")?;
    let mut entities: Vec<String> = Vec::new();
    for entity in triggering.all("EntityRef") {
        entities.push(entity.needed_attribute("entityRef")?.into_owned());
    }
    if entities.is_empty() {
        entities.push(actor.to_owned());
    }
    if entities.len() > GROUPS_MAX {
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
    let mut all = Vec::new();
    for entity in entities {
        let Some((measure, rule, value)) = by_entity_kind(kind, &entity, catalogs, skipped)? else {
            return Ok(None);
        };
        all.push(simple(measure, rule, value));
    }
    let is_any = !triggering.is("triggeringEntitiesRule", "all")?;
    Ok(Some(if is_any {
        all.into_iter().map(|one| vec![one]).collect()
    } else {
        vec![all]
    }))
}

/// True if a `<ParameterCondition>` is met: parameters do not change.
fn parameter_condition(kind: Node) -> Result<bool, DecodeError> {
    let found = kind.parameter(kind.element().needed_attribute("parameterRef")?)?;
    let value = kind.needed_attribute("value")?;
    let is_met = match (finite(found.trim()), finite(value.trim())) {
        (Some(found), Some(value)) => match rule(kind)? {
            Some(Rule::Below) => found < value || kind.is("rule", "lessOrEqual")? && found == value,
            Some(Rule::Above) => {
                found > value || kind.is("rule", "greaterOrEqual")? && found == value
            }
            Some(Rule::Equal) => found == value,
            None => found != value,
        },
        _ => (found.trim() == value.trim()) != kind.is("rule", "notEqualTo")?,
    };
    Ok(is_met)
}

fn state(
    kind: Node,
    line: u32,
    delay_s: f64,
    skipped: &mut Skipped,
) -> Result<Option<Vec<Vec<Read>>>, DecodeError> {
    let reference = StateReference {
        kind: kind.needed_attribute("storyboardElementType")?.into_owned(),
        name: kind.needed_attribute("storyboardElementRef")?.into_owned(),
    };
    let has_ended = match &*kind.needed_attribute("state")? {
        "startTransition" | "runningState" => false,
        "endTransition" | "completeState" => true,
        "standbyState" => return Ok(Some(vec![vec![Read::Constant(true)]])),
        _ => {
            skipped.add(
                kind,
                "the states stopTransition and skipTransition are not read",
            );
            return Ok(None);
        }
    };
    let condition = Condition {
        line,
        measure: Measure::Event {
            events: Arc::from([]),
            has_ended,
        },
        rule: Rule::Above,
        value: 0.0,
        delay_s,
    };
    Ok(Some(vec![vec![Read::State(reference, condition)]]))
}

/// Measure, rule and value of an entity condition about `of`; `None` if it is of a kind that is not
/// read.
fn by_entity_kind(
    kind: Node,
    of: &str,
    catalogs: &Catalogs,
    skipped: &mut Skipped,
) -> Result<Option<(Measure, Rule, f64)>, DecodeError> {
    let of = of.to_owned();
    let other = || kind.needed_attribute("entityRef").map(String::from);
    let between_boxes = || kind.truth("freespace");
    let above = |measure: Measure, value: f64| Ok(Some((measure, Rule::Above, value)));
    // Those without a rule.
    match kind.name() {
        "TraveledDistanceCondition" => {
            return above(Measure::Traveled { of }, kind.number("value")?);
        }
        "StandStillCondition" => {
            return above(Measure::Standing { of }, kind.number("duration")?);
        }
        "ReachPositionCondition" => {
            let Some(place) = positions::read(kind.needed("Position")?, catalogs, skipped)? else {
                return Ok(None);
            };
            let measure = Measure::Distance {
                of,
                to: Target::Place(place),
                direction: Direction::Straight,
                between_boxes: false,
            };
            return Ok(Some((measure, Rule::Below, kind.number("tolerance")?)));
        }
        "CollisionCondition" => {
            let Some(to) = kind.first("EntityRef") else {
                skipped.add(kind, "only a collision with an entity by name is read");
                return Ok(None);
            };
            let measure = Measure::Distance {
                of,
                to: Target::Entity(to.needed_attribute("entityRef")?.into_owned()),
                direction: Direction::Straight,
                between_boxes: true,
            };
            return Ok(Some((measure, Rule::Below, 0.0)));
        }
        _ => {}
    }
    let measure = match kind.name() {
        "SpeedCondition" => Measure::Speed { of },
        "AccelerationCondition" => Measure::Acceleration { of },
        "RelativeSpeedCondition" => Measure::RelativeSpeed { of, to: other()? },
        "RelativeDistanceCondition" => Measure::Distance {
            of,
            to: Target::Entity(other()?),
            direction: direction(kind)?,
            between_boxes: between_boxes()?,
        },
        "DistanceCondition" => {
            let Some(place) = positions::read(kind.needed("Position")?, catalogs, skipped)? else {
                return Ok(None);
            };
            Measure::Distance {
                of,
                to: Target::Place(place),
                direction: direction(kind)?,
                between_boxes: between_boxes()?,
            }
        }
        "TimeHeadwayCondition" => Measure::Headway {
            of,
            to: other()?,
            between_boxes: between_boxes()?,
        },
        "TimeToCollisionCondition" => {
            let Some(to) = collision_target(kind, catalogs, skipped)? else {
                return Ok(None);
            };
            Measure::TimeToCollision {
                of,
                to,
                between_boxes: between_boxes()?,
            }
        }
        _ => {
            skipped.add(kind, "conditions of this kind are not read");
            return Ok(None);
        }
    };
    let Some(rule) = rule(kind)? else {
        skipped.add(kind, "the rule notEqualTo is not read");
        return Ok(None);
    };
    Ok(Some((measure, rule, kind.number("value")?)))
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

/// Rule of a condition; `None` for `notEqualTo`.
fn rule(kind: Node) -> Result<Option<Rule>, DecodeError> {
    Ok(match kind.needed_attribute("rule")?.as_ref() {
        "lessThan" | "lessOrEqual" => Some(Rule::Below),
        "greaterThan" | "greaterOrEqual" => Some(Rule::Above),
        "equalTo" => Some(Rule::Equal),
        "notEqualTo" => None,
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
    Ok(match kind.attribute("relativeDistanceType")?.as_deref() {
        Some("longitudinal") => Direction::Longitudinal,
        Some("lateral") => Direction::Lateral,
        _ if kind.truth("alongRoute")? => Direction::Longitudinal,
        _ => Direction::Straight,
    })
}
