//! Columns of splats in a PLY, as trainers name them, and what is read from their rows.

use decouplegs_scene::{SplatCloud, sh};
use glam::DVec3;
use rayon::prelude::*;

use crate::DecodeError;
use crate::activation::{normalized, scale_of_log, sigmoid};
use crate::ply::{Column, Ply, Rows};
use crate::unknown_keys::UnknownKeys;

/// Moments over which colors that change with time are averaged.
const MOMENTS: usize = 64;
/// Most terms of a Fourier series that are read; the trainer's default is 5.
const TERMS_MAX: usize = 1024;

/// Columns of the splats of an element.
pub(super) struct SplatColumns {
    pub(super) mean: [Column; 3],
    scale: [Option<Column>; 3],
    rotation: [Column; 4],
    opacity: Column,
    dc: DcColumns,
    rest: RestColumns,
    /// Mip-Splatting's filter.
    filter: Option<Column>,
}

impl SplatColumns {
    /// Finds them, and warns of what is not read as it stands.
    pub(super) fn find(ply: &Ply<'_>, element: &str) -> Result<Self, DecodeError> {
        if !ply.has_element(element) {
            return Err(DecodeError::Malformed(format!(
                "there is no element '{element}', only: {}",
                ply.element_names()
            )));
        }
        let column = |name: &str| ply.column(element, name);
        check_properties(ply, element)?;
        let filter = ply.column_if_present(element, "filter_3D");
        if filter.is_some() {
            log::warn!("Mip-Splatting's filter_3D is applied to scales and opacities");
        }
        Ok(Self {
            mean: [column("x")?, column("y")?, column("z")?],
            scale: scale_columns(ply, element)?,
            rotation: [
                column("rot_0")?,
                column("rot_1")?,
                column("rot_2")?,
                column("rot_3")?,
            ],
            opacity: column("opacity")?,
            dc: dc_columns(ply, element)?,
            rest: RestColumns::find(ply, element)?,
            filter,
        })
    }

    /// The splats of `rows`, their means relative to `origin`.
    pub(super) fn read(&self, rows: &Rows<'_>, origin: DVec3) -> SplatCloud {
        let means = if origin == DVec3::ZERO {
            row_slices(rows)
                .map(|row| self.mean.map(|column| column.f32_of(row)))
                .collect()
        } else {
            let relative =
                |axis: usize, row: &[u8]| (self.mean[axis].f64_of(row) - origin[axis]) as f32;
            row_slices(rows)
                .map(|row| std::array::from_fn(|axis| relative(axis, row)))
                .collect()
        };
        let mut cloud = SplatCloud {
            means,
            scales: row_slices(rows)
                .map(|row| {
                    let logarithms = self
                        .scale
                        .map(|column| column.map_or(FLAT_LOG_SCALE, |column| column.f32_of(row)));
                    logarithms.map(scale_of_log)
                })
                .collect(),
            rotations: row_slices(rows)
                .map(|row| normalized(self.rotation.map(|column| column.f32_of(row))))
                .collect(),
            opacities: row_slices(rows)
                .map(|row| sigmoid(self.opacity.f32_of(row)))
                .collect(),
            sh_degree: self.rest.degree,
            sh_dc: row_slices(rows)
                .map(|row| std::array::from_fn(|channel| self.dc.value(channel, row)))
                .collect(),
            sh_rest: self.rest.read(rows, |column, row| column.f32_of(row)),
        };
        if let Some(filter) = self.filter {
            let widths = row_slices(rows).map(|row| filter.f32_of(row));
            cloud
                .scales
                .par_iter_mut()
                .zip(&mut cloud.opacities)
                .zip(widths)
                .for_each(|((scales, opacity), width)| filtered(scales, opacity, width));
        }
        cloud
    }
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
