//! Actions that move an actor aside.

use decouplegs_scene::story::{Action, Direction, End, Limits, Side, TargetLane, Who};

use super::super::roads::OnLane;
use super::super::seen::Scene;
use super::super::shapes::Transition;
use super::spring::Spring;
use super::{Mover, Number, Way};

/// Difference of a distance beside another that counts as none, meters.
const BESIDE_REACHED_M: f64 = 0.05;
/// Speed ahead that an actor keeps while it moves aside, m/s.
const AHEAD_MPS_MIN: f64 = 1e-6;

/// Change of the offset.
#[derive(Clone, Debug)]
pub(super) enum Across {
    Change {
        to: Transition,
        continuous: bool,
    },
    Beside {
        to: Who,
        left_m: f64,
        continuous: bool,
        limits: Limits,
        /// Speed to the left, m/s, where an acceleration is given.
        speed_mps: f64,
        spring: Spring,
    },
}

impl Mover {
    /// 1 if it is behind another, -1 if ahead of it; to the right of it, or left.
    pub(super) fn side_of(&self, scene: &Scene, to: Who, direction: Direction) -> f64 {
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

    /// The change of offset that an action asks for; `None` if it is on no lane, or there is no
    /// such lane.
    pub(super) fn aside(&mut self, action: &Action, scene: &Scene) -> Option<Across> {
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
                    speed_mps: 0.0,
                    spring: Spring::default(),
                });
            }
            _ => return None,
        };
        self.turn_rad = 0.0;
        let from_m = place.sign() * place.left_m;
        let to = Transition::new(from_m, to_m, dynamics);
        Some(Across::Change { to, continuous })
    }

    /// Moves it aside; the way to the side, meters.
    pub(super) fn move_aside(
        &mut self,
        scene: &Scene,
        dt_s: f64,
        way_m: f64,
        ended: &mut Vec<Number>,
    ) -> f64 {
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
                speed_mps,
                spring,
            } => {
                let found = scene
                    .get(*to)
                    .and_then(|other| scene.roads.along(place, other.point_m(), &self.route));
                let Some(found) = found else {
                    self.across = continuous.then_some(job);
                    return 0.0;
                };
                let more_m = found.y + *left_m - before_m;
                let most_mps = limits.speed_mps.unwrap_or(f64::INFINITY);
                let most_mps = most_mps.min((way_m.abs() / dt_s - AHEAD_MPS_MIN).max(0.0));
                let is_free = limits.speed_mps.is_none();
                let (step_m, counts) = match limits.acceleration_mps2 {
                    None if is_free => (more_m, false),
                    None => {
                        let most_m = most_mps * dt_s;
                        (more_m.clamp(-most_m, most_m), true)
                    }
                    Some(most) => {
                        // Damped by its own motion, as players do: it swings behind one that
                        // moves aside itself.
                        let left = [more_m, *speed_mps];
                        let mps2 = spring.acceleration_mps2(left, [most; 2], limits, dt_s);
                        *speed_mps = (*speed_mps + mps2 * dt_s).clamp(-most_mps, most_mps);
                        (*speed_mps * dt_s, true)
                    }
                };
                if counts {
                    self.left_mps = step_m / dt_s;
                }
                let is_reached = (more_m - step_m).abs() <= BESIDE_REACHED_M;
                (before_m + step_m, *continuous || !is_reached, counts)
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
}
