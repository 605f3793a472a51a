//! Trucks, buses, cyclists and pedestrians as assets: simple bodies that do not move their parts.
//!
//! Built in the canonical frame of cars: x forward, y left, z up, origin at the middle of the box,
//! touching the ground at z = -H/2.

use std::f32::consts::TAU;

use decouplegs_scene::{RoadUser, SplatCloud};
use glam::{Quat, Vec3};

use super::AssetLight;
use super::car::{Build, CAR_DENSITY};
use super::emit::emit;
use super::focus::Focus;
use super::light::Light;
use super::loft::{Loft, bar, ellipsoid};
use super::surface::{Element, Shape, SurfacePoint, Texel, boxed, display};
use super::weather::Air;

/// Seed of the splats.
const SEED: u64 = 11;
/// Density of small parts relative to large ones.
const FINE: f32 = 2.0;

/// Kind and variant of an asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RoadUserModel {
    /// Kind of the road user: not a car.
    pub kind: RoadUser,
    /// Variant within the kind, from 0.
    pub variant: usize,
}

impl RoadUserModel {
    /// All models, the variants of a kind in a row.
    pub const ALL: [Self; 8] = [
        Self::new(RoadUser::Truck, 0),
        Self::new(RoadUser::Bus, 0),
        Self::new(RoadUser::Cyclist, 0),
        Self::new(RoadUser::Cyclist, 1),
        Self::new(RoadUser::Pedestrian, 0),
        Self::new(RoadUser::Pedestrian, 1),
        Self::new(RoadUser::Pedestrian, 2),
        Self::new(RoadUser::Pedestrian, 3),
    ];

    const fn new(kind: RoadUser, variant: usize) -> Self {
        Self { kind, variant }
    }

    /// Length, width and height of the box, meters.
    #[must_use]
    pub const fn size_m(self) -> [f32; 3] {
        match self.kind {
            RoadUser::Car | RoadUser::Truck => [7.8, 2.4, 3.3],
            RoadUser::Bus => [11.0, 2.5, 3.1],
            RoadUser::Cyclist => [1.8, 0.6, 1.75],
            RoadUser::Pedestrian => [0.5, 0.6, 1.75],
        }
    }

    /// The asset, of `splats` splats.
    #[must_use]
    pub fn asset(self, splats: usize, asset_light: AssetLight) -> SplatCloud {
        let size = Vec3::from_array(self.size_m());
        let elements = match self.kind {
            RoadUser::Car | RoadUser::Truck => truck(size),
            RoadUser::Bus => bus(size),
            RoadUser::Cyclist => cyclist(self.variant),
            RoadUser::Pedestrian => pedestrian(self.variant),
        };
        let down = Vec3::Z * (-0.5 * size.z);
        let elements: Vec<Element> = elements
            .into_iter()
            .map(|element| element.placed(Quat::IDENTITY, down))
            .collect();
        let air = Air::of_assets(asset_light);
        let light = Light::new(air, vec![]).on_asset(Quat::IDENTITY, Vec3::ZERO);
        let degree = decouplegs_scene::sh::DEGREE_MAX;
        emit(&elements, splats, degree, SEED, &light, &Focus::nowhere())
    }
}

fn glass() -> Texel {
    Texel {
        gloss: 0.9,
        ..Texel::matt(display(44, 54, 62))
    }
}

fn painted(color: Vec3) -> Texel {
    Texel {
        gloss: 0.4,
        ..Texel::matt(color)
    }
}

fn dark() -> Texel {
    Texel {
        openness: 0.5,
        ..Texel::matt(display(38, 38, 40))
    }
}

/// Wheels of a long vehicle whose ground is z = 0.
fn wheels(size: Vec3, axles_x: [f32; 2]) -> Vec<Element> {
    let build = Build {
        size,
        wheel_radius_m: 0.48,
        axles_x,
        ..Build::for_variant(0).0
    };
    let lift = Vec3::Z * (0.5 * size.z);
    axles_x
        .into_iter()
        .flat_map(|x| [1.0f32, -1.0].map(|side| build.wheel(x, side)))
        .flatten()
        .map(|element| element.placed(Quat::IDENTITY, lift))
        .collect()
}

/// A white box behind a cab. Heights are above the ground.
fn truck(size: Vec3) -> Vec<Element> {
    let (half, density) = (0.5 * size, CAR_DENSITY / 9.0);
    let cab_x = half.x - 1.9;
    let cargo = boxed(
        Vec3::new(-half.x, -half.y, 1.05),
        Vec3::new(cab_x - 0.25, half.y, size.z),
        density,
        |point| {
            let rib = (point.position.x * 1.6).fract().abs() < 0.08 && point.normal.y.abs() > 0.5;
            painted(display(232, 232, 228) * if rib { 0.75 } else { 1.0 })
        },
    );
    let cab = boxed(
        Vec3::new(cab_x, -half.y + 0.06, 0.45),
        Vec3::new(half.x, half.y - 0.06, 2.55),
        density,
        move |point| {
            let p = point.position;
            let window = (1.45..2.3).contains(&p.z);
            let front = point.normal.x > 0.5;
            let side = point.normal.y.abs() > 0.5 && p.x > cab_x + 0.7;
            match () {
                () if window && (front || side) => glass(),
                () if front && (0.75..0.95).contains(&p.z) && p.y.abs() > 0.75 => {
                    Texel::matt(display(244, 244, 236))
                }
                () if front && (0.6..1.2).contains(&p.z) => dark(),
                () => painted(display(36, 82, 150)),
            }
        },
    );
    let frame = boxed(
        Vec3::new(-half.x + 0.1, -0.5, 0.55),
        Vec3::new(cab_x, 0.5, 1.05),
        density,
        |_| dark(),
    );
    let mut elements = [cargo, cab, frame].concat();
    elements.extend(wheels(size, [half.x - 1.2, -half.x + 1.7]));
    elements
}

/// A city bus with a row of windows. Heights are above the ground.
fn bus(size: Vec3) -> Vec<Element> {
    let half = 0.5 * size;
    let mut elements = boxed(
        Vec3::new(-half.x, -half.y, 0.32),
        Vec3::new(half.x, half.y, size.z),
        CAR_DENSITY / 9.0,
        move |point| {
            let p = point.position;
            let (side, front) = (point.normal.y.abs() > 0.5, point.normal.x > 0.5);
            let pillar = (p.x / 1.4).rem_euclid(1.0) < 0.09;
            let axle = [half.x - 2.6, -half.x + 3.0]
                .into_iter()
                .any(|x| (p.x - x).hypot(p.z - 0.48) < 0.6);
            match () {
                () if side && axle => dark(),
                () if side && (1.15..2.45).contains(&p.z) && !pillar => glass(),
                () if front && (1.0..2.45).contains(&p.z) => glass(),
                () if front && (2.55..2.85).contains(&p.z) && p.y.abs() < 0.8 => {
                    Texel::matt(display(250, 190, 60))
                }
                () if point.normal.x < -0.5 && (1.5..2.4).contains(&p.z) => glass(),
                () if p.z < 0.5 => dark(),
                () if (0.9..1.1).contains(&p.z) => painted(display(236, 236, 232)),
                () => painted(display(186, 34, 40)),
            }
        },
    );
    elements.extend(wheels(size, [half.x - 2.6, -half.x + 3.0]));
    elements
}

/// A bar with one color.
fn limb(from: Vec3, to: Vec3, radii_m: [f32; 2], color: Vec3) -> Element {
    let shape = Shape::Loft(bar(from, to, radii_m[0], radii_m[1]));
    Element::new(shape, FINE, move |_: &SurfacePoint| Texel::matt(color))
}

fn ball(center: Vec3, radii: Vec3, color: Vec3) -> Element {
    let shape = Shape::Loft(ellipsoid(center, radii));
    Element::new(shape, FINE, move |_: &SurfacePoint| Texel::matt(color))
}

/// Hair on top of a face that looks ahead.
fn head(center: Vec3, hair: Vec3) -> Element {
    let shape = Shape::Loft(ellipsoid(center, Vec3::new(0.1, 0.085, 0.125)));
    Element::new(shape, FINE, move |point: &SurfacePoint| {
        let covered = point.normal.z > 0.45 || point.normal.x < 0.0;
        Texel::matt(if covered {
            hair
        } else {
            display(214, 168, 140)
        })
    })
}

/// Shirt, trousers and hair.
fn clothes(variant: usize) -> [Vec3; 3] {
    match variant % 4 {
        0 => [(176, 44, 40), (44, 52, 74), (60, 42, 30)],
        1 => [(228, 214, 120), (70, 70, 74), (34, 28, 26)],
        2 => [(40, 96, 128), (120, 104, 84), (150, 112, 64)],
        _ => [(70, 112, 66), (30, 30, 34), (96, 92, 90)],
    }
    .map(|(red, green, blue)| display(red, green, blue))
}

/// A person in the midst of a step, walking to x.
fn pedestrian(variant: usize) -> Vec<Element> {
    let [shirt, trousers, hair] = clothes(variant);
    let skin = display(214, 168, 140);
    let hip = Vec3::new(0.0, 0.0, 0.88);
    let mut elements = vec![
        head(Vec3::new(0.0, 0.0, 1.625), hair),
        ball(Vec3::new(0.0, 0.0, 1.17), Vec3::new(0.13, 0.2, 0.33), shirt),
        ball(hip, Vec3::new(0.13, 0.17, 0.14), trousers),
        limb(
            Vec3::new(0.0, 0.0, 1.42),
            Vec3::new(0.0, 0.0, 1.55),
            [0.06, 0.055],
            skin,
        ),
    ];
    for side in [1.0f32, -1.0] {
        let foot = Vec3::new(0.17 * side, 0.09 * side, 0.04);
        let leg = hip + Vec3::Y * (0.09 * side);
        elements.push(limb(leg, foot, [0.085, 0.05], trousers));
        elements.push(ball(
            foot + Vec3::X * 0.04,
            Vec3::new(0.13, 0.05, 0.04),
            display(40, 38, 38),
        ));
        let (shoulder, hand) = (
            Vec3::new(0.0, 0.2 * side, 1.4),
            Vec3::new(-0.16 * side, 0.26 * side, 0.86),
        );
        elements.push(limb(shoulder, hand, [0.055, 0.04], shirt));
        elements.push(ball(hand, Vec3::splat(0.05), skin));
    }
    elements
}

/// A bicycle and its rider.
fn cyclist(variant: usize) -> Vec<Element> {
    let [shirt, trousers, _] = clothes(variant + 1);
    let (metal, skin) = (display(60, 64, 70), display(214, 168, 140));
    let (radius_m, hub_x) = (0.34f32, 0.56f32);
    let [rear, front] = [-hub_x, hub_x].map(|x| Vec3::new(x, 0.0, radius_m));
    let (saddle, crank) = (Vec3::new(-0.2, 0.0, 0.95), Vec3::new(-0.05, 0.0, 0.32));
    let bars = Vec3::new(0.42, 0.0, 1.02);
    let mut elements = vec![
        limb(saddle, crank, [0.025, 0.025], metal),
        limb(rear, crank, [0.02, 0.02], metal),
        limb(rear, saddle, [0.02, 0.02], metal),
        limb(crank, bars, [0.03, 0.03], metal),
        limb(front, bars, [0.025, 0.025], metal),
        limb(
            bars - Vec3::Y * 0.28,
            bars + Vec3::Y * 0.28,
            [0.02, 0.02],
            metal,
        ),
        ball(saddle, Vec3::new(0.13, 0.07, 0.04), display(30, 30, 30)),
        head(Vec3::new(0.24, 0.0, 1.6), display(230, 230, 224)),
        limb(
            saddle + Vec3::Z * 0.08,
            Vec3::new(0.18, 0.0, 1.42),
            [0.14, 0.17],
            shirt,
        ),
    ];
    for hub in [rear, front] {
        let tire = Loft::new(hub + Vec3::Y * 4.0, move |u, v| {
            let (sin, cos) = (u * TAU).sin_cos();
            hub + Vec3::new(cos, 0.0, sin) * (radius_m * (0.86 + 0.14 * v))
        });
        elements.push(Element::new(
            Shape::Loft(tire.bordered()),
            FINE,
            |_: &SurfacePoint| Texel::matt(display(34, 34, 36)),
        ));
    }
    for side in [1.0f32, -1.0] {
        let hip = saddle + Vec3::new(0.0, 0.1 * side, 0.06);
        let knee = Vec3::new(0.2 + 0.06 * side, 0.12 * side, 0.72 + 0.12 * side);
        let pedal = Vec3::new(-0.05 + 0.12 * side, 0.11 * side, 0.32 + 0.1 * side);
        elements.push(limb(hip, knee, [0.085, 0.06], trousers));
        elements.push(limb(knee, pedal, [0.06, 0.045], trousers));
        elements.push(ball(
            pedal,
            Vec3::new(0.12, 0.045, 0.04),
            display(40, 38, 38),
        ));
        let shoulder = Vec3::new(0.17, 0.17 * side, 1.38);
        elements.push(limb(
            shoulder,
            bars + Vec3::Y * (0.24 * side),
            [0.05, 0.04],
            shirt,
        ));
        elements.push(ball(
            bars + Vec3::Y * (0.24 * side),
            Vec3::splat(0.045),
            skin,
        ));
    }
    elements
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_fills_its_box_and_stands_on_the_ground() {
        for model in RoadUserModel::ALL {
            let cloud = model.asset(4_000, AssetLight::Neutral);
            let half = Vec3::from_array(model.size_m()) * 0.5;
            let bounds = cloud.bounds();
            let (low, high) = (Vec3::from(bounds.min), Vec3::from(bounds.max));
            let over = (low + half).abs().max((high - half).abs());
            assert!(
                over.max_element() < 0.13,
                "{model:?}: {low} to {high} in {half}"
            );
        }
    }
}
