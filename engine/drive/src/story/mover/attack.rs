//! An actor that seeks the ego: again and again it takes the way that leads nearest to where the
//! ego will be.
//!
//! The ways are those of HUGSIM's `AttackPlanner` (hyzhou404/HUGSIM at 62c690d,
//! `sim/utils/agent_controller.py`, `submodules/Pplan/Sampling/spline_planner.py`): cubics to
//! places 1.5 m apart across, by ten accelerations and three headings, of which those are left that
//! a vehicle can drive. The ego is foreseen straight on at its speed. A place among the best ways
//! is drawn from the time, so that runs repeat.

use std::f64::consts::FRAC_PI_6;

use decouplegs_scene::random;
use decouplegs_scene::story::Who;
use glam::DVec2;

use super::{Job, Mover, Number, Timed};
use crate::story::seen::Scene;

/// Accelerations of the ways, m/s^2: ten from the first to the last.
const AHEAD_MPS2: [f64; 2] = [-2.0, 5.0];
const ACCELERATIONS: u32 = 10;
/// Places of the ends across, meters to the left.
const ACROSS_M: [f64; 5] = [-3.0, -1.5, 0.0, 1.5, 3.0];
/// Headings of the ends beside the direction to them, radians.
const TURNS_RAD: [f64; 3] = [-FRAC_PI_6, 0.0, FRAC_PI_6];
/// Bounds of a way: acceleration along it, m/s^2, acceleration across, m/s^2, and turn per meter of
/// speed, of which a slow vehicle has as much as one of 0.5 m/s.
const BOUNDS_MPS2: [f64; 2] = [-6.0, 5.0];
const LATERAL_MPS2_MAX: f64 = 8.0;
const STEER_MAX: f64 = 0.5;
const SLOW_MPS: f64 = 0.5;
/// Time between the places of a way, seconds.
const INTERVAL_S: f64 = 0.1;
/// Distance within which a way meets another road user, meters, and what that costs.
const NEAR_M: f64 = 2.0;
const NEAR_COST_M: f64 = 0.1;
/// Other road users that count, at most.
const NEIGHBORS: usize = 2;

/// Attack that goes on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attack {
    pub number: Number,
    /// Length of a way, seconds.
    pub ahead_s: f64,
    /// Time between plans, seconds.
    pub every_s: f64,
    /// Ways among which it chooses.
    pub best: usize,
    /// Time of the next plan, seconds.
    pub next_s: f64,
}

/// A cubic in the plane over a time.
struct Cubic {
    coefficients: [DVec2; 4],
}

impl Cubic {
    /// The cubic from `from_m` to `to_m` in `time_s`, with the velocities at both ends.
    fn new([from_m, from_mps]: [DVec2; 2], [to_m, to_mps]: [DVec2; 2], time_s: f64) -> Self {
        let way_m = to_m - from_m;
        let (square, cube) = (time_s * time_s, time_s * time_s * time_s);
        Self {
            coefficients: [
                from_m,
                from_mps,
                3.0 * way_m / square - (2.0 * from_mps + to_mps) / time_s,
                -2.0 * way_m / cube + (from_mps + to_mps) / square,
            ],
        }
    }

    fn at(&self, t: f64) -> DVec2 {
        let [a, b, c, d] = self.coefficients;
        a + t * (b + t * (c + t * d))
    }

    /// True if a vehicle can drive it at the time `t`.
    fn is_drivable(&self, t: f64) -> bool {
        let [_, b, c, d] = self.coefficients;
        let velocity = b + t * (2.0 * c + t * 3.0 * d);
        let acceleration = 2.0 * c + t * 6.0 * d;
        let speed = velocity.length().max(1e-4);
        let along = acceleration.dot(velocity) / speed;
        let turn = velocity.perp_dot(acceleration) / (speed * speed);
        (BOUNDS_MPS2[0]..=BOUNDS_MPS2[1]).contains(&along)
            && (turn * speed).abs() <= LATERAL_MPS2_MAX
            && turn.abs() <= speed.max(SLOW_MPS) * STEER_MAX
    }
}

impl Mover {
    /// Plans its attack anew where it is time for that. It ends where another line is followed.
    pub(super) fn attack_on(&mut self, scene: &Scene, time_s: f64) {
        let Some(attack) = self.attack else {
            return;
        };
        if self
            .follow
            .as_ref()
            .is_some_and(|job| job.number != attack.number)
        {
            self.attack = None;
            return;
        }
        if time_s + 1e-9 < attack.next_s {
            return;
        }
        let Some(points_m) = self.planned(&attack, scene, time_s) else {
            return;
        };
        let count = points_m.len();
        self.attack = Some(Attack {
            next_s: time_s + attack.every_s,
            ..attack
        });
        (self.turn_rad, self.left_mps) = (0.0, 0.0);
        self.follow = Some(Job {
            number: attack.number,
            kind: Some(Timed {
                points_m,
                times_s: (0..count).map(|index| INTERVAL_S * index as f64).collect(),
                from_s: time_s,
            }),
        });
    }

    /// Places of the way that it takes, [`INTERVAL_S`] apart; `None` without an ego.
    fn planned(&self, attack: &Attack, scene: &Scene, time_s: f64) -> Option<Vec<DVec2>> {
        let ego = scene.get(Who::EGO)?.state;
        let (point_m, heading_rad) = self.pose(scene.roads);
        let steps = (attack.ahead_s / INTERVAL_S).round().max(1.0) as usize;
        let mut others: Vec<_> = scene.all[1..]
            .iter()
            .flatten()
            .filter(|other| other.state.position_m.distance(point_m) > 1e-6)
            .map(|other| other.state)
            .collect();
        others.sort_by(|a, b| {
            let distance_m = |at: DVec2| at.distance_squared(point_m);
            distance_m(a.position_m).total_cmp(&distance_m(b.position_m))
        });
        others.truncate(NEIGHBORS);
        let cost_m = |way: &[DVec2]| {
            let nearest_m = |at_m: DVec2, velocity: DVec2| {
                let places = way.iter().enumerate();
                let apart_m = |(step, place): (usize, &DVec2)| {
                    place.distance(at_m + INTERVAL_S * step as f64 * velocity)
                };
                places.map(apart_m).fold(f64::INFINITY, f64::min)
            };
            let met = others.iter().filter(|other| {
                nearest_m(other.position_m, other.speed_mps * other.ahead()) < NEAR_M
            });
            nearest_m(ego.position_m, ego.speed_mps * ego.ahead())
                + NEAR_COST_M * met.count() as f64
        };
        let ways = self.ways((point_m, heading_rad), steps);
        let mut ranked: Vec<(f64, usize)> = ways
            .iter()
            .enumerate()
            .map(|(index, way)| (cost_m(way), index))
            .collect();
        ranked.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let among = attack.best.min(ranked.len());
        let drawn = random::mix(time_s.to_bits() ^ attack.number.0 as u64);
        let (_, chosen) = ranked[(drawn % among as u64) as usize];
        Some(ways[chosen].clone())
    }

    /// Ways that it could drive from `place` and heading, `steps` intervals long; straight on where
    /// there is none.
    fn ways(&self, (point_m, heading_rad): (DVec2, f64), steps: usize) -> Vec<Vec<DVec2>> {
        let time_s = INTERVAL_S * steps as f64;
        let speed_mps = self.speed_mps.max(1e-3);
        let ahead = DVec2::from_angle(heading_rad);
        let mut ways = Vec::new();
        for across_m in ACROSS_M {
            for index in 0..ACCELERATIONS {
                let share = f64::from(index) / f64::from(ACCELERATIONS - 1);
                let more_mps = time_s * (AHEAD_MPS2[0] + share * (AHEAD_MPS2[1] - AHEAD_MPS2[0]));
                let way = DVec2::new((speed_mps + 0.5 * more_mps) * time_s, across_m);
                for turn_rad in TURNS_RAD {
                    let end_mps = (speed_mps + more_mps).max(1e-3);
                    let end = DVec2::from_angle(heading_rad + way.to_angle() + turn_rad);
                    let cubic = Cubic::new(
                        [point_m, speed_mps * ahead],
                        [point_m + ahead.rotate(way), end_mps * end],
                        time_s,
                    );
                    let times = || (0..=steps).map(|step| INTERVAL_S * step as f64);
                    if times().all(|t| cubic.is_drivable(t)) {
                        ways.push(times().map(|t| cubic.at(t)).collect());
                    }
                }
            }
        }
        if ways.is_empty() {
            let straight = |step| point_m + INTERVAL_S * f64::from(step) * speed_mps * ahead;
            ways.push((0..=steps as u32).map(straight).collect());
        }
        ways
    }
}
