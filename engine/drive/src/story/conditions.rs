//! Conditions of events, asked at every step.

use std::collections::{HashMap, VecDeque};

use decouplegs_scene::story::{Condition, Edge, End, Measure, Rule, State, Trigger, When, Who};
use glam::DVec2;

use super::seen::{Scene, Seen};
use super::signals::Signals;
use crate::polyline::wrapped;

/// Speed up to which a road user stands, m/s.
const STANDING_MPS: f64 = 0.01;
/// Numbers that differ by less are equal.
const SAME: f64 = 1e-6;

/// Past of a road user.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Past {
    last_m: Option<DVec2>,
    traveled_m: f64,
    standing_since_s: Option<f64>,
    at_end_since_s: Option<f64>,
    off_road_since_s: Option<f64>,
}

impl Past {
    /// Adds a moment. `is_off_road` is asked only where it counts.
    pub(super) fn add(&mut self, seen: &Seen, is_at_end: bool, is_off_road: bool, time_s: f64) {
        let point_m = seen.point_m();
        if let Some(last_m) = self.last_m {
            self.traveled_m += point_m.distance(last_m);
        }
        self.last_m = Some(point_m);
        let since = |holds: bool, since_s: Option<f64>| holds.then(|| since_s.unwrap_or(time_s));
        self.standing_since_s = since(seen.speed_mps.abs() <= STANDING_MPS, self.standing_since_s);
        self.at_end_since_s = since(is_at_end, self.at_end_since_s);
        self.off_road_since_s = since(is_off_road, self.off_road_since_s);
    }
}

/// Course of an event.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Course {
    pub runs: bool,
    pub is_over: bool,
    pub act_has_begun: bool,
    pub begun_s: Option<f64>,
    pub ended_s: Option<f64>,
}

/// Facts that conditions are about.
pub(super) struct Facts<'a> {
    pub scene: Scene<'a>,
    pub past: &'a [Past],
    pub courses: &'a [Course],
    pub variables: &'a HashMap<String, String>,
    pub signals: &'a Signals,
    pub time_s: f64,
}

/// Memory of a condition.
#[derive(Clone, Debug, Default)]
struct Memory {
    /// Truth of the statement when it was asked last.
    last: Option<bool>,
    /// Values when they were asked last, for equality.
    values: Vec<Option<f64>>,
    /// Times of changes of the condition, and its truth from then on.
    changes: VecDeque<(f64, bool)>,
}

/// Trigger that is asked, and what it remembers.
#[derive(Clone, Debug, Default)]
pub(super) struct Watch {
    memory: Vec<Vec<Memory>>,
    /// Time from which begins and ends of events count, seconds.
    since_s: f64,
}

impl Watch {
    pub(super) fn new(trigger: &Trigger) -> Self {
        let memory = trigger
            .iter()
            .map(|group| vec![Memory::default(); group.len()]);
        Self {
            memory: memory.collect(),
            since_s: f64::NEG_INFINITY,
        }
    }

    /// Forgets what it has seen: events that happen again wait for new changes.
    pub(super) fn reset(&mut self, time_s: f64) {
        self.memory
            .iter_mut()
            .flatten()
            .for_each(|memory| *memory = Memory::default());
        self.since_s = time_s;
    }

    /// True if all conditions of a group hold. All are asked: they remember changes.
    pub(super) fn holds(&mut self, trigger: &Trigger, facts: &Facts) -> bool {
        let since_s = self.since_s;
        let mut any = trigger.is_empty();
        for (group, memory) in trigger.iter().zip(&mut self.memory) {
            let mut all = true;
            for (condition, memory) in group.iter().zip(memory) {
                all &= memory.holds(condition, facts, since_s);
            }
            any |= all;
        }
        any
    }
}

impl Memory {
    fn holds(&mut self, condition: &Condition, facts: &Facts, since_s: f64) -> bool {
        let now = self.is_true(&condition.when, facts, since_s);
        let before = self.last.replace(now);
        let holds = match (condition.edge, before) {
            (Edge::None, _) => now,
            // A change needs a moment before.
            (_, None) => false,
            (Edge::Rising, Some(before)) => now && !before,
            (Edge::Falling, Some(before)) => before && !now,
            (Edge::Either, Some(before)) => before != now,
        };
        if condition.delay_s <= 0.0 {
            return holds;
        }
        if self.changes.back().is_none_or(|(_, last)| *last != holds) {
            self.changes.push_back((facts.time_s, holds));
        }
        let then_s = facts.time_s - condition.delay_s + SAME;
        while self.changes.get(1).is_some_and(|(at_s, _)| *at_s <= then_s) {
            self.changes.pop_front();
        }
        self.changes
            .front()
            .is_some_and(|(at_s, was)| *at_s <= then_s && *was)
    }

    fn is_true(&mut self, when: &When, facts: &Facts, since_s: f64) -> bool {
        match when {
            When::Always { holds } => *holds,
            When::Time { rule, value_s } => match rule {
                // Time passes every value once.
                Rule::Equal => facts.time_s >= value_s - SAME,
                rule => compared(*rule, facts.time_s, *value_s),
            },
            When::Variable {
                variable,
                rule,
                value,
            } => {
                let found = facts.variables.get(variable).map_or("", String::as_str);
                match (found.trim().parse(), value.trim().parse()) {
                    (Ok(found), Ok(value)) => compared(*rule, found, value),
                    _ => (found.trim() == value.trim()) == (*rule != Rule::NotEqual),
                }
            }
            When::Light { light, color } => facts.signals.shows(light, *color, facts.time_s),
            When::Phase { controller, phase } => {
                facts.signals.is_in(controller, phase, facts.time_s)
            }
            When::Events { events, state } => are(events, *state, facts, since_s),
            When::Value {
                of,
                all,
                measure,
                rule,
                value,
            } => {
                self.values.resize(of.len(), None);
                let mut found = of.iter().zip(&mut self.values).map(|(who, last)| {
                    let now = value_of(*who, measure, facts);
                    let before = std::mem::replace(last, now);
                    now.is_some_and(|now| match (rule, before) {
                        // Steps may pass a value without meeting it.
                        (Rule::Equal, Some(before)) if (before < *value) != (now < *value) => true,
                        _ => compared(*rule, now, *value),
                    })
                });
                // All are asked: each remembers its value.
                let met = found.by_ref().filter(|holds| *holds).count();
                if *all { met == of.len() } else { met > 0 }
            }
        }
    }
}

fn compared(rule: Rule, found: f64, value: f64) -> bool {
    match rule {
        Rule::Less => found < value,
        Rule::LessOrEqual => found <= value + SAME,
        Rule::Greater => found > value + SAME * 1e-3,
        Rule::GreaterOrEqual => found >= value - SAME,
        Rule::Equal => (found - value).abs() < SAME,
        Rule::NotEqual => (found - value).abs() >= SAME,
    }
}

fn are(events: &[usize], state: State, facts: &Facts, since_s: f64) -> bool {
    let mut courses = events.iter().filter_map(|&event| facts.courses.get(event));
    let after = |at_s: Option<f64>| at_s.is_some_and(|at_s| at_s > since_s);
    match state {
        State::Begun => courses.any(|course| after(course.begun_s)),
        State::Ended => courses.all(|course| after(course.ended_s) && !course.runs),
        State::Runs => courses.any(|course| course.runs),
        State::Over => courses.all(|course| course.is_over),
        State::Waits => courses.all(|course| !course.runs && !course.is_over),
        State::ActBegun => courses.any(|course| course.act_has_begun),
        State::ActRuns => courses.any(|course| course.act_has_begun && !course.is_over),
        State::ActWaits => courses.all(|course| !course.act_has_begun),
    }
}

/// The value of a road user; `None` while it has none.
fn value_of(who: Who, measure: &Measure, facts: &Facts) -> Option<f64> {
    let scene = &facts.scene;
    let own = scene.get(who)?;
    let past = facts.past.get(who.0)?;
    let since = |since_s: Option<f64>| Some(facts.time_s - since_s?);
    Some(match measure {
        Measure::Speed => own.speed_mps,
        Measure::Acceleration => own.state.acceleration_mps2,
        Measure::RelativeSpeed { to } => own.speed_mps - scene.get(*to)?.speed_mps,
        Measure::Traveled => past.traveled_m,
        Measure::Standing => since(past.standing_since_s)?,
        Measure::AtEnd => since(past.at_end_since_s)?,
        Measure::OffRoad => since(past.off_road_since_s)?,
        Measure::Distance {
            to,
            direction,
            between_boxes,
        } => scene.gap(own, to, *direction, *between_boxes)?.distance_m(),
        Measure::Headway {
            to,
            direction,
            between_boxes,
        } => {
            let gap = scene.gap(own, &End::Who(*to), *direction, *between_boxes)?;
            if gap.signed_m < 0.0 || own.speed_mps <= STANDING_MPS {
                return None;
            }
            gap.distance_m() / own.speed_mps
        }
        Measure::TimeToCollision {
            to,
            direction,
            between_boxes,
        } => scene.gap(own, to, *direction, *between_boxes)?.closes_s()?,
        Measure::Touched { with } => {
            let outline = own.outline();
            let touched =
                others(scene, who, with).filter(|other| other.outline().overlaps(&outline));
            touched.count() as f64
        }
        Measure::Near {
            with,
            ahead_m,
            behind_m,
            lanes,
            between_boxes,
        } => {
            let place = own.place?;
            let near = others(scene, who, with).filter(|other| {
                let Some(found) = scene.roads.along(&place, other.point_m(), &[]) else {
                    return false;
                };
                let boxes_m = 0.5 * (own.size.length_m + other.size.length_m);
                let apart_m = if *between_boxes { boxes_m } else { 0.0 };
                let is_along = (-behind_m - apart_m..=ahead_m + apart_m).contains(&found.x);
                let beside = scene.roads.lanes_to(&place, found.y);
                is_along && beside.is_some_and(|beside| (lanes[0]..=lanes[1]).contains(&beside))
            });
            near.count() as f64
        }
        Measure::Turn {
            heading_rad,
            is_relative,
        } => {
            let from_rad = match is_relative {
                true => scene.roads.pose(&own.place?).1,
                false => 0.0,
            };
            wrapped(own.state.yaw_rad - from_rad - heading_rad).abs()
        }
    })
}

fn others<'a>(scene: &'a Scene, who: Who, with: &'a [Who]) -> impl Iterator<Item = &'a Seen> {
    let all = scene.all.iter().enumerate();
    let counts = move |at: usize| at != who.0 && (with.is_empty() || with.contains(&Who(at)));
    all.filter(move |(at, _)| counts(*at))
        .filter_map(|(_, seen)| seen.as_ref())
}
