//! Errors of files, as sentences.

use std::io::{self, Read};
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::memory;

/// Reason why bytes do not match their format. Knows no path: decoders work on bytes.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DecodeError {
    /// The bytes end before what they announce.
    #[error(
        "{what} needs {expected_bytes} bytes, found {found_bytes}: the file is cut short or its counts are wrong; copy or export it again"
    )]
    Truncated {
        /// Part that was being read.
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

/// Reason why a format cannot hold the data, and the remedy.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct EncodeError(pub String);

/// Reason why a file could not be read or written.
#[derive(Debug, Error)]
pub enum AssetError {
    /// The operating system refused to read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The operating system refused to write.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The bytes are not a valid file of their format.
    #[error("{}: not a readable {format} file: {source}", path.display())]
    Decode {
        /// Path of the file.
        path: PathBuf,
        /// The format it was taken for.
        format: &'static str,
        /// Error of the decoder.
        source: DecodeError,
    },
    /// Splats, a map or a table of tracks in no form that is read here.
    #[error("{}: {found}; expected {expected}", path.display())]
    Unrecognized {
        /// Path of the file.
        path: PathBuf,
        /// Apparent content of the file.
        found: String,
        /// Supported formats.
        expected: &'static str,
    },
    /// Something that a format cannot hold.
    #[error("{}: cannot be stored as {format}: {source}", path.display())]
    Encode {
        /// Path of the file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
        /// Reason and remedy.
        source: EncodeError,
    },
    /// Cameras that cannot be used.
    #[error("{}: {source}", path.display())]
    Cameras {
        /// Path of the camera file.
        path: PathBuf,
        /// Error, with the camera's name.
        source: DecodeError,
    },
    /// A scene file or a scenario file that is not one.
    #[error("{}: {source}", path.display())]
    Scene {
        /// Path of the file.
        path: PathBuf,
        /// Line, key and reason.
        source: SceneError,
    },
    /// An agent that its world cannot take.
    #[error("{0}")]
    Placement(String),
}

/// Error in a scene file or a scenario file, with its location.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("line {line}, {key}: {reason}")]
pub struct SceneError {
    /// Line in the file, from 1.
    pub line: usize,
    /// The key at fault, such as `rig[2].width_px`.
    pub key: String,
    /// Value found and value expected.
    pub reason: String,
}

/// Reads a whole regular file. Devices and FIFOs are refused: they may have no end, or block
/// forever.
///
/// # Errors
/// [`AssetError::Read`] when `path` is no regular file, is larger than the free memory, or cannot
/// be read.
pub fn read_bytes(path: &Path) -> Result<Vec<u8>, AssetError> {
    read_regular_file(path).map_err(|source| AssetError::Read {
        path: path.to_owned(),
        source,
    })
}

fn read_regular_file(path: &Path) -> io::Result<Vec<u8>> {
    // Examined before it is opened: opening a FIFO waits for its writer.
    let metadata = std::fs::metadata(path)?;
    if metadata.is_dir() {
        return Err(io::Error::other("it is a folder; expected a file"));
    }
    if !metadata.is_file() {
        return Err(io::Error::other(
            "it is a device, a FIFO or a socket; expected a regular file: save the data to one first",
        ));
    }
    memory::require("reading it", metadata.len()).map_err(io::Error::other)?;
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(usize::try_from(metadata.len()).unwrap_or(usize::MAX))?;
    // Never more than was there: a file may grow while it is read.
    std::fs::File::open(path)?
        .take(metadata.len())
        .read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn devices_folders_and_fifos_are_refused_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let message = |path: &Path| read_bytes(path).unwrap_err().to_string();
        assert!(message(Path::new("/dev/zero")).contains("expected a regular file"));
        assert!(message(folder.path()).contains("folder"));
        let fifo = folder.path().join("fifo");
        rustix::fs::mknodat(
            rustix::fs::CWD,
            &fifo,
            rustix::fs::FileType::Fifo,
            rustix::fs::Mode::RUSR,
            0,
        )
        .unwrap();
        assert!(message(&fifo).contains("FIFO"));
        let file = folder.path().join("file");
        std::fs::write(&file, b"content").unwrap();
        assert_eq!(read_bytes(&file).unwrap(), b"content");
        // As large as the file system allows, and without a block on the disk.
        std::fs::File::create(&file)
            .unwrap()
            .set_len(1 << 43)
            .unwrap();
        assert!(message(&file).contains("of memory"));
    }
}
