//! The PLY of the original 3DGS (Kerbl et al., 2023), as nearly every trainer writes it.
//!
//! One row a splat: `x y z`, optional normals, `f_dc_0..2`, `f_rest_*`, `opacity`, `scale_0..2`,
//! `rot_0..3`. Opacity is a logit, scales are natural logarithms, rotations w, x, y, z of any
//! length. `f_rest` is channel-major: all red coefficients, then all green, then all blue.
//! Properties are found by name, of any scalar type, among any others. Coordinates are the
//! trainer's and stay as they are. Where DC has several terms a channel, those of a Fourier series
//! over time (Street Gaussians), their mean over time is read.

use std::io::{self, Write};
use std::path::Path;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use crate::activation::{log_of_scale, logit, normalized, scale_of_log, sigmoid};
use crate::ply::{Column, Ply, Rows};
use crate::{AssetError, DecodeError, write_atomically};

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
    if !ply.has_element(element) {
        return Err(DecodeError::Malformed(format!(
            "there is no element '{element}', only: {}",
            ply.element_names()
        )));
    }
    let columns = |names: &[&str]| -> Result<Vec<Column>, DecodeError> {
        names.iter().map(|name| ply.column(element, name)).collect()
    };
    let mean = columns(&["x", "y", "z"])?;
    let scale = columns(&["scale_0", "scale_1", "scale_2"])?;
    let rotation = columns(&["rot_0", "rot_1", "rot_2", "rot_3"])?;
    let opacity = ply.column(element, "opacity")?;
    let dc = dc_columns(ply, element)?;
    let rest = RestColumns::find(ply, element)?;
    let rows = ply.rows(element)?;
    Ok(SplatCloud {
        means: triples(&rows, &mean),
        scales: triples(&rows, &scale)
            .into_par_iter()
            .map(|logarithms| logarithms.map(scale_of_log))
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
    })
}

/// The `f_dc` columns of an element, channel-major: one per channel, or the terms of its series
/// over time.
struct DcColumns {
    columns: Vec<Column>,
    /// Mean of each term.
    weights: Vec<f64>,
}

/// Finds `f_dc_0..` in `element`.
fn dc_columns(ply: &Ply<'_>, element: &str) -> Result<DcColumns, DecodeError> {
    let count = ply
        .property_names(element)
        .filter(|name| name.starts_with("f_dc_"))
        .count();
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
        weights: mean_weights(terms)?,
    })
}

impl DcColumns {
    fn value(&self, channel: usize, row: &[u8]) -> f32 {
        let terms = self.weights.len();
        let columns = &self.columns[channel * terms..(channel + 1) * terms];
        match columns {
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
mod tests {
    use super::*;

    /// A file of one splat with the given properties, all float.
    fn file(properties: &[(&str, f32)]) -> Vec<u8> {
        let mut bytes = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\n".to_vec();
        for (name, _) in properties {
            bytes.extend_from_slice(format!("property float {name}\n").as_bytes());
        }
        bytes.extend_from_slice(b"end_header\n");
        bytes.extend(properties.iter().flat_map(|(_, value)| value.to_le_bytes()));
        bytes
    }

    const ONE: [(&str, f32); 15] = [
        ("rot_3", 0.0),
        ("rot_0", 2.0),
        ("rot_2", 0.0),
        ("rot_1", 0.0),
        ("confidence", 9.0),
        ("scale_1", 0.0),
        ("scale_0", -1.0),
        ("scale_2", 1.0),
        ("opacity", f32::INFINITY),
        ("f_dc_2", 0.3),
        ("f_dc_0", 0.1),
        ("f_dc_1", 0.2),
        ("z", 3.0),
        ("x", 1.0),
        ("y", 2.0),
    ];

    #[test]
    fn properties_are_found_by_name_in_any_order() {
        let cloud = decode(&file(&ONE)).unwrap();
        assert_eq!(cloud.means, [[1.0, 2.0, 3.0]]);
        assert_eq!(cloud.rotations, [[1.0, 0.0, 0.0, 0.0]]);
        assert_eq!(
            cloud.scales,
            [[(-1.0f64).exp() as f32, 1.0, std::f32::consts::E]]
        );
        assert_eq!(
            (cloud.opacities[0], cloud.sh_dc[0], cloud.sh_degree),
            (1.0, [0.1, 0.2, 0.3], 0)
        );
        assert_eq!(cloud.defect_of(0), None);
    }

    #[test]
    fn a_missing_property_is_named() {
        for (skipped, (name, _)) in ONE
            .iter()
            .enumerate()
            .filter(|(_, (name, _))| *name != "confidence")
        {
            let rest: Vec<_> = ONE
                .iter()
                .enumerate()
                .filter(|(i, _)| *i != skipped)
                .map(|(_, property)| *property)
                .collect();
            assert!(decode(&file(&rest)).unwrap_err().to_string().contains(name));
        }
    }

    #[test]
    fn rest_coefficients_are_channel_major_and_counted() {
        for (count, degree) in [(9usize, 1u8), (24, 2), (45, 3), (72, 3)] {
            let names: Vec<String> = (0..count).map(|i| format!("f_rest_{i}")).collect();
            let mut properties = ONE.to_vec();
            properties.extend(
                names
                    .iter()
                    .enumerate()
                    .map(|(i, name)| (name.as_str(), i as f32)),
            );
            let cloud = decode(&file(&properties)).unwrap();
            let stride = count / 3;
            assert_eq!(
                (cloud.sh_degree, cloud.sh_rest.len()),
                (degree, stride.min(15))
            );
            assert_eq!(
                cloud.rest_of(0)[1],
                [1.0, (stride + 1) as f32, (2 * stride + 1) as f32]
            );
            properties.pop();
            assert!(
                decode(&file(&properties))
                    .unwrap_err()
                    .to_string()
                    .contains("f_rest")
            );
        }
    }

    #[test]
    fn a_splat_that_cannot_be_drawn_does_not_fail_the_file() {
        use decouplegs_scene::SplatDefect;
        for (name, value, defect) in [
            ("x", f32::NAN, SplatDefect::Mean),
            ("scale_2", f32::INFINITY, SplatDefect::Scale),
            ("rot_0", 0.0, SplatDefect::Rotation),
            ("opacity", f32::NAN, SplatDefect::Opacity),
            ("f_dc_1", f32::NEG_INFINITY, SplatDefect::Color),
        ] {
            let changed = ONE.map(|property| {
                if property.0 == name {
                    (name, value)
                } else {
                    property
                }
            });
            assert_eq!(
                decode(&file(&changed)).unwrap().defect_of(0),
                Some(defect),
                "{name}"
            );
        }
    }

    #[test]
    fn one_of_several_models_is_read_by_its_element() {
        let bytes = String::from_utf8(file(&[("x", 0.0)]))
            .unwrap()
            .replace("element vertex", "element vertex_obj_007");
        let error = decode(bytes.as_bytes()).unwrap_err().to_string();
        assert!(error.contains("vertex_obj_007"), "{error}");
        assert!(
            decode_element(bytes.as_bytes(), "vertex_obj_007")
                .unwrap_err()
                .to_string()
                .contains("'y'")
        );
    }

    #[test]
    fn an_empty_cloud_is_a_file() {
        let cloud = SplatCloud::with_degree(2);
        assert_eq!(decode(&encode(&cloud)).unwrap(), cloud);
    }
}
