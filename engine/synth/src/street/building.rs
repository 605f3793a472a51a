//! Houses: fronts with sills, balconies, awnings and cornices in relief; plain sides and roofs.

use glam::Vec3;

use super::facade::{Cladding, Design, SHOP_STOREY_M};
use super::layout::{FAR_M, KERB_M, Lot};
use super::random::{Stream, cell, fractal_noise, smoothstep};
use super::surface::{Element, Shape, SurfacePoint, Texel, boxed, display};

/// Splats a square meter of front, relative to asphalt.
const FRONT_DENSITY: f32 = 1.1;

/// Share of it beyond the detailed extent.
const FAR_DENSITY: f32 = 0.06;

/// Density factor of windows: glass bars and curtains are finer than walls.
const WINDOW_DENSITY: f32 = 1.4;

/// All surfaces of one house, in the world.
pub(super) fn building(lot: &Lot) -> Vec<Element> {
    let design = Design::new(lot.seed);
    let (width, depth, height) = (lot.size.x, lot.size.y, lot.size.z);
    let mut elements = vec![front(
        &design,
        Vec3::ZERO,
        Vec3::X * width,
        height,
        FRONT_DENSITY,
    )];
    if !lot.far {
        elements.extend(window_details(&design, width, height));
        elements.extend(relief(&design, width, height));
    }
    for (free, corner, along) in [
        (lot.free_ends[0], Vec3::Y * depth, Vec3::NEG_Y * depth),
        (lot.free_ends[1], Vec3::X * width, Vec3::Y * depth),
    ] {
        elements.push(if free {
            front(&design, corner, along, height, 0.8 * FRONT_DENSITY)
        } else {
            let shape = Shape::Rectangle {
                corner,
                along,
                up: Vec3::Z * height,
            };
            bare_wall(shape, 0.12, design)
        });
    }
    let back = Shape::Rectangle {
        corner: Vec3::new(width, depth, 0.0),
        along: Vec3::NEG_X * width,
        up: Vec3::Z * height,
    };
    elements.push(bare_wall(back, 0.03, design));
    elements.push(roof(width, depth, height, lot.seed));
    let lift = lot.translation() + Vec3::Z * if lot.far { 0.0 } else { KERB_M };
    elements
        .into_iter()
        .map(|element| {
            element
                .placed(lot.rotation(), lift)
                .denser(if lot.far { FAR_DENSITY } else { 1.0 })
        })
        .collect()
}

/// A wall with windows from `corner` along `along`.
fn front(design: &Design, corner: Vec3, along: Vec3, height_m: f32, density: f32) -> Element {
    let design = *design;
    let width_m = along.length();
    let shape = Shape::Rectangle {
        corner,
        along,
        up: Vec3::Z * height_m,
    };
    Element::new(shape, density, move |point: &SurfacePoint| {
        let texel = design.front(
            (point.position - corner).dot(along) / width_m,
            point.position.z,
            width_m,
            height_m,
        );
        Texel {
            haze: haze_of(point),
            ..texel
        }
    })
    .weathered(move |point| {
        design.weather(
            (point.position - corner).dot(along) / width_m,
            point.position.z,
        )
    })
}

/// A wall without windows.
fn bare_wall(shape: Shape, density: f32, design: Design) -> Element {
    Element::new(shape, density, move |_| design.wall_texel()).weathered(move |point| {
        design.weather(point.position.x + point.position.y, point.position.z)
    })
}

/// Fronts carry no haze near by; the coarse rows beyond the extent fade out.
fn haze_of(point: &SurfacePoint) -> f32 {
    0.25 * smoothstep(FAR_M * 0.5, FAR_M, point.position.length())
}

/// Finer splats over the ground floor and over each window and its frame, from the same texture.
fn window_details(design: &Design, width_m: f32, height_m: f32) -> Vec<Element> {
    let margin_m = 0.2;
    let storefront = front(
        design,
        Vec3::NEG_Y * 0.004,
        Vec3::X * width_m,
        SHOP_STOREY_M,
        WINDOW_DENSITY,
    );
    let mut elements = vec![storefront];
    for storey in 1..=design.storeys(height_m) {
        for bay in 0..design.bays(width_m).0 {
            let [x0, z0, x1, z1] = design.window(bay, storey, width_m);
            let corner = Vec3::new(x0 - margin_m, -0.004, z0 - margin_m);
            let size = [x1 - x0 + 2.0 * margin_m, z1 - z0 + 2.0 * margin_m];
            let shape = Shape::Rectangle {
                corner,
                along: Vec3::X * size[0],
                up: Vec3::Z * size[1],
            };
            let design = *design;
            let window = Element::new(shape, WINDOW_DENSITY, move |point| {
                design.front(point.position.x, point.position.z, width_m, height_m)
            });
            elements.push(
                window.weathered(move |point| design.weather(point.position.x, point.position.z)),
            );
        }
    }
    elements
}

/// Elements that stand out from the wall.
fn relief(design: &Design, width_m: f32, height_m: f32) -> Vec<Element> {
    let trim = design.trim;
    let stone = move |point: &SurfacePoint| {
        // Undersides see little sky.
        Texel {
            openness: 0.6 + 0.4 * (0.5 + 0.5 * point.normal.z),
            ..Texel::matt(trim * (0.85 + 0.15 * point.u))
        }
    };
    let mut elements = boxed(
        Vec3::new(0.0, -0.45, height_m - 0.4),
        Vec3::new(width_m, 0.0, height_m + 0.1),
        1.0,
        stone,
    );
    elements.extend(boxed(
        Vec3::new(0.0, -0.14, SHOP_STOREY_M - 0.2),
        Vec3::new(width_m, 0.0, SHOP_STOREY_M),
        1.0,
        stone,
    ));
    let mut random = Stream::new(design.seed, 4 << 40, 0);
    let balconies = design.cladding == Cladding::Render && random.chance(0.5);
    for storey in 1..=design.storeys(height_m) {
        for bay in 0..design.bays(width_m).0 {
            let [x0, z0, x1, _] = design.window(bay, storey, width_m);
            if balconies && bay % 3 == 1 {
                elements.extend(balcony(x0 - 0.5, x1 + 0.5, z0 - 0.75, trim));
            } else if design.cladding != Cladding::Panels {
                elements.extend(boxed(
                    Vec3::new(x0 - 0.1, -0.16, z0 - 0.14),
                    Vec3::new(x1 + 0.1, 0.0, z0 - 0.02),
                    1.6,
                    stone,
                ));
            }
        }
    }
    if design.shops && random.chance(0.75) {
        elements.extend(awnings(design, width_m, &mut random));
    }
    elements
}

/// A slab and a railing of bars.
fn balcony(x0: f32, x1: f32, floor_m: f32, trim: Vec3) -> Vec<Element> {
    let deep_m = 1.1;
    let slab = move |point: &SurfacePoint| Texel {
        openness: 0.65 + 0.35 * point.normal.z.max(0.0),
        ..Texel::matt(trim * 0.8)
    };
    let mut elements = boxed(
        Vec3::new(x0, -deep_m, floor_m),
        Vec3::new(x1, 0.0, floor_m + 0.16),
        1.5,
        slab,
    );
    let bars = |point: &SurfacePoint| {
        let p = point.position;
        let bar = ((p.x + p.y) / 0.14).fract().abs() < 0.4 || point.v > 0.9;
        Texel {
            openness: 0.8,
            ..Texel::matt(if bar {
                display(46, 48, 52)
            } else {
                display(120, 116, 108)
            })
        }
    };
    let up = Vec3::Z * 0.95;
    let base = floor_m + 0.16;
    for (corner, along) in [
        (Vec3::new(x0, -deep_m, base), Vec3::X * (x1 - x0)),
        (Vec3::new(x0, 0.0, base), Vec3::NEG_Y * deep_m),
        (Vec3::new(x1, -deep_m, base), Vec3::Y * deep_m),
    ] {
        elements.push(Element::new(
            Shape::Rectangle { corner, along, up },
            1.6,
            bars,
        ));
    }
    elements
}

/// Striped cloth over some of the shop windows.
fn awnings(design: &Design, width_m: f32, random: &mut Stream) -> Vec<Element> {
    let cloth = design.sign;
    let mut elements = Vec::new();
    let mut x = 0.6;
    while x + 3.2 < width_m {
        if random.chance(0.6) {
            let stripes = move |point: &SurfacePoint| {
                let pale = (point.position.x / 0.42).fract() < 0.5;
                let albedo = if pale {
                    display(232, 224, 208)
                } else {
                    cloth * 1.15
                };
                Texel {
                    translucency: 0.2,
                    ..Texel::matt(albedo)
                }
            };
            let outer = Vec3::new(x, -1.25, 2.5);
            let shape = Shape::Rectangle {
                corner: outer,
                along: Vec3::X * 3.0,
                up: Vec3::new(0.0, 1.25, 0.55),
            };
            elements.push(Element::new(shape, 4.0, stripes));
            let valance = Shape::Rectangle {
                corner: outer - Vec3::Z * 0.25,
                along: Vec3::X * 3.0,
                up: Vec3::Z * 0.25,
            };
            elements.push(Element::new(valance, 6.0, stripes));
        }
        x += 4.1;
    }
    elements
}

/// A flat roof with gravel and a parapet's color.
fn roof(width_m: f32, depth_m: f32, height_m: f32, seed: u64) -> Element {
    let shape = Shape::Rectangle {
        corner: Vec3::Z * height_m,
        along: Vec3::X * width_m,
        up: Vec3::Y * depth_m,
    };
    let tint = cell(seed, 1, 2);
    Element::new(shape, 0.05, move |point| {
        let shade =
            0.8 + 0.4 * fractal_noise(seed, point.position.x * 0.5, point.position.y * 0.5, 3);
        Texel::matt(display(150, 140, 132).lerp(display(150, 96, 78), tint) * shade)
    })
}
