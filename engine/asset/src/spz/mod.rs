//! SPZ, Niantic's quantized splat format, versions 1 to 4.
//!
//! Versions 1 to 3 are one gzip stream, version 4 a plain header, a table of contents and one
//! Zstandard stream an attribute (nianticlabs/spz, README, `src/cc/load-spz.cc`). We write version
//! 4.
//!
//! **Axes.** SPZ stores right-up-back axes; the PLY that a scene was trained into has
//! right-down-front axes. Reading turns a file into the axes of its PLY and writing turns it back,
//! by half a turn about x of means, rotations and spherical harmonics: the same scene as `.ply` and
//! as `.spz` is the same cloud, and PLY to SPZ to PLY is the identity up to quantization. A file
//! that names other axes in the Adobe coordinate-system extension is turned from those. The
//! reference library turns likewise when it is told both systems; files that were made without
//! telling it (its own `ply_to_spz` does not) hold the axes of their source against the format's
//! rule, and arrive here turned.
//!
//! **Precision.** Means 2^-12 m (coarser beyond 2 km, see [`encode`]), scales a factor of e^(1/16)
//! within 4.5e-5 m to 379 m, rotations 10 bits per component, opacities and DC colors 8 bits,
//! further coefficients 8 bits within -1 to 1. Degree 4 is read to degree 3.

mod attributes;
mod axes;
mod container;

use std::ops::Range;
use std::path::Path;

use decouplegs_scene::SplatCloud;

use crate::{AssetError, DecodeError, EncodeError, write_atomically};
use attributes::{Packed, pack, unpack};
use axes::Signs;
use container::Wrapped;

pub(crate) use axes::flip;

/// Reads the splats of any version.
///
/// # Errors
/// A [`DecodeError`] that names the stream, count or version at fault.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let packed = container::read(bytes)?;
    Ok(turned(&packed, 0..packed.layout.count))
}

/// Splats that are decoded at once where they are read in pieces.
const PIECE: usize = 1 << 16;

/// Reads the splats of any version piece by piece: `each` gets the number of all and the next ones,
/// in the order of the file, so that they are never all decoded at once. False where `each` ended
/// it.
///
/// # Errors
/// Returns the errors of [`decode`].
pub(crate) fn decode_pieces(
    bytes: &[u8],
    each: &mut impl FnMut(usize, SplatCloud) -> bool,
) -> Result<bool, DecodeError> {
    let packed = container::read(bytes)?;
    let count = packed.layout.count;
    // A file without splats has a degree: it comes as one piece.
    let mut pieces = (0..count.max(1)).step_by(PIECE);
    Ok(pieces.all(|first| {
        let piece = first..count.min(first + PIECE);
        each(count, turned(&packed, piece))
    }))
}

/// Splats of a range in the axes of a PLY.
fn turned(packed: &Packed, splats: Range<usize>) -> SplatCloud {
    let mut cloud = unpack(packed, splats);
    packed.axes.turn_to_ply(&mut cloud);
    cloud
}

/// Reads the splats of any version in the axes that they are stored in.
pub(crate) fn decode_as_stored(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let packed = container::read(bytes)?;
    Ok(unpack(&packed, 0..packed.layout.count))
}

/// `cloud` as the bytes of a version 4 file.
///
/// Means keep 12 bits after the point where the cloud lies within 2048 m of its origin, fewer where
/// it is larger. Scales, colors and coefficients outside the ranges of the format are clamped to
/// them.
///
/// # Errors
/// Returns an error if a splat is defective ([`SplatCloud::defect_of`]) or a mean lies beyond 8388
/// km: SPZ has no code for either.
pub fn encode(cloud: &SplatCloud) -> Result<Vec<u8>, EncodeError> {
    let mut bytes = Vec::new();
    match wrapped(cloud)?.write_to(&mut bytes) {
        Ok(()) => Ok(bytes),
        Err(error) => unreachable!("a Vec takes every write: {error}"),
    }
}

fn wrapped(cloud: &SplatCloud) -> Result<Wrapped, EncodeError> {
    Wrapped::new(pack(cloud, &Signs::between_ply_and_rub())?)
}

/// Writes `cloud` to `path`, atomically.
///
/// # Errors
/// Returns the errors of [`encode`], and an error if the operating system refuses to write.
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<(), AssetError> {
    let wrapped = wrapped(cloud).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: "SPZ",
        source,
    })?;
    write_atomically(path, |file| wrapped.write_to(file))
}
