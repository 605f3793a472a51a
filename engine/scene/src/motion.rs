//! Motion of a pose around a moment.

use glam::{DQuat, DVec3};

use crate::{Invalid, Pose};

/// Constant motion of a pose: its position moves along a line, and it turns about an axis of its
/// own.
///
/// Linear interpolation of positions and spherical linear interpolation of rotations between two
/// poses are such a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Velocity in the axes of the parent, meters per second.
    pub velocity_mps: DVec3,
    /// Rotation vector per second in the axes of the child, radians per second.
    pub turn_rad_per_s: DVec3,
}

impl Motion {
    /// The motion of a pose at rest.
    pub const REST: Self = Self {
        velocity_mps: DVec3::ZERO,
        turn_rad_per_s: DVec3::ZERO,
    };

    /// The motion that takes `start` to `end` in `duration_s`, which is above zero; rotation takes
    /// the shorter way.
    #[must_use]
    pub fn between(start: &Pose, end: &Pose, duration_s: f64) -> Self {
        let turn = (start.rotation.conjugate() * end.rotation).normalize();
        let shorter = if turn.w < 0.0 { -turn } else { turn };
        Self {
            velocity_mps: (end.translation - start.translation) / duration_s,
            turn_rad_per_s: shorter.to_scaled_axis() / duration_s,
        }
    }

    /// True if the pose is at rest.
    #[must_use]
    pub fn is_rest(&self) -> bool {
        *self == Self::REST
    }

    /// Checks that all numbers are finite.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        if self.velocity_mps.is_finite() && self.turn_rad_per_s.is_finite() {
            Ok(())
        } else {
            Err(Invalid::new(format!(
                "motion of {} m/s and {} rad/s; expected finite numbers",
                self.velocity_mps, self.turn_rad_per_s
            )))
        }
    }
}

impl Pose {
    /// The pose `time_s` later, or earlier where negative, under a constant motion.
    #[must_use]
    pub fn moved(&self, motion: &Motion, time_s: f64) -> Self {
        let turn = DQuat::from_scaled_axis(motion.turn_rad_per_s * time_s);
        Self {
            rotation: (self.rotation * turn).normalize(),
            translation: self.translation + motion.velocity_mps * time_s,
        }
    }

    /// The pose halfway between two, and the motion that takes one to the other in `duration_s`,
    /// which is above zero.
    #[must_use]
    pub fn halfway(start: &Self, end: &Self, duration_s: f64) -> (Self, Motion) {
        let motion = Motion::between(start, end, duration_s);
        (start.moved(&motion, 0.5 * duration_s), motion)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_between_two_poses_is_their_interpolation() {
        let start = Pose::new(DQuat::from_rotation_x(0.4), DVec3::new(1.0, 2.0, 3.0));
        let end = Pose::new(
            // The other quaternion of the same rotation: the shorter way is taken all the same.
            -(start.rotation * DQuat::from_scaled_axis(DVec3::new(0.3, -0.2, 0.5))),
            DVec3::new(2.0, 1.0, 3.5),
        );
        let motion = Motion::between(&start, &end, 0.03);
        for share in [0.0, 0.25, 0.5, 1.0] {
            let expected = start.interpolate(&end, share);
            let found = start.moved(&motion, 0.03 * share);
            assert!((expected.translation - found.translation).length() < 1e-12);
            assert!(expected.rotation.angle_between(found.rotation) < 1e-7);
        }
        let (middle, _) = Pose::halfway(&start, &end, 0.03);
        let back = middle.moved(&motion, -0.015);
        assert!((back.translation - start.translation).length() < 1e-12);
        assert!(back.rotation.angle_between(start.rotation) < 1e-7);
    }

    #[test]
    fn rest_leaves_a_pose_as_it_is() {
        let pose = Pose::from_yaw(1.1, DVec3::new(-4.0, 0.5, 0.0));
        assert!(Motion::between(&pose, &pose, 0.1).is_rest());
        assert_eq!(pose.moved(&Motion::REST, 5.0).translation, pose.translation);
        let fast = Motion {
            velocity_mps: DVec3::INFINITY,
            ..Motion::REST
        };
        assert!(fast.check().unwrap_err().reason().contains("inf"));
    }
}
