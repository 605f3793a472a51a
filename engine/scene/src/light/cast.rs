//! Cast shadows: the ground from which the box of an agent keeps the sun or a lamp.

use glam::{DMat2, DQuat, DVec2, DVec3};

use crate::light::GroundShadow;
use crate::light::environment::shown_loss;
use crate::{Invalid, Pose};

/// [`GroundShadow::sharpness`] of a cast shadow: dark within, with a soft edge.
const SHARPNESS: u32 = 3;

/// Decay at which the mask of that sharpness, summed over the ground, is as large as its rectangle:
/// `(3.708 Γ(5/4) / 4)⁴`, 3.708 being the area of the super-ellipse.
const DECAY: f64 = 0.498;

/// Sine of the elevation below which a light casts no shadow: it would be longer than the road.
pub(super) const SINE_MIN: f64 = 0.05;

/// Longest shadow away from its box, meters.
const LENGTH_MAX_M: f64 = 12.0;

/// Width of an agent's body over that of its box, which has the mirrors too: 0.86 to 0.89 of
/// passenger cars by their makers' data sheets.
const BODY_WIDTH: f64 = 0.87;

/// Share of the light below which a light casts no shadow that anybody sees.
const SHARE_MIN: f64 = 0.05;

/// Lights that cast shadows of one agent: those that give most.
const LIGHTS_MAX: usize = 4;

/// Lights of a scene that cast shadows of agents on the ground. The background does not tell them
/// reliably, so the scene says them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CastingLights {
    /// The sun; `None`: it does not shine.
    pub sun: Option<Sun>,
    /// Lit street lamps.
    pub lamps: Lamps,
}

/// The sun.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sun {
    /// Direction towards it, world coordinates, any length above 0; z is up.
    pub towards: DVec3,
    /// Share that it has in the light on open level ground, linear, above 0, below 1: about 0.8
    /// with a high sun in a clear sky, 0.5 with a low one, less in haze.
    pub share: f64,
}

impl Sun {
    /// Checks the sun and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let Self { towards, share } = *self;
        if !(towards.is_finite() && towards.length() > 1e-6) {
            return Err(Invalid::new(format!(
                "towards is {towards}; expected a finite direction of any length above 0"
            )));
        }
        if !(share > 0.0 && share < 1.0) {
            return Err(Invalid::new(format!(
                "share is {share}; expected a number above 0 and below 1"
            )));
        }
        Ok(())
    }
}

/// Street lamps that are lit, all alike.
#[derive(Clone, Debug, PartialEq)]
pub struct Lamps {
    /// Positions of the lamps, world coordinates, meters.
    pub positions: Vec<DVec3>,
    /// Distance at which a lamp straight above gives the ground as much light as the sky does,
    /// meters.
    pub range_m: f64,
}

impl Default for Lamps {
    fn default() -> Self {
        Self {
            positions: Vec::new(),
            range_m: 30.0,
        }
    }
}

impl Lamps {
    /// Light on level ground from a lamp that is `to_lamp` away, meters, over that of one straight
    /// above at its range. None from a lamp below.
    pub(super) fn arriving(&self, to_lamp: DVec3) -> f64 {
        let range_m = self.range_m;
        match to_lamp.z > 0.0 {
            true => range_m * range_m * to_lamp.z / to_lamp.length().powi(3),
            false => 0.0,
        }
    }

    /// Checks the lamps and describes the first fault.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        if let Some(position) = self.positions.iter().find(|position| !position.is_finite()) {
            return Err(Invalid::new(format!(
                "places holds {position}; expected finite coordinates"
            )));
        }
        let range_m = self.range_m;
        if !(range_m.is_finite() && range_m > 0.0) {
            return Err(Invalid::new(format!(
                "range_m is {range_m}; expected a number of meters above zero"
            )));
        }
        Ok(())
    }
}

/// A light as it arrives at one position.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Arriving {
    /// Light from afar: a unit vector towards it.
    Sun(DVec3),
    /// Light from a lamp at this position.
    Lamp(DVec3),
}

impl CastingLights {
    /// True if nothing casts a shadow.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.sun.is_none() && self.lamps.positions.is_empty()
    }

    /// Shadows that an agent of size `dims_m` at `world_from_agent` casts on the ground under it,
    /// and the share that the sky has in the light there. `sunlit` is the share of the agent that
    /// the sun reaches. Splats farther than `slab_m` from the ground's plane are not darkened.
    pub(super) fn shadows(
        &self,
        world_from_agent: &Pose,
        dims_m: [f32; 3],
        sunlit: f64,
        slab_m: f64,
    ) -> (Vec<GroundShadow>, f64) {
        let position = world_from_agent.translation;
        // In units of the light of the sky.
        let mut lights = Vec::new();
        if let Some(Sun { towards, share }) = self.sun {
            let towards = towards.normalize();
            // A sun that casts no shadow takes nothing from the contact shadow either.
            if sunlit > 0.0 && towards.z >= SINE_MIN {
                lights.push((Arriving::Sun(towards), sunlit * share / (1.0 - share)));
            }
        }
        let lamps = self.lamps.positions.iter().filter_map(|&lamp| {
            let arriving = self.lamps.arriving(lamp - position);
            (arriving > 0.0).then_some((Arriving::Lamp(lamp), arriving))
        });
        lights.extend(lamps);
        let sum: f64 = 1.0 + lights.iter().map(|(_, arriving)| arriving).sum::<f64>();
        lights.sort_by(|a, b| b.1.total_cmp(&a.1));
        let cast = lights
            .iter()
            .take(LIGHTS_MAX)
            .filter_map(|&(light, arriving)| {
                let share = arriving / sum;
                // Faint shadows fade, so that none appears at once where a car drives.
                let shown = (share / SHARE_MIN - 1.0).clamp(0.0, 1.0);
                let shadow = || shadow_of(light, world_from_agent, dims_m, shown * share, slab_m);
                (shown > 0.0).then(shadow).flatten()
            });
        (cast.collect(), 1.0 / sum)
    }
}

/// Shadow on level ground of a light that has the share `share` in it, linear; `None` where the
/// light is too low.
///
/// The box sweeps an area from its footprint to the shadow of its top, a hexagon. The shadow is the
/// super-ellipse along the principal axes of that area, with its size.
fn shadow_of(
    light: Arriving,
    world_from_agent: &Pose,
    dims_m: [f32; 3],
    share: f64,
    slab_m: f64,
) -> Option<GroundShadow> {
    let [length_m, width_m, height_m] = dims_m.map(|size| f64::from(size).max(1e-3));
    let ground = world_from_agent.then(&Pose {
        translation: DVec3::new(0.0, 0.0, -0.5 * height_m),
        ..Pose::IDENTITY
    });
    let into_ground = ground.rotation.normalize().inverse();
    let (offset_m, growth) = match light {
        Arriving::Sun(towards) => {
            let towards = into_ground * towards;
            if towards.z < SINE_MIN {
                return None;
            }
            (-towards.truncate() / towards.z * height_m, 1.0)
        }
        Arriving::Lamp(position) => {
            let lamp = into_ground * (position - ground.translation);
            let above_m = lamp.z - height_m;
            if above_m < SINE_MIN * lamp.length() {
                return None;
            }
            // The shadow of the top is larger than the top; in the mean half as much.
            let growth = 1.0 + 0.5 * height_m / above_m;
            (-lamp.truncate() / above_m * height_m, growth.min(2.0))
        }
    };
    let offset_m = offset_m.clamp_length_max(LENGTH_MAX_M);
    let sides = [
        DVec2::X * length_m * growth,
        DVec2::Y * width_m * BODY_WIDTH * growth,
        offset_m,
    ];
    // Twelve times the second moments of the sum of three uniform segments.
    let moments: DMat2 = sides
        .iter()
        .map(|side| DMat2::from_cols(side.x * *side, side.y * *side))
        .fold(DMat2::ZERO, |sum, moments| sum + moments);
    let turn_rad = 0.5 * (2.0 * moments.x_axis.y).atan2(moments.x_axis.x - moments.y_axis.y);
    let axis = DVec2::from_angle(turn_rad);
    let half_size_m = [axis, axis.perp()]
        .map(|axis| 0.5 * sides.iter().map(|side| side.dot(axis).abs()).sum::<f64>());
    let [first, second, third] = sides;
    let area_m2 =
        first.perp_dot(second).abs() + first.perp_dot(third).abs() + second.perp_dot(third).abs();
    let scale = (area_m2 / (4.0 * half_size_m[0] * half_size_m[1])).sqrt();
    Some(GroundShadow {
        world_from_ground: ground.then(&Pose {
            rotation: DQuat::from_rotation_z(turn_rad),
            translation: (0.5 * offset_m).extend(0.0),
        }),
        half_size_m: half_size_m.map(|half_m| half_m * scale),
        strength: shown_loss(share),
        decay: DECAY,
        sharpness: SHARPNESS,
        slab_m,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAR_M: [f32; 3] = [4.5, 1.9, 1.5];

    /// True if the way from the ground at `at` towards `towards`, up to `length` of its lengths,
    /// leads through the body of an agent.
    fn is_hidden(pose: &Pose, at: DVec3, towards: DVec3, length: f64) -> bool {
        let into_box = pose.rotation.inverse();
        let from = into_box * (at - pose.translation);
        let along = into_box * towards;
        let mut half = DVec3::from_array(CAR_M.map(|size| 0.5 * f64::from(size)));
        half.y *= BODY_WIDTH;
        let (a, b) = ((-half - from) / along, (half - from) / along);
        let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
        far > near.max(0.0) && near < length
    }

    /// Area by which the mask of `shadow` departs from the ground that a light really is hidden
    /// from, and the area of the mask, both over the true area.
    fn compare(shadow: &GroundShadow, hidden: impl Fn(DVec3) -> bool) -> (f64, f64) {
        let (mut off, mut masked, mut truth) = (0.0, 0.0, 0.0);
        for i in -150..=150 {
            for j in -150..=150 {
                let at = DVec3::new(0.1 * f64::from(i), 0.1 * f64::from(j), 0.0);
                let mask = (1.0 - shadow.factor(at)) / shadow.strength;
                let hidden = f64::from(u8::from(hidden(at)));
                off += (mask - hidden).abs();
                masked += mask;
                truth += hidden;
            }
        }
        (off / truth, masked / truth)
    }

    fn standing(yaw_rad: f64) -> Pose {
        Pose::from_yaw(yaw_rad, DVec3::new(0.0, 0.0, 0.75))
    }

    fn only(lights: &CastingLights, pose: &Pose) -> GroundShadow {
        let (shadows, _) = lights.shadows(pose, CAR_M, 1.0, 0.15);
        let [shadow] = shadows[..] else {
            panic!("{} shadows", shadows.len());
        };
        shadow.check().unwrap();
        shadow
    }

    fn sun(towards: DVec3) -> CastingLights {
        CastingLights {
            sun: Some(Sun {
                towards,
                share: 0.7,
            }),
            ..CastingLights::default()
        }
    }

    fn lamp(position: DVec3) -> CastingLights {
        CastingLights {
            sun: None,
            lamps: Lamps {
                positions: vec![position],
                ..Lamps::default()
            },
        }
    }

    /// The super-ellipse lies where rays say that the sun is hidden, at any heading. A shadow on
    /// the other side of the car is the case that must fail.
    #[test]
    fn a_cast_shadow_lies_where_the_sun_is_hidden() {
        let mut worst = (0.0f64, 0.0f64);
        for step in 0..12 {
            let pose = standing(0.55 * f64::from(step));
            let elevation_rad: f64 = [0.35, 0.7, 1.1][step as usize % 3];
            let towards = DVec3::new(elevation_rad.cos(), 0.0, elevation_rad.sin());
            let hidden = |at| is_hidden(&pose, at, towards, f64::INFINITY);
            let shadow = only(&sun(3.0 * towards), &pose);
            let (off, area) = compare(&shadow, hidden);
            worst = (worst.0.max(off), worst.1.max((area - 1.0).abs()));
            if elevation_rad < 1.0 {
                let mirrored = only(&sun(towards * DVec3::new(-1.0, 1.0, 1.0)), &pose);
                assert!(compare(&mirrored, hidden).0 > 0.6, "heading {step}");
            }
        }
        println!("cast by a sun: {worst:.2?} of the area");
        assert!(worst.0 < 0.4 && worst.1 < 0.03, "{worst:?}");
    }

    #[test]
    fn a_lamp_casts_a_shadow_away_from_it() {
        for (x, y) in [(5.0, 2.0), (-3.0, 6.0), (9.0, 0.0)] {
            let (pose, position) = (standing(0.4), DVec3::new(x, y, 7.0));
            let hidden = |at: DVec3| is_hidden(&pose, at, position - at, 1.0);
            let (off, area) = compare(&only(&lamp(position), &pose), hidden);
            assert!(off < 0.4 && (area - 1.0).abs() < 0.2, "{off} {area}");
            let mirrored = lamp(DVec3::new(-x, -y, 7.0));
            assert!(compare(&only(&mirrored, &pose), hidden).0 > 0.6);
        }
    }

    #[test]
    fn what_lights_give_adds_up() {
        let pose = standing(0.0);
        let high = DVec3::new(0.6, 0.0, 0.8);
        let strength = |lights: &CastingLights, sunlit: f64| {
            let (shadows, sky) = lights.shadows(&pose, CAR_M, sunlit, 0.15);
            (
                shadows
                    .iter()
                    .map(|shadow| shadow.strength)
                    .collect::<Vec<_>>(),
                sky,
            )
        };
        // A full shadow leaves the light of the sky.
        let (cast, sky) = strength(&sun(high), 1.0);
        assert!((sky - 0.3).abs() < 1e-12);
        assert!(((1.0 - cast[0]).powf(2.2) - 0.3).abs() < 1e-12);
        // In the shade of a house there is but the sky, and so there is under a sun on the horizon.
        assert_eq!(strength(&sun(high), 0.0), (vec![], 1.0));
        let low = sun(DVec3::new(1.0, 0.0, 0.02));
        assert_eq!(strength(&low, 1.0), (vec![], 1.0));
        assert_eq!(strength(&CastingLights::default(), 1.0), (vec![], 1.0));
        // A lamp straight above at its range is as bright as the sky, at twice that a quarter.
        let lamps = Lamps::default();
        let above = |distance_m: f64| lamp(pose.translation + DVec3::Z * distance_m);
        assert!((strength(&above(lamps.range_m), 1.0).1 - 0.5).abs() < 1e-12);
        assert!((strength(&above(2.0 * lamps.range_m), 1.0).1 - 0.8).abs() < 1e-12);
        assert_eq!(
            strength(&above(6.0 * lamps.range_m), 1.0).0,
            vec![],
            "3 % of the light"
        );
        // Of many lamps the brightest count.
        let many = CastingLights {
            lamps: Lamps {
                positions: (0..9)
                    .map(|at| DVec3::new(f64::from(at), 4.0, 7.0))
                    .collect(),
                ..lamps
            },
            ..sun(high)
        };
        assert_eq!(strength(&many, 1.0).0.len(), LIGHTS_MAX);
    }

    #[test]
    fn what_is_no_light_is_named() {
        let of_sun = |towards: DVec3, share: f64| Sun { towards, share }.check();
        of_sun(DVec3::Z, 0.5).unwrap();
        let reason = |checked: Result<(), Invalid>| checked.unwrap_err().reason().to_owned();
        assert!(reason(of_sun(DVec3::ZERO, 0.5)).starts_with("towards is"));
        assert!(reason(of_sun(DVec3::Z, 1.0)).starts_with("share is 1;"));
        Lamps::default().check().unwrap();
        assert!(reason(lamp(DVec3::NAN).lamps.check()).starts_with("places holds"));
        let dark = Lamps {
            range_m: 0.0,
            ..Lamps::default()
        };
        assert!(reason(dark.check()).starts_with("range_m is 0;"));
    }
}
