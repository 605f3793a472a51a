//! Similarity transforms of splats: one scale, a rotation and a translation, in f64.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::{Pose, SplatCloud, sh};

/// A transform that keeps shapes, `p_parent = scale * (rotation * p_child) + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Factor of all lengths, above 0.
    pub scale: f64,
    /// Unit quaternion.
    pub rotation: DQuat,
    /// Position of the child's origin in the parent, meters.
    pub translation: DVec3,
}

impl Similarity {
    /// The transform that changes nothing.
    pub const IDENTITY: Self = Self {
        scale: 1.0,
        rotation: DQuat::IDENTITY,
        translation: DVec3::ZERO,
    };

    /// A move by `translation`, meters.
    #[must_use]
    pub fn from_translation(translation: DVec3) -> Self {
        Self {
            translation,
            ..Self::IDENTITY
        }
    }

    /// A turn around the origin by `rotation`, which is normalized.
    #[must_use]
    pub fn from_rotation(rotation: DQuat) -> Self {
        Self {
            rotation: rotation.normalize(),
            ..Self::IDENTITY
        }
    }

    /// Growth from the origin by the factor `scale`, above 0.
    #[must_use]
    pub fn from_scale(scale: f64) -> Self {
        Self {
            scale,
            ..Self::IDENTITY
        }
    }

    /// The turn that brings the axis `from` to the axis `to`, both of unit length, by the shorter
    /// way. Half a turn is around x, or around z where `from` is along x.
    #[must_use]
    pub fn from_axes(from: DVec3, to: DVec3) -> Self {
        let rotation = if from.dot(to) < -0.999_999 {
            let around = if from.x.abs() < 0.5 {
                DVec3::X
            } else {
                DVec3::Z
            };
            DQuat::from_xyzw(around.x, around.y, around.z, 0.0)
        } else {
            DQuat::from_rotation_arc(from, to)
        };
        Self::from_rotation(rotation)
    }

    /// `self` after `child`: grandparent from child, where `self` is grandparent from parent.
    #[must_use]
    pub fn then(&self, child: &Self) -> Self {
        Self {
            scale: self.scale * child.scale,
            rotation: (self.rotation * child.rotation).normalize(),
            translation: self.transform(child.translation),
        }
    }

    /// The transform back: child from parent.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.conjugate();
        Self {
            scale: self.scale.recip(),
            rotation,
            translation: -(rotation * self.translation) / self.scale,
        }
    }

    /// A point of the child frame in the parent frame.
    #[must_use]
    pub fn transform(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.translation
    }

    /// The pose in the parent frame of what has `pose` in the child frame, such as a camera.
    #[must_use]
    pub fn placed(&self, pose: &Pose) -> Pose {
        Pose::new(
            self.rotation * pose.rotation,
            self.transform(pose.translation),
        )
    }
}

impl SplatCloud {
    /// The cloud moved by `parent_from_child`. Shapes turn and grow with it, and colors turn with
    /// it. What a part of the transform does not change keeps its bits.
    #[must_use]
    pub fn transformed(&self, parent_from_child: &Similarity) -> Self {
        let &Similarity {
            scale, rotation, ..
        } = parent_from_child;
        let mut cloud = self.clone();
        if *parent_from_child == Similarity::IDENTITY {
            return cloud;
        }
        cloud.means.par_iter_mut().for_each(|mean| {
            let child = DVec3::from_array(mean.map(f64::from));
            *mean = parent_from_child.transform(child).as_vec3().to_array();
        });
        if scale != 1.0 {
            let grow = |own: f32| (f64::from(own) * scale) as f32;
            let scales = cloud.scales.par_iter_mut();
            scales.for_each(|scales| *scales = scales.map(grow));
        }
        // Turning by nothing would still round.
        if rotation == DQuat::IDENTITY {
            return cloud;
        }
        cloud.rotations.par_iter_mut().for_each(|own| {
            let [w, x, y, z] = own.map(f64::from);
            let turned = (rotation * DQuat::from_xyzw(x, y, z, w)).normalize();
            // A splat without a rotation stays one: it is counted as such.
            if turned.is_finite() {
                *own = [turned.w, turned.x, turned.y, turned.z].map(|part| part as f32);
            }
        });
        let stride = cloud.rest_stride();
        if stride > 0 {
            let turn = sh::ShRotation::new(rotation);
            let rests = cloud.sh_rest.par_chunks_mut(stride);
            rests.for_each(|rest| turn.rotate(rest));
        }
        cloud
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn any() -> Similarity {
        Similarity::from_translation(DVec3::new(3.0, -2.0, 0.5))
            .then(&Similarity::from_scale(2.5))
            .then(&Similarity::from_rotation(DQuat::from_euler(
                glam::EulerRot::ZYX,
                0.7,
                -1.1,
                2.3,
            )))
    }

    fn cloud() -> SplatCloud {
        let count = 40;
        let number = |index: usize, by: f32| (index as f32 * by).sin();
        SplatCloud {
            means: (0..count)
                .map(|i| [9.0 * number(i, 0.37), 9.0 * number(i, 0.91), number(i, 1.7)])
                .collect(),
            scales: (0..count)
                .map(|i| [0.1, 0.2 + 0.1 * number(i, 0.3), 0.01])
                .collect(),
            rotations: (0..count)
                .map(|i| {
                    let axis = glam::Vec3::new(number(i, 2.0), number(i, 3.0), 1.0).normalize();
                    let turn = glam::Quat::from_axis_angle(axis, i as f32);
                    [turn.w, turn.x, turn.y, turn.z]
                })
                .collect(),
            opacities: vec![0.5; count],
            sh_degree: 3,
            sh_dc: vec![[0.3; 3]; count],
            sh_rest: (0..count * 15)
                .map(|i| [number(i, 0.2), number(i, 0.5), number(i, 0.9)])
                .collect(),
        }
    }

    #[test]
    fn composition_is_right_to_left_and_the_inverse_undoes() {
        let (a, b) = (
            any(),
            Similarity::from_axes(DVec3::NEG_Y, DVec3::Z).then(&Similarity::from_scale(0.1)),
        );
        let p = DVec3::new(0.2, -0.7, 1.9);
        assert!((a.then(&b).transform(p) - a.transform(b.transform(p))).length() < 1e-12);
        assert!((a.inverse().transform(a.transform(p)) - p).length() < 1e-12);
    }

    #[test]
    fn axes_go_to_axes_and_back() {
        for from in DVec3::AXES.into_iter().chain(DVec3::AXES.map(|axis| -axis)) {
            for to in DVec3::AXES.into_iter().chain(DVec3::AXES.map(|axis| -axis)) {
                let turn = Similarity::from_axes(from, to);
                assert!((turn.transform(from) - to).length() < 1e-15, "{from} {to}");
                let back = Similarity::from_axes(to, from).then(&turn);
                assert!((back.transform(DVec3::ONE) - DVec3::ONE).length() < 1e-14);
            }
        }
        // y up becomes z up, and x stays.
        let up = Similarity::from_axes(DVec3::Y, DVec3::Z);
        assert!(
            (up.transform(DVec3::new(1.0, 2.0, 3.0)) - DVec3::new(1.0, -3.0, 2.0)).length() < 1e-14
        );
    }

    #[test]
    fn a_cloud_is_turned_and_scaled_as_its_gaussians_are() {
        let (own, there) = (cloud(), any());
        let moved = own.transformed(&there);
        for splat in 0..own.len() {
            assert!((there.transform(own.mean_m(splat)) - moved.mean_m(splat)).length() < 1e-5);
            // The standard deviation along a direction, as a length that turns and grows.
            let deviation = |cloud: &SplatCloud, towards: DVec3| {
                let [w, x, y, z] = cloud.rotations[splat].map(f64::from);
                let local = DQuat::from_xyzw(x, y, z, w).conjugate() * towards;
                (local * DVec3::from_array(cloud.scales[splat].map(f64::from))).length()
            };
            for towards in DVec3::AXES {
                let before = there.scale * deviation(&own, towards);
                let after = deviation(&moved, there.rotation * towards);
                assert!((before - after).abs() < 1e-6 * before.max(1.0));
            }
            let color = |cloud: &SplatCloud, towards: DVec3| -> f64 {
                let basis = sh::basis(towards);
                let rest = cloud.rest_of(splat).iter().zip(&basis[1..]);
                rest.map(|(c, y)| f64::from(c[1]) * y).sum()
            };
            let towards = DVec3::new(0.6, 0.0, 0.8);
            let turned = there.rotation * towards;
            assert!((color(&own, towards) - color(&moved, turned)).abs() < 1e-6);
        }
        // The comparison must be able to fail: colors that do not turn differ.
        let kept = own.placed(&Pose::new(there.rotation, DVec3::ZERO), false);
        assert!(
            kept.sh_rest
                .iter()
                .zip(&moved.sh_rest)
                .any(|(a, b)| (a[1] - b[1]).abs() > 0.1)
        );
    }

    #[test]
    fn the_way_back_restores_all_to_the_rounding_of_floats() {
        let own = cloud();
        let back = own.transformed(&any()).transformed(&any().inverse());
        let near = |a: &[f32], b: &[f32], limit: f32| {
            assert!(
                a.iter().zip(b).all(|(a, b)| (a - b).abs() <= limit),
                "{a:?} {b:?}"
            );
        };
        near(own.means.as_flattened(), back.means.as_flattened(), 4e-6);
        near(own.scales.as_flattened(), back.scales.as_flattened(), 1e-7);
        near(
            own.sh_rest.as_flattened(),
            back.sh_rest.as_flattened(),
            1e-6,
        );
        for (a, b) in own.rotations.iter().zip(&back.rotations) {
            let dot: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            assert!(dot.abs() > 1.0 - 1e-6);
        }
        // Of parts that do nothing, not a bit.
        let moved = own.transformed(&Similarity::from_translation(DVec3::X));
        assert_eq!(
            (&moved.rotations, &moved.sh_rest),
            (&own.rotations, &own.sh_rest)
        );
        assert_eq!(moved.scales, own.scales);
        let broken = SplatCloud {
            rotations: vec![[0.0; 4]; own.len()],
            ..own
        };
        assert_eq!(broken.transformed(&any()).rotations, broken.rotations);
    }
}
