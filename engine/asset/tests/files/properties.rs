//! Properties over generated splat files, and over noise.

use decouplegs_asset::{SceneFile, cameras, compressed_ply, inria_ply, splat, spz};
use decouplegs_scene::{SplatCloud, sh};
use proptest::prelude::*;

use crate::errors::{Errors, SMALLEST_THREE_MAX_RAD};
use crate::sample;

/// Clouds of drawable splats within the ranges that SPZ can hold.
fn clouds() -> impl Strategy<Value = SplatCloud> {
    (0u8..=3, 0usize..12).prop_flat_map(|(degree, count)| {
        let stride = sh::coefficient_count(degree) - 1;
        let triples = |count: usize, range: std::ops::Range<f32>| {
            prop::collection::vec(prop::array::uniform3(range), count..=count)
        };
        let rotations = prop::collection::vec(prop::array::uniform4(-1.0f32..1.0), count..=count);
        let opacities = prop::collection::vec(0.0f32..=1.0, count..=count);
        (
            triples(count, -2000.0..2000.0),
            triples(count, 0.0001..300.0),
            rotations,
            opacities,
            triples(count, -3.0..3.0),
            triples(count * stride, -0.99..0.99),
        )
            .prop_map(
                move |(means, scales, rotations, opacities, sh_dc, sh_rest)| {
                    let rotations = rotations.into_iter().map(unit).collect();
                    SplatCloud {
                        means,
                        scales,
                        rotations,
                        opacities,
                        sh_degree: degree,
                        sh_dc,
                        sh_rest,
                    }
                },
            )
    })
}

/// A unit quaternion along `q`, the identity where `q` is too short to have a direction.
fn unit(q: [f32; 4]) -> [f32; 4] {
    let length = q.iter().map(|x| x * x).sum::<f32>().sqrt();
    if length > 1e-3 {
        q.map(|x| x / length)
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}

fn close(a: &[f32], b: &[f32], tolerance: f32) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= tolerance)
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn a_ply_reads_back_as_it_was_written(cloud in clouds()) {
        let back = inria_ply::decode(&inria_ply::encode(&cloud)).unwrap();
        prop_assert_eq!(&back.means, &cloud.means);
        prop_assert_eq!(&back.sh_dc, &cloud.sh_dc);
        prop_assert_eq!(&back.sh_rest, &cloud.sh_rest);
        prop_assert_eq!(back.sh_degree, cloud.sh_degree);
        prop_assert!(close(&back.opacities, &cloud.opacities, 1e-6));
        prop_assert!(close(back.rotations.as_flattened(), cloud.rotations.as_flattened(), 1e-6));
        for (a, b) in back.scales.as_flattened().iter().zip(cloud.scales.as_flattened()) {
            prop_assert!((a / b - 1.0).abs() < 6e-7, "{a} {b}");
        }
    }

    #[test]
    fn an_spz_reads_back_within_its_quantization(cloud in clouds()) {
        let back = spz::decode(&spz::encode(&cloud).unwrap()).unwrap();
        prop_assert_eq!((back.len(), back.sh_degree), (cloud.len(), cloud.sh_degree));
        // Half a step of 2^-12 m, and the f32 that holds it: 2^-14 m at 2 km.
        prop_assert!(close(back.means.as_flattened(), cloud.means.as_flattened(), 0.5 / 4096.0 + 6.2e-5));
        prop_assert!(close(&back.opacities, &cloud.opacities, 0.5005 / 255.0));
        prop_assert!(close(back.sh_dc.as_flattened(), cloud.sh_dc.as_flattened(), 0.5005 / (255.0 * 0.15)));
        prop_assert!(close(back.sh_rest.as_flattened(), cloud.sh_rest.as_flattened(), 0.5005 / 128.0));
        for (a, b) in back.scales.as_flattened().iter().zip(cloud.scales.as_flattened()) {
            prop_assert!((a.ln() - b.ln()).abs() < 0.5005 / 16.0, "{a} {b}");
        }
        prop_assert!(Errors::between(&cloud, &back).angle_rad <= SMALLEST_THREE_MAX_RAD);
    }

    #[test]
    fn writing_an_spz_again_changes_nothing(cloud in clouds()) {
        let once = spz::decode(&spz::encode(&cloud).unwrap()).unwrap();
        let twice = spz::decode(&spz::encode(&once).unwrap()).unwrap();
        prop_assert_eq!(&once.means, &twice.means);
        prop_assert_eq!(&once.scales, &twice.scales);
        prop_assert_eq!(&once.opacities, &twice.opacities);
        prop_assert_eq!(&once.sh_dc, &twice.sh_dc);
        prop_assert_eq!(&once.sh_rest, &twice.sh_rest);
    }

    #[test]
    fn a_splat_file_is_read_as_its_bytes_say(rows in prop::collection::vec((prop::array::uniform6(any::<f32>()), any::<[u8; 8]>()), 1..20)) {
        let file: Vec<u8> =
            rows.iter().flat_map(|(floats, codes)| floats.iter().flat_map(|x| x.to_le_bytes()).chain(*codes).collect::<Vec<_>>()).collect();
        let cloud = splat::decode(&file).unwrap();
        prop_assert_eq!(cloud.len(), rows.len());
        for (i, ([x, y, z, sx, sy, sz], [r, g, b, a, q @ ..])) in rows.iter().copied().enumerate() {
            prop_assert_eq!(cloud.means[i].map(f32::to_bits), [x, y, z].map(f32::to_bits));
            prop_assert_eq!(cloud.scales[i].map(f32::to_bits), [sx, sy, sz].map(f32::to_bits));
            prop_assert_eq!((cloud.opacities[i] * 255.0).round(), f32::from(a));
            prop_assert_eq!(cloud.sh_dc[i].map(|dc| ((f64::from(dc) * sh::Y0 + 0.5) * 255.0).round()), [r, g, b].map(f64::from));
            let stored = q.map(|code| f32::from(code) - 128.0);
            let length = stored.iter().map(|x| x * x).sum::<f32>().sqrt();
            prop_assert!(length == 0.0 || close(&cloud.rotations[i], &stored.map(|x| x / length), 1e-6));
        }
    }

    #[test]
    fn a_compressed_ply_stays_within_its_chunk(
        words in prop::array::uniform12(any::<[u8; 4]>()),
        low in prop::array::uniform9(-9.0f32..3.0),
        size in prop::array::uniform9(0.0f32..4.0),
    ) {
        // Means, scales and colors of the chunk's extent lie behind the header: minima of three,
        // then maxima of three.
        let (_, mut file, read) = sample::files().swap_remove(1);
        let body = file.windows(11).position(|window| window == b"end_header\n").unwrap() + 11;
        for (attribute, axis) in (0..3).flat_map(|attribute| (0..3).map(move |axis| (attribute, axis))) {
            let (min, at) = (low[3 * attribute + axis], body + 4 * (6 * attribute + axis));
            file[at..at + 4].copy_from_slice(&min.to_le_bytes());
            file[at + 12..at + 16].copy_from_slice(&(min + size[3 * attribute + axis]).to_le_bytes());
        }
        file[body + 72..body + 72 + 48].copy_from_slice(words.as_flattened());
        let cloud = read(&file).unwrap();
        for splat in 0..3 {
            prop_assert_eq!(cloud.defect_of(splat), None);
            let length_squared: f32 = cloud.rotations[splat].iter().map(|q| q * q).sum();
            prop_assert!((length_squared - 1.0).abs() < 1e-6);
            let color = cloud.sh_dc[splat].map(|dc| dc * sh::Y0 as f32 + 0.5);
            for (attribute, value) in [cloud.means[splat], cloud.scales[splat].map(f32::ln), color].into_iter().enumerate() {
                for axis in 0..3 {
                    let (min, size) = (low[3 * attribute + axis], size[3 * attribute + axis]);
                    prop_assert!((min - 1e-5..=min + size + 1e-5).contains(&value[axis]), "{value:?}");
                }
            }
        }
    }

    #[test]
    fn overwritten_bytes_never_panic(
        file in 0usize..11,
        edits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..20),
    ) {
        let (name, mut bytes, read) = sample::files().swap_remove(file);
        for (at, value) in edits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        if let Ok(cloud) = read(&bytes) {
            prop_assert!(cloud.len() <= 16_384 + bytes.len(), "{name}: {} splats", cloud.len());
        }
    }

    #[test]
    fn noise_never_panics(noise in prop::collection::vec(any::<u8>(), 0..300)) {
        let after = |head: &[u8]| [head, &noise].concat();
        let _ = spz::decode(&after(b"NGSP\x04\0\0\0"));
        let _ = spz::decode(&after(&[0x1f, 0x8b, 8, 0]));
        let _ = inria_ply::decode(&after(b"ply\nformat binary_little_endian 1.0\n"));
        let _ = compressed_ply::decode(&after(b"ply\nformat binary_little_endian 1.0\nelement chunk "));
        let _ = cameras::decode(&noise, None);
        let _ = cameras::decode(&after(b"{\"frames\":["), None);
        let _ = SceneFile::parse(&String::from_utf8_lossy(&after(b"version = 1\n")));
    }
}
