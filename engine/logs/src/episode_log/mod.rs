//! Episode logs: what happened in an episode, line by line as it happened, each line vouching for
//! all before it.
//!
//! The format is documented in `engine/asset/episode-log.md`.

mod chain;
mod egos;
mod instant;
mod read;
mod record;
mod sequence;
mod write;

use std::path::Path;

use decouplegs_scene::Episode;

use decouplegs_asset::read_bytes;
use decouplegs_asset::{AssetError, DecodeError, EncodeError};

pub use write::EpisodeLog;

/// Name of the format in the first line.
pub const FORMAT: &str = "decouplegs-episode";

/// The version that is written. Version 1 is read, too: its agents are on the map all the time, and
/// nothing static ends its episodes.
pub const VERSION: u32 = decouplegs_scene::episode::LOG_VERSION;

/// The episode in the bytes of a log.
///
/// # Errors
/// Returns an error if a line was changed, moved, left out or put in, when the end is missing or
/// something follows it, or when a record does not hold together; the sentence names the first line
/// at fault.
pub fn decode(bytes: &[u8]) -> Result<Episode, DecodeError> {
    read::decode(bytes)
}

/// The bytes of the log of `episode`: what [`EpisodeLog`] writes.
///
/// # Errors
/// Returns an error if no log can hold it: a number that is not finite, a scenario that no file can
/// say, steps that do not follow each other.
pub fn encode(episode: &Episode) -> Result<Vec<u8>, EncodeError> {
    write::encode(episode)
}

/// Reads the episode log at `path`.
///
/// # Errors
/// [`AssetError::Read`], or [`AssetError::Decode`] with line and reason.
pub fn read_episode_log(path: &Path) -> Result<Episode, AssetError> {
    let bytes = read_bytes(path)?;
    let path = path.to_owned();
    decode(&bytes).map_err(|source| AssetError::Decode {
        path,
        format: "episode log",
        source,
    })
}
