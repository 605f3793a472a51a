//! One actor in motion: its way, its speed, and the actions that change them.

mod across;
mod along;
mod attack;
mod spring;

use decouplegs_scene::story::{Action, Actor, Limits, Who};
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use self::across::Across;
use self::along::Along;
use self::attack::Attack;
use super::roads::{OnLane, Roads};
use super::seen::{Scene, Seen};
use crate::polyline::{Polyline, wrapped};

/// Turn across its lane beyond which an actor does not follow it, radians.
const ACROSS_RAD: f64 = 0.8;
/// Headings that differ by less are the same, radians.
const SAME_RAD: f64 = 0.05;
/// Way that an actor is on.
#[derive(Clone, Debug)]
pub(super) enum Way {
    /// Lanes that it follows.
    Lane(OnLane),
    /// Line that it follows, and meters along it.
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
    pub size: VehicleSize,
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
    attack: Option<Attack>,
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
            way: place
                .filter(|_| turn_rad.abs() < ACROSS_RAD)
                .map_or(Way::Free(point_m, actor.heading_rad), Way::Lane),
            // Lines of lanes are chords: what is less than they can tell is no turn.
            turn_rad: if turn_rad.abs() < 0.02 { 0.0 } else { turn_rad },
            left_mps: 0.0,
            speed_mps: actor.speed_mps,
            acceleration_mps2: 0.0,
            is_shown: !actor.is_hidden,
            is_at_end: false,
            limits: actor.limits,
            route: Vec::new(),
            along: None,
            across: None,
            follow: None,
            attack: None,
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
        // Its speed is that along its way, of which a part leads aside.
        let aside = self.left_mps / self.speed_mps.abs().max(0.1);
        let drift_rad = aside.clamp(-1.0, 1.0).asin();
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
            Action::Speed { .. }
            | Action::Profile { .. }
            | Action::KeepGap { .. }
            | Action::Arrive { .. } => {
                ended.extend(self.along.take().map(|old| old.number));
                let kind = self.along_for(action, scene);
                self.along = kind.map(|kind| Job { number, kind });
                if self.along.is_none() {
                    ended.push(number);
                }
            }
            Action::Follow {
                points_m,
                seen_from,
                on_lanes,
                places,
                times_s,
                is_absolute,
            } => {
                let from_s = if *is_absolute { 0.0 } else { time_s };
                let found = match places.as_slice() {
                    [] => line_of(points_m, *seen_from, *on_lanes, scene),
                    places => places.iter().map(|place| scene.place(place)).collect(),
                };
                match found {
                    Some(points_m) => self.follow_line(number, points_m, times_s, from_s, ended),
                    None => ended.push(number),
                }
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
            Action::Attack {
                ahead_s,
                every_s,
                best,
            } => {
                self.stop_following(ended);
                ended.extend(self.along.take().map(|old| old.number));
                ended.extend(self.across.take().map(|old| old.number));
                self.attack = Some(Attack {
                    number,
                    ahead_s: *ahead_s,
                    every_s: *every_s,
                    best: *best as usize,
                    next_s: time_s,
                });
            }
            // Those that are no motion of an actor.
            Action::Set { .. }
            | Action::Wait { .. }
            | Action::Light { .. }
            | Action::Phase { .. } => ended.push(number),
        }
    }

    fn follow_line(
        &mut self,
        number: Number,
        points_m: Vec<DVec2>,
        times_s: &[f64],
        from_s: f64,
        ended: &mut Vec<Number>,
    ) {
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
        let place = roads.at(point_m, heading_rad);
        let turn_rad = |place: &OnLane| wrapped(heading_rad - roads.pose(place).1);
        self.way = match place.filter(|place| turn_rad(place).abs() < ACROSS_RAD) {
            Some(place) => {
                self.turn_rad = kept(turn_rad(&place));
                Way::Lane(place)
            }
            None => Way::Free(point_m, heading_rad),
        };
    }

    /// Advances by `dt_s`. Numbers of actions that end are added to `ended`.
    pub(super) fn advance(
        &mut self,
        (scene, time_s, dt_s): (&Scene, f64, f64),
        ended: &mut Vec<Number>,
    ) {
        self.attack_on(scene, time_s);
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
                let middle_m = scene.roads.along_middle_m(place, ahead_m);
                self.is_at_end = !scene.roads.advance(place, middle_m, &self.route);
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
                *point_m += ahead_m * DVec2::from_angle(*heading_rad);
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
        self.attack = self.attack.filter(|attack| attack.number.0 != event);
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
/// Heading beside that of a lane. Lines of lanes are chords: what is less than they tell is none.
fn kept(turn_rad: f64) -> f64 {
    if turn_rad.abs() < SAME_RAD {
        0.0
    } else {
        turn_rad
    }
}

/// Points of a line in world coordinates; `None` where the road user that they count from is not
/// there.
fn line_of(
    points_m: &[[f64; 2]],
    seen_from: Option<Who>,
    on_lanes: bool,
    scene: &Scene,
) -> Option<Vec<DVec2>> {
    let points_m = points_m.iter().copied().map(DVec2::from_array);
    let Some(who) = seen_from else {
        return Some(points_m.collect());
    };
    let seen = scene.get(who)?;
    if !on_lanes {
        let (from_m, ahead) = (seen.point_m(), seen.state.ahead());
        let turned = points_m.map(|point_m| from_m + ahead.rotate(point_m));
        return Some(turned.collect());
    }
    let own = seen.place?;
    let placed = points_m.map(|point_m| {
        let mut place = own;
        place.left_m = place.sign() * point_m.y;
        scene.roads.advance(&mut place, point_m.x, &[]);
        scene.roads.pose(&place).0
    });
    Some(placed.collect())
}
