//! Rigid transforms in f64.

use glam::{DMat3, DQuat, DVec3};

/// An active rigid transform, `p_parent = rotation * p_child + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Position of the child's origin in the parent, meters.
    pub translation: DVec3,
}

impl Pose {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        rotation: DQuat::IDENTITY,
        translation: DVec3::ZERO,
    };

    /// A pose from a rotation, which is normalized, and a translation in meters.
    #[must_use]
    pub fn new(rotation: DQuat, translation: DVec3) -> Self {
        Self {
            rotation: rotation.normalize(),
            translation,
        }
    }

    /// Heading `yaw_rad` about +z at `translation`: how a vehicle stands on level ground.
    #[must_use]
    pub fn from_yaw(yaw_rad: f64, translation: DVec3) -> Self {
        Self::new(DQuat::from_rotation_z(yaw_rad), translation)
    }

    /// Heading of a vehicle with this pose, from x towards y, radians.
    #[must_use]
    pub fn heading_rad(&self) -> f64 {
        let ahead = self.rotation * DVec3::X;
        ahead.y.atan2(ahead.x)
    }

    /// The camera at `eye` that looks at `target` with its image's up towards `up` (OpenCV axes),
    /// as parent from camera.
    ///
    /// Returns `None` when `eye`, `target` and `up` span no frame.
    #[must_use]
    pub fn look_at(eye: DVec3, target: DVec3, up: DVec3) -> Option<Self> {
        let forward = (target - eye).try_normalize()?;
        let right = forward.cross(up).try_normalize()?;
        let down = forward.cross(right);
        Some(Self::new(
            DQuat::from_mat3(&DMat3::from_cols(right, down, forward)),
            eye,
        ))
    }

    /// `self` after `child`: grandparent from child, where `self` is grandparent from parent.
    #[must_use]
    pub fn then(&self, child: &Self) -> Self {
        Self {
            rotation: (self.rotation * child.rotation).normalize(),
            translation: self.transform(child.translation),
        }
    }

    /// The transform back: child from parent.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// A point of the child frame in the parent frame.
    #[must_use]
    pub fn transform(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// Pose between two: position linear, rotation along the shorter great arc; `s` in 0 to 1.
    #[must_use]
    pub fn interpolate(&self, other: &Self, s: f64) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, s).normalize(),
            translation: self.translation.lerp(other.translation, s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn inverse_undoes_and_composition_is_right_to_left() {
        let a = Pose::new(DQuat::from_rotation_x(0.3), DVec3::new(1.0, 2.0, 3.0));
        let b = Pose::from_yaw(1.1, DVec3::new(-4.0, 0.5, 0.0));
        let p = DVec3::new(0.2, -0.7, 1.9);
        assert!((a.then(&b).transform(p) - a.transform(b.transform(p))).length() < 1e-12);
        assert!((a.inverse().transform(a.transform(p)) - p).length() < 1e-12);
    }

    #[test]
    fn look_at_puts_the_target_ahead_and_up_above() {
        let pose = Pose::look_at(DVec3::ZERO, DVec3::new(5.0, 0.0, 0.0), DVec3::Z).unwrap();
        let in_camera = pose.inverse();
        assert!(
            (in_camera.transform(DVec3::new(5.0, 0.0, 0.0)) - DVec3::new(0.0, 0.0, 5.0)).length()
                < 1e-12
        );
        assert!(
            in_camera.transform(DVec3::new(5.0, 0.0, 1.0)).y < 0.0,
            "up in the world is up in the image (y down)"
        );
        assert!(
            in_camera.transform(DVec3::new(5.0, 1.0, 0.0)).x < 0.0,
            "left in the world is left in the image"
        );
        assert!(Pose::look_at(DVec3::ZERO, DVec3::Z, DVec3::Z).is_none());
    }
}
