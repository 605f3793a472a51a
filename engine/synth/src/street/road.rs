//! Asphalt, lane markings, crosswalks, kerbs and sidewalks.

use std::sync::Arc;

use glam::{Vec2, Vec3};

use super::layout::{
    Axis, CROSSING_X_M, EXTENT_M, FAR_M, FRONT_M, KERB_M, LANE_M, LANES_HALF_M, ROAD_HALF_M,
    STOP_LINE_M,
};
use super::random::{cell, fractal_noise, noise, smoothstep};
use super::surface::{Element, Shape, SurfacePoint, Texel, display};

/// Asphalt is shown this much around a marking in the marking's own finer splats, meters.
const MARGIN_M: f32 = 0.12;

/// Sampling density of markings relative to asphalt.
const MARKING_DENSITY: f32 = 8.0;

/// Asphalt on the carriageways, over what densities are relative to: cameras see most of it, and
/// from near by.
const ASPHALT_DENSITY: f32 = 2.8;

/// About the length of a piece of road whose density is of its own, meters.
const SLAB_M: f32 = 12.0;

/// A painted rectangle on the road.
#[derive(Clone, Copy, Debug)]
struct Stripe {
    min: Vec2,
    max: Vec2,
}

/// All paint on the roads, found by place.
struct Markings {
    stripes: Vec<Stripe>,
    cells: Vec<Vec<u16>>,
}

const CELL_M: f32 = 4.0;
const CELLS: i32 = 52;

impl Markings {
    fn new() -> Self {
        let mut stripes = Vec::new();
        for axis in [Axis::Main, Axis::Cross] {
            lane_lines(axis, &mut stripes);
            crossing_paint(axis, &mut stripes);
        }
        let mut cells = vec![Vec::new(); (CELLS * CELLS) as usize];
        for (index, stripe) in stripes.iter().enumerate() {
            let (low, high) = (cell_of(stripe.min - 0.5), cell_of(stripe.max + 0.5));
            for j in low.1.max(0)..=high.1.min(CELLS - 1) {
                for i in low.0.max(0)..=high.0.min(CELLS - 1) {
                    cells[(j * CELLS + i) as usize].push(index as u16);
                }
            }
        }
        Self { stripes, cells }
    }

    /// True if paint lies at a point.
    fn at(&self, point: Vec2) -> bool {
        let (i, j) = cell_of(point);
        if !(0..CELLS).contains(&i) || !(0..CELLS).contains(&j) {
            return false;
        }
        self.cells[(j * CELLS + i) as usize].iter().any(|&index| {
            let Stripe { min, max } = self.stripes[usize::from(index)];
            point.cmpge(min).all() && point.cmple(max).all()
        })
    }
}

fn cell_of(point: Vec2) -> (i32, i32) {
    let cell = (point / CELL_M).floor() + 0.5 * CELLS as f32;
    (cell.x as i32, cell.y as i32)
}

fn stripe(axis: Axis, s: (f32, f32), t: (f32, f32)) -> Stripe {
    let (a, b) = (axis.at(s.0, t.0), axis.at(s.1, t.1));
    Stripe {
        min: a.min(b),
        max: a.max(b),
    }
}

/// Dashed center and lane lines, solid edge lines.
fn lane_lines(axis: Axis, stripes: &mut Vec<Stripe>) {
    for (from, to) in axis.stretches(ROAD_HALF_M + 6.5) {
        for (t, dash_m, gap_m, width_m) in [
            (0.0, 3.0, 3.0, 0.18),
            (LANE_M, 3.0, 6.0, 0.14),
            (-LANE_M, 3.0, 6.0, 0.14),
            (LANES_HALF_M, 12.0, 0.0, 0.14),
            (-LANES_HALF_M, 12.0, 0.0, 0.14),
        ] {
            let mut s = from;
            while s < to {
                stripes.push(stripe(
                    axis,
                    (s, (s + dash_m).min(to)),
                    (t - 0.5 * width_m, t + 0.5 * width_m),
                ));
                s += dash_m + gap_m;
            }
        }
    }
}

/// Crosswalk bars on both arms, and stop lines before them.
fn crossing_paint(axis: Axis, stripes: &mut Vec<Stripe>) {
    for arm in [-1.0f32, 1.0] {
        let s_of = |distance_m: f32| axis.crossing_s() + arm * (ROAD_HALF_M + distance_m);
        let mut t = -ROAD_HALF_M + 0.6;
        while t < ROAD_HALF_M - 0.6 {
            stripes.push(stripe(axis, (s_of(1.2), s_of(4.2)), (t, t + 0.5)));
            t += 1.05;
        }
        // Traffic keeps right: on the near arm it comes with growing s on the side of negative t.
        stripes.push(stripe(
            axis,
            (s_of(5.4), s_of(STOP_LINE_M as f32 - ROAD_HALF_M)),
            (0.1 * arm, arm * LANES_HALF_M),
        ));
    }
}

/// The road's surface at a point of the world.
fn road_texel(markings: &Markings, point: Vec2) -> Texel {
    let (albedo, gloss) = if markings.at(point) {
        (display(240, 238, 228), 0.15)
    } else {
        (display(114, 112, 111), 0.35)
    };
    Texel {
        gloss,
        weathered: true,
        ..Texel::matt(albedo)
    }
}

/// Aging of the road: a factor on its albedo.
fn road_weather(seed: u64, point: Vec2) -> f32 {
    let on_main = point.y.abs() < ROAD_HALF_M;
    let (s, t) = if on_main {
        (point.x, point.y)
    } else {
        (point.y, CROSSING_X_M - point.x)
    };
    let coarse = fractal_noise(seed, point.x * 0.16, point.y * 0.16, 4);
    let grain = noise(seed + 5, point.x * 9.0, point.y * 9.0);
    let mut shade = 0.88 + 0.3 * (coarse - 0.5) + 0.1 * (grain - 0.5);
    // Tires polish two bands of each lane; oil drips between them.
    let in_lane = (t.abs() / LANE_M).fract() - 0.5;
    if t.abs() < LANES_HALF_M {
        shade *= 1.0
            - 0.12 * (-((in_lane.abs() - 0.24) * 14.0).powi(2)).exp()
            - 0.07 * (-(in_lane * 12.0).powi(2)).exp();
    }
    // Repaired trenches: rectangles of newer, darker asphalt.
    let (i, j) = ((s / 11.0).floor() as i32, (t / 3.3).floor() as i32);
    if cell(seed + 7, i, j) < 0.13 {
        let inside = (s / 11.0).fract().abs();
        shade *= if (0.2..0.62).contains(&inside) {
            0.74
        } else {
            1.0
        };
    }
    // Cracks follow the zero of a slow noise.
    let ridge = (fractal_noise(seed + 21, point.x * 0.23, point.y * 0.23, 3) - 0.5).abs();
    shade *= 1.0 - 0.35 * smoothstep(0.012, 0.003, ridge);
    // The gutter gathers dirt.
    shade *= 1.0 - 0.18 * smoothstep(ROAD_HALF_M - 0.6, ROAD_HALF_M, t.abs());
    shade * manhole(seed, s, t)
}

/// Darkening by round covers, one in some cells of the lanes.
fn manhole(seed: u64, s: f32, t: f32) -> f32 {
    let i = (s / 17.0).floor() as i32;
    let center = Vec2::new((i as f32 + 0.5) * 17.0, (cell(seed + 31, i, 0) - 0.5) * 9.0);
    let radius_m = (Vec2::new(s, t) - center).length();
    1.0 - 0.45 * smoothstep(0.36, 0.33, radius_m) + 0.3 * smoothstep(0.28, 0.24, radius_m)
}

fn sidewalk_texel(seed: u64, point: Vec2) -> Texel {
    let stone = 0.75;
    let (i, j) = ((point.x / stone).floor(), (point.y / stone).floor());
    let (x, y) = (point.x / stone - i, point.y / stone - j);
    let joint = x.min(1.0 - x).min(y.min(1.0 - y));
    let dirt = fractal_noise(seed + 41, point.x * 0.4, point.y * 0.4, 3);
    let shade = (0.86 + 0.16 * cell(seed + 43, i as i32, j as i32))
        * (0.78 + 0.3 * dirt)
        * (0.7 + 0.3 * smoothstep(0.0, 0.045, joint));
    Texel {
        gloss: 0.1,
        ..Texel::matt(display(176, 168, 156) * shade)
    }
}

fn flat(min: Vec2, max: Vec2, z: f32) -> Shape {
    let size = max - min;
    Shape::Rectangle {
        corner: min.extend(z),
        along: Vec3::X * size.x,
        up: Vec3::Y * size.y,
    }
}

/// A level rectangle of a street from s and t ranges, whichever way its axis runs.
fn flat_of(axis: Axis, s: (f32, f32), t: (f32, f32), z: f32) -> Shape {
    let Stripe { min, max } = stripe(axis, s, t);
    flat(min, max, z)
}

/// All that lies on the ground between the houses.
pub(super) fn road(seed: u64) -> Vec<Element> {
    let markings = Arc::new(Markings::new());
    let mut elements = Vec::new();
    let textured = |shape: Shape, density: f32| {
        let markings = markings.clone();
        Element::new(shape, density, move |point: &SurfacePoint| {
            road_texel(&markings, point.position.truncate())
        })
        .weathered(move |point| road_weather(seed, point.position.truncate()))
    };
    for axis in [Axis::Main, Axis::Cross] {
        // The main street owns the crossing.
        let clear_m = if axis == Axis::Main { 0.0 } else { ROAD_HALF_M };
        for (from, to) in axis.stretches(clear_m) {
            let slabs = ((to - from) / SLAB_M).round().max(1.0);
            let end = |slab: u32| from + (to - from) * slab as f32 / slabs;
            for slab in 0..slabs as u32 {
                for t in [(-ROAD_HALF_M, 0.0), (0.0, ROAD_HALF_M)] {
                    elements.push(
                        textured(
                            flat_of(axis, (end(slab), end(slab + 1)), t, 0.0),
                            ASPHALT_DENSITY,
                        )
                        .seamless(),
                    );
                }
            }
        }
    }
    for axis in [Axis::Main, Axis::Cross] {
        for (from, to) in [(-FAR_M - 60.0, -EXTENT_M), (EXTENT_M, FAR_M + 60.0)] {
            elements.push(
                textured(flat_of(axis, (from, to), (-FRONT_M, FRONT_M), 0.0), 0.06).seamless(),
            );
        }
    }
    for Stripe { min, max } in &markings.stripes {
        elements.push(textured(
            flat(*min - MARGIN_M, *max + MARGIN_M, 0.001),
            MARKING_DENSITY,
        ));
    }
    for axis in [Axis::Main, Axis::Cross] {
        elements.extend(sidewalks(axis, seed));
    }
    elements
}

/// Sidewalks and kerbs on both sides of one street; the corners belong to the main street.
fn sidewalks(axis: Axis, seed: u64) -> Vec<Element> {
    let mut elements = Vec::new();
    let (walk_clear_m, density) = (
        if axis == Axis::Main {
            ROAD_HALF_M
        } else {
            FRONT_M
        },
        0.8,
    );
    for (stretch, (from, to)) in axis.stretches(walk_clear_m).into_iter().enumerate() {
        for side in [1.0f32, -1.0] {
            let t = (side * ROAD_HALF_M, side * FRONT_M);
            elements.push(Element::new(
                flat_of(axis, (from, to), t, KERB_M),
                density,
                move |point| sidewalk_texel(seed, point.position.truncate()),
            ));
            // The kerb reaches to the corner on both streets.
            let crossing = axis.crossing_s()
                + if stretch == 0 {
                    -ROAD_HALF_M
                } else {
                    ROAD_HALF_M
                };
            let ends = if stretch == 0 {
                (from, crossing)
            } else {
                (crossing, to)
            };
            elements.extend(kerb(axis, ends, side, 3.0 * density, seed));
        }
    }
    elements
}

/// Kerb stones: a narrow top and the face towards the road.
fn kerb(axis: Axis, (from, to): (f32, f32), side: f32, density: f32, seed: u64) -> [Element; 2] {
    let stone = move |point: &SurfacePoint| {
        let p = point.position;
        let along = if axis == Axis::Main { p.x } else { p.y };
        let shade = 0.85 + 0.22 * cell(seed + 51, along.floor() as i32, side as i32)
            - 0.25 * smoothstep(0.06, 0.0, p.z);
        Texel {
            openness: 0.55 + 0.45 * smoothstep(0.0, KERB_M, p.z),
            ..Texel::matt(display(188, 184, 176) * shade)
        }
    };
    let top = flat_of(
        axis,
        (from, to),
        (side * ROAD_HALF_M, side * (ROAD_HALF_M + 0.2)),
        KERB_M + 0.004,
    );
    let (a, b) = (
        axis.at(from, side * ROAD_HALF_M),
        axis.at(to, side * ROAD_HALF_M),
    );
    let along = (b - a).extend(0.0);
    // The face looks back at the centerline.
    let inward = (axis.at(from, 0.0) - a).extend(0.0);
    let (corner, along) = if along.cross(Vec3::Z).dot(inward) > 0.0 {
        (a, along)
    } else {
        (b, -along)
    };
    let face = Shape::Rectangle {
        corner: corner.extend(0.0),
        along,
        up: Vec3::Z * KERB_M,
    };
    [
        Element::new(top, density, stone),
        Element::new(face, density, stone),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paint_lies_where_lane_lines_and_crosswalks_are() {
        let markings = Markings::new();
        let painted = |x: f32, y: f32| markings.at(Vec2::new(x, y));
        assert!(
            painted(-99.0, 0.0) && !painted(-96.0, 0.0) && painted(-93.0, 0.0),
            "a dashed center"
        );
        assert!(
            (0..100).all(|i| painted(-99.6 + i as f32, LANES_HALF_M)),
            "a solid edge"
        );
        assert!(
            painted(CROSSING_X_M - ROAD_HALF_M - 2.0, -ROAD_HALF_M + 0.8),
            "a crosswalk"
        );
        assert!(
            painted(CROSSING_X_M - ROAD_HALF_M - 5.6, -3.0)
                && !painted(CROSSING_X_M - ROAD_HALF_M - 5.6, 3.0),
            "a stop line"
        );
        assert!(
            !painted(CROSSING_X_M, 0.0),
            "nothing on the crossing itself"
        );
    }
}
