use std::f64::consts::FRAC_PI_2;

use super::*;
use crate::zip::StoredZip;

/// A NumPy file.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.as_bytes());
    bytes.extend(data);
    bytes
}

fn floats(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn doubles(values: &[f64]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

fn npz(entries: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut zip = StoredZip::new(&mut bytes);
    for (name, data) in entries {
        zip.add(name, data).unwrap();
    }
    zip.finish().unwrap();
    bytes
}

#[test]
fn points_are_those_of_each_format() {
    let expected = [DVec3::new(1.0, 2.0, -0.5), DVec3::new(-4.0, 0.25, 3.0)];
    let kitti = floats(&[1.0, 2.0, -0.5, 0.3, -4.0, 0.25, 3.0, 0.1]);
    // x to the right, y forward.
    let nuscenes = floats(&[-2.0, 1.0, -0.5, 9.0, 1.0, -0.25, -4.0, 3.0, 9.0, 2.0]);
    let millimeters: Vec<u8> = [1000, 2000, -500, 7, -4000, 250, 3000, 7]
        .iter()
        .flat_map(|value: &i32| value.to_le_bytes())
        .collect();
    let array = npy("<i4", "(2, 4)", &millimeters);
    let meters = npy(
        "<f8",
        "(2, 3)",
        &doubles(&[1.0, 2.0, -0.5, -4.0, 0.25, 3.0]),
    );
    for (format, bytes) in [
        (ScanFormat::Kitti, kitti),
        (ScanFormat::NuScenes, nuscenes),
        (ScanFormat::Npy, meters),
        (ScanFormat::Npz, npz(&[("points.npy", array)])),
    ] {
        let scan = decode(format, &bytes).unwrap();
        assert_eq!(scan.points_m, expected, "{format:?}");
        assert_eq!(scan.world_from_lidar, None);
    }
}

#[test]
fn an_archive_tells_where_the_sensor_was() {
    let points = npy("<f4", "(1, 3)", &floats(&[1.0, 0.0, 0.0]));
    // A quarter of a turn to the left, at (5, 6, 7).
    let matrix = [
        0.0, -1.0, 0.0, 5.0, 1.0, 0.0, 0.0, 6.0, 0.0, 0.0, 1.0, 7.0, 0.0, 0.0, 0.0, 1.0,
    ];
    let pose = npy("<f8", "(4, 4)", &doubles(&matrix));
    let archive = npz(&[
        ("points.npy", points.clone()),
        ("world_from_lidar.npy", pose),
    ]);
    let found = decode(ScanFormat::Npz, &archive).unwrap();
    let found = found.world_from_lidar.unwrap();
    assert!((found.translation - DVec3::new(5.0, 6.0, 7.0)).length() < 1e-12);
    assert!(
        found
            .rotation
            .angle_between(DQuat::from_rotation_z(FRAC_PI_2))
            < 1e-7
    );
    let mirrored = matrix.map(|entry: f64| -entry);
    let bad = npy("<f8", "(4, 4)", &doubles(&mirrored));
    let archive = npz(&[("points.npy", points), ("world_from_lidar.npy", bad)]);
    let error = decode(ScanFormat::Npz, &archive).unwrap_err().to_string();
    assert!(error.contains("no rotation"), "{error}");
}

#[test]
fn what_is_no_scan_is_refused_with_a_sentence() {
    for (bytes, says) in [
        (floats(&[1.0; 5]), "whole number of points"),
        (floats(&[0.0; 8]), "no point"),
        (floats(&[f32::NAN; 8]), "no point"),
        (Vec::new(), "no point"),
    ] {
        let error = decode(ScanFormat::Kitti, &bytes).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
    let data = floats(&[1.0; 6]);
    for (bytes, says) in [
        (npy("<f2", "(2, 3)", &data), "<f2"),
        (npy("<f4", "(2, 4)", &data), "does not take"),
        (npy("<f4", "(6,)", &data), "1 dimensions"),
        (npy("<f4", "(3, 2)", &data), "2 values"),
        (
            npy("<f4", "(99999999999, 99999999999)", &data),
            "does not take",
        ),
        (npy("<f4", "(2, x)", &data), "no number"),
        (b"\x93NUMPY\x01\x00\xff\xff".to_vec(), "needs"),
        (b"PK".to_vec(), "first bytes"),
    ] {
        let error = decode(ScanFormat::Npy, &bytes).unwrap_err().to_string();
        assert!(error.contains(says), "{says}: {error}");
    }
    // Whatever is cut off or changed, it answers.
    let whole = npz(&[("points.npy", npy("<f4", "(2, 3)", &data))]);
    for length in 0..whole.len() {
        let _ = decode(ScanFormat::Npz, &whole[..length]);
        let mut damaged = whole.clone();
        damaged[length] ^= 0x21;
        let _ = decode(ScanFormat::Npz, &damaged);
    }
}

#[test]
fn names_tell_formats() {
    for (name, format) in [
        ("a/000001.bin", Some(ScanFormat::Kitti)),
        ("a.PCD.BIN", Some(ScanFormat::NuScenes)),
        ("a.npy", Some(ScanFormat::Npy)),
        ("a.npz", Some(ScanFormat::Npz)),
        ("a.las", None),
    ] {
        assert_eq!(ScanFormat::of_path(Path::new(name)), format, "{name}");
    }
}
