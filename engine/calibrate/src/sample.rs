//! The splats that a calibration looks at, and the directions in which they are seen.

use decouplegs_scene::{SplatCloud, sh};
use glam::DVec3;

use super::surface::{COEFFICIENTS, Surface, center_of};
use decouplegs_scene::random::Random;

/// Directions over the sphere of which those count in which a splat is seen.
const DIRECTIONS: usize = 256;

/// Agents stand on the ground, and cameras are not below it: a direction of view rises at most so
/// steeply (z of the unit vector from camera to splat).
const RISE_MAX: f64 = 0.35;

/// Opacity below which no pixel shows a splat.
const OPACITY_MIN: f32 = 1.0 / 255.0;

/// Directions of view drawn for each sample, in which colors are compared.
pub(super) const VIEWS: usize = 3;

/// Gram matrix over viewing directions: `[i][j]` is the mean of Y_i Y_j.
pub(super) type Gram = [[f64; COEFFICIENTS]; COEFFICIENTS];

/// A splat and how it is seen.
#[derive(Clone, Debug)]
pub(super) struct Sample {
    pub surface: Surface,
    /// Means of products of the basis over the directions in which the splat's outer side is seen,
    /// by projected area.
    pub seen: Box<Gram>,
    /// The basis in some of these directions.
    pub views: [[f64; COEFFICIENTS]; VIEWS],
}

/// Means of products of the basis over all directions alike: the basis is orthonormal over the
/// sphere.
pub(super) fn gram_of_sphere() -> Gram {
    let mean = 1.0 / (4.0 * std::f64::consts::PI);
    std::array::from_fn(|i| std::array::from_fn(|j| if i == j { mean } else { 0.0 }))
}

/// Directions of view, unit vectors from camera to splat, spread evenly over the sphere without the
/// steeply rising ones.
pub(super) struct Directions(Vec<(DVec3, [f64; COEFFICIENTS])>);

impl Directions {
    pub(super) fn new() -> Self {
        let golden_rad = std::f64::consts::PI * (3.0 - 5f64.sqrt());
        let direction = |index: usize| {
            let z = 1.0 - (2.0 * index as f64 + 1.0) / DIRECTIONS as f64;
            let (y, x) = (golden_rad * index as f64).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            DVec3::new(radius * x, radius * y, z)
        };
        let level = (0..DIRECTIONS)
            .map(direction)
            .filter(|direction| direction.z <= RISE_MAX);
        Self(
            level
                .map(|direction| (direction, sh::basis(direction)))
                .collect(),
        )
    }

    /// Mean projected area of a unit of surface over all directions: 1/4 where cameras are
    /// everywhere.
    fn visible(&self, normal: DVec3) -> f64 {
        self.0
            .iter()
            .map(|(direction, _)| (-normal.dot(*direction)).max(0.0))
            .sum::<f64>()
            / DIRECTIONS as f64
    }

    fn sample(&self, surface: Surface, random: &mut Random) -> Sample {
        let weights: Vec<f64> = self
            .0
            .iter()
            .map(|(direction, _)| (-surface.normal.dot(*direction)).max(0.0))
            .collect();
        let sum: f64 = weights.iter().sum();
        let mut seen = Box::new([[0.0; COEFFICIENTS]; COEFFICIENTS]);
        for ((_, basis), weight) in self.0.iter().zip(&weights) {
            for i in 0..COEFFICIENTS {
                for j in 0..COEFFICIENTS {
                    seen[i][j] += weight / sum * basis[i] * basis[j];
                }
            }
        }
        let mut drawn = || {
            let mut left = random.unit() * sum;
            let found = weights.iter().position(|weight| {
                left -= weight;
                left < 0.0
            });
            self.0[found.unwrap_or(0)].1
        };
        let views = std::array::from_fn(|_| drawn());
        Sample {
            surface,
            seen,
            views,
        }
    }
}

/// Weight of a splat in images of its asset, square meters; 0 if its facing direction is unknown.
fn weight(cloud: &SplatCloud, splat: usize, surface: &Surface, directions: &Directions) -> f64 {
    let [thin, broad, long] = cloud.sorted_scales_m(splat);
    let flat = if broad > 0.0 { 1.0 - thin / broad } else { 0.0 };
    f64::from(cloud.opacities[splat]) * broad * long * flat * directions.visible(surface.normal)
}

/// `count` splats of `cloud`, drawn by what they add to images (systematic sampling; a splat may
/// come more than once). Empty if nothing of it is seen.
pub(super) fn samples(cloud: &SplatCloud, count: usize, seed: u64) -> Vec<Sample> {
    let directions = Directions::new();
    let center = center_of(cloud);
    let mut random = Random::new(seed);
    let shown =
        |&splat: &usize| cloud.opacities[splat] >= OPACITY_MIN && cloud.defect_of(splat).is_none();
    let weighed: Vec<(Surface, f64)> = (0..cloud.len())
        .filter(shown)
        .map(|splat| {
            let surface = Surface::from_splat(cloud, splat, center);
            (surface, weight(cloud, splat, &surface, &directions))
        })
        .filter(|(_, weight)| weight.is_finite() && *weight > 0.0)
        .collect();
    let step = weighed.iter().map(|(_, weight)| weight).sum::<f64>() / count as f64;
    let mut samples = Vec::with_capacity(count);
    let mut next = random.unit() * step;
    let mut passed = 0.0;
    for (surface, weight) in weighed {
        passed += weight;
        while next < passed && samples.len() < count {
            samples.push(directions.sample(surface, &mut random));
            next += step;
        }
    }
    samples
}
