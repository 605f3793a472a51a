//! Plain houses beside the roads: something to see pass by, and to hide what is behind.

use decouplegs_scene::{LaneKind, Obstacle, ObstacleKind};
use glam::{DVec3, Vec2, Vec3};

use super::Drawn;
use super::canvas::{Canvas, Disc, Look};
use super::relief::Relief;
use super::strip_index::StripIndex;
use crate::street::random::{Stream, cell, fractal_noise};
use crate::street::surface::display;

/// Distance between tries for a house along a lane, meters.
const TRY_EVERY_M: f32 = 16.0;

/// Most houses of a place.
const HOUSES_MAX: usize = 600;

/// Free between a house and any lane, meters.
const CLEAR_M: f32 = 4.0;

/// Width of a patch of wall over the spacing on roads.
const PATCH_OVER_SPACING: f32 = 2.6;

/// Spacing on side walls and on walls that no road sees, relative to the front.
const ASIDE: f32 = 1.4;
const UNSEEN: f32 = 4.0;

/// Standard deviation of a disc over the width of its patch.
const SCALE_OVER_PATCH: f32 = 0.62;

/// Storeys and bays of windows, meters.
const STOREY_M: f32 = 3.2;
const BAY_M: f32 = 3.0;

/// Numbers of the streams that belong to houses.
const STREAM: u64 = 1 << 40;

/// A house on the ground.
#[derive(Clone, Copy, Debug)]
pub(super) struct House {
    pub(super) middle: Vec3,
    /// Unit, along its front.
    ahead: Vec2,
    /// Half its length and depth, and its height, meters.
    half_length_m: f32,
    half_depth_m: f32,
    height_m: f32,
    wall: Vec3,
    roof: Vec3,
    /// 1 where the road is on its right, -1 where it is on its left.
    road_on_right: f32,
    number: u64,
}

impl House {
    /// Radius of the circle about it on the plane, meters.
    pub(super) fn radius_m(&self) -> f32 {
        self.half_length_m.hypot(self.half_depth_m)
    }

    /// Box of the house, in world coordinates.
    pub(super) fn obstacle(&self, origin: DVec3) -> Obstacle {
        Obstacle {
            kind: ObstacleKind::House,
            center_m: (origin + self.middle.as_dvec3()).truncate(),
            yaw_rad: f64::from(self.ahead.to_angle()),
            length_m: 2.0 * f64::from(self.half_length_m),
            width_m: 2.0 * f64::from(self.half_depth_m),
        }
    }

    fn side(&self) -> Vec2 {
        self.ahead.perp()
    }
}

/// Houses along the lanes of `index` where there is room.
pub(super) fn houses(index: &StripIndex, relief: &Relief, seed: u64) -> Vec<House> {
    let mut houses: Vec<House> = Vec::new();
    let driving = index
        .strips
        .iter()
        .enumerate()
        .filter(|(_, strip)| strip.kind == LaneKind::Driving);
    for (number, strip) in driving {
        let tries = (strip.length_m() / TRY_EVERY_M) as usize;
        for attempt in 0..tries {
            for side in [-1.0, 1.0] {
                let number = (number as u64) << 24 | (attempt as u64) << 1 | u64::from(side > 0.0);
                let mut random = Stream::new(seed, STREAM, number);
                let at_m = TRY_EVERY_M * (attempt as f32 + random.unit());
                let (section, beyond) = (strip.at(at_m), strip.at(at_m + 1.0));
                let ahead = (beyond.middle() - section.middle())
                    .truncate()
                    .normalize_or(Vec2::X);
                let border = if side > 0.0 {
                    section.left
                } else {
                    section.right
                };
                let house = drawn(&mut random, (border, ahead, side), relief, number);
                let free = is_free(index, &house)
                    && houses.iter().all(|other| {
                        other.middle.truncate().distance(house.middle.truncate())
                            > other.radius_m() + house.radius_m() + 1.0
                    });
                if free {
                    houses.push(house);
                }
                if houses.len() >= HOUSES_MAX {
                    return houses;
                }
            }
        }
    }
    houses
}

fn drawn(
    random: &mut Stream,
    (border, ahead, side): (Vec3, Vec2, f32),
    relief: &Relief,
    number: u64,
) -> House {
    let (half_length_m, half_depth_m) = (random.range(5.0, 9.0), random.range(4.0, 6.5));
    let storeys = 2.0 + (random.unit() * 3.0).floor();
    let walls = [
        display(206, 190, 164),
        display(188, 120, 96),
        display(214, 208, 196),
        display(170, 160, 148),
        display(196, 168, 120),
    ];
    let roofs = [
        display(110, 64, 52),
        display(84, 84, 90),
        display(124, 92, 74),
    ];
    let setback_m = random.range(6.0, 14.0);
    let middle = border.truncate() + ahead.perp() * side * (setback_m + half_depth_m);
    House {
        middle: middle.extend(relief.height_m(middle)),
        ahead,
        half_length_m,
        half_depth_m,
        height_m: storeys * STOREY_M + 0.6,
        wall: *random.pick(&walls),
        roof: *random.pick(&roofs),
        road_on_right: side,
        number,
    }
}

/// True if no lane is near any part of it.
fn is_free(index: &StripIndex, house: &House) -> bool {
    let steps = [-1.0, -0.5, 0.0, 0.5, 1.0];
    let at = |u: f32, v: f32| {
        house.middle.truncate()
            + house.ahead * (u * house.half_length_m)
            + house.side() * (v * house.half_depth_m)
    };
    steps
        .iter()
        .all(|&u| steps.iter().all(|&v| index.distance_m(at(u, v)) > CLEAR_M))
}

/// The walls and roofs of all houses.
pub(super) fn walls(canvas: &mut Canvas, place: &Drawn, spacing_m: f32) {
    let is_dark = place.light.is_dark();
    for house in &place.houses {
        let patch_m = |share: f32| {
            (PATCH_OVER_SPACING * spacing_m * place.coarseness(house.middle) * share).min(BAY_M)
        };
        let (right, left) = if house.road_on_right > 0.0 {
            (1.0, UNSEEN)
        } else {
            (UNSEEN, 1.0)
        };
        let (ahead, side) = (house.ahead.extend(0.0), house.side().extend(0.0));
        let (length_m, depth_m) = (2.0 * house.half_length_m, 2.0 * house.half_depth_m);
        let corner = |u: f32, v: f32| {
            house.middle + ahead * (u * house.half_length_m) + side * (v * house.half_depth_m)
        };
        let up = Vec3::Z * house.height_m;
        let walls = [
            (corner(-1.0, -1.0), ahead * length_m, right),
            (corner(1.0, -1.0), side * depth_m, ASIDE),
            (corner(1.0, 1.0), -ahead * length_m, left),
            (corner(-1.0, 1.0), -side * depth_m, ASIDE),
        ];
        for (number, (start, along, share)) in walls.into_iter().enumerate() {
            let color =
                |along_m: f32, up_m: f32| wall(house, number as u64, (along_m, up_m), is_dark);
            tiles(canvas, (start, along, up), patch_m(share), color);
        }
        let color = |along_m: f32, up_m: f32| {
            let tone = fractal_noise(house.number, along_m * 0.5, up_m * 0.5, 2);
            (house.roof * (0.75 + 0.5 * tone), Look::Lit { gloss: 0.0 })
        };
        tiles(
            canvas,
            (corner(-1.0, -1.0) + up, ahead * length_m, side * depth_m),
            patch_m(UNSEEN),
            color,
        );
    }
}

/// A rectangle of discs, colored by where they are along and up, meters.
pub(super) fn tiles(
    canvas: &mut Canvas,
    (start, along, up): (Vec3, Vec3, Vec3),
    patch_m: f32,
    color: impl Fn(f32, f32) -> (Vec3, Look),
) {
    let (length_m, height_m) = (along.length(), up.length());
    let (columns, rows) = (
        (length_m / patch_m).ceil().max(1.0),
        (height_m / patch_m).ceil().max(1.0),
    );
    for row in 0..rows as u32 {
        for column in 0..columns as u32 {
            let (u, v) = ((column as f32 + 0.5) / columns, (row as f32 + 0.5) / rows);
            let (albedo, look) = color(u * length_m, v * height_m);
            let (spread_along, spread_up) = (
                along * (SCALE_OVER_PATCH / columns),
                up * (SCALE_OVER_PATCH / rows),
            );
            canvas.push(Disc {
                middle: start + along * u + up * v,
                along: spread_along,
                across: spread_up,
                albedo,
                look,
            });
        }
    }
}

/// Plaster and windows, some of them lit where it is dark.
fn wall(house: &House, side: u64, (along_m, up_m): (f32, f32), is_dark: bool) -> (Vec3, Look) {
    let (bay, storey) = ((along_m / BAY_M).floor(), ((up_m - 0.4) / STOREY_M).floor());
    let (in_bay, in_storey) = (along_m / BAY_M - bay, (up_m - 0.4) / STOREY_M - storey);
    let is_window =
        storey >= 0.0 && (0.3..0.7).contains(&in_bay) && (0.3..0.75).contains(&in_storey);
    if !is_window {
        let dirt = fractal_noise(house.number + side, along_m * 0.4, up_m * 0.4, 3);
        return (house.wall * (0.8 + 0.35 * dirt), Look::Lit { gloss: 0.0 });
    }
    if is_dark && cell(house.number + side, bay as i32, storey as i32) < 0.3 {
        return (Vec3::new(1.0, 0.75, 0.41), Look::Shown);
    }
    (display(62, 72, 84), Look::Lit { gloss: 0.0 })
}
