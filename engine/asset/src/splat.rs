//! The `.splat` of antimatter15's viewer: 32 bytes per splat and nothing else.
//!
//! Mean and linear scale as three floats each, color and opacity as four bytes, rotation w, x, y, z
//! as four bytes around 128. No header, no spherical harmonics beyond DC.

use std::io::Write;
use std::path::Path;

use decouplegs_scene::{SplatCloud, sh};
use rayon::prelude::*;

use crate::activation::normalized;
use crate::{AssetError, DecodeError, write_atomically};

const SPLAT_BYTES: usize = 32;

/// Reads the splats.
///
/// The format has no count: a file cut between two splats cannot be told from a shorter one.
///
/// # Errors
/// Returns an error if there is no splat, or the bytes end inside one.
pub fn decode(bytes: &[u8]) -> Result<SplatCloud, DecodeError> {
    if bytes.is_empty() || !bytes.len().is_multiple_of(SPLAT_BYTES) {
        let expected_bytes = (bytes.len() / SPLAT_BYTES + 1) * SPLAT_BYTES;
        return Err(DecodeError::Truncated {
            what: format!("a whole number of splats of {SPLAT_BYTES} bytes"),
            expected_bytes: expected_bytes as u64,
            found_bytes: bytes.len() as u64,
        });
    }
    let rows = || bytes.par_chunks_exact(SPLAT_BYTES);
    Ok(SplatCloud {
        means: rows().map(|row| floats(row, 0)).collect(),
        scales: rows().map(|row| floats(row, 12)).collect(),
        rotations: rows()
            .map(|row| {
                normalized(std::array::from_fn(|i| {
                    (f32::from(row[28 + i]) - 128.0) / 128.0
                }))
            })
            .collect(),
        opacities: rows().map(|row| f32::from(row[27]) / 255.0).collect(),
        sh_degree: 0,
        sh_dc: rows()
            .map(|row| {
                std::array::from_fn(|i| (f32::from(row[24 + i]) / 255.0 - 0.5) / sh::Y0 as f32)
            })
            .collect(),
        sh_rest: Vec::new(),
    })
}

/// `cloud` as the bytes of a file, in its order. Colors outside 0 to 1 are clamped, coefficients
/// beyond DC are left out.
#[must_use]
pub fn encode(cloud: &SplatCloud) -> Vec<u8> {
    let byte = |value: f32| value.round().clamp(0.0, 255.0) as u8;
    let mut file = Vec::with_capacity(cloud.len() * SPLAT_BYTES);
    for splat in 0..cloud.len() {
        file.extend(
            cloud.means[splat]
                .iter()
                .chain(&cloud.scales[splat])
                .flat_map(|value| value.to_le_bytes()),
        );
        file.extend(cloud.sh_dc[splat].map(|dc| byte((dc * sh::Y0 as f32 + 0.5) * 255.0)));
        file.push(byte(cloud.opacities[splat] * 255.0));
        // -q is the same rotation: plus one has no code, minus one has.
        let q = normalized(cloud.rotations[splat]);
        let largest = q.into_iter().fold(
            0.0f32,
            |most, x| if x.abs() > most.abs() { x } else { most },
        );
        let sign = if largest > 0.0 { -1.0 } else { 1.0 };
        file.extend(q.map(|x| byte(sign * x * 128.0 + 128.0)));
    }
    file
}

/// Writes `cloud` to `path`, atomically.
///
/// # Errors
/// Returns an error if the operating system refuses.
pub fn write(path: &Path, cloud: &SplatCloud) -> Result<(), AssetError> {
    write_atomically(path, |file| file.write_all(&encode(cloud)))
}

fn floats(row: &[u8], first: usize) -> [f32; 3] {
    std::array::from_fn(|axis| {
        let at = first + 4 * axis;
        f32::from_le_bytes([row[at], row[at + 1], row[at + 2], row[at + 3]])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_splat_is_read_field_by_field() {
        let mut bytes: Vec<u8> = [1.0f32, -2.0, 3.0, 0.1, 0.2, 0.3]
            .iter()
            .flat_map(|value| value.to_le_bytes())
            .collect();
        bytes.extend_from_slice(&[255, 0, 128, 51, 128, 128, 0, 128]);
        let cloud = decode(&bytes).unwrap();
        assert_eq!(
            (cloud.means[0], cloud.scales[0]),
            ([1.0, -2.0, 3.0], [0.1, 0.2, 0.3])
        );
        assert_eq!(
            (cloud.rotations[0], cloud.opacities[0]),
            ([0.0, 0.0, -1.0, 0.0], 0.2)
        );
        let y0 = sh::Y0 as f32;
        assert!(
            (cloud.sh_dc[0][0] * y0 - 0.5).abs() < 1e-6
                && (cloud.sh_dc[0][1] * y0 + 0.5).abs() < 1e-6
        );
    }

    #[test]
    fn what_is_written_is_read_to_the_byte() {
        let rows = [
            [3u8, 200, 77, 128, 0, 128, 90, 166],
            [255, 0, 1, 255, 128, 128, 128, 0],
        ];
        let floats = [0.5f32, -4.0, 1e6, 1e-3, 2.0, 0.25]
            .map(f32::to_le_bytes)
            .concat();
        let file: Vec<u8> = rows
            .iter()
            .flat_map(|row| floats.iter().chain(row).copied())
            .collect();
        let cloud = decode(&file).unwrap();
        let back = decode(&encode(&cloud)).unwrap();
        assert_eq!(
            (&back.means, &back.scales, &back.opacities),
            (&cloud.means, &cloud.scales, &cloud.opacities)
        );
        assert_eq!(back.sh_dc, cloud.sh_dc);
        for (a, b) in cloud.rotations.iter().zip(&back.rotations) {
            let cosine: f32 = a.iter().zip(b).map(|(a, b)| a * b).sum();
            assert!(cosine.abs() > 0.9998, "{a:?} {b:?}");
        }
    }

    #[test]
    fn a_rotation_of_nothing_is_left_for_the_defect_count() {
        let mut bytes = vec![0; 32];
        bytes[28..].fill(128);
        assert_eq!(
            decode(&bytes).unwrap().defect_of(0),
            Some(decouplegs_scene::SplatDefect::Rotation)
        );
    }
}
