//! Actions of vehicles and pedestrians, as behaviors and paths.

use std::collections::HashMap;

use decouplegs_logs::open_scenario::{
    Action, Condition, Direction, Entity, Event, Measure, Position, Rule, Stage, Target,
    TargetLane, Transition,
};
use decouplegs_logs::scenario_file::DURATION_S_MAX;
use decouplegs_scene::Pedestrian;
use decouplegs_scene::scenario::{After, Behavior, LaneSide, Maneuver, Trigger};
use glam::DVec2;

use super::{Import, Located};

/// Deceleration that drivers choose by themselves, m/s^2. Harder braking is a behavior.
const COMFORT_MPS2: f64 = 3.0;
/// Largest deceleration of a vehicle, m/s^2.
const BRAKING_MPS2: f64 = 8.0;
/// Way of a pedestrian with a speed but no path, meters.
const WALK_M: f64 = 30.0;
/// Way and speed of a pedestrian who stands: a path has a length.
const STANDING_M: f64 = 0.02;
const STANDING_MPS: f64 = 0.1;
/// Lane changes of an action: no road has more lanes.
const CHANGES_MAX: u64 = 16;
/// Longest chain of events that wait for each other, and most events that a condition waits for.
const CHAIN_MAX: u32 = 32;
const EVENTS_MAX: usize = 16;
/// Points closer than this are one point of a path, meters.
const STEP_M_MIN: f64 = 0.05;

impl Import<'_> {
    /// Behaviors of a vehicle, from its events.
    pub(super) fn behaviors(
        &self,
        index: usize,
        ego: usize,
        skipped: &mut Vec<String>,
    ) -> Vec<Behavior> {
        let entity = &self.file.entities[index];
        let mut behaviors = Vec::new();
        let mut speed_mps = self.speed_mps(index);
        if !entity.route.is_empty() {
            skipped.push(format!(
                "{}: its route is skipped; it chooses its way at crossings by the seed",
                entity.name
            ));
        }
        // Behaviors that the events before have become.
        let mut done = Done::new();
        for event in &entity.events {
            let line = event.line;
            let Some(trigger) = self.trigger(event, [index, ego], &done) else {
                skipped.push(format!(
                    "line {line}: what triggers the action of {} cannot be expressed",
                    entity.name
                ));
                continue;
            };
            let first = behaviors.len();
            let mut duration_s = event.duration_s;
            match &event.action {
                Action::Speed { target, transition } => {
                    let target_mps = self.speed_of(Some(target)).clamp(0.0, 100.0);
                    if let Some(brake) = brake(speed_mps, target_mps, *transition) {
                        behaviors.push(Behavior {
                            trigger,
                            maneuver: brake,
                        });
                    }
                    let cruise = Maneuver::Cruise {
                        speed_mps: target_mps,
                    };
                    behaviors.push(Behavior {
                        trigger,
                        maneuver: cruise,
                    });
                    duration_s = duration_s.or(change_s(speed_mps, target_mps, *transition));
                    speed_mps = target_mps;
                    self.events_driven.borrow_mut().insert(event.number);
                }
                Action::ChangeLane(target) => match self.lane_changes(target, index, ego) {
                    Ok(changes) => {
                        self.events_driven.borrow_mut().insert(event.number);
                        behaviors.extend(
                            changes
                                .into_iter()
                                .map(|maneuver| Behavior { trigger, maneuver }),
                        );
                    }
                    Err(reason) => skipped.push(format!("line {line}: {reason}")),
                },
                Action::Teleport(place) => match self.teleport(place, entity) {
                    Ok(maneuver) => {
                        behaviors.push(Behavior { trigger, maneuver });
                        self.events_driven.borrow_mut().insert(event.number);
                    }
                    Err(reason) => skipped.push(format!("line {line}: {reason}")),
                },
                Action::Path { .. } => skipped.push(format!(
                    "line {line}: routes and trajectories of vehicles other than the ego are skipped"
                )),
            }
            if behaviors.len() > first {
                let known = done.entry(event.number).or_insert(Became {
                    first,
                    last: first,
                    duration_s: Some(0.0),
                });
                known.last = behaviors.len() - 1;
                known.duration_s = known
                    .duration_s
                    .zip(duration_s)
                    .map(|(known_s, own_s)| known_s.max(own_s));
            }
        }
        behaviors
    }

    /// The maneuver that puts `entity` to `place`.
    ///
    /// # Errors
    /// A sentence that says why that is not known before the episode, or is on no lane.
    fn teleport(&self, place: &Position, entity: &Entity) -> Result<Maneuver, String> {
        if place.other().is_some() {
            return Err("a position relative to an entity that drives is not read".into());
        }
        let found = self.locator.locate(place, &self.located)?;
        let none = || "its position is on no driving lane of the map".to_owned();
        let center = self.center(entity, &found).ok_or_else(none)?;
        let line = self.locator.index.line(center.lane).ok_or_else(none)?;
        Ok(Maneuver::Teleport {
            point_m: line.at(center.at_m).truncate(),
        })
    }

    /// Pedestrian without name and asset.
    pub(super) fn pedestrian(
        &self,
        index: usize,
        from: Located,
        ego: usize,
        skipped: &mut Vec<String>,
    ) -> Pedestrian {
        let entity = &self.file.entities[index];
        let mut speed_mps = self.speed_mps(index);
        let mut start = Trigger::Time { time_s: 0.0 };
        let mut route = entity.route.as_slice();
        for event in &entity.events {
            let Some(trigger) = self.trigger(event, [index, ego], &Done::new()) else {
                skipped.push(format!(
                    "line {}: what triggers the action of {} cannot be expressed",
                    event.line, entity.name
                ));
                continue;
            };
            match &event.action {
                Action::Speed { target, .. } if speed_mps <= 0.0 => {
                    (speed_mps, start) = (self.speed_of(Some(target)), trigger);
                    self.events_driven.borrow_mut().insert(event.number);
                }
                Action::Path { points, .. } if route.is_empty() => {
                    (route, start) = (points, trigger);
                    self.events_driven.borrow_mut().insert(event.number);
                }
                _ => skipped.push(format!(
                    "line {}: {} walks one path at one speed",
                    event.line, entity.name
                )),
            }
        }
        let mut path_m = vec![from.point_m];
        for position in route {
            match self.locator.locate(position, &self.located) {
                Ok(Located { point_m, .. }) => {
                    if point_m.distance(path_m[path_m.len() - 1]) >= STEP_M_MIN {
                        path_m.push(point_m);
                    }
                }
                Err(reason) => skipped.push(format!(
                    "{}: a point of its path is left out: {reason}",
                    entity.name
                )),
            }
        }
        let ahead = DVec2::from_angle(from.heading_rad);
        if path_m.len() == 1 {
            let walks = speed_mps > 0.0;
            path_m.push(from.point_m + ahead * if walks { WALK_M } else { STANDING_M });
        }
        Pedestrian {
            name: String::new(),
            asset: 0,
            size: entity.size,
            path_m,
            speed_mps: speed_mps.clamp(STANDING_MPS, 8.0),
            start,
            waits_for_gap: false,
        }
    }

    /// The trigger of an event of an actor; `None` if it cannot be expressed. `done` are behaviors
    /// that the actor has already.
    fn trigger(&self, event: &Event, parties: [usize; 2], done: &Done) -> Option<Trigger> {
        let mut time_s: f64 = 0.0;
        let mut measured = None;
        for stage in &event.trigger.stages {
            if let Some(reached_s) = self.stage_s(stage, CHAIN_MAX) {
                // Times after a measured value count from when it was met, not before it.
                if measured.is_some() && reached_s > time_s {
                    return None;
                }
                time_s = time_s.max(reached_s);
                continue;
            }
            let [group] = stage.as_slice() else {
                return None;
            };
            for condition in group {
                if let Some(holds_s) = self.condition_s(condition, CHAIN_MAX) {
                    time_s = time_s.max(holds_s);
                } else if measured.replace(condition).is_some() {
                    // One place holds one comparison: two that wait for each other are not
                    // expressed.
                    return None;
                }
            }
        }
        match measured {
            Some(condition) if time_s == 0.0 => self
                .near_ego(condition, parties)
                .or_else(|| after(condition, time_s, done))
                .or_else(|| self.measured(condition, time_s, parties)),
            Some(condition) => {
                after(condition, time_s, done).or_else(|| self.measured(condition, time_s, parties))
            }
            None => Some(Trigger::Time {
                time_s: time_s.min(DURATION_S_MAX),
            }),
        }
    }

    /// Time at which a stage is reached, seconds, if times alone decide it: that of the first of
    /// its groups, whose last condition counts.
    fn stage_s(&self, stage: &Stage, depth: u32) -> Option<f64> {
        let mut first_s: Option<f64> = None;
        for group in stage {
            let mut last_s: f64 = 0.0;
            for condition in group {
                last_s = last_s.max(self.condition_s(condition, depth)?);
            }
            first_s = Some(first_s.map_or(last_s, |first_s| first_s.min(last_s)));
        }
        Some(first_s.unwrap_or(0.0))
    }

    /// Time from which a condition holds, if times alone decide it: its own, or that of the events
    /// that it waits for.
    fn condition_s(&self, condition: &Condition, depth: u32) -> Option<f64> {
        if condition.rule != Rule::Above {
            return None;
        }
        let at_s = match &condition.measure {
            Measure::Time => condition.value,
            Measure::Event { events, has_ended } => {
                let depth = depth.checked_sub(1)?;
                if events.len() > EVENTS_MAX {
                    return None;
                }
                let mut times_s = Vec::new();
                for &number in events.iter() {
                    times_s.push(self.event_s(number, *has_ended, depth)?);
                }
                let times_s = times_s.into_iter();
                match has_ended {
                    true => times_s.reduce(f64::max)?,
                    false => times_s.reduce(f64::min)?,
                }
            }
            _ => return None,
        };
        Some(at_s + condition.delay_s)
    }

    /// Time at which an event begins or ends, if times alone decide it.
    fn event_s(&self, number: usize, has_ended: bool, depth: u32) -> Option<f64> {
        // Each is found once; while it is, one that waits for itself has no time.
        let known = self
            .event_times_s
            .borrow()
            .get(&(number, has_ended))
            .copied();
        if let Some(known) = known {
            return known;
        }
        self.event_times_s
            .borrow_mut()
            .insert((number, has_ended), None);
        let found = self.unknown_event_s(number, has_ended, depth);
        self.event_times_s
            .borrow_mut()
            .insert((number, has_ended), found);
        found
    }

    fn unknown_event_s(&self, number: usize, has_ended: bool, depth: u32) -> Option<f64> {
        let mut last_s: Option<f64> = None;
        for &(entity, at) in self.by_event.get(&number)? {
            let event = &self.file.entities[entity].events[at];
            let mut begin_s: f64 = 0.0;
            for stage in &event.trigger.stages {
                begin_s = begin_s.max(self.stage_s(stage, depth)?);
            }
            let at_s = begin_s + if has_ended { event.duration_s? } else { 0.0 };
            last_s = Some(last_s.map_or(at_s, |last_s| last_s.max(at_s)));
        }
        last_s
    }

    /// The distance of two entities below which a condition holds, if it is about `own`.
    fn near_ego(&self, condition: &Condition, mut own: [usize; 2]) -> Option<Trigger> {
        let Measure::Distance {
            of,
            to: Target::Entity(to),
            direction: Direction::Straight,
            between_boxes,
        } = &condition.measure
        else {
            return None;
        };
        if condition.rule != Rule::Below || condition.delay_s > 0.0 {
            return None;
        }
        let mut pair = [self.locator.find(of)?, self.locator.find(to)?];
        pair.sort_unstable();
        own.sort_unstable();
        let lengths_m: f64 = own
            .iter()
            .map(|&entity| self.file.entities[entity].size.length_m)
            .sum();
        let boxes_m = if *between_boxes { 0.5 * lengths_m } else { 0.0 };
        (pair == own).then_some(Trigger::NearEgo {
            distance_m: (condition.value.max(0.0) + boxes_m).min(10_000.0),
        })
    }

    /// Lane changes that lead to a lane, one after the other. Other entities are on the lanes of
    /// their start.
    fn lane_changes(
        &self,
        target: &TargetLane,
        index: usize,
        ego: usize,
    ) -> Result<Vec<Maneuver>, String> {
        let change = |side: LaneSide| Maneuver::ChangeLane { side };
        if let TargetLane::Relative { entity, lanes } = target {
            let other = self.locator.find(entity);
            if other == Some(ego) && *lanes == 0 {
                return Ok(vec![Maneuver::CutIn]);
            }
            if other == Some(index) {
                let side = if *lanes > 0 {
                    LaneSide::Left
                } else {
                    LaneSide::Right
                };
                return Ok(vec![
                    change(side);
                    lanes.unsigned_abs().min(CHANGES_MAX) as usize
                ]);
            }
        }
        let unknown = || "the lane of its target is unknown".to_owned();
        let spot_of = |entity: usize| self.located[entity].as_ref().ok()?.spot;
        let own = spot_of(index).ok_or_else(unknown)?;
        let wanted = match target {
            TargetLane::Relative { entity, lanes } => {
                let other = self.locator.find(entity).ok_or_else(unknown)?;
                let mut spot = spot_of(other).ok_or_else(unknown)?;
                for _ in 0..lanes.unsigned_abs() {
                    spot = self.locator.beside(spot, *lanes > 0).ok_or_else(unknown)?;
                }
                spot.lane
            }
            TargetLane::Absolute(id) => {
                let listed = &self.map.lanes[own.lane].id;
                let road = listed.rsplit_once('/').ok_or_else(unknown)?.0;
                let wanted = format!("{road}/{id}");
                let mut lanes = self.map.lanes.iter();
                lanes
                    .position(|lane| lane.id == wanted)
                    .ok_or_else(unknown)?
            }
        };
        for side in [LaneSide::Left, LaneSide::Right] {
            let (mut spot, mut sides) = (own, Vec::new());
            while spot.lane != wanted {
                match self.locator.beside(spot, side == LaneSide::Left) {
                    Some(next) if sides.len() < CHANGES_MAX as usize => {
                        spot = next;
                        sides.push(change(side));
                    }
                    _ => break,
                }
            }
            if spot.lane == wanted {
                return Ok(sides);
            }
        }
        Err("its target is no lane beside the one where the vehicle starts".into())
    }
}

/// Behaviors that an event of an agent has become.
struct Became {
    /// Index of the first.
    first: usize,
    /// Index of the last.
    last: usize,
    /// Duration of the longest, seconds, where it is known.
    duration_s: Option<f64>,
}

/// Behaviors of events, by the numbers of these.
type Done = HashMap<usize, Became>;

/// The wait for an event of the same agent, if `condition` is one.
fn after(condition: &Condition, from_s: f64, done: &Done) -> Option<Trigger> {
    let Measure::Event { events, has_ended } = &condition.measure else {
        return None;
    };
    let [number] = events[..] else {
        return None;
    };
    let became = done.get(&number)?;
    // A known duration counts from the begin: the end is that of the file, whatever the traffic.
    let (behavior, is_over, more_s) = match (has_ended, became.duration_s) {
        (false, _) => (became.first, false, 0.0),
        (true, Some(duration_s)) => (became.first, false, duration_s),
        (true, None) => (became.last, true, 0.0),
    };
    let delay_s = condition.delay_s + more_s;
    (delay_s <= DURATION_S_MAX && from_s <= DURATION_S_MAX).then_some(Trigger::After(After {
        behavior,
        is_over,
        from_s,
        delay_s,
    }))
}

/// Duration of a change of speed, seconds; `None` if it never ends.
fn change_s(from_mps: f64, to_mps: f64, transition: Transition) -> Option<f64> {
    let change_mps = (to_mps - from_mps).abs();
    let duration_s = match transition {
        Transition::Step => 0.0,
        Transition::Time(time_s) => time_s,
        Transition::Rate(rate_mps2) => change_mps / rate_mps2,
        Transition::Distance(distance_m) => 2.0 * distance_m / (from_mps + to_mps),
    };
    duration_s.is_finite().then_some(duration_s)
}

/// Braking that a change of speed needs beyond what a driver does by itself.
fn brake(from_mps: f64, to_mps: f64, transition: Transition) -> Option<Maneuver> {
    let less_mps = from_mps - to_mps;
    if less_mps <= 0.0 {
        return None;
    }
    let deceleration_mps2 = match transition {
        Transition::Step => BRAKING_MPS2,
        Transition::Time(time_s) => less_mps / time_s,
        Transition::Rate(rate_mps2) => rate_mps2,
        Transition::Distance(distance_m) => {
            (from_mps * from_mps - to_mps * to_mps) / (2.0 * distance_m)
        }
    }
    .min(BRAKING_MPS2);
    (deceleration_mps2 > COMFORT_MPS2).then_some(Maneuver::Brake {
        deceleration_mps2,
        duration_s: (less_mps / deceleration_mps2).max(0.01),
    })
}
