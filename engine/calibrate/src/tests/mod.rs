//! Calibrations as a whole, and what they rest on.

mod fit;
mod light;

use decouplegs_scene::light::Probe;
use decouplegs_scene::{SplatCloud, sh};
use glam::DVec3;

use decouplegs_scene::random::Random;

/// A sky of colored lobes over a gray ground: light that differs by direction, hue and contrast,
/// the same for the same seed.
fn sky(seed: u64, width: usize) -> Probe {
    let mut random = Random::new(seed);
    let mut unit = || random.unit();
    let lobes: Vec<(DVec3, f64, [f64; 3])> = (0..4)
        .map(|_| {
            let towards = DVec3::new(unit() - 0.5, unit() - 0.5, unit()).normalize();
            (
                towards,
                2.0 + 30.0 * unit(),
                [unit() + 0.2, unit() + 0.2, unit() + 0.2].map(|value| 3.0 * value),
            )
        })
        .collect();
    let even = [0.2 + 0.5 * unit(), 0.2 + 0.5 * unit(), 0.2 + 0.5 * unit()];
    Probe::from_fn(format!("sky {seed}"), width, |direction| {
        let above = if direction.z > 0.0 { 1.0 } else { 0.4 };
        std::array::from_fn(|channel| {
            let of_lobe = |(towards, sharpness, color): &(DVec3, f64, [f64; 3])| {
                color[channel] * (sharpness * (direction.dot(*towards) - 1.0)).exp()
            };
            (above * (even[channel] + lobes.iter().map(of_lobe).sum::<f64>())) as f32
        })
    })
}

fn skies(count: u64) -> Vec<Probe> {
    (1..=count).map(|seed| sky(seed, 48)).collect()
}

/// Discs all over an ellipsoid, in colors of every brightness, with some sheen.
fn ball(splats: usize, sh_degree: u8) -> SplatCloud {
    let mut random = Random::new(99);
    let mut cloud = SplatCloud::with_degree(sh_degree);
    let stride = sh::coefficient_count(sh_degree) - 1;
    for index in 0..splats {
        let z = 1.0 - (2.0 * index as f64 + 1.0) / splats as f64;
        let azimuth = 2.4 * index as f64;
        let radius = (1.0 - z * z).sqrt();
        let normal = DVec3::new(radius * azimuth.cos(), radius * azimuth.sin(), z);
        let turn = glam::DQuat::from_rotation_arc(DVec3::Z, normal).as_quat();
        cloud
            .means
            .push((normal * DVec3::new(2.0, 1.0, 0.7)).as_vec3().to_array());
        cloud.scales.push([0.05, 0.06, 0.002]);
        cloud.rotations.push([turn.w, turn.x, turn.y, turn.z]);
        cloud.opacities.push(0.9);
        cloud.sh_dc.push(std::array::from_fn(|_| {
            ((0.05 + 0.85 * random.unit() - 0.5) / sh::Y0) as f32
        }));
        cloud
            .sh_rest
            .extend((0..stride).map(|_| [(0.1 * (random.unit() - 0.5)) as f32; 3]));
    }
    cloud
}
