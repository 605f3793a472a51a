//! A sunny afternoon, baked: sun with cast shadows, sky, bounce from the ground, and the dark under parked cars.

use glam::{Vec2, Vec3};

use super::random::{Stream, smoothstep};
use super::surface::Texel;

/// Linear RGB of the air between here and far away.
const HAZE: Vec3 = Vec3::new(0.56, 0.66, 0.78);

/// Width of the cells in which occluders are looked up, metres.
const CELL_M: f32 = 8.0;

/// Cells a side; the grid is centred on the origin, and nothing outside of it casts a shadow.
const CELLS: i32 = 64;

/// Half the spread of the directions in which shadow rays leave, radians: wider than the sun, for penumbras that
/// splats of some centimetres can show.
const PENUMBRA_RAD: f32 = 0.012;

/// Something that stands in the sun's way.
#[derive(Clone, Copy, Debug)]
pub(super) enum Occluder {
    /// A house.
    Box { min: Vec3, max: Vec3 },
    /// A car: a box that also darkens the ground about it.
    Car { min: Vec3, max: Vec3 },
    /// The crown of a tree, through which some light comes.
    Crown { centre: Vec3, radii: Vec3 },
}

impl Occluder {
    fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Self::Box { min, max } | Self::Car { min, max } => (min, max),
            Self::Crown { centre, radii } => (centre - radii, centre + radii),
        }
    }

    /// Share of the light along the ray that passes.
    fn transmittance(&self, from: Vec3, direction: Vec3) -> f32 {
        match *self {
            Self::Box { min, max } | Self::Car { min, max } => {
                let (near, far) = slab(min - from, max - from, direction);
                if far > near.max(0.0) { 0.0 } else { 1.0 }
            }
            Self::Crown { centre, radii } => {
                let (offset, ray) = ((from - centre) / radii, direction / radii);
                let (a, b, c) = (ray.length_squared(), offset.dot(ray), offset.length_squared() - 1.0);
                let discriminant = b * b - a * c;
                if discriminant <= 0.0 {
                    return 1.0;
                }
                let root = discriminant.sqrt();
                let inside_m = ((-b + root) / a).max(0.0) - ((-b - root) / a).max(0.0);
                (-0.85 * inside_m).exp()
            }
        }
    }
}

/// Where the ray from the origin enters and leaves the box.
fn slab(min: Vec3, max: Vec3, direction: Vec3) -> (f32, f32) {
    let inverse = direction.recip();
    let (a, b) = (min * inverse, max * inverse);
    (a.min(b).max_element(), a.max(b).min_element())
}

/// The light of the street, or of one asset under an open sky.
#[derive(Debug)]
pub(super) struct Light {
    /// Unit, towards the sun.
    pub towards_sun: Vec3,
    occluders: Vec<Occluder>,
    /// Occluders whose shadow can fall into each cell.
    shading: Vec<Vec<u16>>,
}

impl Light {
    /// Light from the sun in direction `towards_sun` past `occluders`.
    pub(super) fn new(towards_sun: Vec3, occluders: Vec<Occluder>) -> Self {
        let towards_sun = towards_sun.normalize_or(Vec3::Z);
        let mut shading = vec![Vec::new(); if occluders.is_empty() { 0 } else { (CELLS * CELLS) as usize }];
        for (index, occluder) in occluders.iter().enumerate() {
            let (min, max) = occluder.bounds();
            // Down to the ground, the shadow reaches this far the other way.
            let reach = -towards_sun.truncate() / towards_sun.z.max(0.1) * max.z;
            let margin = Vec2::splat(1.5);
            let low = min.truncate().min(min.truncate() + reach) - margin;
            let high = max.truncate().max(max.truncate() + reach) + margin;
            let ((i0, j0), (i1, j1)) = (cell_of(low), cell_of(high));
            for j in j0.max(0)..=j1.min(CELLS - 1) {
                for i in i0.max(0)..=i1.min(CELLS - 1) {
                    shading[(j * CELLS + i) as usize].push(index as u16);
                }
            }
        }
        Self { towards_sun, occluders, shading }
    }

    fn near(&self, position: Vec3) -> impl Iterator<Item = &Occluder> {
        let (i, j) = cell_of(position.truncate());
        let inside = !self.shading.is_empty() && (0..CELLS).contains(&i) && (0..CELLS).contains(&j);
        let cell: &[u16] = if inside { &self.shading[(j * CELLS + i) as usize] } else { &[] };
        cell.iter().map(|&index| &self.occluders[usize::from(index)])
    }

    /// Share of the sun that reaches a point.
    fn sunlit(&self, position: Vec3, random: &mut Stream) -> f32 {
        let direction = self.towards_sun + PENUMBRA_RAD * random.signed3();
        let mut passing = 1.0;
        for occluder in self.near(position) {
            passing *= occluder.transmittance(position, direction);
            if passing < 0.01 {
                return 0.0;
            }
        }
        passing
    }

    /// Share of the sky that parked cars leave to a point near the ground.
    fn open_sky(&self, position: Vec3) -> f32 {
        if position.z > 0.3 {
            return 1.0;
        }
        self.near(position).fold(1.0, |open, occluder| match *occluder {
            Occluder::Car { min, max } => {
                let outside = (min - position).max(position - max).truncate();
                let distance_m = outside.max(Vec2::ZERO).length() + outside.max_element().min(0.0);
                open * (0.22 + 0.78 * smoothstep(-0.35, 0.75, distance_m))
            }
            _ => open,
        })
    }

    /// Display-referred RGB in [0, 1] of a texel at `position` that faces `normal`.
    pub(super) fn shade(&self, texel: &Texel, position: Vec3, normal: Vec3, random: &mut Stream) -> Vec3 {
        let linear = texel.emitted.unwrap_or_else(|| {
            let facing = normal.dot(self.towards_sun);
            let wrapped = facing.max(0.0).max(texel.translucency * (0.55 + 0.45 * facing.abs()));
            let sunlit = if wrapped > 0.0 { self.sunlit(position + normal * 0.04, random) } else { 0.0 };
            let open = texel.openness * self.open_sky(position);
            let sun = Vec3::new(1.0, 0.92, 0.78) * (1.35 * wrapped * sunlit);
            let sky = Vec3::new(0.31, 0.37, 0.47) * (0.5 + 0.5 * normal.z) + Vec3::new(0.2, 0.185, 0.16) * (0.5 - 0.5 * normal.z);
            texel.albedo * (sun + sky * open)
        });
        to_display(linear.lerp(HAZE, texel.haze))
    }
}

fn cell_of(position: Vec2) -> (i32, i32) {
    let cell = (position / CELL_M).floor() + 0.5 * CELLS as f32;
    (cell.x as i32, cell.y as i32)
}

/// Linear RGB as it is displayed, with a shoulder instead of a clip above 0.8.
fn to_display(linear: Vec3) -> Vec3 {
    linear.max(Vec3::ZERO).map(|value| {
        let encoded = value.powf(1.0 / 2.2);
        if encoded <= 0.8 { encoded } else { 0.8 + 0.2 * (1.0 - (-(encoded - 0.8) / 0.2).exp()) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light() -> Light {
        let house = Occluder::Box { min: Vec3::new(-5.0, 2.0, 0.0), max: Vec3::new(5.0, 8.0, 10.0) };
        let crown = Occluder::Crown { centre: Vec3::new(40.0, 5.0, 5.0), radii: Vec3::splat(2.0) };
        let car = Occluder::Car { min: Vec3::new(-42.0, -1.0, 0.0), max: Vec3::new(-38.0, 1.0, 1.5) };
        Light::new(Vec3::new(0.0, 1.0, 1.0), vec![house, crown, car])
    }

    #[test]
    fn shadows_fall_away_from_the_sun() {
        let light = light();
        let sunlit = |x: f32, y: f32| light.sunlit(Vec3::new(x, y, 0.0), &mut Stream::new(1, 1, 1));
        assert_eq!(sunlit(0.0, -3.0), 0.0, "ten metres of house shade as much ground at 45 degrees");
        assert_eq!(sunlit(0.0, -9.5), 1.0);
        assert_eq!(sunlit(0.0, 9.0), 1.0, "the sunny side");
        let dappled = sunlit(40.0, 0.0);
        assert!(dappled > 0.0 && dappled < 0.2, "{dappled}");
    }

    #[test]
    fn the_ground_is_dark_under_a_car_and_open_away_from_it() {
        let light = light();
        let open = |x: f32| light.open_sky(Vec3::new(x, 0.0, 0.0));
        assert!(open(-40.0) < 0.3 && open(-37.7) > 0.3 && open(-37.7) < 0.9);
        assert_eq!(open(-36.5), 1.0);
    }

    #[test]
    fn display_values_stay_in_range_and_keep_their_order() {
        let values: Vec<f32> = (0..100).map(|i| to_display(Vec3::splat(i as f32 * 0.05)).x).collect();
        assert!(values.windows(2).all(|pair| pair[0] < pair[1] || pair[1] > 0.999));
        assert!(values.iter().all(|value| (0.0..=1.0).contains(value)));
    }
}
