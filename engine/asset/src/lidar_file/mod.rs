//! Models of LiDARs: TOML files, the parameters of NVIDIA NCore as JSON, and the sensors that come
//! with the program.
//!
//! ```toml
//! name = "example"
//! row_elevations_deg = [15.0, 0.0, -15.0]      # falling
//! row_azimuth_offsets_deg = [1.4, -1.4, 1.4]   # positive to the left; 0 if left out
//! row_ids = [2, 0, 1]                          # lasers as the manufacturer counts
//! columns = 1800                               # per sweep
//! first_azimuth_deg = 180.0
//! field_deg = 360.0                            # swept
//! direction = "cw"                             # as seen from above; or "ccw"
//! rate_hz = 10.0
//! range_m = [0.3, 200.0]
//! returns = "median"                           # or "expected", "strongest", "dual"
//! firing_time = "middle"                       # or "start", "ncore"
//! range_noise_m = 0.0
//! ```
//!
//! Instead of rows and columns a file may list `rays`, each
//! `[azimuth_deg, elevation_deg, offset_us, ring]`.

mod form;
mod ncore;

use std::path::Path;

use decouplegs_scene::LidarModel;

use crate::error::read_bytes;
use crate::{AssetError, DecodeError};

/// Models that come with the program: name and text. `engine/asset/sensors` tells where the tables
/// are from.
const BUILT_IN: [(&str, &str); 8] = [
    ("at128", include_str!("../../sensors/at128.toml")),
    ("hdl32e", include_str!("../../sensors/hdl32e.toml")),
    ("hdl64e", include_str!("../../sensors/hdl64e.toml")),
    (
        "hdl64e_kitti",
        include_str!("../../sensors/hdl64e_kitti.toml"),
    ),
    ("pandar128", include_str!("../../sensors/pandar128.toml")),
    ("pandar64", include_str!("../../sensors/pandar64.toml")),
    ("vlp32c", include_str!("../../sensors/vlp32c.toml")),
    ("xt32", include_str!("../../sensors/xt32.toml")),
];

/// Names of the models that come with the program.
#[must_use]
pub fn lidar_names() -> [&'static str; 8] {
    BUILT_IN.map(|(name, _)| name)
}

/// The model called `name`, of [`lidar_names`], or the one in the file of that path.
///
/// # Errors
/// [`AssetError::Read`] where there is neither, or [`AssetError::Decode`] with the line or value at
/// fault.
pub fn read_lidar(name: &Path) -> Result<LidarModel, AssetError> {
    match built_in(name) {
        Some(text) => read_from(text.as_bytes(), name),
        None if !name.exists() => Err(AssetError::Read {
            path: name.to_owned(),
            source: std::io::Error::other(format!(
                "there is no such file, and no model of this name: those are {}",
                lidar_names().join(", ")
            )),
        }),
        None => read_from(&read_bytes(name)?, name),
    }
}

/// Text of the model called `name`, if it comes with the program.
fn built_in(name: &Path) -> Option<&'static str> {
    let mut models = BUILT_IN.iter();
    let found = models.find(|(built_in, _)| Path::new(built_in) == name);
    found.map(|(_, text)| *text)
}

/// True if the model called `name` comes with the program.
pub(crate) fn is_built_in(name: &Path) -> bool {
    built_in(name).is_some()
}

/// The model in `bytes`, which `path` names in messages.
pub(crate) fn read_from(bytes: &[u8], path: &Path) -> Result<LidarModel, AssetError> {
    decode(bytes).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: "LiDAR",
        source,
    })
}

/// Reads a model from the bytes of a file: JSON where they begin with a brace, TOML otherwise.
///
/// # Errors
/// A [`DecodeError`] that names the line or value at fault.
pub fn decode(bytes: &[u8]) -> Result<LidarModel, DecodeError> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let is_json = bytes.trim_ascii_start().starts_with(b"{");
    let model = match is_json {
        true => ncore::decode(bytes)?,
        false => form::decode(bytes)?,
    };
    model
        .check()
        .map_err(|reason| DecodeError::Malformed(reason.to_string()))?;
    Ok(model)
}
