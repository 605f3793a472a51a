//! Lamp posts, bins and signs.

use glam::{Quat, Vec3};

use super::layout::Spot;
use super::loft::{Loft, bar};
use super::surface::{Element, Shape, SurfacePoint, Texel, boxed, display};
use super::weather::lamplight;

/// Splats a square meter of posts, relative to asphalt: thin things need many.
const POST_DENSITY: f32 = 4.0;

/// Splats a square meter of signs, relative to asphalt: they are small and drawn sharply.
const SIGN_DENSITY: f32 = 30.0;

fn painted_metal(point: &SurfacePoint) -> Texel {
    Texel {
        gloss: 0.3,
        ..Texel::matt(display(74, 82, 84) * (0.85 + 0.2 * point.v))
    }
}

pub(super) fn post(from: Vec3, to: Vec3, radius_m: f32) -> Element {
    Element::new(
        Shape::Loft(bar(from, to, radius_m, 0.65 * radius_m)),
        POST_DENSITY,
        painted_metal,
    )
}

/// The end of a lamp's arm, in the frame of its foot, meters.
const LAMP_TIP: Vec3 = Vec3::new(2.1, 0.0, 7.2 + 0.35);

/// Position of the light of a lamp on a spot, world coordinates.
pub(super) fn lamp_light(spot: &Spot) -> Vec3 {
    Quat::from_rotation_z(spot.yaw_rad) * (LAMP_TIP + Vec3::new(0.275, 0.0, -0.3)) + spot.position
}

/// A lamp on an arm over the road.
pub(super) fn lamp(spot: &Spot) -> Vec<Element> {
    let height_m = 7.2;
    let top = Vec3::Z * height_m;
    let tip = LAMP_TIP;
    let mut elements = vec![
        post(Vec3::ZERO, top, 0.095),
        post(Vec3::ZERO, Vec3::Z * 1.0, 0.15),
        post(top, tip, 0.06),
    ];
    elements.extend(boxed(
        tip - Vec3::new(0.1, 0.16, 0.05),
        tip + Vec3::new(0.65, 0.16, 0.07),
        5.0,
        |point| {
            if point.normal.z < -0.5 {
                Texel {
                    glow: lamplight() * 4.0,
                    ..Texel::matt(display(240, 236, 220))
                }
            } else {
                Texel::matt(display(104, 110, 112))
            }
        },
    ));
    elements
        .into_iter()
        .map(|e| e.placed(Quat::from_rotation_z(spot.yaw_rad), spot.position))
        .collect()
}

/// A litter bin beside every lamp, and beside every other one a sign that forbids to park.
pub(super) fn beside_lamp(spot: &Spot) -> Vec<Element> {
    // Local x points to the road, local y along it.
    let foot = Vec3::new(-0.15, 1.3, 0.0);
    let bin = bar(foot, foot + Vec3::Z * 0.9, 0.21, 0.24);
    let mut elements = vec![Element::new(
        Shape::Loft(bin),
        POST_DENSITY,
        |point: &SurfacePoint| {
            let z = point.position.z;
            let dark = (0.68..0.8).contains(&z) || point.normal.z > 0.7;
            Texel::matt(if dark {
                display(26, 28, 28)
            } else {
                display(58, 92, 66) * (0.8 + 0.25 * z)
            })
        },
    )];
    if spot.seed.is_multiple_of(2) {
        let foot = Vec3::new(0.0, -2.2, 0.0);
        elements.push(post(foot, foot + Vec3::Z * 2.75, 0.035));
        elements.extend([1.0, -1.0].map(|side| no_parking(foot + Vec3::Z * 2.5, side)));
    }
    elements
        .into_iter()
        .map(|e| e.placed(Quat::from_rotation_z(spot.yaw_rad), spot.position))
        .collect()
}

/// A round blue sign with a red ring and bar that looks along local y, `side` 1 or -1.
fn no_parking(center: Vec3, side: f32) -> Element {
    let radius_m = 0.3;
    let center = center + Vec3::Y * (0.05 * side);
    // Seen from behind, so that it faces forward.
    let disc = Loft::new(center - Vec3::Y * (8.0 * side), move |u, v| {
        let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
        center + Vec3::new(cos, 0.0, sin) * (radius_m * v)
    });
    Element::new(Shape::Loft(disc.bordered()), SIGN_DENSITY, move |point| {
        let offset = (point.position - center) / radius_m;
        let red = offset.length() > 0.76 || (offset.x * side + offset.z).abs() < 0.2;
        Texel {
            gloss: 0.2,
            ..Texel::matt(if red {
                display(196, 26, 32)
            } else {
                display(24, 72, 168)
            })
        }
    })
}
