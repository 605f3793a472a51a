//! Directions of the axes of a stored cloud.

use decouplegs_scene::{Pose, SplatCloud, sh};
use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::DecodeError;

/// The axes of a file, by the code of the Adobe coordinate-system extension.
///
/// Codes 1 to 8 name x, y, z as left/right, down/up, back/front; codes 9 to 16 as left/right,
/// front/back, down/up.
///
/// We follow the names. The reference (nianticlabs/spz at 3f156355) flips y where LFD, RFD, LBU and
/// RBU (9, 10, 15, 16) ask for z and z where they ask for y, so a file that it wrote in one of
/// these four reads upside down. All others agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct StoredAxes(u32);

impl StoredAxes {
    /// Right, up, back: what a file has that names none.
    pub(super) const RUB: Self = Self(4);

    /// The axes with the given code; 0 is 'not specified'.
    pub(super) fn of_code(code: u32) -> Result<Self, DecodeError> {
        match code {
            0 => Ok(Self::RUB),
            1..=16 => Ok(Self(code)),
            _ => Err(DecodeError::Malformed(format!(
                "coordinate system {code} is unknown; 0 to 16 are defined"
            ))),
        }
    }

    /// Turns a cloud from these axes to right-down-front, those of a PLY.
    pub(super) fn turn_to_ply(self, cloud: &mut SplatCloud) {
        let bit = |index: u32| (self.0 - 1) >> index & 1 == 1;
        let sign = |positive: bool| if positive { 1.0 } else { -1.0 };
        if self.0 <= 8 {
            flip(cloud, [sign(bit(0)), sign(!bit(1)), sign(bit(2))]);
        } else {
            // To right-front-up, whose y and z become front and up.
            flip(cloud, [sign(bit(0)), sign(!bit(2)), sign(bit(1))]);
            let quarter_turn = Pose::new(
                DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
                DVec3::ZERO,
            );
            *cloud = std::mem::take(cloud).placed(&quarter_turn, true);
        }
    }
}

/// Signs by which a cloud is mirrored. Exact: only signs change.
pub(super) struct Signs {
    /// Signs of x, y and z.
    pub(super) means: [f32; 3],
    /// Signs of w, x, y and z of rotations.
    pub(super) rotations: [f32; 4],
    /// Signs of the coefficients after DC, degree 3.
    pub(super) rest: [f32; sh::coefficient_count(sh::DEGREE_MAX) - 1],
}

impl Signs {
    /// Signs that mirror along the axes whose sign is negative.
    fn new([x, y, z]: [f32; 3]) -> Self {
        // Each basis function is even or odd in each axis, so a mirrored direction changes at most
        // its sign.
        let d = DVec3::new(0.36, 0.48, 0.8);
        let mirrored = sh::basis(d * DVec3::new(x.into(), y.into(), z.into()));
        let original = sh::basis(d);
        Self {
            means: [x, y, z],
            rotations: [1.0, y * z, x * z, x * y],
            rest: std::array::from_fn(|k| (original[k + 1] * mirrored[k + 1]).signum() as f32),
        }
    }

    /// Signs that turn right-down-front axes, those of a PLY, to right-up-back ones, and back.
    pub(super) fn between_ply_and_rub() -> Self {
        Self::new([1.0, -1.0, -1.0])
    }
}

/// Mirrors a cloud along the axes whose sign is negative.
pub(crate) fn flip(cloud: &mut SplatCloud, signs: [f32; 3]) {
    if signs == [1.0; 3] {
        return;
    }
    let signs = Signs::new(signs);
    cloud
        .means
        .par_iter_mut()
        .for_each(|mean| *mean = std::array::from_fn(|i| mean[i] * signs.means[i]));
    cloud
        .rotations
        .par_iter_mut()
        .for_each(|rotation| *rotation = std::array::from_fn(|i| rotation[i] * signs.rotations[i]));
    let stride = cloud.rest_stride();
    if stride > 0 {
        cloud.sh_rest.par_chunks_exact_mut(stride).for_each(|rest| {
            for (coefficient, sign) in rest.iter_mut().zip(&signs.rest) {
                *coefficient = coefficient.map(|channel| channel * sign);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud() -> SplatCloud {
        SplatCloud {
            means: vec![[1.0, 2.0, 3.0]],
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

    /// The covariance that scale and rotation of the one splat stand for.
    fn covariance(cloud: &SplatCloud) -> glam::DMat3 {
        let [w, x, y, z] = cloud.rotations[0].map(f64::from);
        let rotation = glam::DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scale = DVec3::from_array(cloud.scales[0].map(f64::from));
        rotation * glam::DMat3::from_diagonal(scale * scale) * rotation.transpose()
    }

    #[test]
    fn half_a_turn_about_x_is_what_placing_the_cloud_gives() {
        let mut flipped = cloud();
        StoredAxes::RUB.turn_to_ply(&mut flipped);
        let placed = cloud().placed(
            &Pose::new(DQuat::from_rotation_x(std::f64::consts::PI), DVec3::ZERO),
            true,
        );
        assert_eq!(flipped.means, [[1.0, -2.0, -3.0]]);
        assert!(covariance(&flipped).abs_diff_eq(covariance(&placed), 1e-6));
        for (a, b) in flipped.sh_rest.iter().zip(&placed.sh_rest) {
            assert!(
                (0..3).all(|channel| (a[channel] - b[channel]).abs() < 1e-6),
                "{a:?} {b:?}"
            );
        }
        assert_ne!(flipped.sh_rest, cloud().sh_rest);
    }

    #[test]
    fn every_code_maps_its_named_axes() {
        // Where a splat that is 1 to the right, 2 up and 3 in front stands in each system.
        let names = "LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU";
        for (index, name) in names.split(' ').enumerate() {
            let stored: Vec<f32> = name
                .chars()
                .map(|axis| match axis {
                    'R' => 1.0,
                    'L' => -1.0,
                    'U' => 2.0,
                    'D' => -2.0,
                    'F' => 3.0,
                    _ => -3.0,
                })
                .collect();
            let mut cloud = cloud();
            cloud.means[0] = [stored[0], stored[1], stored[2]];
            StoredAxes::of_code(index as u32 + 1)
                .unwrap()
                .turn_to_ply(&mut cloud);
            let expected = [1.0, -2.0, 3.0];
            assert!(
                (0..3).all(|i| (cloud.means[0][i] - expected[i]).abs() < 1e-6),
                "{name}: {:?}",
                cloud.means[0]
            );
        }
        assert!(StoredAxes::of_code(17).is_err());
    }

    #[test]
    fn a_mirror_keeps_covariance_and_color_in_step() {
        let original = cloud();
        let mut mirrored = original.clone();
        flip(&mut mirrored, [-1.0, 1.0, 1.0]);
        let mirror = glam::DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        assert!(covariance(&mirrored).abs_diff_eq(mirror * covariance(&original) * mirror, 1e-6));
        let d = DVec3::new(0.6, 0.0, 0.8);
        let color = |cloud: &SplatCloud, d| -> f64 {
            cloud
                .rest_of(0)
                .iter()
                .zip(&sh::basis(d)[1..])
                .map(|(c, y)| f64::from(c[0]) * y)
                .sum()
        };
        assert!((color(&original, d) - color(&mirrored, mirror * d)).abs() < 1e-6);
    }
}
