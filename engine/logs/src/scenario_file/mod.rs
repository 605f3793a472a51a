//! Scenario files: a [`Scenario`] as TOML that a person can read, change and drive again.
//!
//! The format is documented, with an example, in `engine/asset/scenario-file.md`.

mod check;
mod ego;
mod form;
mod seed;
mod story;
mod when;
mod write;

use std::io::Write;
use std::path::Path;

use decouplegs_scene::Scenario;

use decouplegs_asset::read_bytes;
use decouplegs_asset::toml_text::text_of;
use decouplegs_asset::{AssetError, EncodeError, SceneError, write_atomically};

pub use check::{AGENTS_MAX, DURATION_S_MAX, STEP_S_MAX, STEP_S_MIN};

/// The version that is written, and the only one there is.
pub const VERSION: u32 = 1;

/// Reads a scenario from the text of a file. Paths in it stay as they are, relative to the file.
///
/// # Errors
/// A [`SceneError`] with line, key and reason.
pub fn parse(text: &str) -> Result<Scenario, SceneError> {
    form::parse(text)
}

/// The text of a file that describes `scenario`. Reading it gives the same scenario, to the last
/// bit of every number.
///
/// # Errors
/// Returns an error if no file can say it: a path that is not Unicode, or a value that [`parse`]
/// would refuse.
pub fn to_toml(scenario: &Scenario) -> Result<String, EncodeError> {
    write::to_toml(scenario)
}

/// Reads the scenario file at `path`.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Scene`] with line, key and reason.
pub fn read_scenario(path: &Path) -> Result<Scenario, AssetError> {
    let bytes = read_bytes(path)?;
    text_of(&bytes)
        .and_then(parse)
        .map_err(|source| AssetError::Scene {
            path: path.to_owned(),
            source,
        })
}

/// Writes `scenario` to `path`, atomically.
///
/// # Errors
/// [`AssetError::Encode`] when no file can say it, [`AssetError::Write`].
pub fn write_scenario(path: &Path, scenario: &Scenario) -> Result<(), AssetError> {
    let encode_error = |source| AssetError::Encode {
        path: path.to_owned(),
        format: "a scenario file",
        source,
    };
    let text = to_toml(scenario).map_err(encode_error)?;
    write_atomically(path, |file| file.write_all(text.as_bytes()))
}
