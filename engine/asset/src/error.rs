//! What can be wrong with a file, as sentences.

use std::path::{Path, PathBuf};

use thiserror::Error;

/// Why bytes are not what their format promises. Knows no path: decoders work on bytes.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DecodeError {
    /// The bytes end before what they announce.
    #[error(
        "{what} needs {expected_bytes} bytes, found {found_bytes}: the file is cut short or its counts are wrong; copy or export it again"
    )]
    Truncated {
        /// What was being read.
        what: String,
        /// Bytes announced.
        expected_bytes: u64,
        /// Bytes there.
        found_bytes: u64,
    },
    /// Something that the format requires is missing or contradicts itself.
    #[error("{0}")]
    Malformed(String),
    /// A legal variant that is not read here; the sentence says what to do.
    #[error("{0}")]
    Unsupported(String),
}

/// Why a format cannot hold something, and what to do.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct EncodeError(pub String);

/// Why a file could not be read or written.
#[derive(Debug, Error)]
pub enum AssetError {
    /// The operating system refused to read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The refusal.
        source: std::io::Error,
    },
    /// The operating system refused to write.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The refusal.
        source: std::io::Error,
    },
    /// The bytes are not a valid file of their format.
    #[error("{}: not a readable {format} file: {source}", path.display())]
    Decode {
        /// The file.
        path: PathBuf,
        /// The format it was taken for.
        format: &'static str,
        /// What is wrong.
        source: DecodeError,
    },
    /// Neither content nor extension tell a format that is read here.
    #[error("{}: {found}; expected INRIA .ply, PlayCanvas compressed .ply, .splat, .spz, .sog, .glb, .pt or .safetensors", path.display())]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What it looks like, and what to do.
        found: String,
    },
    /// A map or a table of tracks in no form that is read here.
    #[error("{}: {found}; expected {expected}", path.display())]
    Unrecognised {
        /// The file.
        path: PathBuf,
        /// What it looks like.
        found: String,
        /// What is read.
        expected: &'static str,
    },
    /// Something that a format cannot hold.
    #[error("{}: cannot be stored as {format}: {source}", path.display())]
    Encode {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// Why not, and what to do.
        source: EncodeError,
    },
    /// Cameras that cannot be used.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// The camera file.
        path: PathBuf,
        /// What is wrong with which camera.
        source: DecodeError,
    },
    /// A scene file or a scenario file that is not one.
    #[error("{}: {source}", path.display())]
    Scene {
        /// The file.
        path: PathBuf,
        /// Line, key and reason.
        source: SceneError,
    },
    /// An agent that its world cannot take.
    #[error("{0}")]
    Placement(String),
}

/// What is wrong with a scene file or a scenario file, and where.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("line {line}, {key}: {reason}")]
pub struct SceneError {
    /// Line in the file, from 1.
    pub line: usize,
    /// The key at fault, such as `rig[2].width_px`.
    pub key: String,
    /// What was found and what was expected.
    pub reason: String,
}

/// Reads a whole file, naming it if that fails.
pub(crate) fn read_bytes(path: &Path) -> Result<Vec<u8>, AssetError> {
    std::fs::read(path).map_err(|source| AssetError::Read { path: path.to_owned(), source })
}
