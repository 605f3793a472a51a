//! Moving objects: agents in their lanes, the ego vehicle and its cameras.

use std::f64::consts::{FRAC_PI_2, PI};

use decouplegs_scene::{AgentPlacement, Intrinsics, Pose, Rig, RigCamera, ShFrame};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::car::{Build, VARIANTS};
use super::layout::{Axis, LANE_M, ROAD_HALF_M};
use super::random::Stream;

/// Height of the middle of the ego's box above the road, meters: half of a car 1.7 m high.
const EGO_CENTRE_Z_M: f64 = 0.85;
/// Start of the ego, x in meters.
const EGO_START_X_M: f64 = -62.0;
/// Cruising speed of the ego, meters per second.
const EGO_SPEED_MPS: f64 = 10.0;
/// Speed in the turn, meters per second.
const EGO_TURN_SPEED_MPS: f64 = 5.0;
/// Braking before the turn and accelerating after it, meters per second squared.
const EGO_ACCELERATION_MPS2: f64 = 1.5;
/// Radius of the ego's right turn into the crossing street: as wide as the kerb allows, meters.
pub(super) const EGO_TURN_RADIUS_M: f64 = 9.0;
/// Time between knots of the ego's trajectory, seconds.
const EGO_STEP_S: f64 = 0.1;
/// Duration of agents' trajectories, seconds.
pub(super) const DURATION_S: f64 = 20.0;

/// Bumper to bumper in a lane, at least this plus the longest car, meters.
const SLOT_M: f64 = 7.6;

/// A lane to put agents in: s grows with the traffic's heading when `forward`.
#[derive(Clone, Copy)]
struct Lane {
    axis: Axis,
    forward: bool,
    /// 0 next to the centerline, 1 next to the parked cars.
    number: u8,
    /// Stretch of s, meters.
    range_m: (f64, f64),
    speed_mps: f64,
}

impl Lane {
    fn pose(&self, s: f64, z: f64) -> Pose {
        let offset_m = (f64::from(self.number) + 0.5) * f64::from(LANE_M);
        let t = if self.forward { -offset_m } else { offset_m };
        let at = self.axis.at(s as f32, t as f32);
        let yaw_rad = f64::from(self.axis.yaw_rad()) + if self.forward { 0.0 } else { PI };
        Pose::from_yaw(yaw_rad, DVec3::new(f64::from(at.x), f64::from(at.y), z))
    }
}

/// The lanes, those that the ego's cameras see most first. Cross traffic waits at its red light, or
/// drives away.
fn lanes() -> Vec<Lane> {
    let crossing = f64::from(Axis::Main.crossing_s());
    let clear = f64::from(ROAD_HALF_M) + 9.0;
    let lane = |axis, forward, number, range_m, speed_mps| Lane {
        axis,
        forward,
        number,
        range_m,
        speed_mps,
    };
    vec![
        lane(Axis::Main, true, 0, (-96.0, 96.0), 9.0),
        lane(Axis::Main, false, 0, (-96.0, 96.0), 10.5),
        lane(Axis::Main, false, 1, (-96.0, 96.0), 8.5),
        lane(Axis::Cross, true, 0, (-90.0, -clear), 0.0),
        lane(Axis::Cross, true, 1, (-90.0, -clear), 0.0),
        lane(Axis::Cross, false, 0, (clear, 90.0), 0.0),
        lane(Axis::Cross, false, 1, (clear, 90.0), 0.0),
        lane(Axis::Cross, true, 0, (clear, 90.0), 9.0),
        lane(Axis::Cross, false, 0, (-90.0, -clear), 9.0),
        // The ego's own lane comes last, ahead of it only and faster, so that it is never caught:
        // with fewer agents the ego's whole way is clear even for those who film it among agents
        // that stand still.
        lane(Axis::Main, true, 1, (EGO_START_X_M + 16.0, 96.0), 11.5),
        // Beyond the detailed street, one behind the other for as long as there are agents.
        lane(Axis::Main, true, 0, (crossing + 70.0, f64::INFINITY), 9.0),
    ]
}

/// Agents with their trajectories.
pub(super) struct Traffic {
    pub agents: Vec<AgentPlacement>,
    pub trajectories: Vec<Vec<(f64, Pose)>>,
}

/// `count` agents over the lanes, sparse where there is room. Asset `k` is variant `k` of
/// [`Build`].
pub(super) fn traffic(count: usize, assets: usize, seed: u64) -> Traffic {
    let positions = positions(count, seed);
    let mut traffic = Traffic {
        agents: Vec::with_capacity(count),
        trajectories: Vec::with_capacity(count),
    };
    for (number, (lane, s)) in positions.into_iter().enumerate() {
        let asset = number % assets;
        let (build, _) = Build::for_variant(asset);
        let z = 0.5 * f64::from(build.size.z);
        let start = lane.pose(s, z);
        let traveled_m = lane.speed_mps * DURATION_S * if lane.forward { 1.0 } else { -1.0 };
        traffic.agents.push(AgentPlacement {
            name: format!("car_{number:03}"),
            asset,
            world_from_agent: start,
            sh_frame: ShFrame::Canonical,
        });
        traffic.trajectories.push(vec![
            (0.0, start),
            (DURATION_S, lane.pose(s + traveled_m, z)),
        ]);
    }
    traffic
}

/// A lane and a position in it for each agent: lanes in turn, so that a few agents are not one
/// queue.
fn positions(count: usize, seed: u64) -> Vec<(Lane, f64)> {
    let mut lanes = lanes();
    let endless = lanes.remove(lanes.len() - 1);
    let mut slots: Vec<(u64, Lane, f64)> = Vec::new();
    for (number, lane) in lanes.iter().enumerate() {
        let (from, to) = lane.range_m;
        let fits = ((to - from) / SLOT_M) as usize;
        for slot in 0..fits {
            let mut random = Stream::new(seed, 8 << 40, (number * 1000 + slot) as u64);
            let s = from + (slot as f64 + 0.5) * SLOT_M + f64::from(random.range(-0.9, 0.9));
            let beside_ego =
                lane.axis == Axis::Main && (s - EGO_START_X_M).abs() < 7.0 && lane.forward;
            // Every third slot first, then those between; the main street's three lanes before the
            // other street's six, those beside the ego and in its lane last.
            let round = [0u64, 2, 1][slot % 3]
                + [0, 3, 9][usize::from(number >= 3) + usize::from(number >= 9)]
                + u64::from(beside_ego) * 6;
            slots.push((round * 10_000 + random.bits() % 10_000, *lane, s));
        }
    }
    slots.sort_by_key(|(rank, ..)| *rank);
    let mut positions: Vec<(Lane, f64)> = slots
        .into_iter()
        .take(count)
        .map(|(_, lane, s)| (lane, s))
        .collect();
    for extra in positions.len()..count {
        let first = endless.range_m.0;
        positions.push((endless, first + SLOT_M * (extra + 1) as f64));
    }
    positions
}

/// The ego's trajectory: straight along the right lane, then a right turn into the crossing street.
pub(super) fn ego() -> Vec<(f64, Pose)> {
    let lane_m = 1.5 * f64::from(LANE_M);
    let turn_x = f64::from(Axis::Main.crossing_s()) - lane_m - EGO_TURN_RADIUS_M;
    let straight_m = turn_x - EGO_START_X_M;
    let turn_m = EGO_TURN_RADIUS_M * FRAC_PI_2;
    let total_m = straight_m + turn_m + 25.0;
    let (mut s, mut step, mut knots) = (0.0, 0u32, Vec::new());
    while s < total_m {
        knots.push((
            f64::from(step) * EGO_STEP_S,
            ego_pose(s, straight_m, turn_x, lane_m),
        ));
        let to_turn_m = (straight_m - s).max(s - straight_m - turn_m).max(0.0);
        let allowed = (EGO_TURN_SPEED_MPS * EGO_TURN_SPEED_MPS
            + 2.0 * EGO_ACCELERATION_MPS2 * to_turn_m)
            .sqrt();
        s += allowed.min(EGO_SPEED_MPS) * EGO_STEP_S;
        step += 1;
    }
    knots
}

/// The ego after `s` meters of its way.
fn ego_pose(s: f64, straight_m: f64, turn_x: f64, lane_m: f64) -> Pose {
    let radius = EGO_TURN_RADIUS_M;
    let turned_rad = ((s - straight_m) / radius).clamp(0.0, FRAC_PI_2);
    let after_m = (s - straight_m - radius * FRAC_PI_2).max(0.0);
    let on_arc = DVec2::new(
        turn_x + radius * turned_rad.sin(),
        -lane_m - radius * (1.0 - turned_rad.cos()),
    );
    let heading = DVec2::new(turned_rad.cos(), -turned_rad.sin());
    let position = on_arc + heading * after_m - DVec2::X * (straight_m - s).max(0.0);
    Pose::from_yaw(-turned_rad, position.extend(EGO_CENTRE_Z_M))
}

/// Six cameras around the roof at 1.6 m, laid out as on the vehicles of nuScenes (Caesar et al.,
/// 2020): 1600x900, five of 64 degrees and a wide one at the back. The rig's frame is the ego's
/// box.
pub(super) fn rig() -> Rig {
    let layout: [(&str, f64, [f64; 2], f64); 6] = [
        ("front", 0.0, [0.40, 0.0], 1266.4),
        ("front_left", 55.0, [0.25, 0.48], 1266.4),
        ("front_right", -55.0, [0.25, -0.48], 1266.4),
        ("back", 180.0, [-1.10, 0.0], 809.2),
        ("back_left", 110.0, [-0.30, 0.48], 1266.4),
        ("back_right", -110.0, [-0.30, -0.48], 1266.4),
    ];
    // The camera's axes (right, down, forward) in a vehicle that looks along x.
    let vehicle_from_camera =
        DQuat::from_mat3(&DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X));
    let cameras = layout.map(|(name, yaw_deg, [x, y], focal_px)| RigCamera {
        name: name.to_string(),
        intrinsics: Intrinsics::centered([1600, 900], focal_px),
        rig_from_camera: Pose::new(
            DQuat::from_rotation_z(yaw_deg.to_radians()) * vehicle_from_camera,
            DVec3::new(x, y, 1.6 - EGO_CENTRE_Z_M),
        ),
    });
    Rig::from_iter(cameras)
}

/// Number of distinct assets that `agents` agents share.
pub(super) fn asset_count(agents: usize) -> usize {
    agents.min(VARIANTS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ego_moves_smoothly_and_ends_heading_right() {
        let knots = ego();
        for pair in knots.windows(2) {
            let step_m = (pair[1].1.translation - pair[0].1.translation).length();
            assert!(
                (0.3..1.01).contains(&step_m),
                "{step_m} m in {EGO_STEP_S} s"
            );
            let turn_rad = pair[0].1.rotation.angle_between(pair[1].1.rotation);
            assert!(turn_rad < 0.08);
            // The nose points where the car goes.
            let heading = pair[0].1.rotation * DVec3::X;
            assert!(heading.dot(pair[1].1.translation - pair[0].1.translation) > 0.99 * step_m);
        }
        let last = knots[knots.len() - 1].1;
        assert!(
            (last.rotation * DVec3::X - DVec3::NEG_Y).length() < 1e-6 && last.translation.y < -20.0
        );
    }

    #[test]
    fn cameras_look_where_their_names_say() {
        let rig = rig();
        let forward = |name: &str| {
            let camera = rig.cameras().find(|camera| camera.name == name).unwrap();
            camera.rig_from_camera.rotation * DVec3::Z
        };
        assert!(forward("front").x > 0.999 && forward("back").x < -0.999);
        assert!(forward("front_left").y > 0.7 && forward("back_right").y < -0.9);
        for camera in rig.cameras() {
            assert!(
                (camera.rig_from_camera.rotation * DVec3::Y).z < -0.999,
                "image down is world down"
            );
        }
    }
}
