//! Light about agents: what the background tells of it, what it does to their colors, and the
//! shadow they stand in.
//!
//! DecoupleGS section 3.4 and supplement: an ambient descriptor L(x) from the background's
//! spherical harmonics, an affine transfer c' = T(L) (.) c + b(L), and shadows on the
//! ground. Besides, light on each splat by its normal.

/// Weights of red, green and blue in luminance (Rec. 709).
pub const LUMA: [f64; 3] = [0.2126, 0.7152, 0.0722];

/// Luminance of `rgb` (Rec. 709).
#[must_use]
pub fn luminance(rgb: [f64; 3]) -> f64 {
    let weighted = rgb.into_iter().zip(LUMA);
    weighted.map(|(value, weight)| value * weight).sum()
}

mod ambient;
mod ambient_field;
mod cast;
mod confidence;
mod environment;
mod ground_light;
mod lighting;
mod shaded_agent;
mod shading;
mod shadow;
mod transfer;

pub use ambient::AmbientDescriptor;
pub use ambient_field::{AmbientField, AmbientOptions, GroundPatch, ambient_by_definition};
pub use cast::{CastingLights, Lamps, Sun};
pub use confidence::{
    ALBEDO_SPREAD, ALBEDO_SPREAD_GIVEN, RelightOptions, TransferConfidence, Trust,
};
pub use environment::{
    DISPLAY_MAX, IrradianceMap, PROBE_WIDTH, Probe, Surroundings, reflected_by_white,
    reflected_by_white_of_nine, to_display, to_linear,
};
pub use ground_light::GroundLight;
pub use lighting::{Lighting, LitAgent, ShadowOptions};
pub use shading::{LIGHT_MIN, LightFrom, LitShare, SHADING_LIGHTS, Shading, shading_normal};
pub use shadow::{GroundShadow, bake_shadows};
pub use transfer::{ColorTransfer, LightTransfer};
