//! Observations as messages, and trajectories as plans.
//!
//! Three frames: the world; `local`, the world seen from where the rig starts, because messages
//! hold f32; and the rig, x forward, y left, z up, from the ground below the middle of the rear
//! axle. The engine's own frame of the ego has the same axes, from the middle of its box.

use decouplegs::planner::{EpisodeInfo, Localization, LocatedEgo, PlannerError, plan_through};
use decouplegs::scene::{Intrinsics, Plan, PlanPoint, Pose, RigCamera};
use glam::{DVec2, DVec3};

use super::Padding;
use crate::camera_spec::spec_of;
use crate::poses::{message_of, pose_of, vec3_of};
use crate::wire::common::{DynamicState, PoseAtTime, Trajectory, Vec3};
use crate::wire::egodriver::Route;
use crate::wire::sensorsim::available_cameras_return::AvailableCamera;

/// Time of the start of an episode, microseconds: drivers look back from it, and times are
/// unsigned.
const START_US: u64 = 10_000_000;

/// Time `time_s` after the start of the episode, microseconds.
pub(super) fn time_us(time_s: f64) -> u64 {
    START_US + (time_s * 1e6).round() as u64
}

/// Start and end of the exposure of an image that is drawn at `now_us`: its readout has its middle
/// there.
pub(super) fn exposure_us(intrinsics: &Intrinsics, now_us: u64) -> [u64; 2] {
    let size_px = [intrinsics.width_px, intrinsics.height_px];
    let half_us = (0.5e6 * intrinsics.shutter.readout_s(size_px)).round() as u64;
    [now_us - half_us.min(now_us), now_us + half_us]
}

/// Frames of an episode.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frames {
    /// Pose of the rig in the frame of the ego's box.
    box_from_rig: Pose,
    /// Origin of `local`, world coordinates, meters; known from the first decision on.
    origin_m: Option<DVec3>,
}

impl Frames {
    pub(super) fn new(info: &EpisodeInfo) -> Self {
        let below_m = -0.5 * info.ego_size.height_m;
        Self {
            box_from_rig: Pose {
                translation: DVec3::new(-info.rear_axle_to_middle_m, 0.0, below_m),
                ..Pose::IDENTITY
            },
            origin_m: None,
        }
    }

    /// Lays the origin where the rig is at the first decision.
    pub(super) fn begin_at(&mut self, localization: &Localization) {
        let world_from_rig = localization.now().pose.then(&self.box_from_rig);
        self.origin_m.get_or_insert(world_from_rig.translation);
    }

    fn origin_m(&self) -> DVec3 {
        self.origin_m.unwrap_or_default()
    }

    /// `camera` as AlpaSim declares it, called `logical_id`.
    pub(super) fn camera(&self, camera: &RigCamera, logical_id: &str) -> AvailableCamera {
        let rig_from_camera = self.box_from_rig.inverse().then(&camera.rig_from_camera);
        AvailableCamera {
            intrinsics: Some(spec_of(&camera.intrinsics, logical_id)),
            rig_to_camera: Some(message_of(&rig_from_camera)),
            logical_id: logical_id.to_owned(),
        }
    }

    fn local_from_rig(&self, located: &LocatedEgo) -> Pose {
        let world_from_rig = located.pose.then(&self.box_from_rig);
        Pose {
            translation: world_from_rig.translation - self.origin_m(),
            ..world_from_rig
        }
    }

    /// Poses of the rig since the decision before, and its motion at each.
    pub(super) fn path(&self, localization: &Localization) -> (Trajectory, Vec<DynamicState>) {
        let poses = localization.path.iter().map(|located| PoseAtTime {
            pose: Some(message_of(&self.local_from_rig(located))),
            timestamp_us: time_us(located.time_s),
        });
        let states = localization.path.iter().map(motion);
        let trajectory = Trajectory {
            poses: poses.collect(),
        };
        (trajectory, states.collect())
    }

    /// The route ahead, in the frame of the rig.
    pub(super) fn route(&self, localization: &Localization, padding: Padding) -> Route {
        let now = localization.now();
        let rig_from_world = now.pose.then(&self.box_from_rig).inverse();
        let points = localization.route_m.iter();
        let mut waypoints: Vec<Vec3> = points
            .map(|point| vec3_of(rig_from_world.transform(*point)))
            .collect();
        if padding == Padding::Nan {
            waypoints.resize(Localization::WAYPOINTS, vec3_of(DVec3::NAN));
        }
        Route {
            waypoints,
            timestamp_us: time_us(now.time_s),
        }
    }

    /// The plan of `trajectory`, poses of the rig in the local frame; `None` where no pose is later
    /// than now. Poses beyond the limits of a [`Plan`] are left out.
    ///
    /// # Errors
    /// The end of a sentence that begins with "answered".
    pub(super) fn plan(
        &self,
        trajectory: &Trajectory,
        localization: &Localization,
    ) -> Result<Option<Plan>, String> {
        let now = localization.now();
        let rig_from_box = self.box_from_rig.inverse();
        let mut points = Vec::new();
        for (index, timed) in trajectory.poses.iter().enumerate() {
            let since_us = timed.timestamp_us.saturating_sub(time_us(now.time_s));
            let time_s = since_us as f64 * 1e-6;
            if since_us == 0 {
                continue;
            }
            if time_s > Plan::HORIZON_S_MAX || points.len() == Plan::POINTS_MAX {
                break;
            }
            let field = format!("trajectory.poses[{index}]");
            let local_from_rig = pose_of(timed.pose.as_ref(), &field);
            let local_from_rig = local_from_rig.map_err(|status| status.message().to_owned())?;
            let middle_m = local_from_rig.transform(rig_from_box.translation) + self.origin_m();
            points.push(PlanPoint {
                time_s,
                position_m: now.state.to_local(middle_m.truncate()),
            });
        }
        if points.is_empty() {
            return Ok(None);
        }
        let plan = Plan::new(points).map_err(|fault| format!("what is no plan: {fault}"))?;
        Ok(Some(plan))
    }
}

fn motion(located: &LocatedEgo) -> DynamicState {
    let motion = &located.motion;
    let (speed_mps, yaw_rate) = (motion.speed_mps, motion.yaw_rate_radps);
    DynamicState {
        angular_velocity: Some(vec3_of(DVec3::Z * yaw_rate)),
        linear_velocity: Some(vec3_of(DVec3::X * speed_mps)),
        // The rear axle does not slip, and turns about a place to its side.
        linear_acceleration: Some(vec3_of(DVec3::new(
            motion.acceleration_mps2,
            speed_mps * yaw_rate,
            0.0,
        ))),
        angular_acceleration: Some(vec3_of(DVec3::ZERO)),
    }
}

/// The plan of an ego that goes along its route at its speed.
///
/// # Errors
/// Returns an error if the route is too far away to be driven to.
pub(super) fn along_route(localization: &Localization) -> Result<Plan, PlannerError> {
    let now = localization.now();
    let route_m = localization.route_m.iter();
    let points: Vec<DVec2> = route_m
        .map(|point| now.state.to_local(point.truncate()))
        .collect();
    let speed_mps = now.motion.speed_mps;
    let at = |along_m: f64| {
        let legs = along_m / Localization::SPACING_M;
        let leg = (legs.floor() as usize).min(points.len().saturating_sub(2));
        match points.get(leg..leg + 2) {
            Some(&[from, to]) => from + (to - from) * (legs - leg as f64),
            _ => DVec2::X * along_m,
        }
    };
    plan_through(|time_s| at(speed_mps * time_s))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::common::{Pose as PoseMessage, Quat};
    use decouplegs::planner::EgoMotion;
    use decouplegs::scene::{VehicleSize, VehicleState};
    use glam::DQuat;
    use proptest::prelude::*;

    const SIZE: VehicleSize = VehicleSize {
        length_m: 4.5,
        width_m: 1.8,
        height_m: 1.5,
    };

    fn info() -> EpisodeInfo {
        EpisodeInfo {
            scenario: "test".into(),
            seed: 1,
            step_s: 0.1,
            ego_size: SIZE,
            rear_axle_to_middle_m: 1.35,
            sensors: Vec::new(),
        }
    }

    /// An ego far from the origin of the world, on a slope, turned by 2 rad.
    fn localization(time_s: f64) -> Localization {
        let state = VehicleState {
            position_m: DVec2::new(430_000.25 + 8.0 * time_s, 5_400_000.5),
            yaw_rad: 2.0,
            speed_mps: 8.0,
            acceleration_mps2: 0.5,
        };
        let turned = DQuat::from_rotation_z(2.0) * DQuat::from_rotation_y(-0.05);
        Localization {
            path: vec![LocatedEgo {
                time_s,
                pose: Pose::new(turned, state.position_m.extend(120.75)),
                state,
                motion: EgoMotion {
                    speed_mps: 8.0,
                    acceleration_mps2: 0.5,
                    steer_rad: 0.1,
                    yaw_rate_radps: 0.2,
                },
            }],
            route_m: (0..5)
                .map(|index| {
                    state
                        .to_world(DVec2::new(4.0 * f64::from(index), 1.0))
                        .extend(120.0)
                })
                .collect(),
        }
    }

    fn frames() -> Frames {
        let mut frames = Frames::new(&info());
        frames.begin_at(&localization(0.0));
        frames
    }

    #[test]
    fn the_local_frame_begins_at_the_rig_and_turns_with_the_world() {
        let (path, states) = frames().path(&localization(0.0));
        let pose = pose_of(path.poses[0].pose.as_ref(), "pose").unwrap();
        assert_eq!(pose.translation, DVec3::ZERO);
        assert!(
            pose.rotation
                .angle_between(localization(0.0).now().pose.rotation)
                < 1e-6
        );
        assert_eq!(path.poses[0].timestamp_us, START_US);
        let state = &states[0];
        assert_eq!(state.linear_velocity.unwrap().x, 8.0);
        assert!((state.linear_acceleration.unwrap().y - 1.6).abs() < 1e-6);
        let (later, _) = frames().path(&localization(1.0));
        let pose = pose_of(later.poses[0].pose.as_ref(), "pose").unwrap();
        assert!((pose.translation - DVec3::X * 8.0).length() < 1e-6);
    }

    /// A driver that answers the pose that the rig would have some meters on, as AlpaSim's do: the
    /// anchor times a pose in the frame of the rig.
    #[test]
    fn a_trajectory_of_the_rig_is_a_plan_of_the_middle_of_the_box() {
        let (frames, localization) = (frames(), localization(2.0));
        let anchor = frames.local_from_rig(localization.now());
        let ahead = Pose::new(DQuat::from_rotation_z(0.3), DVec3::new(10.0, 1.0, 0.0));
        let pose = |pose: &Pose, after_us: u64| PoseAtTime {
            pose: Some(message_of(pose)),
            timestamp_us: time_us(2.0) + after_us,
        };
        let trajectory = Trajectory {
            poses: vec![pose(&anchor, 0), pose(&anchor.then(&ahead), 500_000)],
        };
        let plan = frames.plan(&trajectory, &localization).unwrap().unwrap();
        let [point] = plan.points() else {
            panic!("{plan:?}")
        };
        // The middle of the box is 1.35 m ahead of the axle, before and after. A slope of 0.05 rad
        // shortens ways ahead on the plane.
        let slope = 0.05_f64.cos();
        let x = slope * (10.0 + 1.35 * 0.3_f64.cos() - 1.35);
        let y = 1.0 + 1.35 * 0.3_f64.sin();
        let expected = DVec2::new(x, y);
        assert_eq!(point.time_s, 0.5);
        assert!(
            (point.position_m - expected).length() < 1e-5,
            "{point:?} {expected}"
        );
    }

    #[test]
    fn routes_are_padded_as_asked_for() {
        let (frames, localization) = (frames(), localization(0.0));
        let padded = frames.route(&localization, Padding::Nan);
        assert_eq!(padded.waypoints.len(), 20);
        assert!(padded.waypoints[4].x.is_finite() && padded.waypoints[5].x.is_nan());
        let plain = frames.route(&localization, Padding::None);
        assert_eq!(plain.waypoints.len(), 5);
        // On the plane, from the rear axle: 4 m on and 1 m to the left.
        let second = plain.waypoints[1];
        assert!((f64::from(second.y) - 1.0).abs() < 1e-5);
        assert!((f64::from(second.x) - f64::from(plain.waypoints[0].x) - 4.0).abs() < 0.01);
    }

    #[test]
    fn an_ego_along_its_route_keeps_its_speed() {
        let plan = along_route(&localization(0.0)).unwrap();
        let last = plan.points().last().unwrap();
        assert_eq!(last.time_s, 4.0);
        assert!(
            (last.position_m - DVec2::new(32.0, 1.0)).length() < 1e-8,
            "{last:?}"
        );
        let alone = Localization {
            route_m: Vec::new(),
            ..localization(0.0)
        };
        let plan = along_route(&alone).unwrap();
        assert_eq!(plan.at(1.0), DVec2::new(8.0, 0.0));
    }

    proptest! {
        #[test]
        fn no_trajectory_breaks_the_loop(poses in prop::collection::vec(
            (any::<[f32; 7]>(), any::<bool>(), 0..2 * START_US), 0..300,
        )) {
            let (frames, localization) = (frames(), localization(0.0));
            let message = |([x, y, z, qw, qx, qy, qz], is_there, timestamp_us): ([f32; 7], bool, u64)| {
                let pose = PoseMessage {
                    vec: Some(Vec3 { x, y, z }),
                    quat: Some(Quat { w: qw, x: qx, y: qy, z: qz }),
                };
                PoseAtTime { pose: is_there.then_some(pose), timestamp_us }
            };
            let trajectory = Trajectory { poses: poses.into_iter().map(message).collect() };
            if let Ok(Some(plan)) = frames.plan(&trajectory, &localization) {
                prop_assert!(plan.points().len() <= Plan::POINTS_MAX);
            }
        }
    }

    #[test]
    fn trajectories_that_are_none_are_refused_and_what_is_not_later_is_no_plan() {
        let (frames, localization) = (frames(), localization(0.0));
        let at = |timestamp_us: u64, x: f32| PoseAtTime {
            pose: Some(message_of(&Pose {
                translation: DVec3::new(f64::from(x), 0.0, 0.0),
                ..Pose::IDENTITY
            })),
            timestamp_us,
        };
        let plan = |poses| frames.plan(&Trajectory { poses }, &localization);
        assert_eq!(plan(vec![]), Ok(None));
        assert_eq!(plan(vec![at(START_US, 1.0), at(0, 2.0)]), Ok(None));
        let nowhere = PoseAtTime {
            pose: None,
            ..at(START_US + 1, 0.0)
        };
        assert!(
            plan(vec![nowhere])
                .unwrap_err()
                .contains("trajectory.poses[0] is missing")
        );
        let back = vec![at(START_US + 200, 1.0), at(START_US + 100, 1.0)];
        assert!(plan(back).unwrap_err().contains("what is no plan"));
        assert!(
            plan(vec![at(START_US + 1, f32::NAN)])
                .unwrap_err()
                .contains("finite")
        );
        let many = (1..=400).map(|index| at(START_US + 1_000 * index, 0.1));
        assert_eq!(
            plan(many.collect()).unwrap().unwrap().points().len(),
            Plan::POINTS_MAX
        );
        let far = vec![
            at(START_US + 1_000_000, 1.0),
            at(START_US + 40_000_000, 1.0),
        ];
        assert_eq!(plan(far).unwrap().unwrap().points().len(), 1);
    }
}
