//! SOG version 2, PlayCanvas' splats in lossless WebP images: a zip (`.sog`) or the folder that was
//! zipped.
//!
//! `meta.json` says how the pixels are meant, one pixel per splat, row by row: 16 bits per axis for
//! means, of which the logarithm is stored (`sign(x) ln(1 + |x|)` within an extent); rotations as
//! the three smallest components in 8 bits each, alpha telling which was left out; scales (natural
//! logarithms) and DC colors as indices into codebooks of 256 numbers; opacity in 8 bits; further
//! coefficients as a 16-bit index into a palette, itself an image of indices into a codebook
//! (developer.playcanvas.com, user manual, 'The SOG Format').
//!
//! Coordinates are those of the PLY that the file was made from, and stay as they are.

mod codebook;
mod lod;
mod meta;
mod palette;
mod pixels;
mod texture;
mod write;

use std::borrow::Cow;
use std::path::Path;

use decouplegs_scene::SplatCloud;

use crate::error::read_bytes;
use crate::zip::Archive;
use crate::{AssetError, DecodeError};
use meta::Meta;

pub(crate) use lod::{LOD_META, read_set};
pub use write::{encode, write};

/// Name of the format for users.
pub(crate) const NAME: &str = "SOG";
/// The entry that describes the others.
pub(crate) const META: &str = "meta.json";
/// Codebooks and a few names; real ones have some ten kilobytes.
const META_BYTES_MAX: u64 = 1 << 20;
/// Number of splats that a file may claim however small it is.
const SPLATS_ALWAYS: u64 = 1 << 14;
/// Number of further splats that a file may claim for each of its bytes: real files take 10 to 20
/// bytes per splat.
const SPLATS_PER_BYTE_MAX: u64 = 1;

/// Reads the splats of a zipped bundle.
///
/// # Errors
/// A [`DecodeError`] that names the entry, count or variant at fault.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let archive = Archive::parse(bytes)?;
    let folder = folder_of(&archive).ok_or_else(|| {
        DecodeError::Malformed(format!(
            "the zip has no '{META}'; a SOG bundle has one beside its images"
        ))
    })?;
    let at = |name: &str| {
        archive.checked(
            &format!("{folder}{name}"),
            bytes.len() as u64 + META_BYTES_MAX,
        )
    };
    decode_files(
        &archive.checked(&format!("{folder}{META}"), META_BYTES_MAX)?,
        bytes.len() as u64,
        at,
    )
}

/// Reads the splats of an unzipped bundle: `folder` has the `meta.json`.
///
/// # Errors
/// [`AssetError::Read`] or [`AssetError::Decode`].
pub fn read_folder(folder: &Path) -> Result<SplatCloud, AssetError> {
    let meta_path = folder.join(META);
    let meta = read_bytes(&meta_path)?;
    let decode_error = |source| AssetError::Decode {
        path: meta_path.clone(),
        format: NAME,
        source,
    };
    let parsed = Meta::parse(&meta).map_err(decode_error)?;
    let mut files = Vec::new();
    for name in parsed.files() {
        // A name with a slash could lead anywhere.
        if name.contains(['/', '\\']) || name.starts_with('.') {
            let message = format!("names the image '{name}'; images lie beside {META}");
            return Err(decode_error(DecodeError::Malformed(message)));
        }
        files.push((name.to_owned(), read_bytes(&folder.join(name))?));
    }
    let total = meta.len() as u64
        + files
            .iter()
            .map(|(_, bytes)| bytes.len() as u64)
            .sum::<u64>();
    let file = |name: &str| {
        let found = files.iter().find(|(known, _)| known == name);
        found
            .map(|(_, bytes)| Cow::Borrowed(bytes.as_slice()))
            .ok_or_else(|| DecodeError::Malformed(format!("no '{name}'")))
    };
    decode_files(&meta, total, file).map_err(decode_error)
}

/// True if a zip is a SOG bundle.
pub(crate) fn is_bundle(archive: &Archive<'_>) -> bool {
    folder_of(archive).is_some()
}

/// The folder in a zip that has the `meta.json`, with its slash: some zip the folder, some what is
/// in it.
fn folder_of<'n>(archive: &'n Archive<'_>) -> Option<&'n str> {
    let folder = |name: &'n str| {
        name.strip_suffix(META)
            .filter(|folder| folder.is_empty() || folder.ends_with('/'))
    };
    archive
        .names()
        .filter_map(folder)
        .min_by_key(|folder| folder.len())
}

/// The splats that `meta` and the images beside it hold, together `total_bytes`.
fn decode_files<'b>(
    meta: &[u8],
    total_bytes: u64,
    file: impl Fn(&str) -> Result<Cow<'b, [u8]>, DecodeError>,
) -> Result<SplatCloud, DecodeError> {
    let meta = Meta::parse(meta)?;
    let count_max = SPLATS_ALWAYS + SPLATS_PER_BYTE_MAX * total_bytes;
    if meta.count > count_max {
        return Err(DecodeError::Malformed(format!(
            "{} splats in {total_bytes} bytes; at most {count_max} are believed: the count is damaged, export the file again",
            meta.count
        )));
    }
    pixels::unpack(&meta, file)
}
