//! Light about agents: what the background tells of it, what it does to their colors, and the
//! shadow they stand in.
//!
//! DecoupleGS section 3.4 and supplement: an ambient descriptor L(x) from the background's
//! spherical harmonics, an affine transfer c' = T(L) (.) c + b(L), and shadows on the
//! ground.

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
mod lighting;
mod shadow;
mod transfer;

pub use ambient::AmbientDescriptor;
pub use ambient_field::{AmbientField, AmbientOptions, ambient_by_definition};
pub use cast::{CastingLights, Lamps, Sun};
pub use confidence::{
    ALBEDO_SPREAD, ALBEDO_SPREAD_GIVEN, RelightOptions, TransferConfidence, Trust,
};
pub use environment::{
    DISPLAY_MAX, IrradianceMap, PROBE_WIDTH, Probe, Surroundings, reflected_by_white,
    reflected_by_white_of_nine, to_display, to_linear,
};
pub use lighting::{Lighting, LitAgent, ShadowOptions};
pub use shadow::{GroundShadow, bake_shadows};
pub use transfer::{ColorTransfer, LightTransfer};
