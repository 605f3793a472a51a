//! Shading by normals: each splat of an agent in the light that falls on its side of the agent.
//!
//! A matt surface of normal n shows `E(n) / pi` of the light times its albedo. Here E is that of a
//! sky above, a ground below, and lights from one side each (hemisphere lighting and Lambert's
//! cosine law). Assets are captured in white light from everywhere, where that factor is 1.

use glam::{DQuat, DVec3};

use crate::light::environment::GAMMA;
use crate::{SplatCloud, sh};

/// Lights from one side, at most: the strongest count.
pub const SHADING_LIGHTS: usize = 4;

/// Least light on a surface, linear: it shows 2 % of its captured color.
pub const LIGHT_MIN: f64 = 1e-4;

/// Power of the ratio of two scales of a splat by which the thinner axis counts more as its normal.
const THIN_EXPONENT: i32 = 8;

/// Light from one direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LightFrom {
    /// Unit vector towards it, in the agent's frame.
    pub towards: DVec3,
    /// `E / pi` on a surface that faces it, linear RGB.
    pub rgb: [f64; 3],
}

/// Light on an agent, for each normal of its surface. White light from everywhere is 1 per channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shading {
    /// Unit vector away from the ground, in the agent's frame.
    pub up: DVec3,
    /// `E / pi` on surfaces that face up, without the lights below, linear RGB.
    pub sky: [f64; 3],
    /// `E / pi` on surfaces that face down, linear RGB.
    pub ground: [f64; 3],
    /// Sun and lamps, the sun first; those that are not there give no light.
    pub lights: [LightFrom; SHADING_LIGHTS],
    /// Share of the first of these that reaches each position.
    pub first: LitShare,
    /// Half the length, width and height of the agent's box, meters: normals point out of it.
    pub half_size_m: [f64; 3],
}

/// Share of a light that reaches the positions of an agent past the background: a shadow's edge
/// may lie across it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LitShare {
    /// Share in the middle of the agent's box, 0 to 1.
    pub middle: f64,
    /// Change along each axis of the agent's frame, per meter.
    pub slope_per_m: DVec3,
}

impl LitShare {
    /// All of the light, everywhere.
    pub const ALL: Self = Self {
        middle: 1.0,
        slope_per_m: DVec3::ZERO,
    };

    /// The share at `mean_m`, 0 to 1.
    #[must_use]
    pub fn at(&self, mean_m: DVec3) -> f64 {
        (self.middle + self.slope_per_m.dot(mean_m)).clamp(0.0, 1.0)
    }
}

impl Shading {
    /// `E / pi` on a surface of unit normal `normal` at `mean_m`, agent's frame, linear RGB, at
    /// least [`LIGHT_MIN`].
    #[must_use]
    pub fn light(&self, normal: DVec3, mean_m: DVec3) -> [f64; 3] {
        let facing_up = 0.5 + 0.5 * normal.dot(self.up);
        let mut facing = self.lights.map(|light| normal.dot(light.towards).max(0.0));
        facing[0] *= self.first.at(mean_m);
        std::array::from_fn(|channel| {
            let around = facing_up * self.sky[channel] + (1.0 - facing_up) * self.ground[channel];
            let lights = self.lights.iter().zip(facing);
            let direct: f64 = lights
                .map(|(light, facing)| facing * light.rgb[channel])
                .sum();
            (around + direct).max(LIGHT_MIN)
        })
    }

    /// Factor on the displayed colors of a surface of unit normal `normal` at `mean_m`: the root of
    /// the light that displays show. The shoulder of the display near white is left out.
    #[must_use]
    pub fn gain(&self, normal: DVec3, mean_m: DVec3) -> [f64; 3] {
        self.light(normal, mean_m)
            .map(|light| light.powf(1.0 / GAMMA))
    }

    /// The splats of `cloud`, in the agent's frame, in this light.
    #[must_use]
    pub fn relit(&self, cloud: &SplatCloud) -> SplatCloud {
        let mut relit = cloud.clone();
        let stride = cloud.rest_stride();
        for splat in 0..cloud.len() {
            let mean_m = DVec3::from_array(cloud.means[splat].map(f64::from));
            let normal = shading_normal(
                cloud.scales[splat].map(f64::from),
                cloud.rotations[splat].map(f64::from),
                self.outward(mean_m),
            );
            let gain = self.gain(normal, mean_m);
            for (channel, gain) in gain.into_iter().enumerate() {
                let dc = &mut relit.sh_dc[splat][channel];
                *dc = (gain * (f64::from(*dc) + sh::DC_SHIFT) - sh::DC_SHIFT) as f32;
                for rest in &mut relit.sh_rest[splat * stride..(splat + 1) * stride] {
                    rest[channel] = (gain * f64::from(rest[channel])) as f32;
                }
            }
        }
        relit
    }

    /// Direction out of the agent at `mean_m`, of any length: the normal of the ellipsoid about
    /// the middle of its box that has the proportions of the box.
    #[must_use]
    pub fn outward(&self, mean_m: DVec3) -> DVec3 {
        let half_m = DVec3::from_array(self.half_size_m);
        mean_m / (half_m * half_m)
    }
}

/// Normal by which a splat is shaded, a unit vector: `outward` times the fourth power of the
/// inverse covariance. So a flat splat has its thinnest axis, on the side of `outward`; a needle
/// has the part of `outward` that is across it; a ball has `outward`. It changes steadily between
/// these.
#[must_use]
pub fn shading_normal(scales_m: [f64; 3], rotation: [f64; 4], outward: DVec3) -> DVec3 {
    let [w, x, y, z] = rotation;
    let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
    let thinnest_m = scales_m.into_iter().fold(f64::INFINITY, f64::min);
    let weight = |axis: usize| match scales_m[axis] {
        scale_m if scale_m > thinnest_m => (thinnest_m / scale_m).powi(THIN_EXPONENT),
        _ => 1.0,
    };
    let weights = DVec3::new(weight(0), weight(1), weight(2));
    let along = rotation.inverse() * outward.normalize_or(DVec3::Z);
    (rotation * (weights * along)).normalize_or(DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const NO_LIGHTS: [LightFrom; SHADING_LIGHTS] = [LightFrom {
        towards: DVec3::ZERO,
        rgb: [0.0; 3],
    }; SHADING_LIGHTS];

    fn even(rgb: [f64; 3]) -> Shading {
        Shading {
            up: DVec3::Z,
            sky: rgb,
            ground: rgb,
            lights: NO_LIGHTS,
            first: LitShare::ALL,
            half_size_m: [2.2, 0.9, 0.75],
        }
    }

    #[test]
    fn light_follows_the_side_that_a_surface_is_on() {
        let mut shading = even([0.0; 3]);
        shading.sky = [0.2, 0.3, 0.4];
        shading.ground = [0.04; 3];
        let towards = DVec3::new(0.6, 0.0, 0.8);
        shading.lights[2] = LightFrom {
            towards,
            rgb: [1.0, 0.5, 0.25],
        };
        let close = |found: [f64; 3], expected: [f64; 3]| {
            let off = (0..3).map(|channel| (found[channel] - expected[channel]).abs());
            assert!(off.fold(0.0, f64::max) < 1e-12, "{found:?} {expected:?}");
        };
        let light = |shading: &Shading, normal: DVec3| shading.light(normal, DVec3::X);
        close(light(&shading, DVec3::Z), [1.0, 0.7, 0.6]);
        close(light(&shading, DVec3::NEG_Z), [0.04; 3]);
        close(light(&shading, DVec3::X), [0.72, 0.47, 0.37]);
        close(light(&shading, DVec3::NEG_X), [0.12, 0.17, 0.22]);
        let factor = shading.gain(DVec3::NEG_Z, DVec3::X);
        close(factor, [0.04f64.powf(1.0 / 2.2); 3]);
        let dark = even([0.0; 3]);
        close(light(&dark, DVec3::Y), [LIGHT_MIN; 3]);
        // A shadow's edge lies across it: the front is in the sun.
        shading.lights.swap(0, 2);
        shading.first = LitShare {
            middle: 0.25,
            slope_per_m: DVec3::new(0.5, 0.0, 0.0),
        };
        for (x, share) in [(-2.0, 0.0), (0.0, 0.25), (1.0, 0.75), (2.0, 1.0)] {
            let found = shading.light(DVec3::Z, DVec3::new(x, 3.0, 1.0));
            close(
                found,
                [0.2 + 0.8 * share, 0.3 + 0.4 * share, 0.4 + 0.2 * share],
            );
        }
    }

    #[test]
    fn white_light_from_everywhere_shows_the_capture() {
        let cloud = ball_of_discs();
        let lit = even([1.0; 3]).relit(&cloud);
        assert_eq!(lit, cloud);
        let half = even([0.25; 3]).relit(&cloud);
        let plain = |cloud: &SplatCloud| f64::from(cloud.sh_dc[7][1]) + sh::DC_SHIFT;
        let factor = 0.25f64.powf(1.0 / 2.2);
        assert!((plain(&half) / plain(&cloud) - factor).abs() < 1e-6);
        let rest = f64::from(half.sh_rest[5][2] / cloud.sh_rest[5][2]);
        assert!((rest - factor).abs() < 1e-6);
        assert_eq!(half.means, cloud.means);
    }

    /// Discs on a ball around the middle, their thin axes out of it, of either sign.
    fn ball_of_discs() -> SplatCloud {
        let mut cloud = SplatCloud::with_degree(1);
        for i in 0..50 {
            let (z, turn) = (f64::from(i) / 25.0 - 0.98, 2.4 * f64::from(i));
            let radius = (1.0 - z * z).sqrt();
            let out = DVec3::new(radius * turn.cos(), radius * turn.sin(), z);
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            let turn = DQuat::from_rotation_arc(DVec3::Z, sign * out).as_quat();
            cloud.means.push((0.8 * out).as_vec3().to_array());
            cloud.scales.push([0.05, 0.04, 0.002]);
            cloud.rotations.push([turn.w, turn.x, turn.y, turn.z]);
            cloud.opacities.push(0.9);
            cloud.sh_dc.push([0.1, 0.2, 0.3]);
            cloud.sh_rest.extend([[0.1, 0.05, 0.02]; 3]);
        }
        cloud
    }

    /// Sides towards the sun are bright, those away from it are not, however the quaternion turns
    /// the disc.
    #[test]
    fn discs_are_lit_on_the_outside() {
        let cloud = ball_of_discs();
        let mut shading = even([0.1; 3]);
        shading.half_size_m = [1.0; 3];
        shading.lights[0] = LightFrom {
            towards: DVec3::X,
            rgb: [2.0; 3],
        };
        let lit = shading.relit(&cloud);
        let (mut bright, mut dark) = (0, 0);
        for splat in 0..cloud.len() {
            let out = DVec3::from_array(cloud.means[splat].map(f64::from)) / 0.8;
            let plain = |cloud: &SplatCloud| f64::from(cloud.sh_dc[splat][0]) + sh::DC_SHIFT;
            let found = plain(&lit) / plain(&cloud);
            let expected = (0.1 + 2.0 * out.x.max(0.0)).powf(1.0 / 2.2);
            assert!((found - expected).abs() < 1e-3, "{out}: {found} {expected}");
            *if expected > 0.9 {
                &mut bright
            } else {
                &mut dark
            } += 1;
        }
        assert!(bright > 10 && dark > 10);
    }

    #[test]
    fn normals_are_across_what_a_splat_shows_of_itself() {
        let [w, x, y, z] = [0.8, 0.1, -0.5, 0.3];
        let turn = DQuat::from_xyzw(x, y, z, w).normalize();
        let outward = DVec3::new(0.3, -0.2, 0.9).normalize();
        let normal = |scales_m: [f64; 3]| shading_normal(scales_m, [w, x, y, z], outward);
        let thin = turn * DVec3::Y;
        for flat_m in [0.0, 1e-6, 0.02] {
            let found = normal([0.1, flat_m, 0.3]);
            let expected = thin * thin.dot(outward).signum();
            assert!(found.distance(expected) < 1e-3, "{flat_m}: {found}");
        }
        assert!(normal([0.1; 3]).distance(outward) < 1e-12);
        let along = turn * DVec3::X;
        let needle = (outward - along * along.dot(outward)).normalize();
        assert!(normal([0.5, 0.0, 0.0]).distance(needle) < 1e-12);
        // Nothing is known of it.
        assert_eq!(
            shading_normal([0.1; 3], [1.0, 0.0, 0.0, 0.0], DVec3::ZERO),
            DVec3::Z
        );
    }
}
