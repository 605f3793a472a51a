//! Light reflected by the ground around an agent: the descriptor that the light has at run time.
//!
//! At run time L(x) is the mean of the background's colors, so it tells what lit surroundings look
//! like, not what shines on them. Here a reference ground stands in for the background: flat, gray,
//! somewhat glossy.

use std::f64::consts::PI;

use crate::light::luminance;
use crate::{AmbientDescriptor, sh};
use glam::DVec3;

use super::display::{to_display, to_linear};
use super::irradiance::reflected_by_white;
use super::probe::Probe;

/// Sheen of a fully glossy surface, in coefficients of its color for each unit of gloss, under a
/// sun that a white surface facing it shows with [`SHEEN_SUN`]: bands 1 and 2. Those of the
/// synthetic street (`street/emit.rs`).
const SHEEN_BY_BAND: [f64; 3] = [0.0, 0.10, 0.07];

/// E / pi of the sun to which [`SHEEN_BY_BAND`] refers; that of the synthetic street
/// (`street/light.rs`).
const SHEEN_SUN: f64 = 1.35;

/// The reference ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// Linear albedo of all channels, above 0, at most 1: what one takes the surroundings of agents
    /// to be like in the mean. The default lies between what made-up streets ask for, 0.12 to 0.18:
    /// brightness of agents follows it.
    pub albedo: f64,
    /// Strength of the view-dependent sheen, 0 to 1.
    pub gloss: f64,
}

impl Default for Surroundings {
    fn default() -> Self {
        Self {
            albedo: 0.15,
            gloss: 0.35,
        }
    }
}

impl Surroundings {
    /// The descriptor where a white surface that faces up shows `up` (E / pi) and the sheen is
    /// `sheen`; both as exposed.
    pub fn descriptor(
        &self,
        up: [f64; 3],
        sheen: &[[f64; 3]; AmbientDescriptor::COEFFICIENTS],
    ) -> AmbientDescriptor {
        let mut coefficients = sheen.map(|rgb| rgb.map(|value| value as f32));
        coefficients[0] = up.map(|white| (to_display(self.albedo * white) / sh::Y0) as f32);
        AmbientDescriptor { coefficients }
    }

    /// The descriptor of the light that shows colors as they are: white, from everywhere.
    #[must_use]
    pub fn neutral(&self) -> AmbientDescriptor {
        self.descriptor([1.0; 3], &[[0.0; 3]; AmbientDescriptor::COEFFICIENTS])
    }

    /// Factor on the light that gives the ground the display value `display` in luminance. `up` is
    /// the value of a white, upward surface without the factor. None in the dark.
    pub fn exposure(&self, up: [f64; 3], display: f64) -> Option<f64> {
        let exposure = to_linear(display) / (self.albedo * luminance(up));
        exposure.is_finite().then_some(exposure)
    }

    /// `probe` with this ground, lit by it, in place of what the probe shows below the horizon: a
    /// road is darker than many of the floors over which environments are photographed.
    #[must_use]
    pub fn below(&self, probe: &Probe) -> Probe {
        let ground = reflected_by_white(probe, DVec3::Z).map(|up| (self.albedo * up) as f32);
        let pixels = probe.rays().zip(probe.pixels());
        let pixels = pixels.map(
            |((direction, ..), &above)| {
                if direction.z > 0.0 { above } else { ground }
            },
        );
        Probe::new(
            probe.name.clone(),
            probe.width(),
            probe.height(),
            pixels.collect(),
        )
    }

    /// Bands 1 and 2 of the ground's color, linear in the light; DC is left at 0.
    ///
    /// A sun of radiant strength E / pi in direction s gives `gloss (E / pi / 1.35) max(0, s_z) w_l
    /// Y_lm(s mirrored in z)`, as in the synthetic street, in whose convention Y is taken in the
    /// direction of view. The sky is a sun in every direction, of which only what stands out from
    /// the sky's median counts: an even sky has no highlights. Unlike the street's, the sheen keeps
    /// the color of what is mirrored: with gray bands 1 and 2, 16 of the 28 columns of a
    /// calibration would say what the others do.
    #[must_use]
    pub fn sheen(&self, probe: &Probe) -> [[f64; 3]; AmbientDescriptor::COEFFICIENTS] {
        let median = median_of_sky(probe);
        let mut sheen = [[0.0; 3]; AmbientDescriptor::COEFFICIENTS];
        for (direction, steradians, rgb) in probe.rays().filter(|(direction, ..)| direction.z > 0.0)
        {
            let basis = sh::basis(DVec3 {
                z: -direction.z,
                ..direction
            });
            let share = self.gloss * steradians * direction.z / (PI * SHEEN_SUN);
            for (k, coefficient) in sheen.iter_mut().enumerate().skip(1) {
                let weight = share * SHEEN_BY_BAND[k.isqrt()] * basis[k];
                (0..3).for_each(|channel| {
                    coefficient[channel] += weight * (rgb[channel] - median[channel]);
                });
            }
        }
        sheen
    }
}

/// The radiance, per channel, that half of the upper hemisphere exceeds.
fn median_of_sky(probe: &Probe) -> [f64; 3] {
    std::array::from_fn(|channel| {
        let mut sky: Vec<(f64, f64)> = probe
            .rays()
            .filter(|(direction, ..)| direction.z > 0.0)
            .map(|(_, steradians, rgb)| (rgb[channel], steradians))
            .collect();
        sky.sort_by(|a, b| a.0.total_cmp(&b.0));
        let half = 0.5 * sky.iter().map(|(_, steradians)| steradians).sum::<f64>();
        let mut passed = 0.0;
        let middle = sky.iter().find(|(_, steradians)| {
            passed += steradians;
            passed >= half
        });
        middle.map_or(0.0, |(value, _)| *value)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An even sky with a sun of one pixel: E / pi of the sun, and the direction of the pixel's
    /// middle.
    fn sun_and_sky(towards: DVec3, strength: f64, sky: f32) -> (Probe, DVec3) {
        let even = Probe::from_fn("sky", 256, |_| [sky; 3]);
        let nearest = |probe: &Probe| {
            (0..probe.pixels().len()).max_by(|&a, &b| {
                probe
                    .direction(a)
                    .dot(towards)
                    .total_cmp(&probe.direction(b).dot(towards))
            })
        };
        let pixel = nearest(&even).unwrap();
        let mut pixels = even.pixels().to_vec();
        pixels[pixel] = [sky + (strength * PI / even.solid_angle(pixel)) as f32; 3];
        (
            Probe::new("sun", even.width(), even.height(), pixels),
            even.direction(pixel),
        )
    }

    #[test]
    fn a_sun_draws_the_sheen_that_the_synthetic_street_draws_whatever_the_sky() {
        let ground = Surroundings::default();
        for sky in [0.0, 0.3] {
            let (probe, sun) = sun_and_sky(DVec3::new(-0.5, -0.36, 0.79).normalize(), 1.35, sky);
            let sheen = ground.sheen(&probe);
            // street/emit.rs, view_dependence: gloss, the cosine, the band's weight, Y in the
            // mirrored direction.
            let lobe = sh::basis(sun - 2.0 * sun.z * DVec3::Z);
            for k in 1..9 {
                let expected = 0.35 * sun.z * if k < 4 { 0.10 } else { 0.07 } * lobe[k];
                for value in sheen[k] {
                    assert!(
                        (value - expected).abs() < 2e-6,
                        "coefficient {k}, sky {sky}: {value}, expected {expected}"
                    );
                }
            }
            assert!(sheen[6][0].abs() > 1e-3, "a sheen of nothing is no test");
        }
    }

    #[test]
    fn ground_below_lights_what_faces_down_and_leaves_the_sky() {
        let ground = Surroundings::default();
        // White floors of studios do not count: only what the sky sheds on the ground.
        let studio = Probe::from_fn("studio", 64, |direction| {
            [if direction.z > 0.0 { 0.6 } else { 5.0 }; 3]
        });
        let over = ground.below(&studio);
        for (normal, expected) in [
            (DVec3::Z, 0.6),
            (DVec3::X, 0.3 + 0.3 * ground.albedo),
            (DVec3::NEG_Z, 0.6 * ground.albedo),
        ] {
            let lit = reflected_by_white(&over, normal)[0];
            assert!((lit - expected).abs() < 1e-3, "{normal}: {lit}");
            let before = reflected_by_white(&studio, normal)[0];
            assert_eq!(normal.z > 0.5, (lit - before).abs() < 1e-3, "{normal}");
        }
    }

    #[test]
    fn exposure_brings_the_ground_to_the_value_asked_for() {
        let ground = Surroundings::default();
        let up = [0.4, 0.4, 0.4];
        for display in [0.12, 0.55, 0.9] {
            let exposure = ground.exposure(up, display).unwrap();
            let shown = ground
                .descriptor(up.map(|value| value * exposure), &[[0.0; 3]; 9])
                .mean()[1];
            assert!(
                (f64::from(shown) - display).abs() < 1e-6,
                "{shown} for {display}"
            );
        }
        assert_eq!(ground.exposure([0.0; 3], 0.5), None);
        assert!((f64::from(ground.neutral().mean()[0]) - 0.15f64.powf(1.0 / 2.2)).abs() < 1e-6);
    }
}
