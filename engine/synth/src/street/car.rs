//! Cars: a lofted body, a cabin of glass and pillars, wheels with rims, mirrors.
//!
//! Built in the canonical frame: x forward, y left, z up, origin at the middle of the box, wheels
//! touching z = -H/2.

use std::f32::consts::{PI, TAU};

use glam::{Vec2, Vec3};

use super::car_paint::{Paint, body_texel, cabin_texel, rim_texel};
use super::loft::{Loft, bar, ellipsoid, superellipse};
use super::random::smoothstep;
use super::surface::{Element, Shape, SurfacePoint, Texel, display};

/// Distinct cars that the generator knows.
pub(super) const VARIANTS: usize = 12;

/// Splats a square meter, relative to asphalt, on a parked car.
pub(super) const CAR_DENSITY: f32 = 9.0;

/// Height of the shadow over the road that is not in the asset, meters: above the road's own
/// splats, which stray.
const SHADOW_Z_M: f32 = 0.06;

/// Splats a square meter of shadow, relative to the body's: it is soft.
const SHADOW_DENSITY: f32 = 0.25;

/// The build of a car. Heights are above the ground, x is from the middle, meters.
#[derive(Clone, Copy, Debug)]
pub(super) struct Build {
    /// Length, width, height of the box.
    pub size: Vec3,
    /// Position at which the hood meets the windscreen.
    pub cowl_x: f32,
    /// Front and rear end of the roof.
    pub roof_x: [f32; 2],
    /// Position at which the rear window meets the deck.
    pub deck_x: f32,
    /// Height of the front edge, the cowl and the tail.
    pub nose_cowl_tail_z: [f32; 3],
    pub wheel_radius_m: f32,
    pub axles_x: [f32; 2],
}

const SEDAN: Build = Build {
    size: Vec3::new(4.66, 1.84, 1.45),
    cowl_x: 0.92,
    roof_x: [0.22, -0.98],
    deck_x: -1.72,
    nose_cowl_tail_z: [0.70, 0.96, 1.00],
    wheel_radius_m: 0.325,
    axles_x: [1.42, -1.34],
};

const HATCHBACK: Build = Build {
    size: Vec3::new(4.05, 1.78, 1.49),
    cowl_x: 0.95,
    roof_x: [0.28, -1.45],
    deck_x: -1.88,
    nose_cowl_tail_z: [0.72, 1.00, 1.00],
    wheel_radius_m: 0.315,
    axles_x: [1.24, -1.30],
};

const SUV: Build = Build {
    size: Vec3::new(4.60, 1.90, 1.70),
    cowl_x: 1.02,
    roof_x: [0.34, -1.78],
    deck_x: -2.12,
    nose_cowl_tail_z: [0.88, 1.12, 1.12],
    wheel_radius_m: 0.365,
    axles_x: [1.38, -1.36],
};

const VAN: Build = Build {
    size: Vec3::new(5.05, 1.96, 1.98),
    cowl_x: 1.72,
    roof_x: [1.02, -2.30],
    deck_x: -2.46,
    nose_cowl_tail_z: [0.92, 1.18, 1.20],
    wheel_radius_m: 0.345,
    axles_x: [1.58, -1.52],
};

impl Build {
    /// Build and paint of a variant; numbers from [`VARIANTS`] on repeat.
    pub(super) fn for_variant(variant: usize) -> (Self, Paint) {
        let colors = [
            display(205, 208, 210),
            display(28, 30, 34),
            display(150, 22, 26),
            display(236, 236, 232),
            display(30, 66, 128),
            display(104, 110, 116),
            display(58, 88, 74),
            display(232, 176, 40),
            display(176, 166, 146),
            display(40, 110, 140),
            display(92, 30, 40),
            display(226, 228, 230),
        ];
        let builds = [
            SEDAN, SUV, HATCHBACK, VAN, SEDAN, SUV, HATCHBACK, SEDAN, SUV, HATCHBACK, SEDAN, SUV,
        ];
        let variant = variant % VARIANTS;
        (
            builds[variant],
            Paint {
                color: colors[variant],
                taxi: variant == 7,
                cargo: variant == 3,
            },
        )
    }

    /// Top of the body (hood, belt line, deck) at `x`, above the ground.
    pub(super) fn top_z(&self, x: f32) -> f32 {
        let [nose, cowl, tail] = self.nose_cowl_tail_z;
        let front =
            nose + (cowl - nose) * smoothstep(0.56 * self.size.x, self.cowl_x - 0.3, x).powf(0.8);
        front + (tail - cowl) * smoothstep(self.cowl_x, self.deck_x, x)
    }

    /// Underside of the body: the sill, rising towards the bumpers.
    pub(super) fn bottom_z(&self, x: f32) -> f32 {
        let end = (2.0 * x / self.size.x).abs();
        0.53 * self.wheel_radius_m + 0.12 * smoothstep(0.75, 1.0, end)
    }

    /// Height of the cabin's belt line above the ground.
    pub(super) fn belt_z(&self) -> f32 {
        self.nose_cowl_tail_z[1] - 0.05
    }

    /// The x where the cabin begins and ends at share `s` of the way from belt to roof.
    pub(super) fn cabin_x(&self, s: f32) -> [f32; 2] {
        [
            self.cowl_x + (self.roof_x[0] - self.cowl_x) * s,
            self.deck_x + (self.roof_x[1] - self.deck_x) * s,
        ]
    }

    /// The tallest part of the cabin's side before it turns into the roof, as a share of the
    /// cabin's parameter v.
    const SHOULDER_V: f32 = 0.68;

    fn body_point(&self, u: f32, v: f32) -> Vec3 {
        // Along: a superellipse in plan, so that bumpers are round. Across: a rounder one for the
        // section.
        let plan = superellipse(PI * (u - 0.5), 5.5);
        let section = superellipse(TAU * v, 3.6);
        let x = 0.5 * self.size.x * plan.y;
        let (bottom, top) = (self.bottom_z(x), self.top_z(x));
        let middle = 0.5 * (bottom + top);
        // Sides lean in above the widest line.
        let lean = 1.0 - 0.055 * section.y.max(0.0).powi(2);
        // The end faces keep their height longer than their width.
        let ring = plan.x.max(0.0);
        let upright = ring.powf(0.55);
        Vec3::new(
            x,
            0.5 * self.size.y * 0.985 * ring * section.x * lean,
            middle + (top - middle) * section.y * upright,
        )
    }

    fn cabin_point(&self, u: f32, v: f32) -> Vec3 {
        let plan = superellipse(TAU * u, 5.0);
        let (rise, spread) = if v < Self::SHOULDER_V {
            (0.94 * v / Self::SHOULDER_V, 1.0)
        } else {
            // Over the shoulder to the middle of the roof: a quarter of a superellipse, nearly
            // flat.
            let turn = superellipse(
                0.5 * PI * (v - Self::SHOULDER_V) / (1.0 - Self::SHOULDER_V),
                2.6,
            );
            (0.94 + 0.06 * turn.y, turn.x.max(0.0))
        };
        let [front, rear] = self.cabin_x(rise.min(1.0));
        let half_width = 0.5 * self.size.y * (0.93 - 0.16 * rise);
        let x = 0.5 * (front + rear) + 0.5 * (front - rear) * plan.x * spread;
        Vec3::new(
            x,
            half_width * plan.y * spread,
            self.belt_z() + (self.size.z - self.belt_z()) * rise,
        )
    }

    /// All surfaces in the canonical frame.
    pub(super) fn elements(&self, paint: Paint) -> Vec<Element> {
        let build = *self;
        let lift = Vec3::Z * (0.5 * self.size.z);
        let core_body = Vec3::new(0.0, 0.0, 0.6 * self.belt_z()) - lift;
        let body = Loft::new(core_body, move |u, v| build.body_point(u, v) - lift);
        let [front, rear] = self.cabin_x(0.5);
        let core_cabin = Vec3::new(0.5 * (front + rear), 0.0, self.belt_z() - 0.1) - lift;
        let cabin = Loft::new(core_cabin, move |u, v| build.cabin_point(u, v) - lift);
        let mut elements = vec![
            Element::new(Shape::Loft(body), 1.0, move |point| {
                body_texel(&build, &paint, point, point.position + lift)
            }),
            Element::new(Shape::Loft(cabin), 1.1, move |point| {
                cabin_texel(&build, &paint, point, point.position + lift)
            }),
        ];
        for x in self.axles_x {
            for side in [1.0f32, -1.0] {
                elements.extend(self.wheel(x, side));
            }
        }
        for side in [1.0f32, -1.0] {
            elements.push(self.mirror(side, paint.color));
        }
        elements
    }

    /// A tire and a rim on one side.
    pub(super) fn wheel(&self, x: f32, side: f32) -> [Element; 3] {
        let radius_m = self.wheel_radius_m;
        let outer_y = side * (0.5 * self.size.y - 0.01);
        let center = Vec3::new(x, outer_y, radius_m - 0.5 * self.size.z);
        let inward = Vec3::NEG_Y * side * 0.22;
        let rubber = |point: &SurfacePoint| {
            let groove = if (point.v * 6.0).fract() < 0.25 {
                0.6
            } else {
                1.0
            };
            Texel {
                openness: 0.6,
                ..Texel::matt(display(40, 40, 42) * groove)
            }
        };
        let tread = Loft::new(center + inward * 0.5, move |u, v| {
            let (sin, cos) = (u * TAU).sin_cos();
            center + inward * v + Vec3::new(cos, 0.0, sin) * radius_m
        });
        let disc = move |u: f32, v: f32| {
            let (sin, cos) = (u * TAU).sin_cos();
            // The rim lies deeper than the tire's wall.
            let dish = 0.045 * smoothstep(0.72, 0.62, v);
            center + Vec3::new(cos, 0.0, sin) * (radius_m * v) + inward * (dish / 0.22)
        };
        // Behind the disc, so that its normals face out of the car.
        let face = Loft::new(center + inward * 8.0, disc);
        let rim = Element::new(Shape::Loft(face.bordered()), 2.2, move |point| {
            let offset = point.position - center;
            rim_texel(Vec2::new(offset.x, offset.z) / radius_m)
        });
        let well = bar(
            center + inward,
            center + inward * 1.05,
            radius_m * 0.98,
            0.05,
        );
        [
            Element::new(Shape::Loft(tread.bordered()), 1.2, rubber),
            rim,
            Element::new(Shape::Loft(well.bordered()), 0.4, |_| Texel {
                openness: 0.2,
                ..Texel::matt(display(30, 30, 32))
            }),
        ]
    }

    /// The dark that the car lays on whatever road it drives over: a sheer plate under it, fading
    /// to its border.
    pub(super) fn shadow(&self) -> Element {
        let half = Vec2::new(0.5 * self.size.x, 0.5 * self.size.y);
        let corner = Vec3::new(-half.x, -half.y, SHADOW_Z_M - 0.5 * self.size.z);
        let shape = Shape::Rectangle {
            corner,
            along: Vec3::X * self.size.x,
            up: Vec3::Y * self.size.y,
        };
        Element::new(shape, SHADOW_DENSITY, move |point| {
            let inside_m = (half - point.position.truncate().abs()).min_element();
            let sheer = 0.75 - 0.7 * smoothstep(0.0, 0.45, inside_m);
            Texel {
                sheer,
                openness: 0.3,
                emitted: Some(display(34, 34, 36)),
                ..Texel::matt(Vec3::ZERO)
            }
        })
        .seamless()
    }

    fn mirror(&self, side: f32, color: Vec3) -> Element {
        let center = Vec3::new(
            self.cowl_x - 0.38,
            side * (0.5 * self.size.y + 0.02),
            self.belt_z() + 0.09 - 0.5 * self.size.z,
        );
        let shell = ellipsoid(center, Vec3::new(0.07, 0.13, 0.085));
        Element::new(Shape::Loft(shell), 1.5, move |point| {
            let glass = point.normal.x < -0.6;
            Texel {
                gloss: 0.5,
                ..Texel::matt(if glass {
                    display(120, 140, 156)
                } else {
                    color * 0.9
                })
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_build_fills_its_box_and_stands_on_its_wheels() {
        for variant in 0..VARIANTS {
            let (build, paint) = Build::for_variant(variant);
            let half = build.size * 0.5;
            let (mut low, mut high) = (Vec3::MAX, Vec3::MIN);
            for element in build.elements(paint) {
                for index in 0..3000 {
                    let point = element.shape.sample(
                        index,
                        3000,
                        &mut super::super::random::Stream::new(1, 1, index as u64),
                    );
                    low = low.min(point.position);
                    high = high.max(point.position);
                }
            }
            assert!(
                (low.z + half.z).abs() < 0.02 && (high.z - half.z).abs() < 0.03,
                "variant {variant}: {low} {high}"
            );
            assert!(
                (low.x + half.x).abs() < 0.03 && (high.x - half.x).abs() < 0.03,
                "variant {variant}: {low} {high}"
            );
            // Mirrors stand out beyond the body, as the width of a car in data sets excludes them.
            assert!(
                high.y > half.y - 0.03 && high.y < half.y + 0.17,
                "variant {variant}: {low} {high}"
            );
        }
    }

    #[test]
    fn the_roof_is_above_the_belt_and_the_belt_above_the_sill() {
        for variant in 0..VARIANTS {
            let (build, _) = Build::for_variant(variant);
            for step in 0..20 {
                let x = build.size.x * (step as f32 / 19.0 - 0.5);
                assert!(
                    build.top_z(x) > build.bottom_z(x) + 0.3 && build.top_z(x) < build.size.z - 0.2,
                    "variant {variant} at {x}"
                );
            }
        }
    }
}
