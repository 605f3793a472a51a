//! Environment light: probes, the irradiance that they cast on surfaces, and the ground that
//! reflects it.

mod display;
mod irradiance;
mod probe;
mod surroundings;

pub use display::{DISPLAY_MAX, to_display, to_linear};
pub(super) use display::{GAMMA, linear_loss, shown_loss};
pub use irradiance::{IrradianceMap, reflected_by_white, reflected_by_white_of_nine};
pub use probe::Probe;
pub use surroundings::Surroundings;

/// Columns to which probes are made smaller: irradiance and bands 1 and 2 are smooth, and sums stay
/// exact.
pub const PROBE_WIDTH: usize = 128;
