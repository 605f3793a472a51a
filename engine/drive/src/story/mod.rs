//! Stories in motion: actors and the events that direct them.
//!
//! A step is divided into parts of at most [`PART_S`]. At the beginning of each, conditions are
//! asked in the order of acts and events, then actors move. Everything follows from the story and
//! the motion of the ego, bit by bit.

mod conditions;
mod mover;
mod roads;
mod seen;
mod shapes;
mod signals;
#[cfg(test)]
mod tests;

use std::collections::HashMap;
use std::sync::Arc;

use decouplegs_scene::episode::LightChangeRecord;
use decouplegs_scene::story::{Action, Change, Priority, Story, Task, Trigger};
use decouplegs_scene::{Invalid, LaneMap, VehicleSize, VehicleState};

use self::conditions::{Course, Facts, Past, Watch};
use self::mover::{Mover, Number};
use self::roads::Roads;
use self::seen::{Scene, Seen};
use self::signals::Signals;
use crate::lights::TrafficLights;

/// Longest part of a step, seconds.
const PART_S: f64 = 0.02;

/// An act that waits, runs or has stopped.
#[derive(Clone, Debug)]
struct RunningAct {
    start: Watch,
    stop: Watch,
    has_begun: bool,
    has_stopped: bool,
}

/// An event and what of it goes on.
#[derive(Clone, Debug)]
struct RunningEvent {
    start: Watch,
    executions: u32,
    /// Times at which waits end, and true for other actions that go on, by action.
    open: Vec<bool>,
    waits_s: Vec<Option<f64>>,
}

/// A story in motion.
#[derive(Clone, Debug)]
pub(crate) struct Stage {
    story: Arc<Story>,
    roads: Arc<Roads>,
    movers: Vec<Mover>,
    seen: Vec<Option<Seen>>,
    past: Vec<Past>,
    acts: Vec<RunningAct>,
    stop: Watch,
    is_over: bool,
    events: Vec<RunningEvent>,
    courses: Vec<Course>,
    variables: HashMap<String, String>,
    signals: Signals,
    asks_off_road: bool,
}

impl Stage {
    /// # Errors
    /// A sentence if an actor's lane is not on the map, or there is no light or controller of a
    /// name.
    pub(crate) fn new(
        story: &Story,
        map: &LaneMap,
        lights: &Arc<TrafficLights>,
    ) -> Result<Self, Invalid> {
        let roads = Roads::new(map);
        for actor in &story.actors {
            if let Some(lane) = actor.lane.as_ref().filter(|id| roads.find(id).is_none()) {
                return Err(Invalid::new(format!(
                    "actor {}: the map has no lane {lane}",
                    actor.name
                )));
            }
        }
        let movers: Vec<Mover> = story
            .actors
            .iter()
            .map(|actor| Mover::new(&roads, actor))
            .collect();
        let seen = movers.iter().map(|mover| Some(mover.seen(&roads)));
        let acts = story.acts.iter().map(|act| RunningAct {
            start: Watch::new(&act.start),
            stop: Watch::new(&act.stop),
            has_begun: false,
            has_stopped: false,
        });
        let events = story.events.iter().map(|event| RunningEvent {
            start: Watch::new(&event.start),
            executions: 0,
            open: vec![false; event.actions.len()],
            waits_s: vec![None; event.actions.len()],
        });
        Ok(Self {
            seen: std::iter::once(None).chain(seen).collect(),
            past: vec![Past::default(); movers.len() + 1],
            acts: acts.collect(),
            stop: Watch::new(&story.stop),
            is_over: false,
            events: events.collect(),
            courses: vec![Course::default(); story.events.len()],
            variables: story.variables.iter().cloned().collect(),
            signals: Signals::new(story, lights)?,
            asks_off_road: asks_off_road(story),
            story: Arc::new(story.clone()),
            roads: Arc::new(roads),
            movers,
        })
    }

    /// Traffic lights as they are now.
    pub(crate) fn lights(&self) -> &Arc<TrafficLights> {
        &self.signals.lights
    }

    /// Takes the changes of lights since this was asked last.
    pub(crate) fn take_light_changes(&mut self) -> Vec<LightChangeRecord> {
        std::mem::take(&mut self.signals.changes)
    }

    /// True once the conditions of its end have held.
    pub(crate) fn is_over(&self) -> bool {
        self.is_over
    }

    /// States of the actors; `None` while one is hidden.
    pub(crate) fn states(&self) -> impl Iterator<Item = Option<VehicleState>> {
        let seen = self.movers.iter().zip(&self.seen[1..]);
        seen.map(|(mover, seen)| seen.filter(|_| mover.is_shown).map(|seen| seen.state))
    }

    /// Boxes of the actors, with their states; `None` while one is hidden.
    pub(crate) fn all(&self) -> impl Iterator<Item = Option<(VehicleState, VehicleSize)>> {
        let sizes = self.movers.iter().map(|mover| mover.size);
        self.states()
            .zip(sizes)
            .map(|(state, size)| Some((state?, size)))
    }

    /// Boxes of the actors that are shown, with their states.
    pub(crate) fn shown(&self) -> impl Iterator<Item = (VehicleState, VehicleSize)> {
        self.all().flatten()
    }

    /// Advances from `time_s` by `dt_s` seconds; `ego` is where the ego is at the beginning.
    pub(crate) fn step(
        &mut self,
        time_s: f64,
        dt_s: f64,
        ego: Option<(&VehicleState, &VehicleSize)>,
    ) {
        let center_m = self.story.ego_center_m;
        self.seen[0] = ego.map(|(state, size)| {
            let point_m = state.position_m - center_m * state.ahead();
            Seen {
                state: *state,
                size: *size,
                center_m,
                speed_mps: state.speed_mps,
                place: self.roads.at(point_m, state.yaw_rad),
            }
        });
        let parts = (dt_s / PART_S - 1e-9).ceil().max(1.0);
        for part in 0..parts as u32 {
            let at_s = time_s + f64::from(part) * dt_s / parts;
            self.remember(at_s);
            self.direct(at_s);
            self.move_all(at_s, dt_s / parts);
        }
    }

    fn remember(&mut self, time_s: f64) {
        for (at, (seen, past)) in self.seen.iter().zip(&mut self.past).enumerate() {
            if let Some(seen) = seen {
                let is_at_end = match at {
                    0 => seen.place.is_some_and(|place| self.roads.ends_at(&place)),
                    actor => self.movers[actor - 1].is_at_end,
                };
                let is_off = self.asks_off_road && self.roads.is_off(seen.point_m());
                past.add(seen, is_at_end, is_off, time_s);
            }
        }
    }

    /// Begins and ends acts and events, and then the story.
    fn direct(&mut self, time_s: f64) {
        let story = self.story.clone();
        for (at, act) in story.acts.iter().enumerate() {
            if self.acts[at].has_stopped {
                continue;
            }
            let has_begun = self.acts[at].has_begun
                || self.holds(|stage| &mut stage.acts[at].start, &act.start, time_s);
            self.acts[at].has_begun = has_begun;
            if has_begun
                && !act.stop.is_empty()
                && self.holds(|stage| &mut stage.acts[at].stop, &act.stop, time_s)
            {
                self.acts[at].has_stopped = true;
                for number in 0..story.events.len() {
                    if story.events[number].act == at {
                        self.stop(number, time_s, true);
                    }
                }
            }
        }
        for (course, event) in self.courses.iter_mut().zip(&story.events) {
            course.act_has_begun = self.acts.get(event.act).is_some_and(|act| act.has_begun);
        }
        for (number, event) in story.events.iter().enumerate() {
            let Some(act) = self.acts.get(event.act) else {
                continue;
            };
            let course = self.courses[number];
            if !act.has_begun || act.has_stopped || course.is_over || course.runs {
                continue;
            }
            if self.holds(
                |stage| &mut stage.events[number].start,
                &event.start,
                time_s,
            ) {
                self.begin(&story, number, time_s);
            }
        }
        for number in 0..story.events.len() {
            self.close(&story, number, time_s);
        }
        if !story.stop.is_empty() {
            self.is_over |= self.holds(|stage| &mut stage.stop, &story.stop, time_s);
        }
    }

    /// True if `trigger`, which `watch` remembers, holds now.
    fn holds(
        &mut self,
        watch: impl Fn(&mut Self) -> &mut Watch,
        trigger: &Trigger,
        time_s: f64,
    ) -> bool {
        // Taken out for the question, which borrows what the conditions are about.
        let mut asked = std::mem::take(watch(self));
        let facts = Facts {
            scene: Scene {
                roads: &self.roads,
                all: &self.seen,
            },
            past: &self.past,
            courses: &self.courses,
            variables: &self.variables,
            signals: &self.signals,
            time_s,
        };
        let holds = asked.holds(trigger, &facts);
        *watch(self) = asked;
        holds
    }

    fn begin(&mut self, story: &Story, number: usize, time_s: f64) {
        let event = &story.events[number];
        let beside =
            |&other: &usize| other != number && story.events[other].maneuver == event.maneuver;
        let running: Vec<usize> = (0..story.events.len())
            .filter(beside)
            .filter(|&other| self.courses[other].runs)
            .collect();
        match event.priority {
            Priority::Skip if !running.is_empty() => return,
            Priority::Override => {
                for other in running {
                    self.stop(other, time_s, false);
                }
            }
            Priority::Skip | Priority::Parallel => {}
        }
        self.events[number].executions += 1;
        self.events[number].open.fill(true);
        let course = &mut self.courses[number];
        (course.runs, course.begun_s) = (true, Some(time_s));
        let mut ended = Vec::new();
        for (at, task) in event.actions.iter().enumerate() {
            self.perform((number, at), task, time_s, &mut ended);
        }
        self.mark(&ended);
        self.close(story, number, time_s);
    }

    fn perform(&mut self, number: Number, task: &Task, time_s: f64, ended: &mut Vec<Number>) {
        match &task.action {
            Action::Wait { duration_s } => {
                self.events[number.0].waits_s[number.1] = Some(time_s + duration_s);
            }
            Action::Set {
                variable,
                value,
                by,
            } => {
                let old: Option<f64> = self
                    .variables
                    .get(variable)
                    .and_then(|old| old.trim().parse().ok());
                let new: Option<f64> = value.trim().parse().ok();
                let changed = match (by, old, new) {
                    (Change::Add, Some(old), Some(new)) => (old + new).to_string(),
                    (Change::Multiply, Some(old), Some(new)) => (old * new).to_string(),
                    _ => value.clone(),
                };
                self.variables.insert(variable.clone(), changed);
                ended.push(number);
            }
            Action::Light { light, color } => {
                self.signals.hold(light, *color, time_s);
                ended.push(number);
            }
            Action::Phase { controller, phase } => {
                self.signals.begin(controller, phase, time_s);
                ended.push(number);
            }
            action => {
                let scene = Scene {
                    roads: &self.roads,
                    all: &self.seen,
                };
                let mover = task
                    .of
                    .0
                    .checked_sub(1)
                    .and_then(|at| self.movers.get_mut(at));
                let Some(mover) = mover else {
                    return ended.push(number);
                };
                mover.begin(number, action, (&scene, time_s), ended);
                self.seen[task.of.0] = Some(mover.seen(&self.roads));
            }
        }
    }

    fn mark(&mut self, ended: &[Number]) {
        for &(event, action) in ended {
            self.events[event].open[action] = false;
        }
    }

    /// Ends an event whose actions are over.
    fn close(&mut self, story: &Story, number: usize, time_s: f64) {
        if !self.courses[number].runs {
            return;
        }
        let event = &mut self.events[number];
        for (open, until_s) in event.open.iter_mut().zip(&event.waits_s) {
            if until_s.is_some_and(|until_s| time_s >= until_s - 1e-9) {
                *open = false;
            }
        }
        if event.open.iter().any(|open| *open) {
            return;
        }
        event.start.reset(time_s);
        let course = &mut self.courses[number];
        course.is_over = event.executions >= story.events[number].executions;
        (course.runs, course.ended_s) = (false, Some(time_s));
    }

    /// Ends what an event does; for good, or until its conditions are met again.
    fn stop(&mut self, number: usize, time_s: f64, for_good: bool) {
        for mover in &mut self.movers {
            mover.end(number, &self.roads);
        }
        let event = &mut self.events[number];
        event.open.fill(false);
        event.start.reset(time_s);
        let course = &mut self.courses[number];
        if course.runs {
            (course.runs, course.ended_s) = (false, Some(time_s));
        }
        course.is_over = for_good || event.executions >= self.story.events[number].executions;
    }

    fn move_all(&mut self, time_s: f64, dt_s: f64) {
        let mut ended = Vec::new();
        let mut moved = Vec::with_capacity(self.movers.len());
        // All move on what was seen before.
        let scene = Scene {
            roads: &self.roads,
            all: &self.seen,
        };
        for mover in &mut self.movers {
            mover.advance((&scene, time_s, dt_s), &mut ended);
            moved.push(Some(mover.seen(&self.roads)));
        }
        self.seen.truncate(1);
        self.seen.extend(moved);
        self.mark(&ended);
    }
}

/// True if a condition asks whether someone is off the road.
fn asks_off_road(story: &Story) -> bool {
    use decouplegs_scene::story::{Measure, When};
    let is_off = |when: &When| {
        matches!(
            when,
            When::Value {
                measure: Measure::OffRoad,
                ..
            }
        )
    };
    story.conditions().any(|condition| is_off(&condition.when))
}
