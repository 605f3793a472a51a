//! Actions that change the speed of an actor.

use decouplegs_scene::story::{
    Action, Direction, Dynamics, End, Extent, Limits, Shape, Side, Speed, Spot, Who,
};
use glam::DVec2;

use super::super::seen::{Scene, Seen};
use super::super::shapes::Transition;
use super::spring::Spring;
use super::{Mover, Number, Way};

/// Difference of a gap that counts as none, meters, and of a speed, m/s.
const GAP_REACHED_M: f64 = 0.1;
const SPEED_REACHED_MPS: f64 = 0.1;

/// Way by which a place of arrival is farther than it was, meters, from which on it is missed.
const MISSED_M: f64 = 0.05;
/// Largest change of speed for an arrival, m/s^2.
const RATE_MPS2: f64 = 10.0;

/// Change of the speed.
#[derive(Clone, Debug)]
pub(super) enum Along {
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
        spring: Spring,
    },
    Arrive {
        with: Who,
        at: Spot,
        other_at: Spot,
        tolerances_m: [f64; 2],
        speed: Option<Speed>,
        steady_m: f64,
        /// Least ways that were left to both places, meters.
        least_m: [f64; 2],
    },
}

impl Mover {
    /// Change of the speed that an action begins; `None` if it begins none.
    pub(super) fn along_for(&mut self, action: &Action, scene: &Scene) -> Option<Along> {
        Some(match action {
            Action::Speed { target, dynamics } => {
                let to_mps = speed_of(target, scene)?;
                let to = Transition::of_speed(self.speed_mps, to_mps, *dynamics);
                if to.is_done() {
                    self.speed_mps = to_mps;
                }
                Along::Change {
                    to,
                    target: *target,
                }
            }
            Action::Profile {
                times_s,
                speeds_mps,
                limits,
            } if !times_s.is_empty() => {
                let first_s = limits.least_s(self.speed_mps, speeds_mps[0]);
                Along::Profile {
                    times_s: times_s.clone(),
                    speeds_mps: speeds_mps.clone(),
                    part: 0,
                    change: part(self.speed_mps, speeds_mps[0], times_s[0].max(first_s)),
                }
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
                Along::Gap {
                    to,
                    gap,
                    is_time,
                    between_boxes,
                    side,
                    continuous,
                    limits,
                    spring: Spring::default(),
                }
            }
            Action::Arrive {
                with,
                at,
                other_at,
                tolerance_m,
                other_tolerance_m,
                speed,
                steady_m,
            } => Along::Arrive {
                with: *with,
                at: *at,
                other_at: *other_at,
                tolerances_m: [*tolerance_m, *other_tolerance_m],
                speed: *speed,
                steady_m: *steady_m,
                least_m: [f64::INFINITY; 2],
            },
            _ => return None,
        })
    }

    /// Changes the speed for a step. Numbers of actions that end are added to `ended`.
    pub(super) fn change_speed(&mut self, scene: &Scene, dt_s: f64, ended: &mut Vec<Number>) {
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
            Along::Gap { .. } => self.keep_gap(&mut job.kind, scene, dt_s),
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
            to.aim(found_mps);
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
    fn keep_gap(&mut self, kind: &mut Along, scene: &Scene, dt_s: f64) -> bool {
        let Along::Gap {
            to,
            gap,
            is_time,
            between_boxes,
            side,
            continuous,
            limits,
            spring,
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
            *gap * other.speed_mps.abs()
        } else {
            *gap
        };
        let more_m = found.signed_m.signum() * found.distance_m() - *side * wanted_m;
        let limited = limits.acceleration_mps2.zip(limits.deceleration_mps2);
        let Some((most, least)) = limited else {
            if let Way::Lane(place) = &mut self.way {
                scene.roads.advance(place, more_m, &self.route);
            }
            self.speed_mps = other.speed_mps;
            return *continuous;
        };
        let faster_mps = self.speed_mps - other.speed_mps;
        let left = [more_m, faster_mps];
        self.speed_mps += spring.acceleration_mps2(left, [most, least], limits, dt_s) * dt_s;
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
            least_m,
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
            .zip(&*least_m)
            .any(|(way_m, least_m)| *way_m > least_m + MISSED_M);
        for (least_m, way_m) in least_m.iter_mut().zip(ways_m) {
            *least_m = least_m.min(way_m);
        }
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
                    (self.speed_mps + rate_mps2.clamp(-RATE_MPS2, RATE_MPS2) * dt_s).max(0.0)
                }
            }
        };
        true
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
