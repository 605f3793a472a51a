//! The story of a file: its actors, acts and events.

use std::collections::HashMap;

use decouplegs_logs::open_scenario::{
    self as file, Along, Entity, Position, StoryEvent, StoryTask, TargetSpeed,
};
use decouplegs_scene::story::{
    Act, Action, Actor, Condition, Dynamics, End, Event, Extent, Measure, Priority, Speed, Spot,
    Story, TargetLane, Task, Trigger, When, Who,
};

use super::{Import, Located};

/// Why an action or a condition cannot be expressed.
type Lost<T> = Result<T, String>;

/// Number of events that are about others than the ego, by what becomes of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counts {
    /// All but those without an effect here.
    pub events: usize,
    /// Events of which each action is driven.
    pub driven: usize,
    /// Events that do nothing that is shown here.
    pub unseen: usize,
}

impl Import<'_> {
    /// The acts and events of the file for `actors`; `whos` are the entities that take part.
    pub(super) fn story(
        &self,
        actors: Vec<Actor>,
        whos: &HashMap<usize, Who>,
        skipped: &mut Vec<String>,
    ) -> (Story, Counts) {
        let cast = Cast { import: self, whos };
        let mut counts = Counts::default();
        let mut story = Story {
            ego_center_m: self.file.entities[self.ego].center_m,
            variables: self.file.variables.clone(),
            actors,
            acts: Vec::new(),
            events: Vec::new(),
        };
        for act in &self.file.acts {
            let start = match &act.start {
                Some(start) => cast.trigger(start).unwrap_or_else(|reason| {
                    skipped.push(reason);
                    never()
                }),
                None => never(),
            };
            let stop = cast.trigger(&act.stop).unwrap_or_else(|reason| {
                skipped.push(reason);
                Trigger::new()
            });
            story.acts.push(Act { start, stop });
        }
        // What happens at the start comes first, in an act of its own.
        story.acts.push(Act::default());
        let mut init = self.event("init", story.acts.len() - 1, usize::MAX);
        for task in &self.file.init {
            match cast.task(task, &mut 0.0) {
                Ok(None) => {}
                Ok(Some(found)) if self.is_at_start(task) => drop(found),
                Ok(Some(found)) => init.actions.push(found),
                Err(reason) => skipped.push(format!("line {}: {reason}", task.line)),
            }
        }
        story.events.push(init);
        let mut ego_mps = self.speed_mps(self.ego);
        for event in &self.file.events {
            let read = self.read_event(event, &cast, &mut ego_mps, skipped);
            let is_of_others = event.actors.iter().any(|actor| *actor != self.ego_name());
            match read.course {
                _ if !is_of_others => {}
                Course::Unseen => counts.unseen += 1,
                Course::Driven => {
                    (counts.events, counts.driven) = (counts.events + 1, counts.driven + 1)
                }
                Course::Lost => counts.events += 1,
            }
            if is_of_others && read.course == Course::Lost {
                skipped.push(format!(
                    "line {}: the event {} is lost, at least in part",
                    event.line, event.name
                ));
            }
            story.events.push(read.event);
        }
        (story, counts)
    }

    fn ego_name(&self) -> &str {
        &self.file.entities[self.ego].name
    }

    fn event(&self, name: &str, act: usize, maneuver: usize) -> Event {
        Event {
            name: name.to_owned(),
            act,
            maneuver: maneuver.min(1_000_000),
            priority: Priority::Parallel,
            executions: 1,
            start: Trigger::new(),
            actions: Vec::new(),
        }
    }

    /// True for speeds at the start, which entities have from the start.
    fn is_at_start(&self, task: &StoryTask) -> bool {
        matches!(
            &task.action,
            file::Action::Speed { target, dynamics }
                if *dynamics == Dynamics::STEP
                    && !matches!(target, TargetSpeed::Relative { continuous: true, .. })
        )
    }

    fn read_event(
        &self,
        event: &StoryEvent,
        cast: &Cast,
        ego_mps: &mut f64,
        skipped: &mut Vec<String>,
    ) -> ReadEvent {
        let mut read = self.event(&event.name, event.act, event.maneuver);
        (read.priority, read.executions) = (event.priority, event.executions.max(1));
        let mut is_lost = event.lost > 0 || self.file.acts[event.act].start.is_none();
        let mut is_seen = false;
        read.start = match event.start.as_ref().map(|start| cast.trigger(start)) {
            Some(Ok(start)) => start,
            Some(Err(reason)) => {
                skipped.push(reason);
                is_lost = true;
                never()
            }
            None => {
                is_lost = true;
                never()
            }
        };
        for task in &event.tasks {
            is_seen |= task.action != file::Action::Unseen && task.actor != self.ego_name();
            match cast.task(task, ego_mps) {
                Ok(found) => read.actions.extend(found),
                Err(reason) => {
                    skipped.push(format!("line {}: {reason}", task.line));
                    is_lost = true;
                }
            }
        }
        let course = match (is_lost, is_seen) {
            (true, _) => Course::Lost,
            (false, true) => Course::Driven,
            (false, false) => Course::Unseen,
        };
        ReadEvent {
            event: read,
            course,
        }
    }
}

/// What becomes of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Course {
    Driven,
    Unseen,
    Lost,
}

struct ReadEvent {
    event: Event,
    course: Course,
}

/// A trigger that is never met.
fn never() -> Trigger {
    vec![vec![Condition {
        edge: Default::default(),
        delay_s: 0.0,
        when: When::Always { holds: false },
    }]]
}

/// Entities of a file as road users of a story.
struct Cast<'a, 'b> {
    import: &'a Import<'b>,
    whos: &'a HashMap<usize, Who>,
}

impl Cast<'_, '_> {
    fn index(&self, name: &str) -> Lost<usize> {
        let found = self.import.locator.find(name);
        found.ok_or_else(|| format!("there is no entity {name}"))
    }

    fn who(&self, name: &str) -> Lost<Who> {
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
    fn sign(&self, name: &str) -> f64 {
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

    fn spot(&self, position: &Position) -> Lost<Spot> {
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
                entity,
                lanes,
                along,
                offset_m,
                ..
            } => {
                let sign = self.sign(entity);
                let lanes = if sign < 0.0 {
                    lanes.saturating_neg()
                } else {
                    *lanes
                };
                let (ahead_m, left_m) = match along {
                    Along::Road(ds_m) => (sign * ds_m, sign * offset_m),
                    Along::Lane(ds_m) => (*ds_m, *offset_m),
                };
                Spot::Lane {
                    who,
                    lanes,
                    ahead_m,
                    left_m: Some(left_m),
                }
            }
            Position::RelativeRoad {
                entity, ds_m, dt_m, ..
            } => {
                let sign = self.sign(entity);
                if *dt_m == 0.0 {
                    Spot::Lane {
                        who,
                        lanes: 0,
                        ahead_m: sign * ds_m,
                        left_m: None,
                    }
                } else {
                    Spot::From {
                        who,
                        offset_m: [sign * ds_m, sign * dt_m],
                        turns: true,
                    }
                }
            }
            _ => return Err("the position counts from an entity in a way that is not read".into()),
        })
    }

    fn trigger(&self, trigger: &file::Trigger) -> Lost<Trigger> {
        let group = |group: &Vec<file::Condition>| -> Lost<Vec<Condition>> {
            let condition = |condition: &file::Condition| {
                self.condition(condition).map_err(|reason| {
                    format!("line {}: the condition is lost: {reason}", condition.line)
                })
            };
            group.iter().map(condition).collect()
        };
        trigger.iter().map(group).collect()
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
            file::When::Always(holds) => When::Always { holds: *holds },
        };
        Ok(Condition {
            edge: condition.edge,
            delay_s: condition.delay_s,
            when,
        })
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

    fn speed(&self, speed: &TargetSpeed) -> Lost<Speed> {
        Ok(match speed {
            TargetSpeed::Absolute(mps) => Speed::Mps(*mps),
            TargetSpeed::Relative {
                entity,
                factor,
                plus_mps,
                continuous,
            } => Speed::Of {
                who: self.who(entity)?,
                factor: *factor,
                plus_mps: *plus_mps,
                continuous: *continuous,
            },
        })
    }

    /// The action of a task; of the ego, its duration alone. `None` if nothing is to be done.
    fn task(&self, task: &StoryTask, ego_mps: &mut f64) -> Lost<Option<Task>> {
        if let file::Action::Set {
            variable,
            value,
            by,
        } = &task.action
        {
            let (variable, value, by) = (variable.clone(), value.clone(), *by);
            let action = Action::Set {
                variable,
                value,
                by,
            };
            return Ok(Some(Task {
                of: Who::EGO,
                action,
            }));
        }
        if task.action == file::Action::Unseen {
            return Ok(None);
        }
        let index = self.index(&task.actor)?;
        if index == self.import.ego {
            let duration_s = self.duration_s(&task.action, ego_mps);
            let action = Action::Wait { duration_s };
            return Ok(Some(Task {
                of: Who::EGO,
                action,
            }));
        }
        let of = self.who(&task.actor)?;
        let action = self.action(&task.action, &self.import.file.entities[index])?;
        Ok(Some(Task { of, action }))
    }

    fn action(&self, action: &file::Action, entity: &Entity) -> Lost<Action> {
        let sign = self.sign(&entity.name);
        Ok(match action {
            file::Action::Speed { target, dynamics } => Action::Speed {
                target: self.speed(target)?,
                dynamics: *dynamics,
            },
            file::Action::Profile {
                times_s,
                speeds_mps,
            } => Action::Profile {
                times_s: times_s.clone(),
                speeds_mps: speeds_mps.clone(),
            },
            file::Action::ChangeLane {
                target,
                offset_m,
                dynamics,
            } => Action::ChangeLane {
                target: match target {
                    file::TargetLane::Absolute(id) => TargetLane::Id(*id),
                    file::TargetLane::Relative { entity, lanes } => TargetLane::Beside {
                        who: self.who(entity)?,
                        lanes: *lanes,
                    },
                },
                offset_m: sign * offset_m,
                dynamics: *dynamics,
            },
            file::Action::Offset {
                offset_m,
                from,
                dynamics,
                continuous,
            } => Action::Offset {
                offset_m: if from.is_some() {
                    *offset_m
                } else {
                    sign * offset_m
                },
                from: from.as_ref().map(|name| self.who(name)).transpose()?,
                dynamics: *dynamics,
                continuous: *continuous,
            },
            file::Action::KeepGap {
                to,
                gap,
                is_time,
                between_boxes,
                side,
                continuous,
                limits,
            } => Action::KeepGap {
                to: self.who(to)?,
                gap: *gap,
                is_time: *is_time,
                between_boxes: *between_boxes,
                side: *side,
                continuous: *continuous,
                limits: *limits,
            },
            file::Action::KeepBeside {
                to,
                distance_m,
                between_boxes,
                side,
                continuous,
                limits,
            } => Action::KeepBeside {
                to: self.who(to)?,
                distance_m: *distance_m,
                between_boxes: *between_boxes,
                side: *side,
                continuous: *continuous,
                limits: *limits,
            },
            file::Action::Arrive {
                with,
                at,
                other_at,
                tolerances_m,
                speed,
                steady_m,
            } => Action::Arrive {
                with: self.who(with)?,
                at: self.spot(at)?,
                other_at: self.spot(other_at)?,
                tolerance_m: tolerances_m[0],
                other_tolerance_m: tolerances_m[1],
                speed: speed.as_ref().map(|speed| self.speed(speed)).transpose()?,
                steady_m: *steady_m,
            },
            file::Action::Follow {
                points,
                times_s,
                is_absolute,
            } => Action::Follow {
                points_m: self.points_m(points)?,
                times_s: times_s.clone().unwrap_or_default(),
                is_absolute: *is_absolute,
            },
            file::Action::Route(points) => Action::Route {
                points_m: self.points_m(points)?,
            },
            file::Action::Teleport(place) => Action::Teleport {
                to: self.spot(place)?,
            },
            file::Action::Show(is_shown) => Action::Show {
                is_shown: *is_shown,
            },
            file::Action::Set { .. } | file::Action::Unseen => {
                return Err("the action is about no entity".into());
            }
        })
    }

    fn points_m(&self, points: &[Position]) -> Lost<Vec<[f64; 2]>> {
        let import = self.import;
        let located = points
            .iter()
            .map(|point| import.locator.locate(point, &import.located));
        located.map(|place| Ok(place?.point_m.to_array())).collect()
    }

    /// Duration of an action of the ego, which drives otherwise; it is that which the file gives.
    fn duration_s(&self, action: &file::Action, ego_mps: &mut f64) -> f64 {
        let of = |dynamics: &Dynamics, change: f64, speed_mps: f64| match dynamics.extent {
            _ if *dynamics == Dynamics::STEP => 0.0,
            Extent::TimeS(time_s) => time_s,
            Extent::RatePerS(rate) => change.abs() / rate,
            Extent::DistanceM(way_m) => way_m / speed_mps,
            Extent::LateralMps2(most) => (6.0 * change.abs() / most).sqrt(),
        };
        let duration_s = match action {
            file::Action::Speed { target, dynamics } => {
                let to_mps = self.import.speed_of(Some(target));
                let from_mps = std::mem::replace(ego_mps, to_mps);
                of(dynamics, to_mps - from_mps, 0.5 * (from_mps + to_mps))
            }
            file::Action::Profile { times_s, .. } => times_s.iter().sum(),
            file::Action::ChangeLane { dynamics, .. } => of(dynamics, LANE_M, *ego_mps),
            file::Action::Offset {
                dynamics, offset_m, ..
            } => of(dynamics, *offset_m, *ego_mps),
            file::Action::Follow {
                times_s: Some(times_s),
                ..
            } => times_s.last().copied().unwrap_or(0.0),
            _ => 0.0,
        };
        if duration_s.is_finite() {
            duration_s.max(0.0)
        } else {
            0.0
        }
    }
}

/// Usual width of a lane, meters.
const LANE_M: f64 = 3.5;

fn point(located: &Located) -> Spot {
    Spot::Point {
        at_m: located.point_m.to_array(),
        heading_rad: Some(located.heading_rad),
    }
}
