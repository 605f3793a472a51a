//! The TOML form of rolling shutters.

use decouplegs_scene::{Invalid, Shutter, ShutterDirection};
use serde::{Deserialize, Serialize};

/// Readout of the rows or columns of an image one after the other.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ShutterForm {
    direction: String,
    readout_s: f64,
}

impl ShutterForm {
    /// The shutter of an image of `size_px` (width, height).
    pub(super) fn shutter(&self, size_px: [u32; 2]) -> Result<Shutter, Invalid> {
        let direction = ShutterDirection::from_name(&self.direction).ok_or_else(|| {
            let names = ShutterDirection::ALL.map(ShutterDirection::name);
            Invalid::new(format!(
                "direction '{}'; expected one of {}",
                self.direction,
                names.join(", ")
            ))
        })?;
        if self.readout_s < 0.0 {
            return Err(Invalid::new(format!(
                "readout_s = {}; expected 0 or more",
                self.readout_s
            )));
        }
        if size_px.contains(&0) {
            // The camera is refused for its size.
            return Ok(Shutter::GLOBAL);
        }
        let shutter = Shutter::new(direction, self.readout_s, size_px);
        shutter.check(size_px).map(|()| shutter)
    }

    /// The form of the shutter of an image of `size_px`; `None` for a global one.
    pub(super) fn from_shutter(shutter: &Shutter, size_px: [u32; 2]) -> Option<Self> {
        // Nanoseconds, so that 0.03 is written as that.
        let readout_s = (shutter.readout_s(size_px) * 1e9).round() / 1e9;
        (!shutter.is_global()).then(|| Self {
            direction: shutter.direction().name().to_owned(),
            readout_s,
        })
    }
}
