//! Writes splats as compressed PLY.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use super::{CHUNK_SPLATS, REST_RANGE};
use crate::activation::{log_of_scale, normalized};
use crate::{AssetError, EncodeError, write_atomically};

/// Logarithms of scales are clamped to plus or minus this.
const LOG_SCALE_MAX: f32 = 20.0;
/// Chunk values: the least and the greatest of three positions, logarithms of scales, and colors.
const CHUNK_VALUES: [&str; 18] = [
    "min_x",
    "min_y",
    "min_z",
    "max_x",
    "max_y",
    "max_z",
    "min_scale_x",
    "min_scale_y",
    "min_scale_z",
    "max_scale_x",
    "max_scale_y",
    "max_scale_z",
    "min_r",
    "min_g",
    "min_b",
    "max_r",
    "max_g",
    "max_b",
];
const WORDS: [&str; 4] = [
    "packed_position",
    "packed_rotation",
    "packed_scale",
    "packed_color",
];

/// Writes `cloud` to `path`. Returns the indices of its splats in the order of the file, in which
/// neighbors share a chunk.
///
/// # Errors
/// [`AssetError::Encode`] if a splat is defective, and [`AssetError::Write`].
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<Vec<u32>, AssetError> {
    let (bytes, order) = encode(cloud).map_err(|source| AssetError::Encode {
        path: path.to_owned(),
        format: super::NAME,
        source,
    })?;
    write_atomically(path, |file| file.write_all(&bytes))?;
    Ok(order)
}

/// The bytes of a file of `cloud`, and the indices of its splats in the order of the file.
///
/// # Errors
/// Returns an error if a splat is defective ([`SplatCloud::defect_of`]).
pub fn encode(cloud: &SplatCloud) -> Result<(Vec<u8>, Vec<u32>), EncodeError> {
    if let Some(first) = (0..cloud.len()).find(|&splat| cloud.defect_of(splat).is_some()) {
        return Err(EncodeError(format!(
            "splat {first} is not finite or has no rotation; drop such splats before writing"
        )));
    }
    let order = cloud.spatial_order();
    let chunks: Vec<([f32; 18], Vec<[u32; 4]>)> = order
        .par_chunks(CHUNK_SPLATS)
        .map(|splats| pack(cloud, splats))
        .collect();
    let mut bytes = header(cloud, chunks.len()).into_bytes();
    for (extents, _) in &chunks {
        bytes.extend(extents.iter().flat_map(|value| value.to_le_bytes()));
    }
    let words = chunks.iter().flat_map(|(_, words)| words.as_flattened());
    bytes.extend(words.flat_map(|word| word.to_le_bytes()));
    if cloud.sh_degree > 0 {
        for &splat in &order {
            let rest = cloud.rest_of(splat as usize);
            // Channel-major, as in an INRIA PLY.
            let channels = (0..3).flat_map(|channel| rest.iter().map(move |rgb| rgb[channel]));
            bytes.extend(channels.map(rest_code));
        }
    }
    Ok((bytes, order))
}

fn header(cloud: &SplatCloud, chunks: usize) -> String {
    let mut header = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n");
    for name in CHUNK_VALUES {
        header += &format!("property float {name}\n");
    }
    header += &format!("element vertex {}\n", cloud.len());
    for name in WORDS {
        header += &format!("property uint {name}\n");
    }
    if cloud.sh_degree > 0 {
        header += &format!("element sh {}\n", cloud.len());
        for index in 0..3 * cloud.rest_stride() {
            header += &format!("property uchar f_rest_{index}\n");
        }
    }
    header + "end_header\n"
}

/// Extents and words of one chunk.
fn pack(cloud: &SplatCloud, splats: &[u32]) -> ([f32; 18], Vec<[u32; 4]>) {
    let mean = |splat: u32| cloud.means[splat as usize];
    let log_scale = |splat: u32| {
        cloud.scales[splat as usize]
            .map(|scale| log_of_scale(scale).clamp(-LOG_SCALE_MAX, LOG_SCALE_MAX))
    };
    let color = |splat: u32| {
        cloud.sh_dc[splat as usize].map(|coefficient| coefficient * sh::Y0 as f32 + 0.5)
    };
    let means = extent(splats.iter().map(|&splat| mean(splat)));
    let scales = extent(splats.iter().map(|&splat| log_scale(splat)));
    let colors = extent(splats.iter().map(|&splat| color(splat)));
    let words = splats.iter().map(|&splat| {
        let at = |values: [f32; 3], (min, max): ([f32; 3], [f32; 3])| {
            std::array::from_fn(|axis| share(values[axis], min[axis], max[axis]))
        };
        let [r, g, b]: [f32; 3] = at(color(splat), colors);
        let opacity = cloud.opacities[splat as usize];
        [
            pack_11_10_11(at(mean(splat), means)),
            pack_rotation(normalized(cloud.rotations[splat as usize])),
            pack_11_10_11(at(log_scale(splat), scales)),
            code(r, 8) << 24 | code(g, 8) << 16 | code(b, 8) << 8 | code(opacity, 8),
        ]
    });
    let words = words.collect();
    let ends = [means.0, means.1, scales.0, scales.1, colors.0, colors.1];
    (std::array::from_fn(|i| ends[i / 3][i % 3]), words)
}

/// The least and the greatest of each channel.
fn extent(values: impl Iterator<Item = [f32; 3]>) -> ([f32; 3], [f32; 3]) {
    let empty = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    values.fold(empty, |(min, max), value| {
        (
            std::array::from_fn(|i| min[i].min(value[i])),
            std::array::from_fn(|i| max[i].max(value[i])),
        )
    })
}

/// Place of `value` between `min` and `max`, 0 to 1; 0 where there is nothing between.
fn share(value: f32, min: f32, max: f32) -> f32 {
    let (value, min, max) = (f64::from(value), f64::from(min), f64::from(max));
    if max > min {
        ((value - min) / (max - min)) as f32
    } else {
        0.0
    }
}

/// The nearest code of `bits` for a value of 0 to 1.
fn code(value: f32, bits: u32) -> u32 {
    let most = ((1_u32 << bits) - 1) as f32;
    (value * most).round().clamp(0.0, most) as u32
}

fn pack_11_10_11([x, y, z]: [f32; 3]) -> u32 {
    code(x, 11) << 21 | code(y, 10) << 11 | code(z, 11)
}

/// The three smaller components of w, x, y, z, and the index of the largest, which is made
/// positive.
fn pack_rotation(rotation: [f32; 4]) -> u32 {
    let largest = (0..4).max_by(|&a, &b| rotation[a].abs().total_cmp(&rotation[b].abs()));
    let largest = largest.unwrap_or(0);
    let sign = rotation[largest].signum();
    let small = (0..4).filter(|&index| index != largest);
    small.fold(largest as u32, |word, index| {
        let value = sign * rotation[index] * std::f32::consts::FRAC_1_SQRT_2 + 0.5;
        word << 10 | code(value, 10)
    })
}

/// The byte whose cell, of 256 over plus or minus half of [`REST_RANGE`], holds `coefficient`.
fn rest_code(coefficient: f32) -> u8 {
    ((coefficient / REST_RANGE + 0.5) * 256.0).clamp(0.0, 255.0) as u8
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compressed_ply::decode;

    fn cloud(count: usize, sh_degree: u8) -> SplatCloud {
        let number = |index: usize, by: f32| (index as f32 * by).sin();
        let stride = sh::coefficient_count(sh_degree) - 1;
        SplatCloud {
            means: (0..count)
                .map(|i| [9.0 * number(i, 0.37), 9.0 * number(i, 0.91), number(i, 1.7)])
                .collect(),
            scales: (0..count)
                .map(|i| [0.1, (3.0 * number(i, 0.3)).exp(), 0.01])
                .collect(),
            rotations: (0..count)
                .map(|i| normalized([number(i, 0.5), number(i, 0.7), number(i, 0.2), 0.3]))
                .collect(),
            opacities: (0..count).map(|i| number(i, 0.6).abs()).collect(),
            sh_degree,
            sh_dc: (0..count)
                .map(|i| [2.0 * number(i, 0.4), 0.3, -1.0])
                .collect(),
            sh_rest: (0..count * stride)
                .map(|i| [number(i, 0.2), 3.0 * number(i, 0.5), -0.5])
                .collect(),
        }
    }

    #[test]
    fn what_is_written_is_read_within_the_steps_of_the_format() {
        for (count, degree) in [(1, 0), (256, 1), (700, 3)] {
            let own = cloud(count, degree);
            let (bytes, order) = encode(&own).unwrap();
            let read = decode(&bytes).unwrap();
            assert_eq!((read.len(), read.sh_degree), (count, degree));
            let own = own.select(&order);
            let near = |a: &[[f32; 3]], b: &[[f32; 3]], limit: f32| {
                let pairs = a.as_flattened().iter().zip(b.as_flattened());
                let worst = pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
                assert!(worst <= limit, "{worst} > {limit}");
                worst
            };
            // Half a step of 10 bits over the largest extent.
            near(&own.means, &read.means, 18.0 / 1023.0 / 2.0 + 1e-5);
            let logs = |scales: &[[f32; 3]]| -> Vec<[f32; 3]> {
                scales.iter().map(|scales| scales.map(f32::ln)).collect()
            };
            near(
                &logs(&own.scales),
                &logs(&read.scales),
                6.0 / 1023.0 / 2.0 + 1e-4,
            );
            near(&own.sh_dc, &read.sh_dc, 4.0 / 255.0 / 2.0 + 1e-4);
            near(&own.sh_rest, &read.sh_rest, 8.0 / 256.0);
            for splat in 0..count {
                let dot: f32 = (0..4)
                    .map(|i| own.rotations[splat][i] * read.rotations[splat][i])
                    .sum();
                assert!(dot.abs() > 1.0 - 1e-5, "{dot}");
                assert!((own.opacities[splat] - read.opacities[splat]).abs() < 0.5 / 255.0 + 1e-6);
            }
        }
        // The comparison can fail: chunks hold neighbors, and not the order that was given.
        let own = cloud(700, 0);
        let read = decode(&encode(&own).unwrap().0).unwrap();
        assert!((own.means[0][0] - read.means[0][0]).abs() > 0.1);
    }

    #[test]
    fn extremes_are_clamped_and_defects_refused() {
        let mut own = cloud(3, 1);
        own.scales[0] = [0.0, 1e30, 1.0];
        own.means[1] = [1e30, -1e30, 0.0];
        own.sh_rest[0] = [9.0, -9.0, 0.0];
        let (bytes, order) = encode(&own).unwrap();
        let read = decode(&bytes).unwrap();
        let place = order.iter().position(|&splat| splat == 0).unwrap();
        assert!(read.scales[place][0] < 1e-8 && read.scales[place][1] > 1e8);
        assert_eq!(read.rest_of(place)[0][..2], [4.0, -4.0]);
        assert!(read.means.as_flattened().iter().all(|x| x.is_finite()));
        own.rotations[2] = [0.0; 4];
        assert!(encode(&own).unwrap_err().to_string().contains("splat 2"));
        let (bytes, order) = encode(&SplatCloud::default()).unwrap();
        assert!(order.is_empty() && decode(&bytes).unwrap().is_empty());
    }
}
