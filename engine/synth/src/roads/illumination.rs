//! The light of a probe on surfaces that nothing shades.

use decouplegs_scene::light::{IrradianceMap, PROBE_WIDTH, Probe, Surroundings, to_display};
use glam::{DVec3, Vec3};

use crate::probes::overcast_probe;

/// Illumination of a position by a probe.
pub(super) struct Illumination {
    /// Small enough that a splat of the sky is about a pixel of it.
    probe: Probe,
    irradiance: IrradianceMap,
    /// Sky reflection of an upward, fully glossy face: bands 1 and 2, by coefficient.
    sheen: [[f64; 3]; 9],
    exposure: f64,
}

impl Illumination {
    /// The light of `probe`, `exposure_ev` stops brighter; an overcast sky without one.
    pub(super) fn new(probe: Option<&Probe>, exposure_ev: f64) -> Self {
        let probe = probe.map_or_else(overcast_probe, |probe| probe.downsampled(PROBE_WIDTH));
        let ground = Surroundings {
            gloss: 1.0,
            ..Surroundings::default()
        };
        let exposure = exposure_ev.clamp(-30.0, 30.0).exp2();
        // Irradiance is smooth: a sun of a few degrees lights as one of half a degree does.
        let irradiance = IrradianceMap::new(&probe.downsampled(PROBE_WIDTH / 2));
        Self {
            irradiance,
            sheen: ground.sheen(&probe),
            exposure,
            probe,
        }
    }

    /// A surface of linear `albedo` that faces the unit vector `normal`, display-referred RGB.
    pub(super) fn shown(&self, albedo: Vec3, normal: Vec3) -> Vec3 {
        let white = self.irradiance.reflected_by_white(normal.as_dvec3());
        let shown = |channel: usize| {
            to_display(f64::from(albedo[channel]) * white[channel] * self.exposure) as f32
        };
        Vec3::new(shown(0), shown(1), shown(2))
    }

    /// Coefficient `k` of what a face that looks up and is all gloss mirrors; 0 beyond band 2.
    pub(super) fn mirrored(&self, k: usize) -> Vec3 {
        self.sheen.get(k).map_or(Vec3::ZERO, |rgb| {
            Vec3::from_array(rgb.map(|value| (value * self.exposure) as f32))
        })
    }

    /// Mean radiance of the probe around a direction, display-referred RGB.
    pub(super) fn seen(&self, direction: Vec3) -> Vec3 {
        Vec3::from_array(
            self.probe
                .radiance(direction.as_dvec3())
                .map(|value| to_display(f64::from(value) * self.exposure) as f32),
        )
    }

    /// The mean of what is seen a little above the horizon, display-referred RGB.
    pub(super) fn horizon(&self) -> [f32; 3] {
        const DIRECTIONS: u32 = 64;
        let direction = |index: u32| {
            let azimuth = std::f32::consts::TAU * (index as f32 + 0.5) / DIRECTIONS as f32;
            Vec3::new(azimuth.cos(), azimuth.sin(), 0.12)
        };
        let sum: Vec3 = (0..DIRECTIONS)
            .map(|index| self.seen(direction(index)))
            .sum();
        (sum / DIRECTIONS as f32).to_array()
    }

    /// True if windows and lamps are lit: a white wall shows less than a quarter of white.
    pub(super) fn is_dark(&self) -> bool {
        let up = self.irradiance.reflected_by_white(DVec3::Z);
        up.iter().sum::<f64>() / 3.0 * self.exposure < 0.05
    }
}
