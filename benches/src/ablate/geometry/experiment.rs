//! Bodies under environments: colors of the asset, of the truth and of the relit asset.

use std::f64::consts::PI;

use decouplegs::scene::light::{
    AmbientOptions, LightFrom, LitShare, Probe, SHADING_LIGHTS, Shading, Surroundings,
    ambient_by_definition, luminance, to_display, to_linear,
};
use decouplegs::scene::{AmbientDescriptor, ColorTransfer, SplatCloud, sh};
use glam::{DQuat, DVec3};

use super::body::Body;
use super::skylight::{BodyOnGround, Environment, directions, environment, on_open_ground};
use crate::ablate::affine::best_on_dc;

/// Half the side of the ground around a body, and the spacing of its splats, meters.
const GROUND_M: [f64; 2] = [12.0, 0.5];

/// A light over the ground that a body stands on.
pub struct Light {
    /// Exposed radiance.
    pub environment: Environment,
    /// Descriptor that the ground's splats give.
    pub descriptor: AmbientDescriptor,
}

impl Light {
    /// `probe`, turned by `quarters` of a turn, over `ground`. The exposure is that at which the
    /// reference ground of a calibration shows `display`.
    pub fn new(probe: &Probe, quarters: usize, display: f64, ground: &Surroundings) -> Self {
        let mut environment = environment(probe, quarters);
        let up = on_open_ground(&environment);
        let exposure = Surroundings::default().exposure(up, display);
        let exposure = exposure.expect("every environment lights the ground");
        let exposed = |rgb: [f64; 3]| rgb.map(|value| value * exposure);
        environment.iter_mut().for_each(|rgb| *rgb = exposed(*rgb));
        let turn = DQuat::from_rotation_z(std::f64::consts::FRAC_PI_2 * quarters as f64);
        let shown = ground.descriptor(exposed(up), &ground.sheen(probe).map(exposed));
        Self {
            descriptor: gathered_from_ground(&shown.turned(turn)),
            environment,
        }
    }
}

impl Light {
    /// Light by normals, and true if there is a sun. The scene file gives the direction of the sun;
    /// the ground shows the colors of sun and sky, and is taken to have `albedo`.
    pub fn shading(&self, albedo: f64) -> (Shading, bool) {
        let shown = self.descriptor.mean();
        let ground = shown.map(|value| to_linear(f64::from(value)));
        let up = on_open_ground(&self.environment);
        let sun = sun_of(&self.environment);
        // Shares of the sun in what the ground shows.
        let share = |channel: usize| sun.map_or(0.0, |(_, sun)| sun[channel] / up[channel]);
        let mut lights = [LightFrom::default(); SHADING_LIGHTS];
        if let Some((towards, _)) = sun {
            let facing = |channel: usize| ground[channel] / albedo * share(channel) / towards.z;
            let rgb = std::array::from_fn(facing);
            lights[0] = LightFrom { towards, rgb };
        }
        let sky = |channel: usize| ground[channel] / albedo * (1.0 - share(channel));
        let shading = Shading {
            up: DVec3::Z,
            sky: std::array::from_fn(sky),
            ground,
            lights,
            first: LitShare::ALL,
            half_size_m: [1.0; 3],
        };
        (shading, sun.is_some())
    }
}

/// Direction of the sun of an environment, and its E / pi on level ground: pixels within 14 degrees
/// of the brightest and four times as bright as half of the sky. `None` where it gives less than a
/// quarter of the light.
fn sun_of(environment: &Environment) -> Option<(DVec3, [f64; 3])> {
    let directions = directions();
    let sky: Vec<_> = directions
        .iter()
        .zip(environment)
        .filter(|((direction, _), _)| direction.z > 0.0)
        .map(|(&(direction, steradians), &rgb)| (direction, steradians, rgb, luminance(rgb)))
        .collect();
    let mut levels: Vec<f64> = sky.iter().map(|(.., level)| *level).collect();
    levels.sort_by(f64::total_cmp);
    let median = levels[levels.len() / 2];
    let brightest = sky.iter().max_by(|a, b| a.3.total_cmp(&b.3))?.0;
    let (mut towards, mut up) = (DVec3::ZERO, [0.0; 3]);
    for (direction, steradians, rgb, level) in sky {
        if direction.dot(brightest) > 0.97 && level > 4.0 * median {
            towards += level * steradians * direction;
            let facing = direction.z * steradians / PI;
            (0..3).for_each(|channel| up[channel] += facing * rgb[channel]);
        }
    }
    let towards = towards.normalize_or_zero();
    let share = luminance(up) / luminance(on_open_ground(environment));
    (share > 0.25 && towards.z > 0.1).then_some((towards, up))
}

/// The descriptor at run time amid splats of ground that all look like `shown`.
fn gathered_from_ground(shown: &AmbientDescriptor) -> AmbientDescriptor {
    let [half_m, step_m] = GROUND_M;
    let side = (2.0 * half_m / step_m) as usize;
    let mut ground = SplatCloud::with_degree(2);
    for position in 0..side * side {
        let at = |index: usize| (step_m * (index as f64 + 0.5) - half_m) as f32;
        ground
            .means
            .push([at(position % side), at(position / side), 0.0]);
        ground.scales.push([0.3, 0.3, 0.01]);
        ground.rotations.push([1.0, 0.0, 0.0, 0.0]);
        ground.opacities.push(0.9);
        let dc = shown.coefficients[0].map(|value| value - sh::DC_SHIFT as f32);
        ground.sh_dc.push(dc);
        ground.sh_rest.extend_from_slice(&shown.coefficients[1..]);
    }
    ambient_by_definition(&ground, &[], DVec3::ZERO, &AmbientOptions::default())
        .expect("ground is within range")
}

/// PSNR of seen colors in dB: as captured, relit, and by the best affine change of DC.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    pub none_db: f64,
    pub relit_db: f64,
    pub affine_db: f64,
    /// Angles between relit and true colors that 95 % do not exceed, degrees.
    pub relit_p95_deg: f64,
    pub none_p95_deg: f64,
}

/// A body in its capture.
pub struct Subject {
    body: Body,
    on_ground: BodyOnGround,
    /// Share of white light that reaches each surfel.
    open: Vec<f64>,
    captured: SplatCloud,
}

impl Subject {
    pub fn new(body: Body) -> Self {
        let on_ground = BodyOnGround::new(&body);
        let open = on_ground.in_white_light();
        let white: Vec<[f64; 3]> = open.iter().map(|&open| [open; 3]).collect();
        let captured = shown(&body, &white);
        Self {
            body,
            on_ground,
            open,
            captured,
        }
    }

    pub fn name(&self) -> &str {
        &self.body.name
    }

    /// Colors as captured, by `relit` and by the best affine change, against the truth in
    /// `environment` over a ground of `albedo`.
    pub fn compare(&self, relit: &ColorTransfer, environment: &Environment, albedo: f64) -> Row {
        let truth = shown(&self.body, &self.on_ground.lit(environment, albedo));
        let weights: Vec<f32> = self.open.iter().map(|&open| open as f32).collect();
        let affine = best_on_dc(&self.captured, &truth, &weights);
        let found = |transfer: &ColorTransfer| {
            let found = transfer.relit(&self.captured);
            self.difference(&found, &truth)
        };
        let (none_db, none_p95_deg) = found(&ColorTransfer::IDENTITY);
        let (relit_db, relit_p95_deg) = found(relit);
        Row {
            none_db,
            none_p95_deg,
            relit_db,
            relit_p95_deg,
            affine_db: found(&affine).0,
        }
    }

    /// Compares colors that follow the surfels' normals in `shading`, a body's of unit size.
    pub fn compare_by_normals(
        &self,
        shading: &Shading,
        environment: &Environment,
        albedo: f64,
    ) -> Row {
        let none = self.compare(&ColorTransfer::IDENTITY, environment, albedo);
        let truth = shown(&self.body, &self.on_ground.lit(environment, albedo));
        let mut lit = self.captured.clone();
        for (dc, surfel) in lit.sh_dc.iter_mut().zip(&self.body.surfels) {
            let gain = shading.gain(surfel.normal, surfel.position);
            for (dc, gain) in dc.iter_mut().zip(gain) {
                *dc = (gain * (f64::from(*dc) + sh::DC_SHIFT) - sh::DC_SHIFT) as f32;
            }
        }
        let (relit_db, relit_p95_deg) = self.difference(&lit, &truth);
        Row {
            relit_db,
            relit_p95_deg,
            ..none
        }
    }

    /// PSNR, each surfel by the share of light that reaches it, and the 95th percentile of angles
    /// between colors that are not black.
    fn difference(&self, found: &SplatCloud, truth: &SplatCloud) -> (f64, f64) {
        let shown = |cloud: &SplatCloud, surfel: usize| {
            let dc = DVec3::from_array(cloud.sh_dc[surfel].map(f64::from));
            (sh::Y0 * dc + 0.5).clamp(DVec3::ZERO, DVec3::ONE)
        };
        let (mut squares, mut weights) = (0.0, 0.0);
        let mut angles = Vec::new();
        for (surfel, weight) in self.open.iter().enumerate() {
            let (found, truth) = (shown(found, surfel), shown(truth, surfel));
            squares += weight * found.distance_squared(truth) / 3.0;
            weights += weight;
            if truth.max_element() > 0.05 {
                let angle_rad = found.normalize_or(DVec3::X).angle_between(truth);
                angles.push((angle_rad.to_degrees(), *weight));
            }
        }
        angles.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut left = 0.95 * angles.iter().map(|(_, weight)| weight).sum::<f64>();
        let p95_deg = angles.iter().find(|(_, weight)| {
            left -= weight;
            left <= 0.0
        });
        (
            -10.0 * (squares / weights).log10(),
            p95_deg.map_or(0.0, |(angle_deg, _)| *angle_deg),
        )
    }
}

/// Surfels as splats of one color: their reflectance under `light`, E / pi.
fn shown(body: &Body, light: &[[f64; 3]]) -> SplatCloud {
    let mut cloud = SplatCloud::with_degree(0);
    for (surfel, light) in body.surfels.iter().zip(light) {
        cloud.means.push(surfel.position.as_vec3().to_array());
        cloud.scales.push([0.05, 0.05, 0.001]);
        cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
        cloud.opacities.push(1.0);
        cloud.sh_dc.push(std::array::from_fn(|channel| {
            let display = to_display(surfel.albedo[channel] * light[channel]);
            ((display - 0.5) / sh::Y0) as f32
        }));
    }
    cloud
}
