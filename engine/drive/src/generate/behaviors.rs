//! Driver types, and misbehavior of some agents.

use decouplegs_scene::scenario::{Behavior, DriverKind, Maneuver, TrafficAgent, Trigger};
use decouplegs_scene::{LaneMap, RoadUser};
use glam::DVec2;

use super::ego_start::EgoStart;
use super::placement::{Role, Vehicle};
use super::random::Stream;
use super::rules::{LevelRequirements, NEAR_M};
use super::to_tenth;

/// Name of the vehicle ahead of the ego.
pub(super) const LEAD: &str = "lead";

/// Time at which a vehicle ahead brakes, seconds, or the share of its distance at the start at
/// which the ego makes it brake: before an ego that keeps its speed has reached it.
const BRAKE_S: (f64, f64) = (0.5, 3.0);
const BRAKE_NEAR: (f64, f64) = (0.7, 0.9);
/// A standing vehicle cannot swerve, m/s.
const SWERVE_MPS_MIN: f64 = 2.0;
/// Distance to the ego at which a vehicle ahead on the same route swerves, meters: the ego can
/// still brake.
const SWERVE_NEAR_M: (f64, f64) = (12.0, 25.0);
/// Lateral distance: into the next lane.
const SWERVE_M: (f64, f64) = (0.8, 1.6);
/// Lateral distance of a swerve of oncoming or adjacent vehicles, within their own lane: an ego
/// that they hit could not avoid it.
const SWERVE_IN_LANE_M: (f64, f64) = (0.4, 0.7);
/// Cosine of the angle between the headings of two that drive the same way.
const ALONG: f64 = 0.8;

/// The agents among `vehicles`, of which the first is the ego.
pub(super) fn agents(
    map: &LaneMap,
    rules: &LevelRequirements,
    start: &EgoStart,
    vehicles: &[Vehicle],
    random: &Stream,
) -> Vec<TrafficAgent> {
    let mut draw = random.split(0);
    let mut agents: Vec<TrafficAgent> = Vec::with_capacity(vehicles.len());
    for (number, vehicle) in vehicles.iter().enumerate().skip(1) {
        let driver = draw
            .pick(rules.drivers)
            .copied()
            .unwrap_or(DriverKind::Normal);
        agents.push(TrafficAgent {
            name: match vehicle.role {
                Role::Lead => LEAD.into(),
                Role::CutIn => "cut_in".into(),
                Role::Ego | Role::Other => format!("{}_{number:02}", vehicle.kind.name()),
            },
            kind: vehicle.kind,
            asset: vehicle.asset,
            size: vehicle.size,
            lane: map.lanes[vehicle.spot.lane].id.clone(),
            at_m: vehicle.spot.at_m,
            speed_mps: vehicle.speed_mps,
            cruise_mps: None,
            driver,
            changes_lanes: draw.chance(rules.lane_change_share)
                && vehicle.kind != RoadUser::Cyclist,
            behaviors: Vec::new(),
        });
    }
    let mut inject = random.split(1);
    let cuts_in = vehicles.iter().any(|vehicle| vehicle.role == Role::CutIn);
    for (agent, vehicle) in agents.iter_mut().zip(&vehicles[1..]) {
        let distance_m = vehicle
            .outline
            .center_m
            .distance(vehicles[0].outline.center_m);
        match vehicle.role {
            Role::CutIn => agent.behaviors.push(cut_in(&mut inject)),
            Role::Lead if rules.lead_brakes => {
                agent
                    .behaviors
                    .push(brake((6.0, 8.0), distance_m, &mut inject));
            }
            // Where no lane lies beside the ego's, the vehicle ahead closes the gap by other
            // means.
            Role::Lead if rules.cut_ins > 0 && !cuts_in => {
                agent
                    .behaviors
                    .push(brake((3.0, 5.0), distance_m, &mut inject));
            }
            _ => {}
        }
    }
    for (at, amplitude_range_m) in swerving(start, vehicles, inject.whole(rules.swerves)) {
        agents[at - 1]
            .behaviors
            .push(swerve(amplitude_range_m, &mut inject));
    }
    agents
}

fn cut_in(random: &mut Stream) -> Behavior {
    Behavior {
        trigger: Trigger::Time {
            time_s: to_tenth(random.between((0.5, 3.0))),
        },
        maneuver: Maneuver::CutIn,
    }
}

/// A brake after some seconds, or when the ego has come nearer than the `distance_m` of the start.
fn brake(deceleration_mps2: (f64, f64), distance_m: f64, random: &mut Stream) -> Behavior {
    let trigger = if random.chance(0.5) {
        Trigger::Time {
            time_s: to_tenth(random.between(BRAKE_S)),
        }
    } else {
        Trigger::NearEgo {
            distance_m: (random.between(BRAKE_NEAR) * distance_m).round(),
        }
    };
    let maneuver = Maneuver::Brake {
        deceleration_mps2: to_tenth(random.between(deceleration_mps2)),
        duration_s: to_tenth(random.between((1.5, 3.0))),
    };
    Behavior { trigger, maneuver }
}

fn swerve(amplitude_range_m: (f64, f64), random: &mut Stream) -> Behavior {
    let side = if random.chance(0.5) { 1.0 } else { -1.0 };
    let maneuver = Maneuver::Swerve {
        amplitude_m: to_tenth(side * random.between(amplitude_range_m)),
        duration_s: to_tenth(random.between((2.0, 4.0))),
    };
    Behavior {
        trigger: Trigger::NearEgo {
            distance_m: random.between(SWERVE_NEAR_M).round(),
        },
        maneuver,
    }
}

/// Vehicles that swerve, and by how much. Among those near the ego: first vehicles ahead on its
/// route, then moving ones, then the nearest to its route. All others keep to their lanes.
fn swerving(start: &EgoStart, vehicles: &[Vehicle], count: usize) -> Vec<(usize, (f64, f64))> {
    let ego = &vehicles[0].outline;
    let mut near: Vec<(bool, bool, f64, usize)> = Vec::new();
    for (at, vehicle) in vehicles
        .iter()
        .enumerate()
        .filter(|(_, vehicle)| vehicle.role == Role::Other && vehicle.kind == RoadUser::Car)
    {
        let local_m = ego.to_local(vehicle.outline.center_m);
        let along = DVec2::from_angle(vehicle.outline.yaw_rad - ego.yaw_rad).x;
        if local_m.length() <= NEAR_M {
            let ahead = along > ALONG && local_m.x > SWERVE_NEAR_M.0;
            let off_m = start
                .route
                .line()
                .project(vehicle.outline.center_m)
                .distance_m;
            near.push((!ahead, vehicle.speed_mps < SWERVE_MPS_MIN, off_m, at));
        }
    }
    near.sort_by(|a, b| {
        (a.0, a.1)
            .cmp(&(b.0, b.1))
            .then(a.2.total_cmp(&b.2))
            .then(a.3.cmp(&b.3))
    });
    near.into_iter()
        .take(count)
        .map(|(not_ahead, .., at)| {
            (
                at,
                if not_ahead {
                    SWERVE_IN_LANE_M
                } else {
                    SWERVE_M
                },
            )
        })
        .collect()
}
