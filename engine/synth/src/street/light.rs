//! Light, baked: the sun with cast shadows, the sky, bounce from the ground, street lamps, and the
//! dark under cars.

use decouplegs_scene::light::{CastingLights, Lamps, Sun, luminance};
use glam::{Quat, Vec2, Vec3};

use super::occluder::Occluder;
use super::random::{Stream, smoothstep};
use super::surface::Texel;
use super::weather::{Air, TOWARDS_SUN, TOWARDS_SUN_ASSET};

/// Width of the cells in which occluders are looked up, meters.
const CELL_M: f32 = 8.0;

/// Cells a side; the grid is centered on the origin, and nothing outside of it casts a shadow.
const CELLS: i32 = 64;

/// Half the spread of the directions in which shadow rays leave, radians: wider than the sun, for
/// penumbras that splats of some centimeters can show.
const PENUMBRA_RAD: f32 = 0.012;

/// Half the size of what shines in a street lamp, meters: larger than life, for the same reason.
const LAMP_HALF_M: f32 = 0.25;

/// Range of the light of a street lamp, meters.
const LAMP_RANGE_M: f32 = 32.0;

/// Longest shadow of a car or a tree crown away from a lamp, meters.
const LAMP_SHADOW_M: f32 = 7.0;

/// Share of a lamp's light that comes back from what it shines on, to faces turned away from it as
/// well.
const LAMP_BOUNCE: f32 = 0.06;

/// The light of the street, or of one asset under an open sky.
#[derive(Debug)]
pub(super) struct Light {
    /// Unit, towards the sun.
    towards_sun: Vec3,
    air: Air,
    occluders: Vec<Occluder>,
    /// Occluders whose shadow can fall into each cell.
    shading: Vec<Vec<u32>>,
    /// Positions of the street lamps' lights.
    lamps: Vec<Vec3>,
    /// World from what is lit.
    rotation: Quat,
    translation: Vec3,
    /// The sun by whose side of a face random numbers are drawn, in the frame of what is lit.
    /// Splats and their noise are then the same in any light.
    drawn_by: Vec3,
}

/// Texel after lighting.
pub(super) struct Lit {
    /// Display-referred RGB in [0, 1].
    pub color: Vec3,
    /// Mirrored share of the sun, per channel.
    pub sheen: Vec3,
}

impl Light {
    /// The light of `air` past `occluders` on what is placed in the world already.
    pub(super) fn new(air: Air, occluders: Vec<Occluder>) -> Self {
        let towards_sun = air.towards_sun.normalize_or(Vec3::Z);
        let lamplit = air.lamp != Vec3::ZERO;
        let mut shading = vec![
            Vec::new();
            if occluders.is_empty() {
                0
            } else {
                (CELLS * CELLS) as usize
            }
        ];
        for (index, occluder) in occluders.iter().enumerate() {
            let (min, max) = occluder.bounds();
            // Down to the ground, the shadow reaches this far the other way.
            let shadow = -towards_sun.truncate() / towards_sun.z.max(0.1) * max.z;
            let margin = Vec2::splat(if lamplit { LAMP_SHADOW_M } else { 1.5 });
            let low = min.truncate().min(min.truncate() + shadow) - margin;
            let high = max.truncate().max(max.truncate() + shadow) + margin;
            let ((i0, j0), (i1, j1)) = (cell_of(low), cell_of(high));
            for j in j0.max(0)..=j1.min(CELLS - 1) {
                for i in i0.max(0)..=i1.min(CELLS - 1) {
                    shading[(j * CELLS + i) as usize].push(index as u32);
                }
            }
        }
        let (rotation, translation) = (Quat::IDENTITY, Vec3::ZERO);
        let drawn_by = TOWARDS_SUN.normalize_or(Vec3::Z);
        Self {
            towards_sun,
            air,
            occluders,
            shading,
            lamps: Vec::new(),
            rotation,
            translation,
            drawn_by,
        }
    }

    /// The lights that cast shadows on open ground, as a scene tells them.
    pub(super) fn casting(&self) -> CastingLights {
        let luminance = |rgb: Vec3| luminance(rgb.as_dvec3().to_array());
        // What a file shows is no longer than it needs to be.
        let rounded = |at: Vec3| (at.as_dvec3() * 1e6).round() / 1e6;
        let air = &self.air;
        let sky = luminance(air.sky);
        let sun = luminance(air.sun * air.sun_strength * self.towards_sun.z);
        CastingLights {
            sun: (sun > 0.0).then(|| Sun {
                towards: rounded(self.towards_sun),
                share: (sun / (sun + sky) * 1e6).round() / 1e6,
            }),
            lamps: match self.lamps[..] {
                [] => Lamps::default(),
                _ => Lamps {
                    positions: self.lamps.iter().copied().map(rounded).collect(),
                    range_m: f64::from(LAMP_RANGE_M).min((luminance(air.lamp) / sky).sqrt()),
                },
            },
        }
    }

    /// Adds street lamps at `lamps`.
    pub(super) fn with_lamps(self, lamps: Vec<Vec3>) -> Self {
        Self { lamps, ..self }
    }

    /// Light on an asset that stands at `rotation` and `translation`, while its splats are made in
    /// its own frame.
    pub(super) fn on_asset(self, rotation: Quat, translation: Vec3) -> Self {
        Self {
            rotation,
            translation,
            drawn_by: TOWARDS_SUN_ASSET.normalize_or(Vec3::Z),
            ..self
        }
    }

    /// Unit, towards the sun in the frame of what is lit.
    pub(super) fn towards_sun(&self) -> Vec3 {
        self.rotation.inverse() * self.towards_sun
    }

    fn near(&self, position: Vec3) -> impl Iterator<Item = &Occluder> {
        let (i, j) = cell_of(position.truncate());
        let inside = !self.shading.is_empty() && (0..CELLS).contains(&i) && (0..CELLS).contains(&j);
        let cell: &[u32] = if inside {
            &self.shading[(j * CELLS + i) as usize]
        } else {
            &[]
        };
        cell.iter().map(|&index| &self.occluders[index as usize])
    }

    /// Share of the light from `length` lengths of `direction` away that arrives.
    fn passing(&self, position: Vec3, direction: Vec3, length: f32) -> f32 {
        let mut passing = 1.0;
        for occluder in self.near(position) {
            passing *= occluder.transmittance(position, direction, length);
            if passing < 0.01 {
                return 0.0;
            }
        }
        passing
    }

    /// Share of the sun that reaches a point. `spread` moves the ray within the penumbra.
    fn sunlit(&self, position: Vec3, spread: Vec3) -> f32 {
        if self.air.sun_strength == 0.0 {
            return 0.0;
        }
        self.passing(
            position,
            self.towards_sun + PENUMBRA_RAD * spread,
            f32::INFINITY,
        )
    }

    /// Share of the sky that cars leave to a point near the ground.
    fn open_sky(&self, position: Vec3) -> f32 {
        if position.z > 0.3 {
            return 1.0;
        }
        self.near(position)
            .fold(1.0, |open, occluder| open * occluder.open_sky(position))
    }

    /// Light of street lamps at a point, and its reflection from the surroundings.
    fn lamplight(
        &self,
        texel: &Texel,
        (position, normal): (Vec3, Vec3),
        open: f32,
        aside: &mut Stream,
    ) -> Vec3 {
        let (mut direct, mut around) = (0.0, 0.0);
        for lamp in &self.lamps {
            let to_lamp = *lamp + LAMP_HALF_M * aside.signed3() - position;
            let distance_m = to_lamp.length();
            if !(0.5..LAMP_RANGE_M).contains(&distance_m) {
                continue;
            }
            let direction = to_lamp / distance_m;
            // It hangs with its back to the sky, and its light ends softly.
            let shining = smoothstep(0.0, 0.75, direction.z)
                * (1.0 - (distance_m / LAMP_RANGE_M).powi(2)).powi(2);
            let arriving = shining / (distance_m * distance_m + 3.0);
            around += arriving;
            // Leaves let less of a single beam through than of the whole bright side of the sky.
            let facing = normal
                .dot(direction)
                .max(0.35 * wrapped(texel, normal.dot(direction)));
            if facing * arriving > 1e-5 {
                direct += arriving
                    * facing
                    * self.passing(position + normal * 0.04, direction, distance_m);
            }
        }
        self.air.lamp * (direct * (0.4 + 0.6 * open) + LAMP_BOUNCE * around * open)
    }

    /// Color of a texel at `position` that faces `normal`, both in the frame of the lit object.
    pub(super) fn shade(
        &self,
        texel: &Texel,
        position: Vec3,
        normal: Vec3,
        random: &mut Stream,
    ) -> Lit {
        let sheen = self.air.sheen * self.air.shaded_sheen;
        if let Some(emitted) = texel.emitted {
            return Lit {
                color: to_display(emitted.lerp(self.air.haze, texel.haze)),
                sheen,
            };
        }
        let mut aside = random.aside();
        let drawn = wrapped(texel, normal.dot(self.drawn_by)) > 0.0;
        let spread = if drawn {
            random.signed3()
        } else {
            aside.signed3()
        };

        let (position, normal) = (
            self.rotation * position + self.translation,
            self.rotation * normal,
        );
        let facing = wrapped(texel, normal.dot(self.towards_sun));
        let sunlit = if facing > 0.0 {
            self.sunlit(position + normal * 0.04, spread)
        } else {
            0.0
        };
        let open = texel.openness * self.open_sky(position);
        let air = &self.air;
        let sun = air.sun * (air.sun_strength * facing * sunlit);
        let sky = air.sky * (0.5 + 0.5 * normal.z) + air.bounce * (0.5 - 0.5 * normal.z);
        let mut linear = texel.albedo * (sun + sky * open);
        if !self.lamps.is_empty() {
            linear += texel.albedo * self.lamplight(texel, (position, normal), open, &mut aside);
        }
        linear += texel.glow * air.glow;
        Lit {
            color: to_display(linear.lerp(air.haze, texel.haze)),
            sheen: air.sheen * sunlit.max(air.shaded_sheen),
        }
    }
}

/// Share of the light from a direction that a face takes, from the cosine between them: leaves let
/// it through.
fn wrapped(texel: &Texel, facing: f32) -> f32 {
    facing
        .max(0.0)
        .max(texel.translucency * (0.55 + 0.45 * facing.abs()))
}

fn cell_of(position: Vec2) -> (i32, i32) {
    let cell = (position / CELL_M).floor() + 0.5 * CELLS as f32;
    (cell.x as i32, cell.y as i32)
}

/// Linear RGB as it is displayed, with a shoulder instead of a clip above 0.8.
fn to_display(linear: Vec3) -> Vec3 {
    linear.max(Vec3::ZERO).map(|value| {
        let encoded = value.powf(1.0 / 2.2);
        if encoded <= 0.8 {
            encoded
        } else {
            0.8 + 0.2 * (1.0 - (-(encoded - 0.8) / 0.2).exp())
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::street::weather::Weather;

    fn light(air: Air) -> Light {
        let house = Occluder::Box {
            min: Vec3::new(-5.0, 2.0, 0.0),
            max: Vec3::new(5.0, 8.0, 10.0),
        };
        let crown = Occluder::Crown {
            center: Vec3::new(40.0, 5.0, 5.0),
            radii: Vec3::splat(2.0),
        };
        let car = Occluder::Car {
            min: Vec3::new(-42.0, -1.0, 0.0),
            max: Vec3::new(-38.0, 1.0, 1.5),
        };
        Light::new(air, vec![house, crown, car])
    }

    fn sunny() -> Light {
        light(Air {
            towards_sun: Vec3::new(0.0, 1.0, 1.0),
            ..Air::for_weather(Weather::Clear)
        })
    }

    fn white_ground(light: &Light, x: f32, y: f32) -> Vec3 {
        light
            .shade(
                &Texel::matt(Vec3::splat(0.3)),
                Vec3::new(x, y, 0.0),
                Vec3::Z,
                &mut Stream::new(1, 1, 1),
            )
            .color
    }

    #[test]
    fn shadows_fall_away_from_the_sun() {
        let light = sunny();
        let sunlit =
            |x: f32, y: f32| light.sunlit(Vec3::new(x, y, 0.0), Stream::new(1, 1, 1).signed3());
        assert_eq!(
            sunlit(0.0, -3.0),
            0.0,
            "ten meters of house shade as much ground at 45 degrees"
        );
        assert_eq!(sunlit(0.0, -9.5), 1.0);
        assert_eq!(sunlit(0.0, 9.0), 1.0, "the sunny side");
        let dappled = sunlit(40.0, 0.0);
        assert!(dappled > 0.0 && dappled < 0.2, "{dappled}");
    }

    #[test]
    fn the_ground_is_dark_under_a_car_and_open_away_from_it() {
        let light = sunny();
        let open = |x: f32| light.open_sky(Vec3::new(x, 0.0, 0.0));
        assert!(open(-40.0) < 0.3 && open(-37.7) > 0.3 && open(-37.7) < 0.9);
        assert_eq!(open(-36.5), 1.0);
    }

    #[test]
    fn clouds_leave_no_cast_shadow_but_the_dark_under_a_car() {
        let (sunny, gray) = (sunny(), light(Air::for_weather(Weather::Overcast)));
        assert!(white_ground(&sunny, 0.0, -3.0).x < 0.7 * white_ground(&sunny, 0.0, -20.0).x);
        assert_eq!(
            white_ground(&gray, 0.0, -3.0),
            white_ground(&gray, 0.0, -20.0)
        );
        assert!(white_ground(&gray, -40.0, 0.0).x < 0.6 * white_ground(&gray, -30.0, 0.0).x);
        // Relative to open ground, what a car hides from the sun is darker than what it hides from
        // clouds.
        let below =
            |light: &Light| white_ground(light, -40.0, 0.0).x / white_ground(light, -30.0, 0.0).x;
        assert!(
            below(&sunny) < below(&gray) - 0.05,
            "{} and {}",
            below(&sunny),
            below(&gray)
        );
    }

    #[test]
    fn a_lamp_lights_what_is_below_it_warmly_and_a_car_throws_its_shadow() {
        let lamp = Vec3::new(-34.0, 0.0, 7.5);
        let lit = light(Air::for_weather(Weather::Night)).with_lamps(vec![lamp]);
        let (below, far) = (
            white_ground(&lit, -34.0, 0.0),
            white_ground(&lit, -34.0, 60.0),
        );
        assert!(
            below.x > 3.0 * far.x && below.x > 1.4 * below.z && far.z > far.x,
            "{below} and {far}"
        );
        assert!(
            white_ground(&lit, -34.0, 9.0).x < 0.9 * below.x,
            "it falls with distance"
        );
        // The car at -42 to -38 stands between the lamp and -42.6, and open ground is as far on the
        // other side.
        let (shaded, open) = (
            white_ground(&lit, -42.8, 0.0),
            white_ground(&lit, -25.2, 0.0),
        );
        assert!(shaded.x < 0.75 * open.x, "{shaded} and {open}");
    }

    #[test]
    fn neutral_light_shows_albedo() {
        let light = Light::new(
            Air::of_assets(super::super::weather::AssetLight::Neutral),
            vec![],
        )
        .on_asset(Quat::IDENTITY, Vec3::ZERO);
        for normal in [Vec3::Z, Vec3::NEG_Z, Vec3::X, Vec3::new(0.6, 0.0, -0.8)] {
            let texel = Texel {
                openness: 0.5,
                gloss: 1.0,
                ..Texel::matt(Vec3::new(0.4, 0.2, 0.1))
            };
            let lit = light.shade(&texel, Vec3::ZERO, normal, &mut Stream::new(1, 1, 1));
            assert!(
                (lit.color - to_display(texel.albedo * 0.5))
                    .abs()
                    .max_element()
                    < 1e-6
                    && lit.sheen == Vec3::ZERO
            );
        }
    }

    #[test]
    fn an_asset_is_lit_as_it_stands() {
        let light = || Light::new(Air::for_weather(Weather::Dusk), vec![]);
        let turn = Quat::from_rotation_z(2.1);
        let texel = Texel::matt(Vec3::splat(0.3));
        let shade = |light: &Light, normal: Vec3| {
            light
                .shade(&texel, Vec3::ZERO, normal, &mut Stream::new(1, 1, 1))
                .color
        };
        let turned = light().on_asset(turn, Vec3::new(5.0, 0.0, 0.7));
        for normal in [Vec3::X, Vec3::Y, Vec3::NEG_X] {
            assert!(
                (shade(&turned, normal) - shade(&light(), turn * normal))
                    .abs()
                    .max_element()
                    < 1e-5
            );
        }
        assert!((turn * turned.towards_sun() - light().towards_sun).length() < 1e-5);
    }

    #[test]
    fn display_values_stay_in_range_and_keep_their_order() {
        let values: Vec<f32> = (0..100)
            .map(|i| to_display(Vec3::splat(i as f32 * 0.05)).x)
            .collect();
        assert!(
            values
                .windows(2)
                .all(|pair| pair[0] < pair[1] || pair[1] > 0.999)
        );
        assert!(values.iter().all(|value| (0.0..=1.0).contains(value)));
    }
}
