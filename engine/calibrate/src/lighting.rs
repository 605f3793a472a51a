//! The lights of a calibration: probes turned about the vertical, mirrored and exposed; and the
//! neutral one.

use std::f64::consts::TAU;

use decouplegs_scene::AmbientDescriptor;
use glam::{DQuat, DVec3};

use decouplegs_scene::light::{IrradianceMap, Probe, Surroundings};

/// Display values of the reference ground to which each probe is exposed: from the dark between
/// street lamps to glaring.
pub const GROUND_DISPLAY: [f64; 6] = [0.06, 0.12, 0.25, 0.4, 0.55, 0.7];

/// Coefficients of bands 0 to 2 that change their sign when y does: the basis functions y, xy and
/// yz.
const ODD_IN_Y: [usize; 3] = [1, 4, 5];

/// Values that are computed once per probe.
#[derive(Clone, Debug)]
pub struct PreparedProbe {
    /// Name of the probe.
    pub name: String,
    irradiance: IrradianceMap,
    up: [f64; 3],
    sheen: [[f64; 3]; AmbientDescriptor::COEFFICIENTS],
}

impl PreparedProbe {
    /// `probe` over `ground`.
    #[must_use]
    pub fn new(probe: &Probe, ground: &Surroundings) -> Self {
        let irradiance = IrradianceMap::new(&ground.below(probe));
        let up = irradiance.reflected_by_white(DVec3::Z);
        Self {
            name: probe.name.clone(),
            irradiance,
            up,
            sheen: ground.sheen(probe),
        }
    }
}

/// One light: a probe as it is turned, mirrored and exposed.
#[derive(Clone, Copy, Debug)]
pub struct Lighting<'a> {
    /// Index and probe, among those given; `None` for the neutral light.
    pub probe: Option<(usize, &'a PreparedProbe)>,
    /// Angle by which the world about the agent is turned, radians about z.
    pub yaw_rad: f64,
    /// Mirrors left and right (y) before the turn.
    pub mirrored: bool,
    /// Factor on the probe's radiance.
    pub exposure: f64,
    /// L: what the reference ground looks like in it.
    pub descriptor: AmbientDescriptor,
}

impl<'a> Lighting<'a> {
    /// The light that shows colors as they are.
    #[must_use]
    pub fn neutral(ground: &Surroundings) -> Self {
        Self {
            probe: None,
            yaw_rad: 0.0,
            mirrored: false,
            exposure: 1.0,
            descriptor: ground.neutral(),
        }
    }

    /// Probe `index`, turned and exposed so that `ground` shows `display` in luminance; `None`
    /// where nothing lights the ground.
    #[must_use]
    pub fn of_probe(
        (index, probe): (usize, &'a PreparedProbe),
        ground: &Surroundings,
        yaw_rad: f64,
        mirrored: bool,
        display: f64,
    ) -> Option<Self> {
        let exposure = ground.exposure(probe.up, display)?;
        let mut sheen = probe.sheen.map(|rgb| rgb.map(|value| value * exposure));
        if mirrored {
            ODD_IN_Y
                .iter()
                .for_each(|&k| sheen[k] = sheen[k].map(|value| -value));
        }
        let descriptor = ground.descriptor(probe.up.map(|value| value * exposure), &sheen);
        let descriptor = descriptor.turned(DQuat::from_rotation_z(yaw_rad));
        Some(Self {
            probe: Some((index, probe)),
            yaw_rad,
            mirrored,
            exposure,
            descriptor,
        })
    }

    /// E(n) / pi, linear RGB: what a white surface that faces the unit vector n reflects.
    #[must_use]
    pub fn reflected_by_white(&self, normal: DVec3) -> [f64; 3] {
        let Some((_, probe)) = self.probe else {
            return [1.0; 3];
        };
        let mut normal = DQuat::from_rotation_z(-self.yaw_rad) * normal;
        if self.mirrored {
            normal.y = -normal.y;
        }
        probe
            .irradiance
            .reflected_by_white(normal)
            .map(|value| value * self.exposure)
    }
}

/// All lights: the neutral one, then each probe, as it is and mirrored, turned in `rotations` steps
/// of a full turn, at every exposure. Probes that leave the ground dark have none.
#[must_use]
pub fn lightings<'a>(
    probes: &'a [PreparedProbe],
    ground: &Surroundings,
    rotations: usize,
) -> Vec<Lighting<'a>> {
    let mut lights = vec![Lighting::neutral(ground)];
    for probe in probes.iter().enumerate() {
        for mirrored in [false, true] {
            for step in 0..rotations {
                let yaw_rad = TAU * step as f64 / rotations as f64;
                let exposed =
                    |display| Lighting::of_probe(probe, ground, yaw_rad, mirrored, display);
                lights.extend(GROUND_DISPLAY.into_iter().filter_map(exposed));
            }
        }
    }
    lights
}
