//! PLY to SPZ and back, and the files of older versions, code by code.

use decouplegs_asset::{inria_ply, read_splats, spz};
use decouplegs_scene::SplatCloud;

use crate::data::data;
use crate::errors::{Errors, SMALLEST_THREE_MAX_RAD};
use crate::sample::{self, cloud};

/// `cloud` with every value moved to the nearest that SPZ reaches: what is measured is the
/// quantization within.
fn within_range(mut cloud: SplatCloud) -> SplatCloud {
    let scale_range = [(-10.0f32).exp(), (255.0f32 / 16.0 - 10.0).exp()];
    cloud
        .scales
        .as_flattened_mut()
        .iter_mut()
        .for_each(|scale| *scale = scale.clamp(scale_range[0], scale_range[1]));
    cloud
        .sh_dc
        .as_flattened_mut()
        .iter_mut()
        .for_each(|dc| *dc = dc.clamp(-0.5 / 0.15, 0.5 / 0.15));
    cloud
        .sh_rest
        .as_flattened_mut()
        .iter_mut()
        .for_each(|rest| *rest = rest.clamp(-1.0, 127.0 / 128.0));
    cloud
}

/// PLY bytes to SPZ bytes to PLY bytes, and what that did.
fn check_round_trip(name: &str, ply: &[u8]) {
    let original = inria_ply::decode(ply).unwrap();
    let packed = spz::encode(&original).unwrap();
    let back = inria_ply::decode(&inria_ply::encode(&spz::decode(&packed).unwrap())).unwrap();
    let errors = Errors::between(&within_range(original), &back);
    println!(
        "{name}: PLY {} bytes, SPZ {} bytes, {errors:?}",
        ply.len(),
        packed.len()
    );
    // Half a step of each quantization, and what f32 arithmetic on the way adds: a thousandth of
    // that, or less.
    assert!(errors.mean_m <= 0.5005 / 4096.0, "{errors:?}");
    assert!(errors.scale_ln <= 0.5005 / 16.0, "{errors:?}");
    assert!(errors.opacity <= 0.5005 / 255.0, "{errors:?}");
    assert!(errors.dc <= 0.5005 / (255.0 * 0.15), "{errors:?}");
    assert!(errors.rest <= 0.5005 / 128.0, "{errors:?}");
    // A uniform error has 1/sqrt(12) of its step as root mean square.
    assert!(errors.rest_rms <= 0.295 / 128.0, "{errors:?}");
    assert!(errors.angle_rad <= SMALLEST_THREE_MAX_RAD, "{errors:?}");
}

#[test]
fn ply_to_spz_to_ply_is_the_identity_up_to_quantization() {
    for degree in 0..=3 {
        check_round_trip(
            &format!("sample of degree {degree}"),
            &inria_ply::encode(&cloud(500, degree)),
        );
    }
    if let Some(path) = data("splats/hfk_keys.ply") {
        check_round_trip("hfk_keys.ply", &std::fs::read(path).unwrap());
    }
}

#[test]
fn a_file_on_disk_is_turned_to_the_axes_of_its_ply() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("cloud.spz");
    let original = cloud(10, 3);
    spz::write(&path, &original).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    assert!(bytes.starts_with(b"NGSP\x04"));
    // In the file, y points up: its codes are those of -y.
    let positions_bytes = u64::from_le_bytes(bytes[32..40].try_into().unwrap()) as usize;
    let data_at = 32 + 6 * 16;
    let positions = zstd::bulk::decompress(&bytes[data_at..data_at + positions_bytes], 90).unwrap();
    let y_code = i32::from_le_bytes([0, positions[3], positions[4], positions[5]]) >> 8;
    assert_eq!(y_code, (-original.means[0][1] * 4096.0).round() as i32);
    let back = read_splats(&path).unwrap();
    assert!((back.means[0][1] - original.means[0][1]).abs() < 2e-4);
}

#[test]
fn version_3_is_read_code_by_code() {
    let position = [0x00, 0x10, 0x00, 0x00, 0xf0, 0xff, 0x00, 0x08, 0x00]; // 1, -1, 0.5 m right, up, back
    let (alpha, color, scale) = ([51], [255, 0, 51], [160, 144, 176]);
    let rotation = u32::to_le_bytes(3 << 30 | 511 << 20); // w largest, x at its end
    let rest = [128, 0, 255, 64, 128, 192, 128, 128, 129];
    let streams = [&position[..], &alpha, &color, &scale, &rotation, &rest].concat();
    let cloud = spz::decode(&sample::spz_gzip(3, 1, 1, 12, &streams)).unwrap();
    assert_eq!(cloud.means, [[1.0, 1.0, -0.5]]);
    assert_eq!(cloud.opacities, [0.2]);
    assert_eq!(cloud.scales, [[1.0, (-1.0f32).exp(), 1.0f32.exp()]]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    assert!(
        (cloud.rotations[0][0] - half).abs() < 1e-6 && (cloud.rotations[0][1] - half).abs() < 1e-6,
        "{:?}",
        cloud.rotations[0]
    );
    assert!(
        (cloud.sh_dc[0][0] - 0.5 / 0.15).abs() < 1e-5
            && (cloud.sh_dc[0][2] + 0.3 / 0.15).abs() < 1e-5
    );
    // Band 1 is (-y, z, -x): half a turn about x changes the sign of the first two.
    assert_eq!(
        cloud.sh_rest,
        [
            [0.0, 1.0, -127.0 / 128.0],
            [0.5, 0.0, -0.5],
            [0.0, 0.0, 1.0 / 128.0]
        ]
    );
}

#[test]
fn versions_1_and_2_are_read() {
    let tail = [&[255u8][..], &[128, 128, 128], &[160; 3], &[255, 127, 127]].concat();
    let halves = [0x3c00u16, 0xc000, 0x3800].map(u16::to_le_bytes).concat();
    let one = spz::decode(&sample::spz_gzip(
        1,
        1,
        0,
        12,
        &[halves, tail.clone()].concat(),
    ))
    .unwrap();
    let two = spz::decode(&sample::spz_gzip(
        2,
        1,
        0,
        8,
        &[vec![0, 1, 0, 0, 0xfe, 0xff, 0x80, 0, 0], tail].concat(),
    ))
    .unwrap();
    assert_eq!(one.means, [[1.0, 2.0, -0.5]]);
    assert_eq!(one, two, "the same splat");
    assert!(one.rotations[0][1] > 0.999, "x is 1: half a turn about x");
}

#[test]
fn axes_named_in_an_extension_are_followed() {
    let streams = [
        &[0, 0x10, 0, 0, 0x10, 0, 0, 0x10, 0][..],
        &[255, 1, 1, 1, 1, 1, 1],
        &[0, 0, 0, 0xc0],
    ]
    .concat();
    let with = |code: u32| {
        let mut bytes = streams.clone();
        // A record of a kind that is skipped stands first.
        for word in [0xadbe_0002, 4, 7, 0xadbe_0003, 4, code] {
            bytes.extend_from_slice(&u32::to_le_bytes(word));
        }
        spz::decode(&sample::spz_gzip_with_flags(3, 1, 0, 12, 2, &bytes))
    };
    assert_eq!(with(4).unwrap().means, [[1.0, -1.0, -1.0]]);
    assert_eq!(with(6).unwrap().means, [[1.0, 1.0, 1.0]]);
    assert!(with(99).unwrap_err().to_string().contains("99"));
    let mut cut = streams.clone();
    cut.extend_from_slice(&[3, 0, 0xbe, 0xad, 4, 0, 0, 0, 1]);
    assert!(spz::decode(&sample::spz_gzip_with_flags(3, 1, 0, 12, 2, &cut)).is_err());
}

#[test]
fn degree_4_is_read_to_degree_3() {
    let rest: Vec<u8> = (0..72).map(|i| 128 + i).collect();
    let streams = [
        &[0; 9][..],
        &[255, 1, 1, 1, 1, 1, 1],
        &[0, 0, 0, 0xc0],
        &rest,
    ]
    .concat();
    let cloud = spz::decode(&sample::spz_gzip(3, 1, 4, 12, &streams)).unwrap();
    assert_eq!((cloud.sh_degree, cloud.sh_rest.len()), (3, 15));
    assert_eq!(cloud.sh_rest[14][2].abs(), 44.0 / 128.0);
}

#[test]
fn what_spz_cannot_hold_is_refused_with_its_reason() {
    let mut broken = cloud(4, 0);
    broken.means[2][0] = f32::NAN;
    assert!(
        spz::encode(&broken)
            .unwrap_err()
            .to_string()
            .contains("splat 2 first")
    );
    let mut far = cloud(1, 0);
    far.means[0][0] = 1e7;
    assert!(
        spz::encode(&far)
            .unwrap_err()
            .to_string()
            .contains("origin")
    );
    let same = cloud(1, 3).select(&[0; 300_000]);
    assert!(
        spz::encode(&same)
            .unwrap_err()
            .to_string()
            .contains("the same")
    );
}
