//! Entities, places and conditions of a file as those of its story.

use std::collections::HashMap;

use decouplegs_logs::open_scenario::{self as file, Along, Position};
use decouplegs_scene::story::{Condition, End, Measure, Spot, Trigger, When, Who};

use super::{Import, Located};

/// Result, or a sentence that says why it cannot be expressed.
pub(super) type Lost<T> = Result<T, String>;

/// Entities of a file as road users of a story.
pub(super) struct Cast<'a, 'b> {
    pub import: &'a Import<'b>,
    pub whos: &'a HashMap<usize, Who>,
}

impl Cast<'_, '_> {
    pub(super) fn index(&self, name: &str) -> Lost<usize> {
        let found = self.import.locator.find(name);
        found.ok_or_else(|| format!("there is no entity {name}"))
    }

    pub(super) fn who(&self, name: &str) -> Lost<Who> {
        let index = self.index(name)?;
        let found = self.whos.get(&index).copied();
        found.ok_or_else(|| format!("{name} takes no part"))
    }

    fn located(&self, name: &str) -> Lost<&Located> {
        let located = &self.import.located[self.index(name)?];
        located
            .as_ref()
            .map_err(|reason| format!("{name}: {reason}"))
    }

    /// 1 if left of an entity at the start is left of its road's reference line, otherwise -1.
    pub(super) fn sign(&self, name: &str) -> f64 {
        let sign = self
            .located(name)
            .map(|located| self.import.locator.sign(located));
        sign.unwrap_or(1.0)
    }

    fn end(&self, target: &file::Target) -> Lost<End> {
        match target {
            file::Target::Place(place) => Ok(End::At(self.spot(place)?)),
            file::Target::Entity(name) => match self.who(name) {
                Ok(who) => Ok(End::Who(who)),
                // An object that stands is a place.
                Err(reason) => {
                    let index = self.index(name)?;
                    if self.import.file.entities[index].kind.is_some() {
                        return Err(reason);
                    }
                    let located = self.located(name)?;
                    Ok(End::At(point(located)))
                }
            },
        }
    }

    pub(super) fn spot(&self, position: &Position) -> Lost<Spot> {
        let moves = position.other().and_then(|name| self.who(name).ok());
        let Some(who) = moves else {
            let import = self.import;
            return Ok(point(&import.locator.locate(position, &import.located)?));
        };
        Ok(match position {
            Position::RelativeEntity {
                offset_m,
                is_in_its_frame,
                ..
            } => Spot::From {
                who,
                offset_m: offset_m.to_array(),
                turns: *is_in_its_frame,
            },
            Position::RelativeLane {
                lanes,
                along,
                offset_m,
                ..
            } => {
                let (on_road, ahead_m) = match along {
                    Along::Road(ds_m) => (true, *ds_m),
                    Along::Lane(ds_m) => (false, *ds_m),
                };
                Spot::Lane {
                    who,
                    lanes: *lanes,
                    ahead_m,
                    on_road,
                    left_m: Some(*offset_m),
                }
            }
            Position::RelativeRoad { ds_m, dt_m, .. } => Spot::Road {
                who,
                along_m: *ds_m,
                left_m: *dt_m,
            },
            _ => return Err("the position counts from an entity in a way that is not read".into()),
        })
    }

    pub(super) fn trigger(&self, trigger: &file::Trigger) -> Lost<Trigger> {
        trigger.iter().map(|group| self.group(group)).collect()
    }

    /// Conditions that have to hold together.
    pub(super) fn group(&self, group: &[file::Condition]) -> Lost<Vec<Condition>> {
        let condition = |condition: &file::Condition| {
            self.condition(condition).map_err(|reason| {
                format!("line {}: the condition is lost: {reason}", condition.line)
            })
        };
        group.iter().map(condition).collect()
    }

    fn condition(&self, condition: &file::Condition) -> Lost<Condition> {
        let when = match &condition.when {
            file::When::Time { rule, value_s } => When::Time {
                rule: *rule,
                value_s: *value_s,
            },
            file::When::Value {
                of,
                all,
                measure,
                rule,
                value,
            } => When::Value {
                of: of.iter().map(|name| self.who(name)).collect::<Lost<_>>()?,
                all: *all,
                measure: self.measure(measure)?,
                rule: *rule,
                value: *value,
            },
            file::When::Events { events, state } => When::Events {
                // The event of the start is the first.
                events: events.iter().map(|event| event + 1).collect(),
                state: *state,
            },
            file::When::Variable {
                variable,
                rule,
                value,
            } => When::Variable {
                variable: variable.clone(),
                rule: *rule,
                value: value.clone(),
            },
            file::When::Signal { signal, color } => When::Light {
                light: signal.clone(),
                color: *color,
            },
            file::When::Phase { controller, phase } => {
                self.check_phase(controller, phase)?;
                When::Phase {
                    controller: controller.clone(),
                    phase: phase.clone(),
                }
            }
            file::When::Always(holds) => When::Always { holds: *holds },
        };
        Ok(Condition {
            edge: condition.edge,
            delay_s: condition.delay_s,
            when,
        })
    }

    /// # Errors
    /// A sentence if the controller has no phase of that name.
    pub(super) fn check_phase(&self, controller: &str, phase: &str) -> Lost<()> {
        let mut controllers = self.import.file.controllers.iter();
        let Some(found) = controllers.find(|one| one.name == controller) else {
            return Err(format!("there is no controller {controller}"));
        };
        match found.phases.iter().any(|(name, _)| name == phase) {
            true => Ok(()),
            false => Err(format!("the controller {controller} has no phase {phase}")),
        }
    }

    fn measure(&self, measure: &file::Measure) -> Lost<Measure> {
        let all = |names: &[String]| -> Lost<Vec<Who>> {
            names.iter().map(|name| self.who(name)).collect()
        };
        Ok(match measure {
            file::Measure::Speed => Measure::Speed,
            file::Measure::Acceleration => Measure::Acceleration,
            file::Measure::RelativeSpeed { to } => Measure::RelativeSpeed { to: self.who(to)? },
            file::Measure::Traveled => Measure::Traveled,
            file::Measure::Standing => Measure::Standing,
            file::Measure::AtEnd => Measure::AtEnd,
            file::Measure::OffRoad => Measure::OffRoad,
            file::Measure::Distance {
                to,
                direction,
                between_boxes,
            } => Measure::Distance {
                to: self.end(to)?,
                direction: *direction,
                between_boxes: *between_boxes,
            },
            file::Measure::Headway {
                to,
                direction,
                between_boxes,
            } => Measure::Headway {
                to: self.who(to)?,
                direction: *direction,
                between_boxes: *between_boxes,
            },
            file::Measure::TimeToCollision {
                to,
                direction,
                between_boxes,
            } => Measure::TimeToCollision {
                to: self.end(to)?,
                direction: *direction,
                between_boxes: *between_boxes,
            },
            file::Measure::Touched { with } => Measure::Touched { with: all(with)? },
            file::Measure::Near {
                with,
                ahead_m,
                behind_m,
                lanes,
                between_boxes,
            } => Measure::Near {
                with: all(with)?,
                ahead_m: *ahead_m,
                behind_m: *behind_m,
                lanes: *lanes,
                between_boxes: *between_boxes,
            },
            file::Measure::Turn {
                heading_rad,
                is_relative,
            } => Measure::Turn {
                heading_rad: *heading_rad,
                is_relative: *is_relative,
            },
        })
    }
}

fn point(located: &Located) -> Spot {
    Spot::Point {
        at_m: located.point_m.to_array(),
        heading_rad: Some(located.heading_rad),
    }
}
