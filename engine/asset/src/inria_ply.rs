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

use std::io::{self, Write};
use std::path::Path;

use decouplegs_scene::{SplatCloud, sh};
use glam::DVec3;
use rayon::prelude::*;

use crate::activation::{log_of_scale, logit, normalized, scale_of_log, sigmoid};
use crate::ply::{Column, Ply, Rows, Scalar};
use crate::unknown_keys::UnknownKeys;
use crate::{AssetError, DecodeError, PlacedSplats, SplatLabels, write_atomically};

/// Moments over which colors that change with time are averaged.
const MOMENTS: usize = 64;
/// Most terms of a Fourier series that are read; the trainer's default is 5.
const TERMS_MAX: usize = 1024;

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
    let (mut least, mut most) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for row in rows.bytes.chunks_exact(rows.stride.max(1)) {
        let point = DVec3::from_array(std::array::from_fn(|axis| columns[axis].f64_of(row)));
        if point.is_finite() {
            (least, most) = (least.min(point), most.max(point));
        }
    }
    let largest_m = least.abs().max(most.abs()).max_element();
    if !(EXACT_M..1e12).contains(&largest_m) {
        return Ok(DVec3::ZERO);
    }
    if columns.iter().any(|column| column.scalar != Scalar::F64) {
        // A power of two below the coordinate, over the 24 bits that a float has.
        let step_m = largest_m.log2().floor().exp2() / f64::from(1 << 23);
        log::warn!(
            "coordinates up to {largest_m:.0} m are stored in 32 bits: they are rounded to steps of {step_m} m; export \
             them as doubles, or relative to an origin"
        );
        return Ok(DVec3::ZERO);
    }
    Ok((0.5 * (least + most)).round())
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
    if !ply.has_element(element) {
        return Err(DecodeError::Malformed(format!(
            "there is no element '{element}', only: {}",
            ply.element_names()
        )));
    }
    let columns = |names: &[&str]| -> Result<Vec<Column>, DecodeError> {
        names.iter().map(|name| ply.column(element, name)).collect()
    };
    check_properties(ply, element)?;
    let mean = columns(&["x", "y", "z"])?;
    let scale = scale_columns(ply, element)?;
    let rotation = columns(&["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let opacity = ply.column(element, "opacity")?;
    let dc = dc_columns(ply, element)?;
    let rest = RestColumns::find(ply, element)?;
    let rows = ply.rows(element)?;
    let means = if origin == DVec3::ZERO {
        triples(&rows, &mean)
    } else {
        let relative = |axis: usize, row: &[u8]| (mean[axis].f64_of(row) - origin[axis]) as f32;
        row_slices(&rows)
            .map(|row| std::array::from_fn(|axis| relative(axis, row)))
            .collect()
    };
    let mut cloud = SplatCloud {
        means,
        scales: row_slices(&rows)
            .map(|row| {
                let logarithms: [f32; 3] = std::array::from_fn(|axis| {
                    scale[axis].map_or(FLAT_LOG_SCALE, |column| column.f32_of(row))
                });
                logarithms.map(scale_of_log)
            })
            .collect(),
        rotations: row_slices(&rows)
            .map(|row| normalized(std::array::from_fn(|i| rotation[i].f32_of(row))))
            .collect(),
        opacities: row_slices(&rows)
            .map(|row| sigmoid(opacity.f32_of(row)))
            .collect(),
        sh_degree: rest.degree,
        sh_dc: row_slices(&rows)
            .map(|row| std::array::from_fn(|channel| dc.value(channel, row)))
            .collect(),
        sh_rest: rest.read(&rows, |column, row| column.f32_of(row)),
    };
    if let Some(filter) = ply.column_if_present(element, "filter_3D") {
        log::warn!("Mip-Splatting's filter_3D is applied to scales and opacities");
        let widths = row_slices(&rows).map(|row| filter.f32_of(row));
        cloud
            .scales
            .par_iter_mut()
            .zip(&mut cloud.opacities)
            .zip(widths)
            .for_each(|((scales, opacity), width)| filtered(scales, opacity, width));
    }
    Ok(cloud)
}

/// Widens a splat by a low-pass filter of standard deviation `width`, and fades it as much as it
/// grows (Yu et al., "Mip-Splatting", 2024, equation 9).
fn filtered(scales: &mut [f32; 3], opacity: &mut f32, width: f32) {
    let mut share = 1.0;
    for scale in scales {
        let wider = scale.hypot(width);
        share *= *scale / wider;
        *scale = wider;
    }
    if share.is_finite() {
        *opacity *= share;
    }
}

/// Logarithm of the third scale of flat splats, 1e-6, as the authors of 2DGS advise.
const FLAT_LOG_SCALE: f32 = -13.815_511;
/// Band 0 of the spherical harmonics.
const SH_BAND_0: f32 = 0.282_094_79;

/// Properties that change nothing that is drawn. Ends in `_`: all names that begin so.
const HARMLESS: [&str; 33] = [
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "opacity",
    "filter_3D",
    "red",
    "green",
    "blue",
    "alpha",
    "f_dc_",
    "f_rest_",
    "scale_",
    "rot_",
    "confidence",
    "label",
    "class",
    "instance",
    "segment",
    "semantic_",
    "obj_dc_",
    "id",
    "objectid",
    "ids",
    "uid",
    "score",
    "feature_",
    "language_feature_",
    "embedding_",
    "road_mask",
    "sky_mask",
];
/// Properties of splats that move, bend or shine otherwise than those that are drawn here, with
/// what they are.
const REFUSED: [(&str, &str); 7] = [
    ("trbf_", "splats that appear and vanish with time"),
    ("motion_", "splats that move with time"),
    ("omega_", "splats that turn with time"),
    ("f_t_", "colors that change with time"),
    ("t_scale", "splats of four dimensions"),
    ("sb_params_", "colors of spherical Betas"),
    (
        "beta",
        "splats with the kernel of Deformable Beta Splatting",
    ),
];

/// Refuses files with another kind of splat, and warns of unknown properties.
fn check_properties(ply: &Ply<'_>, element: &str) -> Result<(), DecodeError> {
    let mut unknown = UnknownKeys::default();
    for name in ply.property_names(element) {
        if let Some((_, what)) = REFUSED.iter().find(|(start, _)| name.starts_with(start)) {
            return Err(DecodeError::Unsupported(format!(
                "the property '{name}' tells of {what}, which are not drawn; export plain Gaussian splats"
            )));
        }
        let is_known = HARMLESS
            .iter()
            .any(|known| *known == name || known.ends_with('_') && name.starts_with(known));
        if !is_known {
            unknown.add(name);
        }
    }
    unknown.warn("properties of splats");
    Ok(())
}

/// Columns of the logarithms of the scales; `None` for the third of flat splats.
fn scale_columns(ply: &Ply<'_>, element: &str) -> Result<[Option<Column>; 3], DecodeError> {
    let found = ["scale_0", "scale_1", "scale_2"].map(|name| ply.column_if_present(element, name));
    match found {
        [Some(_), Some(_), None] => {
            log::warn!("two scales a splat, as 2DGS writes them: the third is 1e-6");
            Ok(found)
        }
        [Some(_), None, None] => {
            log::warn!("one scale a splat: it holds for all three axes");
            Ok([found[0]; 3])
        }
        _ => {
            for name in ["scale_0", "scale_1", "scale_2"] {
                ply.column(element, name)?;
            }
            Ok(found)
        }
    }
}

/// The `f_dc` columns of an element, channel-major: one per channel, or the terms of its series
/// over time.
struct DcColumns {
    columns: Vec<Column>,
    /// True if they are the colors themselves, 0 to 1 or integers.
    are_colors: bool,
    /// Mean of each term.
    weights: Vec<f64>,
}

/// Finds `f_dc_0..` in `element`.
fn dc_columns(ply: &Ply<'_>, element: &str) -> Result<DcColumns, DecodeError> {
    let count = ply
        .property_names(element)
        .filter(|name| name.starts_with("f_dc_"))
        .count();
    let colors = ["red", "green", "blue"].map(|name| ply.column_if_present(element, name));
    if let ([Some(red), Some(green), Some(blue)], 0) = (colors, count) {
        log::warn!("colors are red, green and blue, as nerfstudio writes them, without bands");
        return Ok(DcColumns {
            columns: vec![red, green, blue],
            are_colors: true,
            weights: vec![1.0],
        });
    }
    // Fewer than three are missed by name.
    let terms = if count > 3 && count.is_multiple_of(3) {
        count / 3
    } else {
        1
    };
    let columns = (0..3 * terms)
        .map(|i| ply.column(element, &format!("f_dc_{i}")))
        .collect::<Result<_, DecodeError>>()?;
    Ok(DcColumns {
        columns,
        are_colors: false,
        weights: mean_weights(terms)?,
    })
}

impl DcColumns {
    fn value(&self, channel: usize, row: &[u8]) -> f32 {
        let terms = self.weights.len();
        let columns = &self.columns[channel * terms..(channel + 1) * terms];
        match columns {
            [only] if self.are_colors => (only.share_of(row) - 0.5) / SH_BAND_0,
            [only] => only.f32_of(row),
            _ => columns
                .iter()
                .zip(&self.weights)
                .map(|(column, weight)| f64::from(column.f32_of(row)) * weight)
                .sum::<f64>() as f32,
        }
    }
}

/// The `f_rest` columns of an element, `[coefficient][rgb]`.
pub(crate) struct RestColumns {
    /// Degree that is read: a fourth band, which nothing here evaluates, is left out.
    pub(crate) degree: u8,
    columns: Vec<[Column; 3]>,
}

impl RestColumns {
    /// Finds `f_rest_0..` in `element` and the degree that their number means.
    pub(crate) fn find(ply: &Ply<'_>, element: &str) -> Result<Self, DecodeError> {
        let count = ply
            .property_names(element)
            .filter(|name| name.starts_with("f_rest_"))
            .count();
        let degree: u8 = match count {
            0 => 0,
            9 => 1,
            24 => 2,
            45 | 72 => sh::DEGREE_MAX,
            _ => {
                return Err(DecodeError::Malformed(format!(
                    "element '{element}' has {count} f_rest properties; degree 0 to 4 has 0, 9, 24, 45 or 72"
                )));
            }
        };
        let stride = count / 3;
        let columns = (0..sh::coefficient_count(degree) - 1)
            .map(|coefficient| {
                let of = |channel: usize| {
                    ply.column(
                        element,
                        &format!("f_rest_{}", channel * stride + coefficient),
                    )
                };
                Ok([of(0)?, of(1)?, of(2)?])
            })
            .collect::<Result<_, DecodeError>>()?;
        Ok(Self { degree, columns })
    }

    /// All coefficients of all rows, each through `value`.
    pub(crate) fn read(
        &self,
        rows: &Rows<'_>,
        value: impl Fn(Column, &[u8]) -> f32 + Sync,
    ) -> Vec<[f32; 3]> {
        let stride = self.columns.len();
        if stride == 0 {
            return Vec::new();
        }
        let mut rest = vec![[0.0; 3]; rows.count * stride];
        rest.par_chunks_mut(stride)
            .zip(row_slices(rows))
            .for_each(|(coefficients, row)| {
                for (coefficient, columns) in coefficients.iter_mut().zip(&self.columns) {
                    *coefficient = columns.map(|column| value(column, row));
                }
            });
        rest
    }
}

/// The rows, each as its bytes. Only for rows with properties.
pub(crate) fn row_slices<'a>(
    rows: &Rows<'a>,
) -> impl IndexedParallelIterator<Item = &'a [u8]> + use<'a> {
    rows.bytes.par_chunks_exact(rows.stride.max(1))
}

fn triples(rows: &Rows<'_>, columns: &[Column]) -> Vec<[f32; 3]> {
    row_slices(rows)
        .map(|row| std::array::from_fn(|axis| columns[axis].f32_of(row)))
        .collect()
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

/// Mean of each term of the series over time 0 to 1: cosines at even indices, sines at odd ones.
///
/// # Errors
/// For more than 1024 terms.
pub(crate) fn mean_weights(terms: usize) -> Result<Vec<f64>, DecodeError> {
    if terms > TERMS_MAX {
        let message =
            format!("colors are Fourier series of {terms} terms; at most {TERMS_MAX} are read");
        return Err(DecodeError::Malformed(message));
    }
    let term = |term: usize, time: f64| {
        let angle = std::f64::consts::PI * time;
        if term.is_multiple_of(2) {
            (angle * term as f64).cos()
        } else {
            (angle * (term + 1) as f64).sin()
        }
    };
    let moment = |index: usize| (index as f64 + 0.5) / MOMENTS as f64;
    Ok((0..terms)
        .map(|t| {
            (0..MOMENTS)
                .map(|index| term(t, moment(index)))
                .sum::<f64>()
                / MOMENTS as f64
        })
        .collect())
}

#[cfg(test)]
mod tests;
