//! Records of light: shadows on the ground, colors to be relit, and shading by normals.

use bytemuck::{Pod, Zeroable};
use decouplegs_scene::light::{SHADING_LIGHTS, Shading};
use decouplegs_scene::{ColorTransfer, GroundShadow, sh};
use glam::{DMat3, DVec3};

/// `Shadow` of `shadow.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ShadowRecord {
    /// The ground under the agent's middle relative to the world's origin, rounded to f32.
    pub center_high_m: [f32; 3],
    /// Rounding error.
    pub center_low_m: [f32; 3],
    /// Axis along the agent in the ground, over its half length.
    pub along: [f32; 3],
    /// Axis across the agent in the ground, over its half width.
    pub across: [f32; 3],
    /// Unit normal of the ground.
    pub normal: [f32; 3],
    /// Share of the light that is gone in the middle.
    pub strength: f32,
    /// Decay for a half size, as a power of two.
    pub log2_decay: f32,
    /// Squarings of the radius before it decays.
    pub sharpness: u32,
    /// Half sizes beyond which the mask counts as zero.
    pub cutoff: f32,
    /// Splats whose mean is farther from the plane are not ground.
    pub slab_m: f32,
    /// Cameras of the frame that see it, a bit each.
    pub cameras: u32,
}

impl ShadowRecord {
    /// `shadow` in a world whose means are relative to `origin`, seen by all cameras. Made in f64:
    /// only the result is rounded.
    #[must_use]
    pub fn new(shadow: &GroundShadow, origin: DVec3) -> Self {
        let center = shadow.world_from_ground.translation - origin;
        let high = center.as_vec3();
        let axes = DMat3::from_quat(shadow.world_from_ground.rotation.normalize());
        let [half_length_m, half_width_m] = shadow.half_size_m;
        Self {
            center_high_m: high.to_array(),
            center_low_m: (center - high.as_dvec3()).as_vec3().to_array(),
            along: (axes.x_axis / half_length_m).as_vec3().to_array(),
            across: (axes.y_axis / half_width_m).as_vec3().to_array(),
            normal: axes.z_axis.as_vec3().to_array(),
            strength: shadow.strength as f32,
            log2_decay: (shadow.decay * std::f64::consts::LOG2_E) as f32,
            sharpness: shadow.sharpness,
            cutoff: shadow.cutoff() as f32,
            slab_m: shadow.slab_m as f32,
            cameras: u32::MAX,
        }
    }
}

/// Numbers of T, and of b.
const NUMBERS: usize = 48;

/// `Relight` of `relight.comp`: a codebook's colors, and the light that they are put in.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct RelightRecord {
    /// T, `[coefficient][rgb]`.
    pub gain: [f32; NUMBERS],
    /// Summand b of the affine map.
    pub summand: [f32; NUMBERS],
    /// First color in the pool.
    pub first_color: u32,
    /// Number of colors.
    pub colors: u32,
    /// Index of the first relit color.
    pub first_relit: u32,
    /// Workgroups of those before it.
    pub first_group: u32,
}

impl RelightRecord {
    /// `colors` colors of degree `sh_degree` from `first_color` on, in the light of `transfer`;
    /// where they go is said later.
    #[must_use]
    pub fn new(transfer: &ColorTransfer, sh_degree: u8, first_color: usize, colors: usize) -> Self {
        // What the colors have no coefficient for stays nothing.
        let has =
            |number: usize| f32::from(u8::from(number / 3 < sh::coefficient_count(sh_degree)));
        let numbers = |of: &[[f32; 3]; 16]| {
            std::array::from_fn(|number| has(number) * of[number / 3][number % 3])
        };
        Self {
            gain: numbers(&transfer.gain),
            summand: numbers(&transfer.offset),
            first_color: first_color as u32,
            colors: colors as u32,
            first_relit: 0,
            first_group: 0,
        }
    }
}

/// `Shading` of `shading.glsl`: light on an agent by normals, in its frame, `E / pi`, linear.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct ShadingRecord {
    /// Unit vector away from the ground.
    pub up: [f32; 3],
    /// Light of sky and ground on upright surfaces.
    pub upright: [f32; 3],
    /// Surplus of light on surfaces that face up over these.
    pub upward: [f32; 3],
    /// One over half the size of the agent's box, squared.
    pub outward: [f32; 3],
    /// Unit vectors towards the lights.
    pub towards: [[f32; 3]; SHADING_LIGHTS],
    /// Light of each on surfaces that face it, linear RGB.
    pub rgb: [[f32; 3]; SHADING_LIGHTS],
    /// Slope of the share of the first light that reaches a position.
    pub first_slope_per_m: [f32; 3],
    /// Share in the middle of the agent.
    pub first_middle: f32,
}

impl ShadingRecord {
    /// `shading`, rounded.
    #[must_use]
    pub fn new(shading: &Shading) -> Self {
        let Shading { sky, ground, .. } = *shading;
        let half = |sign: f64| -> [f32; 3] {
            std::array::from_fn(|channel| (0.5 * (sky[channel] + sign * ground[channel])) as f32)
        };
        Self {
            up: shading.up.as_vec3().to_array(),
            upright: half(1.0),
            upward: half(-1.0),
            outward: shading.half_size_m.map(|half_m| half_m.powi(-2) as f32),
            towards: shading
                .lights
                .map(|light| light.towards.as_vec3().to_array()),
            rgb: shading
                .lights
                .map(|light| light.rgb.map(|value| value as f32)),
            first_slope_per_m: shading.first.slope_per_m.as_vec3().to_array(),
            first_middle: shading.first.middle as f32,
        }
    }

    /// True if all numbers are finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        bytemuck::cast_slice::<_, f32>(std::slice::from_ref(self))
            .iter()
            .all(|number| number.is_finite())
    }
}
