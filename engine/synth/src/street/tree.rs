//! Street trees: a trunk that forks, and a crown of several lobes of leaves.

use glam::Vec3;

use super::layout::Spot;
use super::loft::bar;
use super::occluder::Occluder;
use super::random::{Stream, cell, fractal_noise, smoothstep};
use super::surface::{Element, Shape, SurfacePoint, Texel, display};

/// Splats a square meter of leaves, relative to asphalt.
const LEAF_DENSITY: f32 = 1.2;

/// The lobes of the tree on a spot, in the world: center and radii.
fn lobes(spot: &Spot) -> Vec<(Vec3, Vec3)> {
    let mut random = Stream::new(spot.seed, 5 << 40, 0);
    let trunk_m = random.range(2.4, 3.2);
    let spread_m = random.range(1.0, 1.5);
    let base = spot.position + Vec3::Z * trunk_m;
    let mut lobes = vec![(
        base + Vec3::Z * (1.1 * spread_m + 0.6),
        Vec3::new(1.35, 1.35, 1.25) * spread_m,
    )];
    let count = 5;
    for lobe in 0..count {
        let angle = spot.yaw_rad
            + std::f32::consts::TAU * (lobe as f32 + 0.4 * random.unit()) / count as f32;
        let out = Vec3::new(angle.cos(), angle.sin(), 0.0) * spread_m * random.range(0.75, 1.15);
        let up = Vec3::Z * spread_m * random.range(0.5, 1.9);
        lobes.push((
            base + out + up,
            Vec3::splat(spread_m) * Vec3::new(0.95, 0.95, 0.8) * random.range(0.75, 1.05),
        ));
    }
    lobes
}

/// Occluders of a tree.
pub(super) fn tree_occluders(spot: &Spot) -> impl Iterator<Item = Occluder> {
    lobes(spot)
        .into_iter()
        .map(|(center, radii)| Occluder::Crown { center, radii })
}

/// All surfaces of a tree.
pub(super) fn tree(spot: &Spot) -> Vec<Element> {
    let mut random = Stream::new(spot.seed, 6 << 40, 0);
    let hues = [
        display(96, 132, 52),
        display(78, 122, 54),
        display(118, 140, 62),
        display(88, 126, 70),
    ];
    let green = *random.pick(&hues);
    let lobes = lobes(spot);
    let fork =
        spot.position + Vec3::Z * (lobes[0].0.z - spot.position.z - 1.5 * lobes[0].1.z).max(1.6);
    let seed = spot.seed;
    let bark = move |point: &SurfacePoint| {
        let grain = fractal_noise(seed, point.u * 9.0, point.position.z * 2.5, 3);
        Texel::matt(display(98, 82, 66) * (0.6 + 0.7 * grain))
    };
    let mut elements = vec![Element::new(
        Shape::Loft(bar(spot.position, fork, 0.17, 0.12)),
        3.0,
        bark,
    )];
    for (center, _) in lobes.iter().take(5) {
        elements.push(Element::new(
            Shape::Loft(bar(fork, *center, 0.085, 0.03)),
            2.0,
            bark,
        ));
    }
    let (low, high) = lobes
        .iter()
        .fold((f32::MAX, f32::MIN), |(low, high), (c, r)| {
            (low.min(c.z - r.z), high.max(c.z + r.z))
        });
    for (center, radii) in lobes {
        elements.push(Element::new(
            Shape::Crown { center, radii },
            LEAF_DENSITY,
            move |point| {
                let clumps = fractal_noise(
                    seed + 9,
                    1.3 * (point.position.x + point.position.z),
                    1.3 * (point.position.y - point.position.z),
                    3,
                );
                let height = smoothstep(low, high, point.position.z);
                let leaf = cell(seed, (point.u * 9e4) as i32, (point.v * 9e4) as i32);
                let albedo = green * (0.35 + 0.6 * clumps + 0.25 * height + 0.5 * (leaf - 0.5));
                Texel {
                    openness: 0.4 + 0.6 * height,
                    translucency: 0.75,
                    gloss: 0.1,
                    ..Texel::matt(albedo)
                }
            },
        ));
    }
    elements.push(pit(spot));
    elements
}

/// The square of soil in the sidewalk.
fn pit(spot: &Spot) -> Element {
    let corner = spot.position + Vec3::new(-0.6, -0.6, 0.004);
    let seed = spot.seed;
    Element::new(
        Shape::Rectangle {
            corner,
            along: Vec3::X * 1.2,
            up: Vec3::Y * 1.2,
        },
        1.5,
        move |point| {
            let clods = fractal_noise(seed + 3, point.position.x * 5.0, point.position.y * 5.0, 2);
            Texel {
                openness: 0.8,
                ..Texel::matt(display(96, 82, 62) * (0.6 + 0.6 * clods))
            }
        },
    )
}
