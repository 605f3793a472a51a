//! Distant elements: ground between and behind the houses, towers, hills and a sky dome.

use glam::Vec3;

use super::layout::{Axis, FAR_M, FRONT_M, LOT_DEPTH_M};
use super::loft::Loft;
use super::random::{Stream, cell, fractal_noise, smoothstep};
use super::surface::{Element, Shape, SurfacePoint, Texel, boxed, display};
use super::weather::{Air, Weather, lamplight};

/// Radius of the dome, meters.
pub(super) const DOME_RADIUS_M: f32 = 480.0;

/// Radius of the hills' ring, meters.
const HILLS_RADIUS_M: f32 = 400.0;

/// Linear RGB of the sky in the direction of `direction`, the sun towards `sun`.
fn sky_color(weather: Weather, direction: Vec3, sun: Vec3, seed: u64) -> Vec3 {
    match weather {
        Weather::Clear => clear_sky(direction, sun, seed),
        Weather::Overcast => overcast_sky(direction, seed),
        Weather::Dusk => dusk_sky(direction, sun, seed),
        Weather::Night => night_sky(direction, seed),
    }
}

/// Cloud cover in a direction: drawn on a plane, so that clouds shrink towards the horizon.
fn cover(direction: Vec3, seed: u64, stretch: f32) -> f32 {
    let plane = direction.truncate() / (direction.z.max(0.0) + 0.16);
    fractal_noise(seed + 111, plane.x * 1.1 + 3.0, plane.y * stretch, 5)
}

/// A closed cover, brighter overhead, with darker billows.
fn overcast_sky(direction: Vec3, seed: u64) -> Vec3 {
    let height = direction.z.max(0.0);
    let gray = display(196, 200, 204).lerp(display(222, 225, 229), 1.0 - (-2.5 * height).exp());
    let billow = smoothstep(0.35, 0.7, cover(direction, seed, 1.7)) * smoothstep(0.0, 0.15, height);
    gray * (1.0 - 0.30 * billow)
}

/// Gold about the sun, rose opposite to it, violet above, and thin clouds lit from below.
fn dusk_sky(direction: Vec3, sun: Vec3, seed: u64) -> Vec3 {
    let height = direction.z.max(0.0);
    let facing = direction
        .truncate()
        .normalize_or_zero()
        .dot(sun.truncate().normalize_or_zero());
    let sunward = smoothstep(-0.5, 1.0, facing);
    let horizon = display(190, 138, 150).lerp(display(255, 176, 92), sunward);
    let middle = display(126, 112, 158).lerp(display(196, 142, 142), sunward);
    let zenith = display(62, 66, 118);
    let clear = horizon
        .lerp(middle, 1.0 - (-7.0 * height).exp())
        .lerp(zenith, smoothstep(0.08, 0.75, height));
    let glow = direction.dot(sun).max(0.0);
    let clear = clear
        + Vec3::new(1.0, 0.52, 0.18)
            * (0.30 * glow.powi(12) + 0.6 * glow.powi(80) + 2.5 * glow.powi(900));
    let clouds =
        smoothstep(0.52, 0.72, cover(direction, seed, 3.4)) * smoothstep(0.01, 0.10, height) * 0.8;
    let lit = display(150, 104, 126).lerp(display(255, 158, 98), smoothstep(-0.2, 0.9, glow));
    clear.lerp(lit, clouds)
}

/// Nearly black, with the light of the town over the horizon and under the clouds.
fn night_sky(direction: Vec3, seed: u64) -> Vec3 {
    let height = direction.z.max(0.0);
    let town = display(64, 52, 46);
    let clear = display(12, 15, 30).lerp(town, (-6.0 * height).exp());
    let clouds =
        smoothstep(0.50, 0.75, cover(direction, seed, 1.7)) * smoothstep(0.02, 0.15, height);
    clear.lerp(display(44, 40, 44), 0.6 * clouds)
}

/// A clear afternoon sky and its clouds.
fn clear_sky(direction: Vec3, sun: Vec3, seed: u64) -> Vec3 {
    let height = direction.z.max(0.0);
    let horizon = display(206, 220, 232);
    let zenith = display(66, 124, 205);
    let clear = horizon.lerp(zenith, 1.0 - (-3.2 * height).exp());
    let glow = direction.dot(sun).max(0.0);
    let clear = clear + Vec3::new(1.0, 0.9, 0.7) * (0.10 * glow.powi(8) + 0.5 * glow.powi(300));
    // Clouds are drawn on a plane, so that they shrink towards the horizon.
    let plane = direction.truncate() / (height + 0.16);
    let billow = fractal_noise(seed + 111, plane.x * 1.1 + 3.0, plane.y * 1.7, 5);
    let cover = smoothstep(0.55, 0.74, billow) * smoothstep(0.01, 0.12, height) * 0.92;
    let thick = fractal_noise(
        seed + 111,
        plane.x * 1.1 + 3.0 - 0.16 * sun.x,
        plane.y * 1.7 - 0.16 * sun.y,
        5,
    );
    let cloud = display(255, 254, 251).lerp(display(206, 214, 226), smoothstep(0.5, 0.8, thick));
    clear.lerp(cloud, cover)
}

/// Everything beyond the houses.
pub(super) fn far_shell(seed: u64, weather: Weather) -> Vec<Element> {
    let towards_sun = Air::for_weather(weather).towards_sun.normalize_or(Vec3::Z);
    let dome = Element::new(
        Shape::Dome {
            radius_m: DOME_RADIUS_M,
            low: -0.05,
        },
        0.0012,
        move |point: &SurfacePoint| {
            let direction = point.position.normalize_or(Vec3::Z);
            Texel {
                emitted: Some(sky_color(weather, direction, towards_sun, seed)),
                ..Texel::matt(Vec3::ONE)
            }
        },
    );
    let mut elements = vec![dome];
    elements.push(hills(seed, HILLS_RADIUS_M, 34.0, 0.62));
    elements.push(hills(seed + 1, HILLS_RADIUS_M - 60.0, 17.0, 0.38));
    elements.extend(ground(seed));
    elements.extend(towers(seed));
    elements
}

/// A ring of wooded hills up to about `height_m`.
fn hills(seed: u64, radius_m: f32, height_m: f32, haze: f32) -> Element {
    let ridge = move |u: f32| {
        let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
        height_m * (0.25 + 1.0 * fractal_noise(seed + 131, 4.0 + 3.5 * cos, 4.0 + 3.5 * sin, 4))
    };
    // Far below, so that 'outward' is up on every slope.
    let loft = Loft::new(Vec3::new(0.0, 0.0, -4000.0), move |u, v| {
        let (sin, cos) = (u * std::f32::consts::TAU).sin_cos();
        let radius = radius_m + 25.0 * v;
        Vec3::new(radius * cos, radius * sin, -3.0 + (ridge(u) + 3.0) * v)
    });
    Element::new(Shape::Loft(loft), 0.008, move |point| {
        let azimuth_m = point.u * 6.0 * radius_m;
        let woods = fractal_noise(seed + 137, azimuth_m * 0.05, point.position.z * 0.12, 4);
        let albedo = display(92, 112, 66).lerp(display(128, 132, 84), smoothstep(0.4, 0.65, woods))
            * (0.7 + 0.5 * woods);
        Texel {
            haze,
            ..Texel::matt(albedo)
        }
    })
}

/// Courtyards behind the houses and open land beyond, as coarse as distance allows.
fn ground(seed: u64) -> Vec<Element> {
    let inner = FRONT_M + LOT_DEPTH_M;
    let land = move |point: &SurfacePoint| {
        let p = point.position;
        let patches = fractal_noise(seed + 151, p.x * 0.03, p.y * 0.03, 4);
        let albedo =
            display(122, 128, 84).lerp(display(150, 140, 118), smoothstep(0.4, 0.6, patches));
        Texel {
            haze: 0.45 * smoothstep(80.0, 400.0, p.length()),
            ..Texel::matt(albedo * (0.75 + 0.4 * patches))
        }
    };
    let mut elements = Vec::new();
    let radius = HILLS_RADIUS_M;
    let cross = Axis::Main.crossing_s();
    for (x0, x1) in [(-radius, cross - inner), (cross + inner, radius)] {
        for (y0, y1) in [(-radius, -inner), (inner, radius)] {
            let shape = Shape::Rectangle {
                corner: Vec3::new(x0, y0, -0.05),
                along: Vec3::X * (x1 - x0),
                up: Vec3::Y * (y1 - y0),
            };
            elements.push(Element::new(shape, 0.0012, land));
        }
    }
    elements
}

/// A skyline: towers behind the rows, paler the farther they stand.
fn towers(seed: u64) -> Vec<Element> {
    let mut elements = Vec::new();
    for index in 0..46u64 {
        let mut random = Stream::new(seed, 7 << 40, index);
        let azimuth = std::f32::consts::TAU * (index as f32 + random.unit()) / 46.0;
        let distance_m = random.range(FAR_M + 20.0, HILLS_RADIUS_M - 70.0);
        let center = Vec3::new(azimuth.cos(), azimuth.sin(), 0.0) * distance_m;
        let half = Vec3::new(random.range(8.0, 17.0), random.range(8.0, 17.0), 0.0);
        let height_m = if random.chance(0.3) {
            random.range(45.0, 85.0)
        } else {
            random.range(18.0, 40.0)
        };
        let hues = [
            display(150, 158, 170),
            display(176, 164, 150),
            display(128, 140, 156),
            display(190, 188, 184),
        ];
        let wall = *random.pick(&hues);
        let tower = random.bits();
        let haze = 0.25 + 0.4 * smoothstep(FAR_M, HILLS_RADIUS_M, distance_m);
        let texture = move |point: &SurfacePoint| {
            let p = point.position;
            let storey = (p.z / 7.0).floor() as i32;
            let bay = ((p.x + p.y) / 5.0).floor() as i32;
            let glass = (p.x + p.y).rem_euclid(5.0) > 1.6
                && (p.z / 7.0).fract() > 0.45
                && point.normal.z < 0.5;
            let albedo = if glass {
                display(112, 128, 148) * (0.85 + 0.3 * cell(tower, bay, storey))
            } else {
                wall
            };
            let lit = glass && cell(tower + 1, bay, storey) < 0.3;
            let glow = if lit {
                lamplight() * (0.2 + 0.4 * cell(tower + 2, bay, storey))
            } else {
                Vec3::ZERO
            };
            Texel {
                haze,
                glow,
                ..Texel::matt(albedo)
            }
        };
        elements.extend(boxed(
            center - half,
            center + half + Vec3::Z * height_m,
            0.011,
            texture,
        ));
    }
    elements
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sky_is_bluer_above_than_at_the_horizon() {
        let sun = Vec3::new(-0.5, -0.4, 0.8).normalize();
        // Averaged over azimuth, so that no single cloud decides.
        let blueness = |height: f32| -> f32 {
            (0..64)
                .map(|i| {
                    let azimuth = i as f32 / 64.0 * std::f32::consts::TAU;
                    let ring = (1.0 - height * height).sqrt();
                    let color = clear_sky(
                        Vec3::new(ring * azimuth.cos(), ring * azimuth.sin(), height),
                        sun,
                        1,
                    );
                    color.z - color.x
                })
                .sum()
        };
        assert!(blueness(0.8) > 2.0 * blueness(0.02));
    }
}
