//! The PLY of the original 3DGS (Kerbl et al., 2023), as nearly every trainer writes it.
//!
//! One row a splat: `x y z`, optional normals, `f_dc_0..2`, `f_rest_*`, `opacity`, `scale_0..2`,
//! `rot_0..3`. Opacity is a logit, scales are natural logarithms, rotations w, x, y, z of any
//! length. `f_rest` is channel-major: all red coefficients, then all green, then all blue.
//! Properties are found by name, of any scalar type, among any others. Coordinates are the
//! trainer's and stay as they are. Where DC has several terms a channel, those of a Fourier series
//! over time (Street Gaussians), their mean over time is read.
//!
//! Other trainers leave out or add columns. Read are files of 2DGS, whose splats are flat (no
//! `scale_2`: the third scale is 1e-6), of one scale for all axes, with `red green blue` instead of
//! `f_dc` (nerfstudio), and with Mip-Splatting's `filter_3D`, which widens splats and fades them.
//! Splats that move with time are refused. Coordinates that are stored as doubles and are large,
//! as georeferenced ones are, are read relative to an origin ([`decode_placed`]).

mod columns;

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::Path;

use decouplegs_scene::SplatCloud;
use glam::DVec3;
use rayon::prelude::*;

use crate::activation::{log_of_scale, logit};
use crate::ply::{Column, Ply, Rows, Scalar};
use crate::{AssetError, DecodeError, PlacedSplats, SplatLabels, write_atomically};
use columns::SplatColumns;

pub(crate) use columns::{RestColumns, mean_weights, row_slices};

/// The element that holds the splats of a file with one model.
const ELEMENT: &str = "vertex";

/// Reads the splats of element `vertex`.
///
/// Splats that cannot be drawn (NaN, zero rotation) are kept for [`SplatCloud::defect_of`] to
/// count.
///
/// # Errors
/// A [`DecodeError`] that names the property, count or variant at fault.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    decode_ply(&Ply::parse(bytes)?, ELEMENT)
}

/// Reads the splats of element `vertex` relative to an origin, world coordinates: zero unless
/// coordinates are doubles that f32 would round by more than a millimeter. With the labels of
/// splats, where there are such.
///
/// # Errors
/// Returns the errors of [`decode`].
pub fn decode_placed(bytes: &[u8]) -> Result<PlacedSplats, DecodeError> {
    let ply = Ply::parse(bytes)?;
    let origin = origin_of(&ply)?;
    Ok(PlacedSplats {
        cloud: decode_relative(&ply, ELEMENT, origin)?,
        origin,
        labels: SplatLabels::from_ply(&ply, ELEMENT)?,
    })
}

/// Coordinates up to this are exact to a millimeter as f32, meters.
const EXACT_M: f64 = 16_384.0;

/// The middle of the splats in whole meters, where their coordinates are large doubles; else zero.
fn origin_of(ply: &Ply<'_>) -> Result<DVec3, DecodeError> {
    let names = ["x", "y", "z"];
    let columns: Option<Vec<Column>> = names
        .iter()
        .map(|name| ply.column_if_present(ELEMENT, name))
        .collect();
    let Some(columns) = columns else {
        return Ok(DVec3::ZERO);
    };
    let rows = ply.rows(ELEMENT)?;
    let nowhere = || (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let (least, most) = rows
        .bytes
        .par_chunks_exact(rows.stride.max(1))
        .map(|row| DVec3::from_array(std::array::from_fn(|axis| columns[axis].f64_of(row))))
        .filter(|point| point.is_finite())
        .fold(nowhere, |(least, most), point| {
            (least.min(point), most.max(point))
        })
        .reduce(nowhere, |a, b| (a.0.min(b.0), a.1.max(b.1)));
    let largest_m = least.abs().max(most.abs()).max_element();
    if !(EXACT_M..1e12).contains(&largest_m) {
        return Ok(DVec3::ZERO);
    }
    if columns.iter().any(|column| column.scalar != Scalar::F64) {
        warn_of_rounded(largest_m);
        return Ok(DVec3::ZERO);
    }
    Ok((0.5 * (least + most)).round())
}

/// Warns where coordinates up to `largest_m` are large for 32 bits, meters.
fn warn_of_rounded(largest_m: f64) {
    if (EXACT_M..1e12).contains(&largest_m) {
        // A power of two below the coordinate, over the 24 bits that a float has.
        let step_m = largest_m.log2().floor().exp2() / f64::from(1 << 23);
        log::warn!(
            "coordinates up to {largest_m:.0} m are stored in 32 bits: they are rounded to steps of {step_m} m; export \
             them as doubles, or relative to an origin"
        );
    }
}

/// Reads the splats of the element called `element`: files that keep one element a model
/// (`vertex_background`, `vertex_obj_007`) are read one model at a time.
///
/// # Errors
/// Returns the errors of [`decode`].
pub fn decode_element(bytes: &[u8], element: &str) -> Result<SplatCloud, DecodeError> {
    decode_ply(&Ply::parse(bytes)?, element)
}

/// Reads the splats of `element` of a parsed file.
pub(crate) fn decode_ply(ply: &Ply<'_>, element: &str) -> Result<SplatCloud, DecodeError> {
    decode_relative(ply, element, DVec3::ZERO)
}

/// Reads the splats of `element`, their means relative to `origin`.
fn decode_relative(ply: &Ply<'_>, element: &str, origin: DVec3) -> Result<SplatCloud, DecodeError> {
    let columns = SplatColumns::find(ply, element)?;
    Ok(columns.read(&ply.rows(element)?, origin))
}

/// Bytes of rows that are in memory at once where a file is read piece by piece.
const PIECE_BYTES: usize = 16 << 20;

/// Reads the splats of the binary file at `path` piece by piece: `each` gets the number of all and
/// the next ones, in the order of the file, which is never whole in memory. The next piece is read
/// while one is decoded. `Some(false)` where `each` ended it. `None`, before any piece, for a file
/// that is read whole: one of text, with coordinates that are doubles, of another format, or at
/// fault.
///
/// # Errors
/// Returns an error if the operating system refuses to read, or the file is cut meanwhile.
pub(crate) fn read_pieces(
    path: &Path,
    each: &mut impl FnMut(usize, SplatCloud) -> bool,
) -> io::Result<Option<bool>> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut start = Vec::new();
    let mut header = Read::by_ref(&mut file).take(Ply::HEADER_BYTES_MAX as u64);
    header.read_to_end(&mut start)?;
    let Some((ply, found)) = Ply::of_header(&start, length, ELEMENT) else {
        return Ok(None);
    };
    let is_single = |name: &str| {
        let column = ply.column_if_present(ELEMENT, name);
        column.is_some_and(|column| column.scalar == Scalar::F32)
    };
    if !["x", "y", "z"].into_iter().all(is_single) {
        return Ok(None);
    }
    let Ok(columns) = SplatColumns::find(&ply, ELEMENT) else {
        return Ok(None);
    };
    file.seek(SeekFrom::Start(found.start))?;
    let rows_each = (PIECE_BYTES / found.stride).max(1);
    let rows_from = |first: usize| rows_each.min(found.count.saturating_sub(first));
    let mut read_rows = |bytes: &mut Vec<u8>, count: usize| {
        bytes.resize(count * found.stride, 0);
        file.read_exact(bytes)
    };
    let (mut bytes, mut next, mut largest_m) = (Vec::new(), Vec::new(), 0f32);
    read_rows(&mut bytes, rows_from(0))?;
    // A file without splats has a degree: it comes as one piece.
    for first in (0..found.count.max(1)).step_by(rows_each) {
        let rows = Rows {
            bytes: &bytes,
            stride: found.stride,
            count: rows_from(first),
        };
        let (cloud, read) = rayon::join(
            || columns.read(&rows, DVec3::ZERO),
            || read_rows(&mut next, rows_from(first + rows_each)),
        );
        read?;
        let means = cloud.means.iter();
        let finite = means.filter(|mean| mean.iter().all(|x| x.is_finite()));
        largest_m = (finite.flatten()).fold(largest_m, |largest, x| largest.max(x.abs()));
        if !each(found.count, cloud) {
            return Ok(Some(false));
        }
        std::mem::swap(&mut bytes, &mut next);
    }
    warn_of_rounded(f64::from(largest_m));
    Ok(Some(true))
}

/// Writes `cloud` to `path`, atomically.
///
/// # Errors
/// Returns an error if the operating system refuses.
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<(), AssetError> {
    write_atomically(path, |file| write_to(file, cloud))
}

/// `cloud` as the bytes of a file.
#[must_use]
pub fn encode(cloud: &SplatCloud) -> Vec<u8> {
    let mut bytes = Vec::new();
    match write_to(&mut bytes, cloud) {
        Ok(()) => bytes,
        Err(error) => unreachable!("a Vec takes every write: {error}"),
    }
}

/// Splats whose rows are built in memory at once.
const BLOCK: usize = 1 << 14;

fn write_to(file: &mut impl Write, cloud: &SplatCloud) -> io::Result<()> {
    write!(
        file,
        "ply\nformat binary_little_endian 1.0\nelement {ELEMENT} {}\n",
        cloud.len()
    )?;
    let stride = cloud.rest_stride();
    let rest = (0..3 * stride).map(|i| format!("f_rest_{i}"));
    let before = [
        "x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2",
    ]
    .map(String::from);
    let after = [
        "opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3",
    ]
    .map(String::from);
    for name in before.into_iter().chain(rest).chain(after) {
        writeln!(file, "property float {name}")?;
    }
    writeln!(file, "end_header")?;
    let row_bytes = (17 + 3 * stride) * size_of::<f32>();
    let mut block = vec![0; row_bytes * BLOCK.min(cloud.len())];
    for first in (0..cloud.len()).step_by(BLOCK) {
        let count = BLOCK.min(cloud.len() - first);
        let rows = &mut block[..count * row_bytes];
        rows.par_chunks_exact_mut(row_bytes)
            .enumerate()
            .for_each(|(i, row)| fill_row(row, cloud, first + i));
        file.write_all(rows)?;
    }
    Ok(())
}

fn fill_row(row: &mut [u8], cloud: &SplatCloud, splat: usize) {
    let rest = cloud.rest_of(splat);
    let channel_major =
        (0..3).flat_map(|channel| rest.iter().map(move |coefficient| coefficient[channel]));
    let values = cloud.means[splat]
        .into_iter()
        .chain([0.0; 3])
        .chain(cloud.sh_dc[splat])
        .chain(channel_major)
        .chain([logit(cloud.opacities[splat])])
        .chain(cloud.scales[splat].map(log_of_scale))
        .chain(cloud.rotations[splat]);
    for (to, value) in row.chunks_exact_mut(size_of::<f32>()).zip(values) {
        to.copy_from_slice(&value.to_le_bytes());
    }
}

#[cfg(test)]
mod tests;
