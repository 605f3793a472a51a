//! Motion as timed poses.

use crate::{Invalid, Motion, Pose};

/// Half the time over which the motion at a moment is measured, seconds.
const MOTION_HALF_S: f64 = 0.005;

/// Pose at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedPose {
    /// The moment, seconds.
    pub time_s: f64,
    /// The pose at that moment.
    pub pose: Pose,
}

/// Timed poses, never none, their times finite and strictly rising.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    poses: Vec<TimedPose>,
}

impl Trajectory {
    /// A trajectory through `poses`.
    ///
    /// # Errors
    /// A sentence naming the first pose at fault when there is none, a value is not finite, or time
    /// does not rise.
    pub fn new(poses: Vec<TimedPose>) -> Result<Self, Invalid> {
        if poses.is_empty() {
            return Err("a trajectory needs at least one pose".into());
        }
        for (index, TimedPose { time_s, pose }) in poses.iter().enumerate() {
            if !(time_s.is_finite() && pose.translation.is_finite() && pose.rotation.is_finite()) {
                return Err(Invalid::new(format!(
                    "pose {index} has a time, position or rotation that is not finite"
                )));
            }
            if index > 0 && *time_s <= poses[index - 1].time_s {
                return Err(Invalid::new(format!(
                    "pose {index} at {time_s} s does not follow pose {} at {} s",
                    index - 1,
                    poses[index - 1].time_s
                )));
            }
        }
        Ok(Self { poses })
    }

    /// Standing at `pose` for all time.
    #[must_use]
    pub fn standing(pose: Pose) -> Self {
        Self {
            poses: vec![TimedPose { time_s: 0.0, pose }],
        }
    }

    /// The poses it passes through, in time.
    #[must_use]
    pub fn poses(&self) -> &[TimedPose] {
        &self.poses
    }

    /// First moment, seconds.
    #[must_use]
    pub fn start_s(&self) -> f64 {
        self.poses[0].time_s
    }

    /// Last moment, seconds.
    #[must_use]
    pub fn end_s(&self) -> f64 {
        self.poses[self.poses.len() - 1].time_s
    }

    /// The pose at `time_s`: position linear and rotation along the great arc between neighbors,
    /// the end poses before and after the ends. A time that is not a number counts as the start.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Pose {
        let next = self.poses.partition_point(|timed| timed.time_s <= time_s);
        let (Some(before), after) = (
            next.checked_sub(1).and_then(|i| self.poses.get(i)),
            self.poses.get(next),
        ) else {
            return self.poses[0].pose;
        };
        match after {
            Some(after) => {
                let share = (time_s - before.time_s) / (after.time_s - before.time_s);
                before.pose.interpolate(&after.pose, share)
            }
            None => before.pose,
        }
    }

    /// Motion at `time_s`, measured over 10 ms; rest before the start and after the end.
    #[must_use]
    pub fn motion_at(&self, time_s: f64) -> Motion {
        let from_s = (time_s - MOTION_HALF_S).max(self.start_s());
        let to_s = (time_s + MOTION_HALF_S).min(self.end_s());
        if from_s < to_s {
            Motion::between(&self.at(from_s), &self.at(to_s), to_s - from_s)
        } else {
            Motion::REST
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn trajectory() -> Trajectory {
        let pose = |time_s, yaw_rad, x| TimedPose {
            time_s,
            pose: Pose::from_yaw(yaw_rad, DVec3::X * x),
        };
        Trajectory::new(vec![
            pose(1.0, 0.0, 0.0),
            pose(2.0, 1.0, 10.0),
            pose(4.0, -3.0, 10.0),
        ])
        .unwrap()
    }

    #[test]
    fn motion_is_that_between_the_poses_around() {
        let trajectory = trajectory();
        for (time_s, x_mps, turn_rad_per_s) in [(1.0, 10.0, 1.0), (1.5, 10.0, 1.0), (0.5, 0.0, 0.0)]
        {
            let motion = trajectory.motion_at(time_s);
            assert!(
                (motion.velocity_mps - DVec3::X * x_mps).length() < 1e-9,
                "{motion:?}"
            );
            assert!((motion.turn_rad_per_s - DVec3::Z * turn_rad_per_s).length() < 1e-9);
        }
        assert!(trajectory.motion_at(9.0).is_rest());
    }

    #[test]
    fn poses_are_met_exactly_and_joined_between() {
        let trajectory = trajectory();
        for timed in trajectory.poses() {
            assert_eq!(trajectory.at(timed.time_s), timed.pose);
        }
        let middle = trajectory.at(1.25);
        assert!((middle.translation.x - 2.5).abs() < 1e-12);
        assert!(
            middle
                .rotation
                .angle_between(glam::DQuat::from_rotation_z(0.25))
                < 1e-7
        );
        // From 1 rad to -3 rad the shorter way leads over pi.
        let across = trajectory.at(3.0).rotation;
        assert!(
            across.angle_between(glam::DQuat::from_rotation_z(
                1.0 + (std::f64::consts::PI - 2.0)
            )) < 1e-7
        );
    }

    #[test]
    fn beyond_the_ends_it_stands() {
        let trajectory = trajectory();
        assert_eq!(trajectory.at(f64::NEG_INFINITY), trajectory.poses()[0].pose);
        assert_eq!(trajectory.at(f64::INFINITY), trajectory.poses()[2].pose);
        assert_eq!(trajectory.at(f64::NAN), trajectory.poses()[0].pose);
        assert_eq!((trajectory.start_s(), trajectory.end_s()), (1.0, 4.0));
        let standing = Trajectory::standing(Pose::IDENTITY);
        assert_eq!(standing.at(-5.0), standing.at(1e9));
    }

    #[test]
    fn what_is_no_motion_is_refused() {
        assert!(Trajectory::new(vec![]).is_err());
        let at = |time_s| TimedPose {
            time_s,
            pose: Pose::IDENTITY,
        };
        assert!(
            Trajectory::new(vec![at(1.0), at(1.0)])
                .unwrap_err()
                .reason()
                .contains("pose 1")
        );
        assert!(
            Trajectory::new(vec![at(f64::NAN)])
                .unwrap_err()
                .reason()
                .contains("finite")
        );
    }
}
