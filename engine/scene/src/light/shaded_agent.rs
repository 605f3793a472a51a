//! Light on one agent of a scene, for each side of it.

use glam::{DMat3, DVec3};

use crate::Pose;
use crate::light::cast::SINE_MIN;
use crate::light::{
    GroundLight, LightFrom, Lighting, LitShare, SHADING_LIGHTS, Shading, to_linear,
};

/// Points of an agent's box whose light is asked for, in sizes of the box from its middle.
const POINTS: [[f64; 3]; 12] = {
    let mut points = [[0.0; 3]; 12];
    let (x, y, z) = ([-0.35, 0.0, 0.35], [-0.35, 0.35], [-0.2, 0.25]);
    let mut at = 0;
    while at < points.len() {
        points[at] = [x[at % 3], y[at / 3 % 2], z[at / 6]];
        at += 1;
    }
    points
};

impl Lighting {
    /// Light on an agent of size `dims_m` at `world_from_agent`, by the normals of its surface.
    /// `None` where the scene does not ask for it, or nothing tells of the light there.
    ///
    /// The sky and the direct light are those of [`Lighting::ground_light`] over the albedo of the
    /// ground. Where that tells nothing, all light is from the sky, as bright as the ground about
    /// the agent says.
    #[must_use]
    pub fn shading(&self, world_from_agent: &Pose, dims_m: [f32; 3]) -> Option<Shading> {
        if !self.relighting.by_normals {
            return None;
        }
        let position = world_from_agent.translation;
        let albedo = self.ground_albedo()?;
        let shown = self.field.at(position)?.mean();
        let ground = shown.map(|value| to_linear(f64::from(value)));
        let over_albedo = |color: [f64; 3], factor: f64| color.map(|value| factor * value / albedo);
        let into_agent = world_from_agent.rotation.normalize().inverse();
        let mut sources: Vec<(DVec3, [f64; 3])> = Vec::new();
        let mut first = LitShare::ALL;
        let mut sky = ground;
        if let Some(told) = &self.ground_light {
            sky = told.sky;
            let mut of_lamps = told.direct;
            if let Some(sun) = self.casting.sun {
                // Lamps by day are in units of the light of the sky.
                of_lamps = told.sky;
                let towards = sun.towards.normalize();
                if towards.z >= SINE_MIN {
                    first = self.sunlit_share(told, (world_from_agent, dims_m), towards);
                    sources.push((towards, over_albedo(told.direct, 1.0 / towards.z)));
                }
            }
            let lamps = &self.casting.lamps;
            let mut near: Vec<DVec3> = lamps
                .positions
                .iter()
                .map(|lamp| *lamp - position)
                .collect();
            near.retain(|to_lamp| to_lamp.z > 0.0);
            near.sort_by(|a, b| a.length_squared().total_cmp(&b.length_squared()));
            sources.extend(near.iter().take(SHADING_LIGHTS).map(|to_lamp| {
                let arriving = lamps.range_m.powi(2) / to_lamp.length_squared().max(1.0);
                (to_lamp.normalize(), over_albedo(of_lamps, arriving))
            }));
        }
        let mut lights = [LightFrom::default(); SHADING_LIGHTS];
        for (light, (towards, rgb)) in lights.iter_mut().zip(sources) {
            let towards = into_agent * towards;
            *light = LightFrom { towards, rgb };
        }
        Some(Shading {
            up: into_agent * DVec3::Z,
            sky: over_albedo(sky, 1.0),
            ground,
            lights,
            first,
            half_size_m: dims_m.map(|size_m| 0.5 * f64::from(size_m).max(1e-3)),
        })
    }

    /// Share of the sun in direction `towards` that reaches an agent of the given pose and size
    /// past the background.
    ///
    /// A ray from the sun that passes through the agent ends on the ground, which the background
    /// shows without agents: that ground is in the sun if this part of the agent is. Where no ray
    /// ends on ground, the background must leave the way to the sun open.
    fn sunlit_share(
        &self,
        told: &GroundLight,
        (world_from_agent, dims_m): (&Pose, [f32; 3]),
        towards: DVec3,
    ) -> LitShare {
        let size_m = DVec3::from_array(dims_m.map(f64::from));
        let ground_z = world_from_agent.translation.z - 0.5 * size_m.z;
        let mut shares: Vec<(DVec3, f64)> = Vec::new();
        for point in POINTS {
            let at = DVec3::from_array(point) * size_m;
            let from = world_from_agent.transform(at);
            let end = from - towards * ((from.z - ground_z) / towards.z);
            let (mut sunlit, mut all) = (0.0, 0.0);
            for patch in self.field.ground_at(end) {
                sunlit += patch.area_m2 * told.share(patch.color);
                all += patch.area_m2;
            }
            if all > 0.0 {
                shares.push((at, sunlit / all));
            }
        }
        match shares[..] {
            [] => LitShare {
                middle: self.field.open_share(world_from_agent, dims_m, towards),
                slope_per_m: DVec3::ZERO,
            },
            _ => plane_through(&shares),
        }
    }
}

/// The least squares of `share = middle + slope . position` over all positions. Where these do not
/// tell a slope, it is small.
fn plane_through(shares: &[(DVec3, f64)]) -> LitShare {
    let count = shares.len() as f64;
    let center = shares.iter().map(|(at, _)| *at).sum::<DVec3>() / count;
    let mean = shares.iter().map(|(_, share)| share).sum::<f64>() / count;
    let mut squares = DMat3::from_diagonal(DVec3::splat(0.01 * count));
    let mut products = DVec3::ZERO;
    for (at, share) in shares {
        let off = *at - center;
        squares += DMat3::from_cols(off * off.x, off * off.y, off * off.z);
        products += off * (share - mean);
    }
    let slope_per_m = squares.inverse() * products;
    LitShare {
        middle: mean - slope_per_m.dot(center),
        slope_per_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::{
        AmbientField, AmbientOptions, CastingLights, Lamps, RelightOptions, Sun, luminance,
        to_display,
    };
    use crate::{ShFrame, SplatCloud, sh};

    const SKY: [f64; 3] = [0.20, 0.19, 0.33];
    const SUN: [f64; 3] = [0.51, 0.25, 0.09];
    const DIMS_M: [f32; 3] = [4.5, 1.9, 1.5];

    /// Level ground of albedo 0.15, 40 m by 20 m, in `light` at x and y meters.
    fn over_ground(light: impl Fn(f64, f64) -> [f64; 3], casting: CastingLights) -> Lighting {
        let mut ground = SplatCloud::with_degree(0);
        for i in 0..160 {
            for j in 0..80 {
                let (x, y) = (0.25 * f64::from(i) - 19.9, 0.25 * f64::from(j) - 9.9);
                ground.means.push([x as f32, y as f32, 0.0]);
                ground.scales.push([0.1, 0.1, 0.001]);
                ground.rotations.push([1.0, 0.0, 0.0, 0.0]);
                ground.opacities.push(0.9);
                let shown = light(x, y).map(|value| to_display(0.15 * value));
                let dc = shown.map(|display| ((display - 0.5) / sh::Y0) as f32);
                ground.sh_dc.push(dc);
            }
        }
        let options = AmbientOptions::default();
        let field = AmbientField::new(&ground, ground.len(), DVec3::ZERO, &options);
        let way = (-18..=18).map(|x| DVec3::new(f64::from(x), 0.0, 0.75));
        let patches = field.ground_along(way, GroundLight::LANE_M);
        Lighting {
            ground_light: GroundLight::from_patches(&patches, &casting),
            field,
            transfer: None,
            relighting: RelightOptions {
                by_normals: true,
                ..RelightOptions::default()
            },
            shadows: None,
            casting,
        }
    }

    /// Sunny from x = 0 on.
    fn half_sunny(towards: DVec3) -> Lighting {
        let sunny: [f64; 3] = std::array::from_fn(|channel| SKY[channel] + SUN[channel]);
        let sun = Sun {
            towards,
            share: luminance(SUN) / luminance(sunny),
        };
        let casting = CastingLights {
            sun: Some(sun),
            ..CastingLights::default()
        };
        over_ground(|x, _| if x < 0.0 { SKY } else { sunny }, casting)
    }

    fn standing(x: f64) -> Pose {
        Pose::from_yaw(0.4, DVec3::new(x, 0.3, 0.75))
    }

    fn close(found: [f64; 3], expected: [f64; 3], share: f64) {
        let off = (0..3).map(|channel| (found[channel] / expected[channel] - 1.0).abs());
        let off = off.fold(0.0, f64::max);
        assert!(off < share, "{found:?} for {expected:?}");
    }

    #[test]
    fn agents_in_the_sun_and_in_the_shade_have_the_light_of_the_road() {
        let towards = DVec3::new(0.0, 0.6, 0.8);
        let lighting = half_sunny(towards);
        for (x, sunlit) in [(-8.0, 0.0), (0.0, 0.5), (8.0, 1.0)] {
            let pose = standing(x);
            let shading = lighting.shading(&pose, DIMS_M).unwrap();
            close(shading.sky, SKY, 0.03);
            let light = shading.lights[0];
            let towards_world = pose.rotation * light.towards;
            assert!(towards_world.distance(towards) < 1e-9);
            close(light.rgb, SUN.map(|value| value / 0.8), 0.03);
            let off = shading.first.at(DVec3::ZERO) - sunlit;
            assert!(off.abs() < 0.15, "{x}: {off}");
            if sunlit == 0.5 {
                let ends = [-2.0, 2.0].map(|along| shading.first.at(DVec3::X * along));
                assert!(ends[0] < 0.15 && ends[1] > 0.85, "{ends:?}");
            }
            // What lies open shows what the road shows, over its albedo.
            let up = pose.rotation.inverse() * DVec3::Z;
            if sunlit == 1.0 {
                let sunny = std::array::from_fn(|channel| SKY[channel] + SUN[channel]);
                close(shading.light(up, DVec3::ZERO), sunny, 0.03);
                close(shading.ground, sunny.map(|value| 0.15 * value), 0.03);
            }
            let lit = lighting.of_agent(&pose, DIMS_M, ShFrame::Canonical);
            assert!(lit.shading == Some(shading) && lit.relight.is_none() && lit.known);
        }
    }

    /// Rays of a low sun pass over ground in the sun before they end on ground in the shade: the
    /// ground below an agent does not tell.
    #[test]
    fn a_low_sun_reaches_an_agent_where_its_rays_would_end_in_the_sun() {
        let sunlit = |towards: DVec3, x: f64| {
            let shading = half_sunny(towards).shading(&standing(x), DIMS_M);
            shading.unwrap().first.at(DVec3::ZERO)
        };
        let low = DVec3::new(1.0, 0.0, 0.1);
        let (over_sun, over_shade) = (
            sunlit(low, 3.0),
            sunlit(low * DVec3::new(-1.0, 1.0, 1.0), -3.0),
        );
        assert!(over_sun < 0.2, "{over_sun}");
        assert!(over_shade > 0.8, "{over_shade}");
    }

    #[test]
    fn without_lights_the_sky_is_as_bright_as_the_road_here() {
        let dim = |x: f64| SKY.map(|value| value * (1.0 + 0.01 * x));
        let lighting = over_ground(|x, _| dim(x), CastingLights::default());
        assert!(lighting.ground_light.is_none());
        let shading = lighting.shading(&standing(6.0), DIMS_M).unwrap();
        close(shading.sky, dim(6.0), 0.02);
        assert_eq!(shading.lights, [LightFrom::default(); SHADING_LIGHTS]);
        assert!(lighting.shading(&standing(500.0), DIMS_M).is_none());
        let given = Lighting {
            relighting: RelightOptions {
                ground_albedo: Some(0.3),
                ..lighting.relighting
            },
            ..lighting
        };
        let shading = given.shading(&standing(6.0), DIMS_M).unwrap();
        close(shading.sky, dim(6.0).map(|value| 0.5 * value), 0.02);
        let off = Lighting {
            relighting: RelightOptions::default(),
            ..given
        };
        assert!(off.shading(&standing(6.0), DIMS_M).is_none());
    }

    #[test]
    fn the_nearest_lamps_shine_from_where_they_hang() {
        let night = [0.017, 0.021, 0.036];
        let lamp = [0.06, 0.04, 0.02];
        let lamps = Lamps {
            positions: [-12.0, 0.0, 12.0].map(|x| DVec3::new(x, 4.0, 7.0)).into(),
            range_m: 20.0,
        };
        let arriving = |x: f64, y: f64| -> f64 {
            let of_lamp = |at: &DVec3| lamps.arriving(*at - DVec3::new(x, y, 0.0));
            lamps.positions.iter().map(of_lamp).sum()
        };
        let light = |x: f64, y: f64| {
            let arriving = arriving(x, y);
            std::array::from_fn(|at| night[at] + arriving * lamp[at])
        };
        let casting = CastingLights {
            sun: None,
            lamps: lamps.clone(),
        };
        let lighting = over_ground(light, casting);
        let pose = standing(11.0);
        let shading = lighting.shading(&pose, DIMS_M).unwrap();
        let to_lamp = lamps.positions[2] - pose.translation;
        let nearest = shading.lights[0];
        assert!((pose.rotation * nearest.towards).distance(to_lamp.normalize()) < 1e-9);
        let arriving = 400.0 / to_lamp.length_squared();
        close(nearest.rgb, lamp.map(|value| arriving * value), 0.05);
        assert!(shading.lights[1].rgb[0] < 0.5 * nearest.rgb[0]);
        assert_eq!(shading.lights[3], LightFrom::default());
    }
}
