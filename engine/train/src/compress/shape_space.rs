//! Space in which the shape codebook is trained, so that distances between shapes have a meaning.
//!
//! Measured with 512 shapes and 1024 colors on a synthetic car of 50,000 splats, from 10 m with a
//! focal length of 1266 px, and on a captured object of 13,536 from as many of its lengths: PSNR in
//! dB against the original.
//!
//! | space | car | captured object |
//! |---|---|---|
//! | covariance (the paper's) | 27.6 | 37.9 |
//! | its logarithm | 32.5 | 36.7 |
//! | logarithm at size 1, size per splat | 35.6 | 39.7 |
//! | root at size 1, size per splat (default) | 37.0 | 41.2 |

use decouplegs_scene::shape::{PrincipalAxes, triangular_factor};
use decouplegs_scene::symmetric::{OwnAxes, from_six, to_six};
use glam::{DMat3, DQuat, DVec3};
use serde::Serialize;

/// Axes are held to this share of the longest before a logarithm is taken: a tenth of a pixel on a
/// splat that is 25 pixels wide. Thinner ones look the same, yet would be far apart.
const LOG_ASPECT_MIN: f64 = 1.0 / 256.0;

/// Sizes are held to 2^-60 to 2^60 m, so that no product of them leaves f32: a splat of zero size
/// is drawn as one of the smallest.
pub(super) const LOG2_SIZE_MAX: f32 = 60.0;

/// Transform of a covariance before clustering. All distances are Frobenius distances.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ShapeSpace {
    /// The covariance as it is, size included: what the paper quantizes.
    Covariance,
    /// The logarithm of the covariance, size included (Arsigny et al., Log-Euclidean Metrics,
    /// 2006).
    LogCovariance,
    /// The logarithm of the covariance of the splat brought to size 1; the size is kept per splat.
    UnitLogCovariance,
    /// The square root of the covariance of the splat brought to size 1; the size is kept per
    /// splat. Its distances are standard deviations, what an image shows, and axes of length zero
    /// are nothing special.
    #[default]
    UnitRootCovariance,
}

impl ShapeSpace {
    /// All of them, for comparisons.
    pub const ALL: [Self; 4] = [
        Self::Covariance,
        Self::LogCovariance,
        Self::UnitLogCovariance,
        Self::UnitRootCovariance,
    ];

    /// True if each splat keeps a size of its own.
    #[must_use]
    pub fn keeps_size(self) -> bool {
        matches!(self, Self::UnitLogCovariance | Self::UnitRootCovariance)
    }

    /// A shape whose `size` (meters) counts as 1, as a vector of this space.
    pub(super) fn vector(self, axes: &PrincipalAxes, size: f64) -> [f32; 6] {
        let scales = held(&axes.scales) / size;
        let floor = (LOG_ASPECT_MIN * scales.max_element()).max(1e-12);
        let values = match self {
            Self::Covariance => scales * scales,
            Self::LogCovariance | Self::UnitLogCovariance => scales
                .max(DVec3::splat(floor))
                .map(|scale| 2.0 * scale.ln()),
            Self::UnitRootCovariance => scales,
        };
        let [w, x, y, z] = axes.rotation.map(f64::from);
        let axes = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        to_six(&OwnAxes { values, axes }.matrix()).map(|value| value as f32)
    }

    /// The triangular factor of the shape that a vector of this space stands for, brought to size 1
    /// where splats keep sizes.
    pub(super) fn factor(self, vector: &[f32]) -> [f32; 6] {
        let mut six = [0.0; 6];
        six.iter_mut()
            .zip(vector)
            .for_each(|(to, &from)| *to = f64::from(from));
        let own = OwnAxes::from_matrix(&from_six(&six));
        let scales = match self {
            Self::Covariance => own.values.max(DVec3::ZERO).map(f64::sqrt),
            Self::LogCovariance | Self::UnitLogCovariance => own
                .values
                .map(|value| (0.5 * value.clamp(-80.0, 80.0)).exp()),
            Self::UnitRootCovariance => own.values.max(DVec3::ZERO),
        };
        let length = scales.length();
        let scales = if self.keeps_size() && length > 0.0 {
            scales / length
        } else {
            scales
        };
        let axes = PrincipalAxes {
            scales: scales.as_vec3().to_array(),
            rotation: own.rotation_wxyz(),
        };
        triangular_factor(&axes).map(|value| value as f32)
    }
}

/// The size of a splat: the root of the sum of its squared scales, meters. Not zero unless all
/// scales are, and smooth where the longest axis changes.
pub(super) fn size_of(scales: &[f32; 3]) -> f64 {
    held(scales).length().max(f64::from(-LOG2_SIZE_MAX).exp2())
}

fn held(scales: &[f32; 3]) -> DVec3 {
    // The root of 3 keeps the size, too, within the limit.
    DVec3::from_array(
        scales.map(|scale| f64::from(scale).min(f64::from(LOG2_SIZE_MAX - 1.0).exp2())),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::shape::principal_axes;
    use proptest::prelude::*;

    fn sorted(mut scales: [f32; 3]) -> [f32; 3] {
        scales.sort_by(f32::total_cmp);
        scales
    }

    proptest! {
        #[test]
        fn a_vector_is_its_shape(
            exponents in prop::array::uniform3(-3.0f32..1.0), q in prop::array::uniform4(-1.0f32..1.0), size in -10.0f32..3.0,
        ) {
            prop_assume!(q.iter().map(|x| x * x).sum::<f32>() > 0.01);
            let axes = PrincipalAxes { scales: exponents.map(|e| (e + size).exp2()), rotation: q };
            let size = size_of(&axes.scales);
            for space in ShapeSpace::ALL {
                let back = principal_axes(&space.factor(&space.vector(&axes, size)));
                for (a, b) in sorted(back.scales).iter().zip(sorted(axes.scales)) {
                    // f32 vectors: a smallest axis is known to the digits of the largest, squared
                    // for the covariance.
                    prop_assert!((f64::from(*a) * size - f64::from(b)).abs() < 2e-5 * size, "{space:?}: {back:?} from {axes:?}");
                }
            }
        }
    }

    #[test]
    fn needles_discs_and_points_have_finite_vectors_and_shapes() {
        for scales in [
            [1.0, 1e-5, 1e-5],
            [1.0, 1.0, 0.0],
            [1.0, 0.0, 0.0],
            [0.0; 3],
            [1e-30; 3],
            [3e38; 3],
        ] {
            let axes = PrincipalAxes {
                scales,
                rotation: [0.5, 0.5, -0.5, 0.5],
            };
            for space in ShapeSpace::ALL {
                let vector = space.vector(&axes, size_of(&scales));
                assert!(
                    vector.iter().all(|value| value.is_finite()),
                    "{space:?} of {scales:?}: {vector:?}"
                );
                assert!(
                    space.factor(&vector).iter().all(|value| value.is_finite()),
                    "{space:?} of {scales:?}"
                );
            }
        }
    }

    #[test]
    fn the_root_keeps_needles_thin_and_the_logarithm_says_how_thin() {
        let axes = PrincipalAxes {
            scales: [1.0, 1e-5, 1e-5],
            rotation: [1.0, 0.0, 0.0, 0.0],
        };
        let thin = |space: ShapeSpace| {
            sorted(principal_axes(&space.factor(&space.vector(&axes, 1.0))).scales)[0]
        };
        assert!((thin(ShapeSpace::UnitRootCovariance) / 1e-5 - 1.0).abs() < 1e-3);
        assert!(
            (f64::from(thin(ShapeSpace::UnitLogCovariance)) / LOG_ASPECT_MIN - 1.0).abs() < 1e-3
        );
    }
}
