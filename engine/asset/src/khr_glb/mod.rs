//! Splats in binary glTF (`.glb`) by the extension KHR_gaussian_splatting.
//!
//! Every primitive of points that has the extension is read, where the nodes of the scene put it:
//! their transforms apply to means, scales, rotations and spherical harmonics, mirrors and unequal
//! scales included. Attributes are floats or integers, normalized or not; rotations x, y, z, w;
//! opacities 0 to 1; spherical harmonics `[coefficient][rgb]` with the signs of INRIA's. The child
//! extension with an SPZ inside (`KHR_gaussian_splatting_compression_spz_2`) is read too.
//!
//! **Scales.** The ratified extension stores them as they are, never negative. Its drafts until the
//! release candidate of January 2026 stored natural logarithms, under the same name. A file with a
//! scale below zero, which logarithms of all splats smaller than a meter are, is taken for such a
//! draft as a whole.
//!
//! **Axes.** glTF says y is up. Clouds have the axes of COLMAP, as in a PLY: y is down. Half a turn
//! about z is between them, when a file is read and when it is written. It changes signs alone, so
//! a cloud that is written reads back to the bit.
//!
//! **Colors** are as stored. A file that says `lin_rec709_display` means light, which should be
//! blended as such and turned to display values afterwards; it is drawn too dark here, and
//! [`read_notes`] says so.

mod accessor;
mod document;
mod nodes;
mod place;
mod splats;
mod write;

use decouplegs_scene::SplatCloud;

use crate::DecodeError;
use crate::memory::decoded_bytes_max;
use document::Document;

pub use write::{encode, write};

/// Name of the format for users.
pub(crate) const NAME: &str = "KHR_gaussian_splatting glTF";
/// The extension, and what its attributes' names begin with.
const EXTENSION: &str = "KHR_gaussian_splatting";
/// The child extension with an SPZ inside.
const EXTENSION_SPZ: &str = "KHR_gaussian_splatting_compression_spz_2";
/// Bytes of the file's header.
const HEADER_BYTES: usize = 12;
/// Bytes before each chunk.
const CHUNK_HEADER_BYTES: usize = 8;
/// Signs of the axes of a cloud in the axes of a file, and of a file in those of a cloud.
const HALF_TURN: [f32; 3] = [-1.0, -1.0, 1.0];
const CHUNK_JSON: u32 = u32::from_le_bytes(*b"JSON");
const CHUNK_BINARY: u32 = u32::from_le_bytes(*b"BIN\0");

/// Reads all splats of the scene.
///
/// # Errors
/// A [`DecodeError`] that names the accessor, node or extension at fault.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let (text, binary) = chunks(bytes)?;
    let document = Document::parse(text)?;
    splats::gather(&document, binary, decoded_bytes_max(bytes.len()))
}

/// Reads the properties whose meaning differs from the rendered one, one sentence each.
///
/// # Errors
/// Returns the errors of [`decode`].
pub fn read_notes(bytes: &[u8]) -> Result<Vec<String>, DecodeError> {
    Ok(Document::parse(chunks(bytes)?.0)?.notes())
}

/// The JSON and the binary chunk, which may be absent.
fn chunks(bytes: &[u8]) -> Result<(&[u8], &[u8]), DecodeError> {
    let word = |at: usize| {
        bytes
            .get(at..at + 4)
            .map(|word| u32::from_le_bytes([word[0], word[1], word[2], word[3]]))
    };
    let truncated = |what: &str, expected: usize| DecodeError::Truncated {
        what: what.to_owned(),
        expected_bytes: expected as u64,
        found_bytes: bytes.len() as u64,
    };
    let (Some(version), Some(length)) = (word(4), word(8)) else {
        return Err(truncated("the header", HEADER_BYTES));
    };
    if version != 2 {
        return Err(DecodeError::Unsupported(format!(
            "binary glTF of version {version}; version 2 is read"
        )));
    }
    if length as usize > bytes.len() {
        return Err(truncated("the file", length as usize));
    }
    let (mut text, mut binary) = (None, &[][..]);
    let mut at = HEADER_BYTES;
    while at < length as usize {
        let (Some(size), Some(kind)) = (word(at), word(at + 4)) else {
            return Err(truncated("the header of a chunk", at + CHUNK_HEADER_BYTES));
        };
        let start = at + CHUNK_HEADER_BYTES;
        let content = bytes
            .get(start..start + size as usize)
            .ok_or_else(|| truncated("a chunk", start + size as usize))?;
        match kind {
            CHUNK_JSON if text.is_none() => text = Some(content),
            CHUNK_BINARY if binary.is_empty() => binary = content,
            // Others are to be passed over.
            _ => {}
        }
        at = start + size as usize;
    }
    let text = text.ok_or_else(|| DecodeError::Malformed("there is no chunk of JSON".into()))?;
    Ok((text, binary))
}
