//! Errors of files, as sentences.

use std::io::{self, Read};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
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

/// Checks that [`read_bytes`] could begin to read `path`: before a complaint about what is in it.
///
/// # Errors
/// [`AssetError::Read`] when `path` is no regular file or cannot be opened.
pub fn check_readable(path: &Path) -> Result<(), AssetError> {
    let opened = regular_file(path).and_then(|_| std::fs::File::open(path));
    opened.map(drop).map_err(|source| AssetError::Read {
        path: path.to_owned(),
        source,
    })
}

/// Bytes of a file that one thread reads at a time.
const PIECE_BYTES: usize = 1 << 23;

/// The metadata of `path`, which is a regular file.
fn regular_file(path: &Path) -> io::Result<std::fs::Metadata> {
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
    Ok(metadata)
}

fn read_regular_file(path: &Path) -> io::Result<Vec<u8>> {
    let metadata = regular_file(path)?;
    memory::require("reading it", metadata.len()).map_err(io::Error::other)?;
    let length = usize::try_from(metadata.len()).unwrap_or(usize::MAX);
    let mut bytes = Vec::new();
    bytes.try_reserve_exact(length)?;
    let file = std::fs::File::open(path)?;
    // Never more than was there: a file may grow while it is read.
    if length < 2 * PIECE_BYTES {
        file.take(metadata.len()).read_to_end(&mut bytes)?;
        return Ok(bytes);
    }
    // It was reserved to find out that there is memory: zeros for which there is none end the
    // program.
    drop(bytes);
    read_pieces(&file, length, PIECE_BYTES)
}

/// The first `length` bytes of a file, pieces of `piece_bytes` side by side: one thread copies
/// about a gigabyte in a second.
fn read_pieces(file: &std::fs::File, length: usize, piece_bytes: usize) -> io::Result<Vec<u8>> {
    // The system gives zeros without writing them.
    let mut bytes = vec![0; length];
    let pieces = bytes.par_chunks_mut(piece_bytes).enumerate();
    pieces.try_for_each(|(piece, bytes)| {
        file.read_exact_at(bytes, (piece * piece_bytes) as u64)
            .map_err(|error| match error.kind() {
                io::ErrorKind::UnexpectedEof => {
                    io::Error::other("it became shorter while it was read")
                }
                _ => error,
            })
    })?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pieces_of_a_file_are_read_to_their_places() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        let content: Vec<u8> = (0..=200).collect();
        std::fs::write(&path, &content).unwrap();
        let file = std::fs::File::open(&path).unwrap();
        for piece_bytes in [1, 7, 67, 200, 201, 1000] {
            assert_eq!(read_pieces(&file, 201, piece_bytes).unwrap(), content);
        }
        assert_eq!(read_pieces(&file, 90, 7).unwrap(), content[..90]);
        let error = read_pieces(&file, 202, 7).unwrap_err();
        assert!(error.to_string().contains("shorter"), "{error}");
        // Two pieces and a half.
        let large: Vec<u8> = (0..PIECE_BYTES * 5 / 2)
            .map(|at| (at % 251) as u8)
            .collect();
        std::fs::write(&path, &large).unwrap();
        assert!(read_bytes(&path).unwrap() == large);
    }

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
