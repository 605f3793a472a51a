//! Boxes set on the ground: four corners, a plane, a pose.

use decouplegs_scene::Pose;
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::align::{Aligned, Register};
use super::prepared::Prepared;
use super::route::{Leg, may_use};
use super::{PoseFlags, RegisterOptions, Registered, RegisteredPose, Treatment};
use crate::ground::Ground;
use crate::polyline::{Foot, wrapped};

/// Corners farther than this from their plane lie on something, meters.
const UNEVEN_M: f64 = 0.08;
/// A road is not steeper; what is, is no road.
const GRADE_MAX: f64 = 0.4;
/// Largest distance of a lane to a track that follows none, meters.
const NEAR_M: f64 = 15.0;

/// A plane in the frame of a vehicle: z = height + forward x + left y.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoadPlane {
    /// Height under the middle of the vehicle, meters.
    pub height_m: f64,
    /// Rise a meter to its front.
    pub forward: f64,
    /// Rise a meter to its left.
    pub left: f64,
}

/// The four bottom corners of a box of `dims_m` in its own frame, seen from above.
#[must_use]
pub fn corners(dims_m: [f64; 3]) -> [DVec2; 4] {
    let half = DVec2::new(0.5 * dims_m[0], 0.5 * dims_m[1]);
    [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|side| half * DVec2::from_array(side))
}

/// The least-squares plane through at least three of four corners, and the largest distance of one
/// from it; `None` for fewer.
#[must_use]
pub fn plane(corners: &[DVec2; 4], heights_m: &[Option<f64>; 4]) -> Option<(RoadPlane, f64)> {
    let known: Vec<(DVec2, f64)> = corners
        .iter()
        .zip(heights_m)
        .filter_map(|(corner, height)| Some((*corner, (*height)?)))
        .collect();
    if known.len() < 3 {
        return None;
    }
    let first = known[0].1;
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for (corner, height) in &known {
        let row = DVec3::new(1.0, corner.x, corner.y);
        normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        right += row * (height - first);
    }
    let found = normal.inverse() * right;
    let off = |(corner, height): &(DVec2, f64)| {
        (found.x + found.y * corner.x + found.z * corner.y - (height - first)).abs()
    };
    let largest = known.iter().map(off).fold(0.0, f64::max);
    let plane = RoadPlane {
        height_m: first + found.x,
        forward: found.y,
        left: found.z,
    };
    let road = found.is_finite() && plane.forward.hypot(plane.left) <= GRADE_MAX;
    road.then_some((plane, largest))
}

/// The pose of a box of height `height_m` whose bottom lies in `plane` and whose middle is above
/// `at`, its nose towards `yaw_rad`.
#[must_use]
pub fn pose_on(plane: &RoadPlane, at: DVec2, yaw_rad: f64, height_m: f64) -> Pose {
    let (ahead, side) = (
        DVec2::from_angle(yaw_rad),
        DVec2::from_angle(yaw_rad).perp(),
    );
    let forward = ahead.extend(plane.forward).normalize();
    let up = forward.cross(side.extend(plane.left)).normalize();
    let rotation = DQuat::from_mat3(&DMat3::from_cols(forward, up.cross(forward), up));
    // The middle is half a height from the plane along its normal, and so more than that above it.
    Pose::new(rotation, at.extend(plane.height_m + 0.5 * height_m / up.z))
}

/// Surfaces on which poses are placed.
pub(super) struct Grounding<'a> {
    pub register: &'a Register<'a>,
    pub ground: Option<&'a Ground>,
    pub options: &'a RegisterOptions,
}

impl Grounding<'_> {
    /// `prepared` as `aligned`, on the ground.
    pub fn place(&self, prepared: &Prepared, aligned: Aligned, treatment: Treatment) -> Registered {
        let dims_m = prepared.track.dims_m.unwrap_or(self.options.dims_m);
        let pose = |at: usize| {
            let mut pose = self.pose(prepared, &aligned, at, dims_m);
            pose.flags.parked = treatment.is_parked();
            pose.flags.lane_unsure = treatment == Treatment::KeptLaneUnsure;
            pose
        };
        let poses = (0..prepared.track.points.len()).map(pose).collect();
        let lanes = aligned
            .legs
            .iter()
            .flat_map(|leg| leg.lanes.iter().copied())
            .collect();
        let Aligned {
            fit, lane_changes, ..
        } = aligned;
        Registered {
            fit,
            treatment,
            lanes,
            lane_changes,
            poses,
            noise_m: prepared.smoothed.noise_m,
        }
    }

    fn pose(
        &self,
        prepared: &Prepared,
        aligned: &Aligned,
        at: usize,
        dims_m: [f64; 3],
    ) -> RegisteredPose {
        let point = &prepared.track.points[at];
        let motion = &aligned.fit.motion;
        let position = motion.apply(prepared.smoothed.positions[at]);
        let logged_yaw = prepared.smoothed.yaws[at].map(|yaw_rad| yaw_rad + motion.yaw_rad);
        let on_leg = foot_on_leg(prepared, aligned, at, position);
        let lane = on_leg.or_else(|| {
            self.lane_near(
                prepared,
                position,
                logged_yaw,
                point.z_m.map(|z_m| z_m - 0.5 * dims_m[2]),
            )
        });
        let yaw_rad = wrapped(
            logged_yaw
                .or(lane.as_ref().map(|lane| lane.foot.heading_rad))
                .unwrap_or(0.0),
        );
        let mut flags = PoseFlags {
            lane_change: aligned
                .lane_changes
                .iter()
                .any(|change| change.contains(point.time_s)),
            outlier: prepared.smoothed.outliers[at],
            ..PoseFlags::default()
        };
        let lane_plane = lane
            .as_ref()
            .filter(|lane| lane.has_height)
            .map(|lane| lane.plane_along(yaw_rad));
        let logged = point.z_m.map(|z_m| RoadPlane {
            height_m: z_m - 0.5 * dims_m[2],
            forward: 0.0,
            left: 0.0,
        });
        let expected = lane_plane.or(logged);
        let measured = self
            .ground
            .and_then(|ground| under(ground, position, yaw_rad, dims_m, expected.as_ref()));
        let plane = match measured {
            Some((plane, off_m)) => {
                flags.uneven = off_m > UNEVEN_M;
                plane
            }
            None => {
                flags.no_support = self.ground.is_some();
                flags.no_height = expected.is_none();
                expected.unwrap_or(RoadPlane {
                    height_m: 0.0,
                    forward: 0.0,
                    left: 0.0,
                })
            }
        };
        let lane = on_leg.map(|lane| lane.foot);
        RegisteredPose {
            time_s: point.time_s,
            pose: pose_on(&plane, position, yaw_rad, dims_m[2]),
            lane,
            flags,
        }
    }

    /// The lane nearest to a track that follows none. The log's height chooses between levels.
    fn lane_near(
        &self,
        prepared: &Prepared,
        position: DVec2,
        yaw_rad: Option<f64>,
        z_m: Option<f64>,
    ) -> Option<LaneBelow> {
        let map = self.register.map;
        let mut near = self.register.index.lanes_near(position, NEAR_M);
        near.retain(|point| may_use(&prepared.track.class, map.lanes[point.lane].kind));
        let turned =
            |heading_rad: f64| yaw_rad.map_or(0.0, |yaw_rad| 1.0 - (heading_rad - yaw_rad).cos());
        let off = |point: &crate::lane_index::LanePoint| {
            let height = z_m
                .filter(|_| map.lanes[point.lane].has_height)
                .map_or(0.0, |z_m| (point.foot.point.z - z_m).abs());
            point.foot.distance_m
                + self.options.heading_weight * turned(point.foot.heading_rad)
                + height
        };
        let nearest = near.iter().min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let grade = self
            .register
            .index
            .line(nearest.lane)?
            .grade_at(nearest.foot.arc_m);
        Some(LaneBelow {
            foot: nearest.foot,
            grade,
            has_height: map.lanes[nearest.lane].has_height,
        })
    }
}

/// The lane under a vehicle.
#[derive(Clone, Copy)]
struct LaneBelow {
    foot: Foot,
    grade: f64,
    has_height: bool,
}

impl LaneBelow {
    fn plane_along(&self, yaw_rad: f64) -> RoadPlane {
        let turned = yaw_rad - self.foot.heading_rad;
        RoadPlane {
            height_m: self.foot.point.z,
            forward: self.grade * turned.cos(),
            left: -self.grade * turned.sin(),
        }
    }
}

/// The plane of `ground` under a box of `dims_m` whose center is at `pose`, and the box's pose with
/// its bottom on that plane. Position from above and heading stay. The surface is that near the
/// bottom of the box, or else the lowest. None where there is no ground.
#[must_use]
pub fn set_on_ground(ground: &Ground, pose: &Pose, dims_m: [f64; 3]) -> Option<(RoadPlane, Pose)> {
    let (position, yaw_rad) = (pose.translation.truncate(), pose.heading_rad());
    let bottom = RoadPlane {
        height_m: pose.transform(DVec3::new(0.0, 0.0, -0.5 * dims_m[2])).z,
        forward: (pose.rotation * DVec3::X).z,
        left: (pose.rotation * DVec3::Y).z,
    };
    let (plane, _) = under(ground, position, yaw_rad, dims_m, Some(&bottom))
        .or_else(|| under(ground, position, yaw_rad, dims_m, None))?;
    Some((plane, pose_on(&plane, position, yaw_rad, dims_m[2])))
}

/// The plane of the ground under the corners of a box.
fn under(
    ground: &Ground,
    position: DVec2,
    yaw_rad: f64,
    dims_m: [f64; 3],
    expected: Option<&RoadPlane>,
) -> Option<(RoadPlane, f64)> {
    let corners = corners(dims_m);
    let heights = corners.map(|corner| {
        let at = position + DVec2::from_angle(yaw_rad).rotate(corner);
        let expected_z_m =
            expected.map(|plane| plane.height_m + plane.forward * corner.x + plane.left * corner.y);
        ground.height_at(at, expected_z_m).map(|height| height.z_m)
    });
    plane(&corners, &heights)
}

/// Nearest point on the leg's lane to the track's point `at`, moved to `position`.
fn foot_on_leg(
    prepared: &Prepared,
    aligned: &Aligned,
    at: usize,
    position: DVec2,
) -> Option<LaneBelow> {
    let next = prepared
        .waypoints
        .partition_point(|waypoint| waypoint.index < at);
    let known = |waypoint: usize| aligned.feet.get(waypoint).copied().flatten();
    let (number, near) = known(next).or_else(|| known(next.checked_sub(1)?))?;
    // Between two waypoints it has not gone farther than from one to the other.
    const WINDOW_M: f64 = 5.0;
    let leg: &Leg = &aligned.legs[number];
    let foot = leg
        .line
        .project_within(position, near.arc_m - WINDOW_M, near.arc_m + WINDOW_M);
    let has_height = aligned.has_height.get(number).copied().unwrap_or(false);
    Some(LaneBelow {
        foot,
        grade: leg.line.grade_at(foot.arc_m),
        has_height,
    })
}
