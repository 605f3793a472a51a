//! Poses of messages, checked, and back.

use decouplegs::scene::{Motion, Pose};
use glam::{DQuat, DVec3};
use tonic::Status;

use crate::wire::common;
use crate::wire::sensorsim::PosePair;

/// Largest distance from the local origin, meters: farther away, f32 has no decimeters left.
const DISTANCE_MAX_M: f64 = 1e6;
/// A quaternion shorter than this is no rotation.
const QUATERNION_MIN: f64 = 1e-6;

/// The pose in `field` of a message.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that is missing or makes no sense.
pub fn pose_of(pose: Option<&common::Pose>, field: &str) -> Result<Pose, Status> {
    let pose = pose.ok_or_else(|| Status::invalid_argument(format!("{field} is missing")))?;
    let position = pose.vec.unwrap_or_default();
    let position = DVec3::new(position.x.into(), position.y.into(), position.z.into());
    if !(position.is_finite() && position.length() <= DISTANCE_MAX_M) {
        let reason = format!(
            "{field}.vec: {position} must be finite and within {DISTANCE_MAX_M:e} m of the local origin"
        );
        return Err(Status::invalid_argument(reason));
    }
    let turn = pose.quat.unwrap_or_default();
    let turn = DQuat::from_xyzw(turn.x.into(), turn.y.into(), turn.z.into(), turn.w.into());
    if !(turn.is_finite() && turn.length() >= QUATERNION_MIN) {
        let (w, x, y, z) = (turn.w, turn.x, turn.y, turn.z);
        return Err(Status::invalid_argument(format!(
            "{field}.quat: w {w}, x {x}, y {y}, z {z} is no rotation"
        )));
    }
    Ok(Pose::new(turn, position))
}

/// The pose halfway between the two in `field` of a message, where something is at mid-shutter, and
/// the motion from one to the other in `duration_s`; rest where that is 0.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that is missing or makes no sense.
pub fn middle_of(
    pair: Option<&PosePair>,
    duration_s: f64,
    field: &str,
) -> Result<(Pose, Motion), Status> {
    let (start, end) = pair_of(pair, field)?;
    let motion = if duration_s > 0.0 {
        Motion::between(&start, &end, duration_s)
    } else {
        Motion::REST
    };
    Ok((start.interpolate(&end, 0.5), motion))
}

/// The start and the end in `field` of a message.
///
/// # Errors
/// INVALID_ARGUMENT with the name of the field that is missing or makes no sense.
pub fn pair_of(pair: Option<&PosePair>, field: &str) -> Result<(Pose, Pose), Status> {
    let pair = pair.ok_or_else(|| Status::invalid_argument(format!("{field} is missing")))?;
    let start = pose_of(pair.start_pose.as_ref(), &format!("{field}.start_pose"))?;
    let end = pose_of(pair.end_pose.as_ref(), &format!("{field}.end_pose"))?;
    Ok((start, end))
}

/// `pose` as a message.
#[must_use]
pub fn message_of(pose: &Pose) -> common::Pose {
    let Pose {
        rotation,
        translation,
    } = pose;
    common::Pose {
        vec: Some(vec3_of(*translation)),
        quat: Some(common::Quat {
            w: rotation.w as f32,
            x: rotation.x as f32,
            y: rotation.y as f32,
            z: rotation.z as f32,
        }),
    }
}

/// `place` as a message.
#[must_use]
pub fn vec3_of(place: DVec3) -> common::Vec3 {
    common::Vec3 {
        x: place.x as f32,
        y: place.y as f32,
        z: place.z as f32,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn poses_survive_the_wire_as_far_as_f32_holds_them() {
        let pose = Pose::new(
            DQuat::from_xyzw(0.1, -0.7, 0.3, 0.5),
            DVec3::new(120.25, -33.5, 1.75),
        );
        let read = pose_of(Some(&message_of(&pose)), "pose").unwrap();
        assert_eq!(read.translation, pose.translation);
        assert!(read.rotation.angle_between(pose.rotation) < 1e-6);
    }

    #[test]
    fn a_place_is_added_after_the_turn() {
        let quarter = common::Quat {
            w: 0.5f32.sqrt(),
            x: 0.0,
            y: 0.0,
            z: 0.5f32.sqrt(),
        };
        let pose = common::Pose {
            vec: Some(common::Vec3 {
                x: 10.0,
                y: 0.0,
                z: 0.0,
            }),
            quat: Some(quarter),
        };
        let moved = pose_of(Some(&pose), "pose").unwrap().transform(DVec3::X);
        assert!(
            (moved - DVec3::new(10.0, 1.0, 0.0)).length() < 1e-6,
            "{moved}"
        );
    }

    #[test]
    fn nonsense_is_refused_by_the_name_of_its_field() {
        let level = common::Quat {
            w: 1.0,
            x: 0.0,
            y: 0.0,
            z: 0.0,
        };
        let said = |vec, quat| {
            pose_of(
                Some(&common::Pose {
                    vec: Some(vec),
                    quat: Some(quat),
                }),
                "sensor_pose",
            )
            .unwrap_err()
        };
        for x in [f32::NAN, f32::INFINITY, 1e9] {
            let status = said(common::Vec3 { x, y: 0.0, z: 0.0 }, level);
            assert!(
                status.code() == tonic::Code::InvalidArgument
                    && status.message().starts_with("sensor_pose.vec"),
                "{status}"
            );
        }
        for quat in [
            common::Quat::default(),
            common::Quat {
                w: f32::NAN,
                ..level
            },
        ] {
            assert!(
                said(common::Vec3::default(), quat)
                    .message()
                    .starts_with("sensor_pose.quat")
            );
        }
        assert!(
            pose_of(None, "x")
                .unwrap_err()
                .message()
                .contains("x is missing")
        );
        assert!(
            middle_of(Some(&PosePair::default()), 0.03, "pair")
                .unwrap_err()
                .message()
                .contains("pair.start_pose")
        );
    }
}
