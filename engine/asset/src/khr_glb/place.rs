//! A cloud moved by any affine transform.

use decouplegs_scene::shape::principal_axes_of;
use decouplegs_scene::{Pose, SplatCloud};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;

use crate::spz::flip;

/// Rounds of the polar decomposition; it squares its error in each.
const ROUNDS: usize = 40;
/// Scales along the axes that differ by less, relatively, count as equal.
const EQUAL: f64 = 1e-6;

/// Moves `cloud` by `world` from its own frame. Means go where it sends them, and shapes are those
/// of the transformed Gaussians. Colors turn by the rotation that is nearest to the transform,
/// mirrored where it mirrors.
pub(super) fn place(cloud: &mut SplatCloud, world: &DAffine3) {
    if *world == DAffine3::IDENTITY {
        return;
    }
    let mut matrix = world.matrix3;
    if matrix.determinant() < 0.0 {
        flip(cloud, [-1.0, 1.0, 1.0]);
        matrix.x_axis = -matrix.x_axis;
    }
    let turn = nearest_rotation(&matrix);
    // What is left beside the rotation: the same along all axes for rigid and uniformly scaled
    // nodes.
    let stretch = DMat3::from_quat(turn).transpose() * matrix;
    let scale = stretch.determinant().cbrt();
    let is_uniform = stretch.abs_diff_eq(DMat3::from_diagonal(DVec3::splat(scale)), EQUAL * scale);
    let (own_scales, own_rotations) = (cloud.scales.clone(), cloud.rotations.clone());
    let own_means = cloud.means.clone();
    // Turning by nothing would still round.
    if turn != DQuat::IDENTITY {
        *cloud = std::mem::take(cloud).placed(
            &Pose {
                rotation: turn,
                translation: DVec3::ZERO,
            },
            true,
        );
    }
    let linear = DAffine3 {
        matrix3: matrix,
        translation: world.translation,
    };
    cloud
        .means
        .par_iter_mut()
        .zip(own_means)
        .for_each(|(mean, own)| {
            *mean = linear
                .transform_point3(DVec3::from_array(own.map(f64::from)))
                .as_vec3()
                .to_array();
        });
    if is_uniform {
        cloud
            .scales
            .par_iter_mut()
            .for_each(|scales| *scales = scales.map(|own| (f64::from(own) * scale) as f32));
        return;
    }
    let shapes = cloud.scales.par_iter_mut().zip(&mut cloud.rotations);
    shapes
        .zip(own_scales.par_iter().zip(&own_rotations))
        .for_each(|((scales, rotation), (own_scales, own_rotation))| {
            let [w, x, y, z] = own_rotation.map(f64::from);
            let [sx, sy, sz] = own_scales.map(f64::from);
            let own = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
            let sides =
                [own.x_axis * sx, own.y_axis * sy, own.z_axis * sz].map(|side| matrix * side);
            // A splat that cannot be drawn stays one.
            if sides.iter().all(|side| side.is_finite()) {
                let axes = principal_axes_of(sides);
                (*scales, *rotation) = (axes.scales, axes.rotation);
            }
        });
}

/// The rotation of the polar decomposition of `matrix`, whose determinant is positive (Higham
/// 1986).
fn nearest_rotation(matrix: &DMat3) -> DQuat {
    let mut rotation = *matrix * (1.0 / matrix.determinant().cbrt());
    for _ in 0..ROUNDS {
        let next = (rotation + rotation.inverse().transpose()) * 0.5;
        let is_done = next.abs_diff_eq(rotation, 1e-15);
        rotation = next;
        if is_done {
            break;
        }
    }
    DQuat::from_mat3(&rotation).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::sh;

    fn cloud() -> SplatCloud {
        SplatCloud {
            means: vec![[1.0, -2.0, 0.5]],
            scales: vec![[0.1, 0.5, 2.0]],
            rotations: vec![[0.5, 0.1, -0.7, 0.5]],
            opacities: vec![0.5],
            sh_degree: 3,
            sh_dc: vec![[0.3; 3]],
            sh_rest: (0..15)
                .map(|k| [k as f32 * 0.1 - 0.7, 0.2, -0.1 * k as f32])
                .collect(),
        }
    }

    fn covariance(cloud: &SplatCloud) -> DMat3 {
        let [w, x, y, z] = cloud.rotations[0].map(f64::from);
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scale = DVec3::from_array(cloud.scales[0].map(f64::from));
        rotation * DMat3::from_diagonal(scale * scale) * rotation.transpose()
    }

    fn color(cloud: &SplatCloud, d: DVec3) -> f64 {
        cloud
            .rest_of(0)
            .iter()
            .zip(&sh::basis(d)[1..])
            .map(|(c, y)| f64::from(c[0]) * y)
            .sum()
    }

    #[test]
    fn shapes_are_those_of_the_transformed_gaussian() {
        let turn = DQuat::from_euler(glam::EulerRot::ZYX, 0.7, -0.4, 1.9);
        for scale in [
            DVec3::splat(2.0),
            DVec3::new(1.0, 3.0, 0.5),
            DVec3::new(-1.0, 1.0, 1.0),
            DVec3::new(-2.0, -1.0, -0.5),
        ] {
            let world =
                DAffine3::from_scale_rotation_translation(scale, turn, DVec3::new(4.0, 5.0, 6.0));
            let (original, mut placed) = (cloud(), cloud());
            place(&mut placed, &world);
            let expected = world.matrix3 * covariance(&original) * world.matrix3.transpose();
            let size = expected
                .to_cols_array()
                .into_iter()
                .fold(0.0, |most: f64, x| most.max(x.abs()));
            assert!(
                covariance(&placed).abs_diff_eq(expected, 1e-5 * size),
                "{scale}"
            );
            let mean = world.transform_point3(DVec3::new(1.0, -2.0, 0.5));
            assert!((DVec3::from_array(placed.means[0].map(f64::from)) - mean).length() < 1e-5);
        }
    }

    #[test]
    fn colors_turn_and_mirror_with_what_they_are_on() {
        let turn = DQuat::from_euler(glam::EulerRot::ZYX, 0.7, -0.4, 1.9);
        for scale in [
            DVec3::splat(2.0),
            DVec3::new(-1.0, 1.0, 1.0),
            DVec3::new(1.0, -3.0, 1.0) / 3.0,
        ] {
            let world = DAffine3::from_scale_rotation_translation(
                scale.signum() * scale.length(),
                turn,
                DVec3::ZERO,
            );
            let (original, mut placed) = (cloud(), cloud());
            place(&mut placed, &world);
            for d in [DVec3::X, DVec3::Y, DVec3::new(0.6, 0.0, 0.8)] {
                let seen = (world.matrix3 * d).normalize();
                assert!(
                    (color(&original, d) - color(&placed, seen)).abs() < 1e-5,
                    "{scale} {d}"
                );
            }
        }
    }

    #[test]
    fn nothing_changes_where_nothing_moves() {
        let mut placed = cloud();
        place(&mut placed, &DAffine3::IDENTITY);
        assert_eq!(placed, cloud());
    }
}
