//! The ambient descriptor.

use glam::{DQuat, DVec3};

use crate::light::luminance;
use crate::sh::{self, ShRotation};

/// The light about a position: bands 0 to 2 of spherical harmonics of display-referred color, as a
/// plain expansion `color(d) = sum_k coefficients[k] Y_k(d)`, without the 0.5 that splats' colors
/// add. L(x) of the paper, in R^27.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmbientDescriptor {
    /// `[coefficient][rgb]`.
    pub coefficients: [[f32; 3]; Self::COEFFICIENTS],
}

impl AmbientDescriptor {
    /// Coefficients of bands 0 to 2.
    pub const COEFFICIENTS: usize = 9;
    /// Numbers in all.
    pub const LEN: usize = 3 * Self::COEFFICIENTS;

    /// The same color from everywhere.
    #[must_use]
    pub fn uniform(rgb: [f32; 3]) -> Self {
        let mut coefficients = [[0.0; 3]; Self::COEFFICIENTS];
        coefficients[0] = rgb.map(|channel| channel / sh::Y0 as f32);
        Self { coefficients }
    }

    /// The numbers in a row, `[coefficient][rgb]`.
    #[must_use]
    pub fn to_vector(&self) -> [f64; Self::LEN] {
        std::array::from_fn(|index| f64::from(self.coefficients[index / 3][index % 3]))
    }

    /// The light of a position that was turned by `rotation`. With the inverse of an agent's
    /// rotation: the light in its frame.
    #[must_use]
    pub fn turned(&self, rotation: DQuat) -> Self {
        let mut turned = *self;
        ShRotation::new(rotation).rotate(&mut turned.coefficients[1..]);
        turned
    }

    /// The mean color, RGB.
    #[must_use]
    pub fn mean(&self) -> [f32; 3] {
        self.coefficients[0].map(|channel| channel * sh::Y0 as f32)
    }

    /// Directionality of the light: |L1| over its largest possible value beside L0, that of a point
    /// light, in luminance. 0 where it is the same all round or there is none, 1 at most. It tells
    /// direction, not brightness.
    #[must_use]
    pub fn directionality(&self) -> f64 {
        let [direct, y, z, x] =
            std::array::from_fn(|index| luminance(self.coefficients[index].map(f64::from)));
        let sideways = DVec3::new(x, y, z).length();
        if direct > 0.0 {
            (sideways / (3f64.sqrt() * direct)).min(1.0)
        } else {
            0.0
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point_light(direction: DVec3) -> AmbientDescriptor {
        let basis = sh::basis(direction);
        AmbientDescriptor {
            coefficients: std::array::from_fn(|index| [basis[index] as f32; 3]),
        }
    }

    #[test]
    fn a_point_light_is_all_from_one_side_and_a_gray_sky_from_none() {
        assert!((point_light(DVec3::new(0.6, 0.0, 0.8)).directionality() - 1.0).abs() < 1e-6);
        assert_eq!(AmbientDescriptor::uniform([0.7; 3]).directionality(), 0.0);
        assert_eq!(AmbientDescriptor::uniform([0.0; 3]).directionality(), 0.0);
        assert!((AmbientDescriptor::uniform([0.7, 0.2, 0.1]).mean()[1] - 0.2).abs() < 1e-6);
    }

    #[test]
    fn turning_the_light_turns_where_it_comes_from() {
        let turn = DQuat::from_euler(glam::EulerRot::ZYX, 0.4, -1.1, 2.0);
        let from = DVec3::new(0.36, 0.48, 0.8);
        let (turned, expected) = (point_light(from).turned(turn), point_light(turn * from));
        for (a, b) in turned.to_vector().iter().zip(expected.to_vector()) {
            assert!((a - b).abs() < 1e-6, "{a} {b}");
        }
    }
}
