//! PlayCanvas' compressed PLY: splats quantized within chunks of 256.
//!
//! Element `chunk` holds the extent of each chunk (means, log-scales and, from SuperSplat 2 on, DC
//! colors), element `vertex` four words per splat: position and scale as 11-10-11 bits, rotation as
//! an index of 2 bits and three times 10 bits, color and opacity as 8-8-8-8 bits. An optional
//! element `sh` holds `f_rest_*` as bytes, channel-major.

mod write;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use crate::DecodeError;
use crate::activation::{normalized, scale_of_log};
use crate::inria_ply::{RestColumns, row_slices};
use crate::ply::{Column, Ply, Rows, Scalar};

pub use write::{encode, write};

/// Name of the format for users.
pub(crate) const NAME: &str = "compressed PLY";

/// Splats that share a chunk's extent.
const CHUNK_SPLATS: usize = 256;

/// Rest coefficients lie in -4 to 4 over the range of a byte.
const REST_RANGE: f32 = 8.0;

/// True if a parsed PLY is of this kind.
pub(crate) fn is_compressed(ply: &Ply<'_>) -> bool {
    ply.has_element("chunk") && ply.column_if_present("vertex", "packed_position").is_some()
}

/// Reads the splats.
///
/// # Errors
/// A [`DecodeError`] that names the property, count or variant at fault.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    let ply = Ply::parse(bytes)?;
    let chunks = chunk_extents(&ply)?;
    let word = |name: &str| -> Result<Column, DecodeError> {
        let column = ply.column("vertex", name)?;
        match column.scalar {
            Scalar::U32 | Scalar::I32 => Ok(column),
            other => Err(DecodeError::Malformed(format!(
                "vertex property '{name}' is {other:?}, expected a 32-bit integer"
            ))),
        }
    };
    let [position, rotation, scale, color] = [
        word("packed_position")?,
        word("packed_rotation")?,
        word("packed_scale")?,
        word("packed_color")?,
    ];
    let rows = ply.rows("vertex")?;
    if chunks.len() < rows.count.div_ceil(CHUNK_SPLATS) {
        return Err(DecodeError::Malformed(format!(
            "{} splats need {} chunks of {CHUNK_SPLATS}, found {}",
            rows.count,
            rows.count.div_ceil(CHUNK_SPLATS),
            chunks.len()
        )));
    }
    let words = |column: Column| {
        row_slices(&rows)
            .enumerate()
            .map(move |(splat, row)| (splat / CHUNK_SPLATS, column.u32_of(row)))
    };
    let (sh_degree, sh_rest) = rest_coefficients(&ply, rows.count)?;
    Ok(SplatCloud {
        means: words(position)
            .map(|(chunk, word)| chunks[chunk].means.at(unpack_11_10_11(word)))
            .collect(),
        scales: words(scale)
            .map(|(chunk, word)| {
                chunks[chunk]
                    .log_scales
                    .at(unpack_11_10_11(word))
                    .map(scale_of_log)
            })
            .collect(),
        rotations: words(rotation)
            .map(|(_, word)| unpack_rotation(word))
            .collect(),
        opacities: words(color).map(|(_, word)| unorm(word, 8)).collect(),
        sh_degree,
        sh_dc: words(color)
            .map(|(chunk, word)| {
                let rgb = chunks[chunk].colors.at([
                    unorm(word >> 24, 8),
                    unorm(word >> 16, 8),
                    unorm(word >> 8, 8),
                ]);
                rgb.map(|channel| (channel - 0.5) / sh::Y0 as f32)
            })
            .collect(),
        sh_rest,
    })
}

/// The range that quantized values of three channels span.
struct Extent {
    min: [f32; 3],
    max: [f32; 3],
}

impl Extent {
    fn at(&self, t: [f32; 3]) -> [f32; 3] {
        std::array::from_fn(|i| self.min[i] * (1.0 - t[i]) + self.max[i] * t[i])
    }
}

struct Chunk {
    means: Extent,
    log_scales: Extent,
    colors: Extent,
}

fn chunk_extents(ply: &Ply<'_>) -> Result<Vec<Chunk>, DecodeError> {
    let triple = |prefix: &str, axes: [&str; 3]| -> Result<[Column; 3], DecodeError> {
        let [a, b, c] = axes.map(|axis| ply.column("chunk", &format!("{prefix}_{axis}")));
        Ok([a?, b?, c?])
    };
    let xyz = ["x", "y", "z"];
    let (means, scales) = (
        (triple("min", xyz)?, triple("max", xyz)?),
        (triple("min_scale", xyz)?, triple("max_scale", xyz)?),
    );
    // SuperSplat 1 stored colors over 0 to 1 without an extent.
    let rgb = ["r", "g", "b"];
    let colors = if ply.column_if_present("chunk", "min_r").is_some() {
        Some((triple("min", rgb)?, triple("max", rgb)?))
    } else {
        None
    };
    let rows: Rows<'_> = ply.rows("chunk")?;
    let extent = |row: &[u8], (min, max): ([Column; 3], [Column; 3])| Extent {
        min: min.map(|column| column.f32_of(row)),
        max: max.map(|column| column.f32_of(row)),
    };
    Ok(row_slices(&rows)
        .map(|row| Chunk {
            means: extent(row, means),
            log_scales: extent(row, scales),
            colors: colors.map_or(
                Extent {
                    min: [0.0; 3],
                    max: [1.0; 3],
                },
                |columns| extent(row, columns),
            ),
        })
        .collect())
}

/// Degree and coefficients of the element `sh`, if there is one with any property.
fn rest_coefficients(ply: &Ply<'_>, splats: usize) -> Result<(u8, Vec<[f32; 3]>), DecodeError> {
    if !ply.has_element("sh") {
        return Ok((0, Vec::new()));
    }
    let columns = RestColumns::find(ply, "sh")?;
    if columns.degree == 0 {
        return Ok((0, Vec::new()));
    }
    let rows = ply.rows("sh")?;
    if rows.count != splats {
        return Err(DecodeError::Malformed(format!(
            "element 'sh' has {} rows for {splats} splats",
            rows.count
        )));
    }
    // The ends of the range are exact, the codes between them stand for the middle of their cell.
    let value = |column: Column, row: &[u8]| match column.f32_of(row) {
        0.0 => -0.5 * REST_RANGE,
        255.0 => 0.5 * REST_RANGE,
        code => ((code + 0.5) / 256.0 - 0.5) * REST_RANGE,
    };
    Ok((columns.degree, columns.read(&rows, value)))
}

/// The low `bits` of `word` over 0 to 1.
fn unorm(word: u32, bits: u32) -> f32 {
    let mask = (1u32 << bits) - 1;
    (word & mask) as f32 / mask as f32
}

fn unpack_11_10_11(word: u32) -> [f32; 3] {
    [
        unorm(word >> 21, 11),
        unorm(word >> 11, 10),
        unorm(word, 11),
    ]
}

/// Three components of w, x, y, z over plus or minus 1/sqrt(2); the one left out, named by the top
/// bits, is the largest.
fn unpack_rotation(word: u32) -> [f32; 4] {
    let small =
        [20, 10, 0].map(|shift| (unorm(word >> shift, 10) - 0.5) * std::f32::consts::SQRT_2);
    let largest = (1.0 - small.iter().map(|q| q * q).sum::<f32>())
        .max(0.0)
        .sqrt();
    let mut small = small.into_iter();
    normalized(std::array::from_fn(|i| {
        if i == (word >> 30) as usize {
            largest
        } else {
            small.next().unwrap_or(0.0)
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(color_extent: bool, sh: &str, sh_bytes: &[u8]) -> Vec<u8> {
        let mut header = "ply\nformat binary_little_endian 1.0\nelement chunk 1\n".to_owned();
        let mut extents: Vec<(&str, f32)> = Vec::new();
        for (name, value) in [
            ("min_x", -1.0),
            ("min_y", 0.0),
            ("min_z", 10.0),
            ("max_x", 1.0),
            ("max_y", 4.0),
            ("max_z", 10.0),
        ] {
            extents.push((name, value));
        }
        for name in ["min_scale_x", "min_scale_y", "min_scale_z"] {
            extents.push((name, -8.0));
        }
        for name in ["max_scale_x", "max_scale_y", "max_scale_z"] {
            extents.push((name, 0.0));
        }
        if color_extent {
            for (name, value) in [
                ("min_r", 0.5),
                ("min_g", 0.5),
                ("min_b", 0.5),
                ("max_r", 1.5),
                ("max_g", 1.5),
                ("max_b", 1.5),
            ] {
                extents.push((name, value));
            }
        }
        for (name, _) in &extents {
            header += &format!("property float {name}\n");
        }
        header += "element vertex 1\nproperty uint packed_position\nproperty uint packed_rotation\nproperty uint packed_scale\n\
                   property uint packed_color\n";
        header += sh;
        header += "end_header\n";
        let mut bytes = header.into_bytes();
        bytes.extend(extents.iter().flat_map(|(_, value)| value.to_le_bytes()));
        let position = 2047 << 21;
        // The largest is y (index 2); w, x and z follow in order.
        let rotation = (2 << 30) | (1023 << 20) | (512 << 10) | 511;
        let (scale, color) = ((2047 << 21) | (1023 << 11) | 2047, 0xff00_0080u32);
        for word in [position, rotation, scale, color] {
            bytes.extend_from_slice(&u32::to_le_bytes(word));
        }
        bytes.extend_from_slice(sh_bytes);
        bytes
    }

    #[test]
    fn words_are_unpacked_within_their_chunk() {
        let cloud = decode(&file(true, "", &[])).unwrap();
        assert_eq!(cloud.means, [[1.0, 0.0, 10.0]]);
        assert_eq!(cloud.scales, [[1.0; 3]]);
        assert!((cloud.opacities[0] - 128.0 / 255.0).abs() < 1e-6);
        assert!(
            (cloud.sh_dc[0][0] - 1.0 / sh::Y0 as f32).abs() < 1e-5
                && cloud.sh_dc[0][1].abs() < 1e-5
        );
        let [w, x, y, z] = cloud.rotations[0];
        assert!((w - std::f32::consts::FRAC_1_SQRT_2).abs() < 1e-4, "{w}");
        assert!(x.abs() < 1e-3 && z.abs() < 1e-3 && y > 0.7, "{x} {y} {z}");
    }

    #[test]
    fn colors_without_an_extent_span_zero_to_one() {
        let cloud = decode(&file(false, "", &[])).unwrap();
        assert!(
            (cloud.sh_dc[0][0] - 0.5 / sh::Y0 as f32).abs() < 1e-5
                && (cloud.sh_dc[0][1] + 0.5 / sh::Y0 as f32).abs() < 1e-5
        );
    }

    #[test]
    fn rest_coefficients_are_bytes_and_may_be_announced_but_absent() {
        let header: String = (0..9)
            .map(|i| format!("property uchar f_rest_{i}\n"))
            .collect();
        let cloud = decode(&file(
            true,
            &format!("element sh 1\n{header}"),
            &[0, 128, 255, 1, 2, 3, 4, 5, 6],
        ))
        .unwrap();
        assert_eq!((cloud.sh_degree, cloud.sh_rest.len()), (1, 3));
        assert_eq!([cloud.sh_rest[0][0], cloud.sh_rest[2][0]], [-4.0, 4.0]);
        assert!((cloud.sh_rest[1][0] - 8.0 * 0.5 / 256.0).abs() < 1e-6);
        assert!((cloud.sh_rest[0][1] - (1.5 / 256.0 - 0.5) * 8.0).abs() < 1e-6);
        assert_eq!(
            decode(&file(true, "element sh 1\n", &[]))
                .unwrap()
                .sh_degree,
            0
        );
        let error = decode(&file(true, &format!("element sh 2\n{header}"), &[0; 18]))
            .unwrap_err()
            .to_string();
        assert!(error.contains("2 rows for 1 splats"), "{error}");
    }

    #[test]
    fn too_few_chunks_are_refused() {
        let bytes = file(true, "", &[]);
        let text = b"element vertex 1\n";
        let at = bytes
            .windows(text.len())
            .position(|window| window == text)
            .unwrap();
        let mut more = bytes.clone();
        more.splice(at..at + text.len(), b"element vertex 257\n".iter().copied());
        more.extend_from_slice(&[0; 256 * 16]);
        assert!(
            decode(&more)
                .unwrap_err()
                .to_string()
                .contains("need 2 chunks")
        );
    }
}
