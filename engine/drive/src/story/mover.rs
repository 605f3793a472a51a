//! One actor in motion: its way, its speed, and the actions that change them.

use decouplegs_scene::VehicleState;
use decouplegs_scene::story::{
    Action, Actor, Dynamics, End, Limits, Shape, Side, Speed, TargetLane, Who,
};
use decouplegs_scene::story::{Direction, Extent, Spot};
use glam::DVec2;

use super::roads::{OnLane, Roads};
use super::seen::{Scene, Seen};
use super::shapes::Transition;
use crate::polyline::{Polyline, wrapped};

/// Difference of a gap that counts as none, meters, and of a speed, m/s.
const GAP_REACHED_M: f64 = 0.1;
const SPEED_REACHED_MPS: f64 = 0.1;
/// Pull of a gap that is to be reached, per meter, as a share of the largest acceleration.
const GAP_PULL: f64 = 0.4;
/// Lateral speed at which a distance beside another is reached without limits of it, m/s.
const BESIDE_PULL_PER_S: f64 = 1.0;

/// Way that an actor is on.
#[derive(Clone, Debug)]
pub(super) enum Way {
    /// Along lanes.
    Lane(OnLane),
    /// Along a line, meters along it.
    Line(Box<Polyline>, f64),
    /// Straight on.
    Free(DVec2, f64),
}

/// Number of an action: its event, and its place among the event's actions.
pub(super) type Number = (usize, usize);

/// Action that goes on.
#[derive(Clone, Debug)]
pub(super) struct Job<T> {
    pub number: Number,
    kind: T,
}

/// What happens to the speed.
#[derive(Clone, Debug)]
enum Along {
    Change {
        to: Transition,
        target: Speed,
    },
    Profile {
        times_s: Vec<f64>,
        speeds_mps: Vec<f64>,
        part: usize,
        change: Transition,
    },
    Gap {
        to: Who,
        gap: f64,
        is_time: bool,
        between_boxes: bool,
        side: f64,
        continuous: bool,
        limits: Limits,
    },
    Arrive {
        with: Who,
        at: Spot,
        other_at: Spot,
        tolerances_m: [f64; 2],
        speed: Option<Speed>,
        steady_m: f64,
        last_m: [f64; 2],
    },
}

/// What happens to the offset.
#[derive(Clone, Debug)]
enum Across {
    Change {
        to: Transition,
        continuous: bool,
    },
    Beside {
        to: Who,
        left_m: f64,
        continuous: bool,
        limits: Limits,
    },
}

/// Times of a line that is followed.
#[derive(Clone, Debug)]
struct Timed {
    points_m: Vec<DVec2>,
    times_s: Vec<f64>,
    /// Time that counts as zero, seconds.
    from_s: f64,
}

/// Actor in motion.
#[derive(Clone, Debug)]
pub(super) struct Mover {
    pub size: decouplegs_scene::VehicleSize,
    pub center_m: f64,
    pub way: Way,
    /// Heading beside that of the way, radians.
    turn_rad: f64,
    /// Speed to the left, m/s.
    left_mps: f64,
    pub speed_mps: f64,
    acceleration_mps2: f64,
    pub is_shown: bool,
    /// True at the end of its lanes.
    pub is_at_end: bool,
    limits: Limits,
    route: Vec<usize>,
    along: Option<Job<Along>>,
    across: Option<Job<Across>>,
    follow: Option<Job<Option<Timed>>>,
}

impl Mover {
    pub(super) fn new(roads: &Roads, actor: &Actor) -> Self {
        let point_m = DVec2::from_array(actor.point_m);
        let lane = actor.lane.as_ref().and_then(|id| roads.find(id));
        let place = lane.and_then(|lane| roads.on(lane, point_m, actor.heading_rad));
        let turn_rad = place.map_or(0.0, |place| {
            wrapped(actor.heading_rad - roads.pose(&place).1)
        });
        Self {
            size: actor.size(),
            center_m: actor.center_m,
            way: place.map_or(Way::Free(point_m, actor.heading_rad), Way::Lane),
            // Lines of lanes are chords: what is less than they can tell is no turn.
            turn_rad: if turn_rad.abs() < 0.02 { 0.0 } else { turn_rad },
            left_mps: 0.0,
            speed_mps: actor.speed_mps,
            acceleration_mps2: 0.0,
            is_shown: true,
            is_at_end: false,
            limits: actor.limits,
            route: Vec::new(),
            along: None,
            across: None,
            follow: None,
        }
    }

    /// Reference point and heading of the way.
    fn pose(&self, roads: &Roads) -> (DVec2, f64) {
        match &self.way {
            Way::Lane(place) => roads.pose(place),
            Way::Line(line, at_m) => (line.at(*at_m).truncate(), line.heading_at(*at_m)),
            Way::Free(point_m, heading_rad) => (*point_m, *heading_rad),
        }
    }

    pub(super) fn seen(&self, roads: &Roads) -> Seen {
        let (point_m, way_rad) = self.pose(roads);
        let drift_rad = match self.left_mps {
            0.0 => 0.0,
            left_mps => left_mps.atan2(self.speed_mps.abs().max(0.1)),
        };
        let yaw_rad = wrapped(way_rad + self.turn_rad + drift_rad);
        Seen {
            state: VehicleState {
                position_m: point_m + self.center_m * DVec2::from_angle(yaw_rad),
                yaw_rad,
                // No vehicle here drives backwards: one that does seems to stand.
                speed_mps: self.speed_mps.max(0.0),
                acceleration_mps2: self.acceleration_mps2,
            },
            size: self.size,
            center_m: self.center_m,
            speed_mps: self.speed_mps,
            place: match self.way {
                Way::Lane(place) => Some(place),
                _ => roads.at(point_m, yaw_rad),
            },
        }
    }

    /// Begins an action. Numbers of actions that end by it are added to `ended`; the action itself
    /// is among them if it takes no time.
    pub(super) fn begin(
        &mut self,
        number: Number,
        action: &Action,
        (scene, time_s): (&Scene, f64),
        ended: &mut Vec<Number>,
    ) {
        match action {
            Action::Speed { target, dynamics } => {
                let Some(to_mps) = speed_of(target, scene) else {
                    return ended.push(number);
                };
                let to = Transition::of_speed(self.speed_mps, to_mps, *dynamics);
                if to.is_done() {
                    self.speed_mps = to_mps;
                }
                self.go(
                    number,
                    Along::Change {
                        to,
                        target: *target,
                    },
                    ended,
                );
            }
            Action::Profile {
                times_s,
                speeds_mps,
            } if !times_s.is_empty() => {
                let profile = Along::Profile {
                    times_s: times_s.clone(),
                    speeds_mps: speeds_mps.clone(),
                    part: 0,
                    change: part(self.speed_mps, speeds_mps[0], times_s[0]),
                };
                self.go(number, profile, ended);
            }
            Action::KeepGap {
                to,
                gap,
                is_time,
                between_boxes,
                side,
                continuous,
                limits,
            } => {
                let side = match side {
                    Side::LeftOrBehind => 1.0,
                    Side::RightOrAhead => -1.0,
                    Side::Any => self.side_of(scene, *to, Direction::AlongLanes),
                };
                let (to, gap, is_time) = (*to, *gap, *is_time);
                let (between_boxes, continuous, limits) = (*between_boxes, *continuous, *limits);
                let keep = Along::Gap {
                    to,
                    gap,
                    is_time,
                    between_boxes,
                    side,
                    continuous,
                    limits,
                };
                self.go(number, keep, ended);
            }
            Action::Arrive {
                with,
                at,
                other_at,
                tolerance_m,
                other_tolerance_m,
                speed,
                steady_m,
            } => {
                let arrive = Along::Arrive {
                    with: *with,
                    at: *at,
                    other_at: *other_at,
                    tolerances_m: [*tolerance_m, *other_tolerance_m],
                    speed: *speed,
                    steady_m: *steady_m,
                    last_m: [f64::INFINITY; 2],
                };
                self.go(number, arrive, ended);
            }
            Action::Follow {
                points_m,
                times_s,
                is_absolute,
            } => {
                let from_s = if *is_absolute { 0.0 } else { time_s };
                self.follow_line(number, points_m, times_s, from_s, ended);
            }
            Action::ChangeLane { .. } | Action::Offset { .. } | Action::KeepBeside { .. } => {
                let found = self.aside(action, scene);
                ended.extend(self.across.take().map(|old| old.number));
                self.across = found.map(|kind| Job { number, kind });
                if self.across.is_none() {
                    ended.push(number);
                }
            }
            Action::Route { points_m } => {
                if let Way::Lane(place) = self.way {
                    let points_m: Vec<DVec2> =
                        points_m.iter().copied().map(DVec2::from_array).collect();
                    self.route = scene.roads.route(&place, &points_m);
                }
                ended.push(number);
            }
            Action::Teleport { to } => {
                if let Some((point_m, heading_rad)) = scene.spot(to) {
                    self.stop_following(ended);
                    ended.extend(self.across.take().map(|old| old.number));
                    self.settle(scene.roads, point_m, heading_rad);
                }
                ended.push(number);
            }
            Action::Show { is_shown } => {
                self.is_shown = *is_shown;
                ended.push(number);
            }
            // Those that are no motion of an actor.
            Action::Profile { .. } | Action::Set { .. } | Action::Wait { .. } => ended.push(number),
        }
    }

    fn go(&mut self, number: Number, kind: Along, ended: &mut Vec<Number>) {
        ended.extend(
            self.along
                .replace(Job { number, kind })
                .map(|old| old.number),
        );
    }

    /// 1 if it is behind another, -1 if ahead of it; to the right of it, or left.
    fn side_of(&self, scene: &Scene, to: Who, direction: Direction) -> f64 {
        let own = self.seen(scene.roads);
        let found = scene.gap(&own, &End::Who(to), direction, false);
        let across = direction == Direction::AcrossLanes;
        let fallback = if across {
            Direction::Beside
        } else {
            Direction::Ahead
        };
        let found = found.or_else(|| scene.gap(&own, &End::Who(to), fallback, false));
        found.map_or(1.0, |gap| if gap.signed_m < 0.0 { -1.0 } else { 1.0 })
    }

    fn follow_line(
        &mut self,
        number: Number,
        points_m: &[[f64; 2]],
        times_s: &[f64],
        from_s: f64,
        ended: &mut Vec<Number>,
    ) {
        let points_m: Vec<DVec2> = points_m.iter().copied().map(DVec2::from_array).collect();
        let line = Polyline::new(points_m.iter().map(|point| point.extend(0.0)));
        self.stop_following(ended);
        ended.extend(self.across.take().map(|old| old.number));
        let Some(line) = line else {
            return ended.push(number);
        };
        (self.turn_rad, self.left_mps) = (0.0, 0.0);
        self.way = Way::Line(Box::new(line), 0.0);
        let timed = (times_s.len() == points_m.len()).then(|| Timed {
            points_m,
            times_s: times_s.to_vec(),
            from_s,
        });
        if timed.is_some() {
            ended.extend(self.along.take().map(|old| old.number));
        }
        self.follow = Some(Job {
            number,
            kind: timed,
        });
    }

    fn stop_following(&mut self, ended: &mut Vec<Number>) {
        ended.extend(self.follow.take().map(|old| old.number));
    }

    /// Puts it to a point, on the lane there if there is one.
    fn settle(&mut self, roads: &Roads, point_m: DVec2, heading_rad: f64) {
        (self.turn_rad, self.left_mps) = (0.0, 0.0);
        self.way = match roads.at(point_m, heading_rad) {
            Some(place) => {
                let turn_rad = wrapped(heading_rad - roads.pose(&place).1);
                self.turn_rad = if turn_rad.abs() < 0.05 { 0.0 } else { turn_rad };
                Way::Lane(place)
            }
            None => Way::Free(point_m, heading_rad),
        };
    }

    /// The change of offset that an action asks for; `None` if it is on no lane, or there is no
    /// such lane.
    fn aside(&mut self, action: &Action, scene: &Scene) -> Option<Across> {
        let Way::Lane(place) = &mut self.way else {
            return None;
        };
        let roads = scene.roads;
        let (continuous, to_m, dynamics) = match action {
            Action::ChangeLane {
                target,
                offset_m,
                dynamics,
            } => {
                let lane = match *target {
                    TargetLane::Id(id) => roads.by_number(place, id)?,
                    TargetLane::Beside { who, lanes } => {
                        let other = scene.get(who)?;
                        let from = other.place?;
                        let lane = roads.beside(&from, lanes)?;
                        // The other may be on another section: the lane there that is as far aside.
                        let there = roads.on(lane, other.point_m(), other.state.yaw_rad)?;
                        let middle = OnLane {
                            left_m: 0.0,
                            ..there
                        };
                        match roads.along(place, roads.pose(&middle).0, &self.route) {
                            Some(found) => {
                                let lanes = roads.lanes_to(place, found.y)?;
                                roads.beside(place, lanes)?
                            }
                            None => lane,
                        }
                    }
                };
                let (point_m, heading_rad) = roads.pose(place);
                *place = roads.on(lane, point_m, heading_rad)?;
                (false, *offset_m, *dynamics)
            }
            Action::Offset {
                offset_m,
                from,
                dynamics,
                continuous,
            } => {
                let from_m = match from {
                    Some(who) => {
                        let found = roads.along(place, scene.get(*who)?.point_m(), &self.route)?;
                        found.y
                    }
                    None => 0.0,
                };
                (*continuous, from_m + offset_m, *dynamics)
            }
            Action::KeepBeside {
                to,
                distance_m,
                between_boxes,
                side,
                continuous,
                limits,
            } => {
                let width_m = scene.get(*to)?.size.width_m + self.size.width_m;
                let apart_m = distance_m + if *between_boxes { 0.5 * width_m } else { 0.0 };
                // Left of the other, or right of it.
                let left = match side {
                    Side::LeftOrBehind => 1.0,
                    Side::RightOrAhead => -1.0,
                    Side::Any => -self.side_of(scene, *to, Direction::AcrossLanes),
                };
                let (continuous, limits) = (*continuous, *limits);
                return Some(Across::Beside {
                    to: *to,
                    left_m: left * apart_m,
                    continuous,
                    limits,
                });
            }
            _ => return None,
        };
        self.turn_rad = 0.0;
        let from_m = place.sign() * place.left_m;
        let to = Transition::new(from_m, to_m, dynamics);
        Some(Across::Change { to, continuous })
    }

    /// Advances by `dt_s`. Numbers of actions that end are added to `ended`.
    pub(super) fn advance(
        &mut self,
        (scene, time_s, dt_s): (&Scene, f64, f64),
        ended: &mut Vec<Number>,
    ) {
        if self.advance_timed(scene.roads, time_s + dt_s, dt_s, ended) {
            return;
        }
        let before_mps = self.speed_mps;
        self.change_speed(scene, dt_s, ended);
        self.acceleration_mps2 = (self.speed_mps - before_mps) / dt_s;
        let way_m = 0.5 * (before_mps + self.speed_mps) * dt_s;
        let aside_m = self.move_aside(scene, dt_s, way_m, ended);
        let ahead_m = way_m.signum() * (way_m * way_m - aside_m * aside_m).max(0.0).sqrt();
        match &mut self.way {
            Way::Lane(place) => {
                // A turn of the heading leads no other way; it is where it looks.
                self.is_at_end = !scene.roads.advance(place, ahead_m, &self.route);
            }
            Way::Line(line, at_m) => {
                *at_m += ahead_m;
                if *at_m >= line.length_m() {
                    let more_m = *at_m - line.length_m();
                    let end = (line.at(*at_m).truncate(), line.heading_at(*at_m));
                    self.stop_following(ended);
                    self.settle(scene.roads, end.0, end.1);
                    if let Way::Lane(place) = &mut self.way {
                        scene.roads.advance(place, more_m, &self.route);
                    }
                }
            }
            Way::Free(point_m, heading_rad) => {
                *point_m += ahead_m * DVec2::from_angle(*heading_rad)
            }
        }
    }

    /// Advances along a line with times. False if it follows none.
    fn advance_timed(
        &mut self,
        roads: &Roads,
        time_s: f64,
        dt_s: f64,
        ended: &mut Vec<Number>,
    ) -> bool {
        let Some(Job {
            kind: Some(timed), ..
        }) = &self.follow
        else {
            return false;
        };
        let at_s = time_s - timed.from_s;
        let last = timed.times_s.len() - 1;
        let next = timed.times_s.partition_point(|&time_s| time_s <= at_s);
        let (from, to) = (next.saturating_sub(1).min(last), next.min(last));
        let part_s = timed.times_s[to] - timed.times_s[from];
        let share = if part_s > 0.0 {
            (at_s - timed.times_s[from]) / part_s
        } else {
            0.0
        };
        let (a, b) = (timed.points_m[from], timed.points_m[to]);
        let point_m = a.lerp(b, share.clamp(0.0, 1.0));
        // Vertices at one place keep the heading.
        let heading_rad = match (b - a).length() > 1e-6 {
            true => (b - a).to_angle(),
            false => self.pose(roads).1,
        };
        let (is_over, over_s) = (at_s >= timed.times_s[last], at_s - timed.times_s[last]);
        let speed_mps = if part_s > 0.0 {
            a.distance(b) / part_s
        } else {
            0.0
        };
        if !is_over || last == 0 {
            self.acceleration_mps2 = (speed_mps - self.speed_mps) / dt_s;
            self.speed_mps = speed_mps;
        } else {
            self.acceleration_mps2 = 0.0;
        }
        self.way = Way::Free(point_m, heading_rad);
        if is_over {
            self.stop_following(ended);
            let more_m = self.speed_mps * over_s.max(0.0);
            self.settle(roads, point_m, heading_rad);
            if let Way::Lane(place) = &mut self.way {
                roads.advance(place, more_m, &self.route);
            }
        }
        true
    }

    fn change_speed(&mut self, scene: &Scene, dt_s: f64, ended: &mut Vec<Number>) {
        let Some(mut job) = self.along.take() else {
            return;
        };
        let goes_on = match &mut job.kind {
            Along::Change { to, target } => self.follow_change(to, target, scene, dt_s),
            Along::Profile {
                times_s,
                speeds_mps,
                part: at,
                change,
            } => {
                change.advance(dt_s, 0.0);
                self.speed_mps = change.value();
                if change.is_done() {
                    *at += 1;
                    if *at < times_s.len() {
                        *change = part(self.speed_mps, speeds_mps[*at], times_s[*at]);
                    }
                }
                *at < times_s.len()
            }
            Along::Gap { .. } => self.keep_gap(&job.kind, scene, dt_s),
            Along::Arrive { .. } => self.arrive(&mut job.kind, scene, dt_s),
        };
        if goes_on {
            self.along = Some(job);
        } else {
            ended.push(job.number);
        }
    }

    /// Goes on with a change of speed; false once it is over.
    fn follow_change(
        &mut self,
        to: &mut Transition,
        target: &Speed,
        scene: &Scene,
        dt_s: f64,
    ) -> bool {
        let follows = matches!(
            target,
            Speed::Of {
                continuous: true,
                ..
            }
        );
        if let (Speed::Of { .. }, Some(found_mps)) = (target, speed_of(target, scene)) {
            to.to = found_mps;
        }
        let (before_mps, was_done) = (self.speed_mps, to.is_done());
        to.advance(dt_s, 0.0);
        let wanted_mps = to.value();
        if was_done && !follows {
            self.speed_mps = to.to;
            return false;
        }
        let limits = self.limits;
        let change_mps = wanted_mps - before_mps;
        let most = |limit: Option<f64>| limit.map_or(f64::INFINITY, |limit| limit * dt_s + 1e-9);
        let bounded_mps = change_mps
            .min(most(limits.acceleration_mps2))
            .max(-most(limits.deceleration_mps2));
        if bounded_mps != change_mps {
            // What the limits keep from it comes later.
            to.advance(-dt_s * (1.0 - bounded_mps / change_mps), 0.0);
        }
        self.speed_mps = before_mps + bounded_mps;
        if let Some(most_mps) = limits.speed_mps {
            self.speed_mps = self.speed_mps.clamp(-most_mps, most_mps);
        }
        follows || !to.is_done() || bounded_mps != change_mps
    }

    /// Keeps a gap; false once it is reached, if that is enough.
    fn keep_gap(&mut self, kind: &Along, scene: &Scene, dt_s: f64) -> bool {
        let Along::Gap {
            to,
            gap,
            is_time,
            between_boxes,
            side,
            continuous,
            limits,
        } = kind
        else {
            return false;
        };
        let own = self.seen(scene.roads);
        let (Some(other), end) = (scene.get(*to), End::Who(*to)) else {
            return false;
        };
        let boxes = *between_boxes;
        let found = scene.gap(&own, &end, Direction::AlongLanes, boxes);
        let Some(found) = found.or_else(|| scene.gap(&own, &end, Direction::Ahead, boxes)) else {
            return *continuous;
        };
        let wanted_m = if *is_time {
            gap * other.speed_mps.abs()
        } else {
            *gap
        };
        let more_m = found.signed_m.signum() * found.distance_m() - side * wanted_m;
        let limited = limits.acceleration_mps2.zip(limits.deceleration_mps2);
        let Some((most, least)) = limited else {
            if let Way::Lane(place) = &mut self.way {
                scene.roads.advance(place, more_m, &self.route);
            }
            self.speed_mps = other.speed_mps;
            return *continuous;
        };
        // A spring with the damping that lets it settle soonest.
        let pull = GAP_PULL * if more_m < 0.0 { most } else { least };
        let faster_mps = self.speed_mps - other.speed_mps;
        let wanted_mps2 = pull * more_m - 2.0 * pull.sqrt() * faster_mps;
        self.speed_mps += wanted_mps2.clamp(-least, most) * dt_s;
        if let Some(limit_mps) = limits.speed_mps {
            self.speed_mps = self.speed_mps.clamp(-limit_mps, limit_mps);
        }
        *continuous || more_m.abs() > GAP_REACHED_M || faster_mps.abs() > SPEED_REACHED_MPS
    }

    /// Speed for an arrival together with another; false once it or the other has arrived.
    fn arrive(&mut self, kind: &mut Along, scene: &Scene, dt_s: f64) -> bool {
        let Along::Arrive {
            with,
            at,
            other_at,
            tolerances_m,
            speed,
            steady_m,
            last_m,
        } = kind
        else {
            return false;
        };
        let (Some((at_m, _)), Some((other_m, _))) = (scene.spot(at), scene.spot(other_at)) else {
            return false;
        };
        let own = self.seen(scene.roads);
        let Some(other) = scene.get(*with) else {
            return false;
        };
        let left_m = |seen: &Seen, point_m: DVec2, route: &[usize]| {
            let along = seen
                .place
                .and_then(|place| scene.roads.along(&place, point_m, route));
            along.map_or(seen.point_m().distance(point_m), |found| found.x.abs())
        };
        let own_m = match &self.way {
            Way::Line(line, arc_m) => (line.project(at_m).arc_m - arc_m).abs(),
            _ => left_m(&own, at_m, &self.route),
        };
        let ways_m = [own_m, left_m(other, other_m, &[])];
        let has_arrived = ways_m
            .iter()
            .zip(&*tolerances_m)
            .any(|(way_m, within_m)| way_m < within_m);
        let has_missed = ways_m
            .iter()
            .zip(&*last_m)
            .any(|(way_m, last_m)| *way_m > last_m + 1e-6);
        *last_m = ways_m;
        let final_mps = speed.as_ref().and_then(|speed| speed_of(speed, scene));
        let own_m = (ways_m[0] - tolerances_m[0]).max(1e-6);
        let time_s = (ways_m[1] - tolerances_m[1]).max(0.0) / other.speed_mps.max(0.0);
        if has_arrived || has_missed || time_s < dt_s {
            self.speed_mps = final_mps.unwrap_or(self.speed_mps);
            return false;
        }
        self.speed_mps = match final_mps {
            _ if !time_s.is_finite() => 0.0,
            None => own_m / time_s,
            Some(final_mps) => {
                let steady_s = *steady_m / final_mps;
                if *steady_m > 0.0 && (own_m <= *steady_m || time_s <= steady_s) {
                    final_mps
                } else {
                    let (way_m, left_s) = (
                        own_m - *steady_m,
                        time_s - if *steady_m > 0.0 { steady_s } else { 0.0 },
                    );
                    let rate_mps2 = arrival_mps2(self.speed_mps, final_mps, way_m, left_s);
                    (self.speed_mps + rate_mps2 * dt_s).max(0.0)
                }
            }
        };
        true
    }

    /// Moves it aside; the way to the side, meters.
    fn move_aside(&mut self, scene: &Scene, dt_s: f64, way_m: f64, ended: &mut Vec<Number>) -> f64 {
        self.left_mps = 0.0;
        let (Some(mut job), Way::Lane(place)) = (self.across.take(), &mut self.way) else {
            return 0.0;
        };
        let before_m = place.sign() * place.left_m;
        let (left_m, goes_on, counts) = match &mut job.kind {
            Across::Change { to, continuous } => {
                let rate = to.rate(way_m.abs() / dt_s);
                let ahead_m = (way_m * way_m - (rate * dt_s).powi(2)).max(0.0).sqrt();
                let was_done = to.is_done();
                to.advance(dt_s, ahead_m);
                self.left_mps = if to.is_done() {
                    0.0
                } else {
                    to.rate(way_m.abs() / dt_s)
                };
                (to.value(), *continuous || !to.is_done(), !was_done)
            }
            Across::Beside {
                to,
                left_m,
                continuous,
                limits,
            } => {
                let found = scene
                    .get(*to)
                    .and_then(|other| scene.roads.along(place, other.point_m(), &self.route));
                let Some(found) = found else {
                    self.across = continuous.then_some(job);
                    return 0.0;
                };
                let wanted_m = found.y + *left_m;
                let more_m = wanted_m - before_m;
                let step_m = match (limits.speed_mps, limits.acceleration_mps2) {
                    (None, None) => more_m,
                    (limit, _) => {
                        let most_m = limit.unwrap_or(f64::INFINITY) * dt_s;
                        (more_m * BESIDE_PULL_PER_S * dt_s).clamp(-most_m, most_m)
                    }
                };
                (
                    before_m + step_m,
                    *continuous || (more_m - step_m).abs() > 0.05,
                    false,
                )
            }
        };
        place.left_m = place.sign() * left_m;
        if goes_on {
            self.across = Some(job);
        } else {
            ended.push(job.number);
        }
        if counts { left_m - before_m } else { 0.0 }
    }

    /// Ends the actions of an event.
    pub(super) fn end(&mut self, event: usize, roads: &Roads) {
        if self.along.as_ref().is_some_and(|job| job.number.0 == event) {
            self.along = None;
        }
        if self
            .across
            .as_ref()
            .is_some_and(|job| job.number.0 == event)
        {
            (self.across, self.left_mps) = (None, 0.0);
        }
        if self
            .follow
            .as_ref()
            .is_some_and(|job| job.number.0 == event)
        {
            self.follow = None;
            let (point_m, heading_rad) = self.pose(roads);
            self.settle(roads, point_m, heading_rad);
        }
    }
}

/// Change of speed of a part of a profile.
fn part(from_mps: f64, to_mps: f64, time_s: f64) -> Transition {
    let extent = Extent::TimeS(time_s);
    Transition::new(
        from_mps,
        to_mps,
        Dynamics {
            shape: Shape::Linear,
            extent,
        },
    )
}

fn speed_of(target: &Speed, scene: &Scene) -> Option<f64> {
    Some(match *target {
        Speed::Mps(mps) => mps,
        Speed::Of {
            who,
            factor,
            plus_mps,
            ..
        } => scene.get(who)?.speed_mps * factor + plus_mps,
    })
}

/// Acceleration now of a vehicle that is to go `way_m` in `time_s` and arrive with `to_mps`: it
/// changes its speed at one rate, and back at the same rate.
fn arrival_mps2(from_mps: f64, to_mps: f64, way_m: f64, time_s: f64) -> f64 {
    if time_s <= 0.0 {
        return 0.0;
    }
    // With m = 2 way / time, the speed x between both parts solves
    // 2 x^2 - 2 m x + m (from + to) - from^2 - to^2 = 0.
    let (m, sum) = (2.0 * way_m / time_s, from_mps + to_mps);
    let root = (m * m - 2.0 * (m * sum - from_mps * from_mps - to_mps * to_mps))
        .max(0.0)
        .sqrt();
    let between_mps = 0.5 * (m + if m >= sum { root } else { -root });
    if between_mps < 0.0 {
        // It has to stand meanwhile: both parts have rates of equal size, and their ways are known.
        return -(from_mps * from_mps + to_mps * to_mps) / (2.0 * way_m.max(1e-6));
    }
    (2.0 * between_mps - sum) / time_s
}
