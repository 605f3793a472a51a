//! The story of a file: its acts and events.

use std::collections::{HashMap, HashSet};

use decouplegs_logs::open_scenario::{self as file, StoryEvent, StoryTask, TargetSpeed};
use decouplegs_scene::TrafficLight;
use decouplegs_scene::story::{
    Act, Actor, Condition, Dynamics, Edge, Event, LightController, Priority, Story, Tracks,
    Trigger, When, Who,
};

use super::Import;
use super::cast::Cast;

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
        lights: &[TrafficLight],
        skipped: &mut Vec<String>,
    ) -> (Story, Counts) {
        let cast = Cast { import: self, whos };
        let mut counts = Counts::default();
        let mut story = Story {
            ego_center_m: self.file.entities[self.ego].center_m,
            variables: self.file.variables.clone(),
            actors,
            acts: Vec::new(),
            stop: Trigger::new(),
            events: Vec::new(),
            controllers: self.controllers(lights),
            tracks: Tracks::default(),
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
        for group in &self.file.stop {
            match cast.group(group) {
                Ok(group) => story.stop.push(group),
                Err(reason) => skipped.push(format!("{reason}; it does not stop the episode")),
            }
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
                    counts.events += 1;
                    counts.driven += 1;
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

    /// The controllers that something of the story may name.
    fn controllers(&self, lights: &[TrafficLight]) -> Vec<LightController> {
        let are_named = self.file.names_controllers();
        let controllers = self.file.controllers.iter().filter(|_| are_named);
        let names: HashSet<&String> = lights.iter().map(|light| &light.name).collect();
        let is_light = |signal: &&String| names.contains(*signal);
        controllers
            .map(|controller| LightController {
                name: controller.name.clone(),
                phases: controller.phases.clone(),
                offset_s: controller.offset_s,
                lights: controller
                    .signals
                    .iter()
                    .filter(is_light)
                    .cloned()
                    .collect(),
            })
            .collect()
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

/// Fate of an event.
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
        edge: Edge::None,
        delay_s: 0.0,
        when: When::Always { holds: false },
    }]]
}
