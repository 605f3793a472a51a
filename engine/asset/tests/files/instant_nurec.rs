//! Bundles of Instant NuRec: splats with labels, a sky beside them, and calibrations of cameras.

use std::path::{Path, PathBuf};

use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{LoadedScene, SkyKind, inria_ply, open_scene, sky_file};
use decouplegs_scene::Photometry;
use glam::{DMat3, DVec3};

use crate::data::data;
use crate::sample::cloud;

/// An array of NumPy.
fn npy(descr: &str, shape: &str, data: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}\n");
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(data);
    bytes
}

fn texts(texts: &[&str]) -> Vec<u8> {
    let longest = texts.iter().map(|text| text.len()).max().unwrap_or(1);
    let letters = texts.iter().flat_map(|text| {
        let codes = text.chars().map(u32::from);
        codes.chain(std::iter::repeat(0)).take(longest)
    });
    let data: Vec<u8> = letters.flat_map(u32::to_le_bytes).collect();
    npy(
        &format!("<U{longest}"),
        &format!("({},)", texts.len()),
        &data,
    )
}

fn text(text: &str) -> Vec<u8> {
    let data: Vec<u8> = text
        .chars()
        .flat_map(|letter| u32::from(letter).to_le_bytes())
        .collect();
    npy(&format!("<U{}", text.len()), "()", &data)
}

fn floats(shape: &str, values: &[f32]) -> Vec<u8> {
    let data: Vec<u8> = values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    npy("<f4", shape, &data)
}

/// Entries of a bundle with one texel a face, whose red is the number of the face.
fn entries() -> Vec<(&'static str, Vec<u8>)> {
    let texels: Vec<f32> = (0..6).flat_map(|face| [face as f32, 0.0, 0.25]).collect();
    let affine = [
        1.5, 0.1, 0.0, 0.25, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.5, -0.125,
    ];
    vec![
        ("format_version", npy("<i4", "()", &1i32.to_le_bytes())),
        ("sky_cubemap", floats("(6, 1, 1, 3)", &texels)),
        ("affine_matrix", floats("(1, 3, 4)", &affine)),
        ("affine_sensor_ids", texts(&["front"])),
        ("face_axes", texts(&["+X", "-X", "-Y", "+Y", "+Z", "-Z"])),
        ("uv_convention", text("u_left_to_right_v_top_to_bottom")),
    ]
}

fn npz(entries: &[(&'static str, Vec<u8>)]) -> Vec<u8> {
    let mut zip = StoredZip::new(Vec::new());
    for (name, bytes) in entries {
        zip.add(&format!("{name}.npy"), bytes).unwrap();
    }
    zip.finish().unwrap()
}

/// A PLY of `count` splats, of which every third shows the road and every fourth the sky.
fn labeled(count: usize) -> Vec<u8> {
    let splats = cloud(count, 0);
    let plain = inria_ply::encode(&splats);
    let end = b"end_header\n";
    let at = plain
        .windows(end.len())
        .position(|part| part == end)
        .unwrap();
    let (header, rows) = (&plain[..at], &plain[at + end.len()..]);
    let mut bytes = header.to_vec();
    bytes.extend(b"property uchar road_mask\nproperty float sky_mask\n");
    bytes.extend(end);
    for (splat, row) in rows.chunks_exact(rows.len() / count).enumerate() {
        // Behind x, y and z.
        let normal = normal_of(splat).map(|x| (2.0 * x).to_le_bytes());
        bytes.extend([&row[..12], normal.as_flattened(), &row[24..]].concat());
        bytes.push(u8::from(splat % 3 == 0));
        let share: f32 = if splat % 4 == 1 { 0.75 } else { 0.25 };
        bytes.extend(share.to_le_bytes());
    }
    bytes
}

/// Normal of a splat of [`labeled`], whose file has twice its length; every seventh has none.
fn normal_of(splat: usize) -> [f32; 3] {
    match splat % 7 {
        0 => [0.0; 3],
        n if n % 2 == 1 => [0.0, 0.6, 0.8],
        _ => [-1.0, 0.0, 0.0],
    }
}

fn bundle(folder: &Path) -> PathBuf {
    let path = folder.join("street.ply");
    std::fs::write(&path, labeled(24)).unwrap();
    std::fs::write(folder.join("street.sky.npz"), npz(&entries())).unwrap();
    path
}

#[test]
fn splats_come_with_the_sky_beside_them_and_their_labels() {
    let folder = tempfile::tempdir().unwrap();
    let loaded = open_scene(&bundle(folder.path()), 0.0).unwrap();
    let sky = loaded.splat_scene.sky_map.as_ref().unwrap();
    let axes = [
        DVec3::X,
        -DVec3::X,
        -DVec3::Y,
        DVec3::Y,
        DVec3::Z,
        -DVec3::Z,
    ];
    for (face, axis) in axes.into_iter().enumerate() {
        assert_eq!(sky.color(axis), [face as f64, 0.0, 0.25]);
    }
    let row = |row: [f32; 4]| row.map(f64::from);
    assert_eq!(
        loaded.photometry_of_camera("front").matrix,
        [
            row([1.5, 0.1, 0.0, 0.25]),
            row([0.0, 1.0, 0.0, 0.0]),
            row([0.0, 0.0, 0.5, -0.125])
        ]
    );
    assert!(loaded.photometry_of_camera("rear").is_identity());
    // Labels follow their splats into spatial order.
    let original = cloud(24, 0);
    let means = &loaded.splat_scene.splats.means;
    let of = |labels: &[u32]| {
        let mut found: Vec<[f32; 3]> = labels.iter().map(|splat| means[*splat as usize]).collect();
        found.sort_by(|a, b| a.partial_cmp(b).unwrap());
        found
    };
    let mut expected: Vec<[f32; 3]> = original.means.iter().skip(1).step_by(4).copied().collect();
    expected.sort_by(|a, b| a.partial_cmp(b).unwrap());
    assert_eq!(of(&loaded.splat_scene.sky_splats), expected);
    let road = (0..24)
        .step_by(3)
        .filter(|splat| original.opacities[*splat] >= 0.5);
    assert_eq!(loaded.recording.ground_m.len(), road.count());
    let met = loaded.splat_scene.without_sky_splats();
    assert_eq!(met.splats.len(), 18);
    assert_eq!(loaded.normals().len(), 24);
    for (mean, normal) in means.iter().zip(loaded.normals()) {
        let splat = original.means.iter().position(|own| own == mean).unwrap();
        let expected = normal_of(splat);
        for (found, expected) in normal.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6, "{splat}: {normal:?}");
        }
    }
}

/// Trainers write zeros in place of normals.
#[test]
fn files_without_normals_have_none() {
    let splats = cloud(24, 0);
    let zeros = inria_ply::encode(&splats);
    let placed = inria_ply::decode_placed(&zeros).unwrap();
    assert!(placed.labels.normals.is_empty());
    // A background that was changed is no longer the one that its file has normals of.
    let folder = tempfile::tempdir().unwrap();
    let mut loaded = open_scene(&bundle(folder.path()), 0.0).unwrap();
    loaded.splat_scene.splats = loaded.splat_scene.splats.select(&[1, 2, 3]);
    assert!(loaded.normals().is_empty());
}

#[test]
fn a_scene_file_names_the_sky_and_its_cameras_are_calibrated_by_it() {
    let folder = tempfile::tempdir().unwrap();
    bundle(folder.path());
    let camera = |name: &str| {
        format!(
            "[[rig]]\nname = \"{name}\"\nwidth_px = 8\nheight_px = 8\nfx_px = 8.0\nfy_px = 8.0\ncx_px = 4.0\ncy_px = 4.0\nposition_m = [0.0, 0.0, 0.0]\nlook = [1.0, 0.0, 0.0]\n"
        )
    };
    let text = format!(
        "version = 1\norigin = [100.0, 0.0, 0.0]\nbackground = \"street.ply\"\n[sky]\nkind = \"npz\"\nfile = \"street.sky.npz\"\n{}{}photometry = {{ exposure_ev = 1.0 }}\n{}",
        camera("front"),
        camera("left"),
        camera("rear")
    );
    let path = folder.path().join("scene.toml");
    std::fs::write(&path, text).unwrap();
    let loaded = open_scene(&path, 0.0).unwrap();
    let photometry: Vec<Photometry> = loaded
        .rig
        .cameras()
        .map(|camera| camera.intrinsics.photometry)
        .collect();
    assert_eq!(photometry[0], loaded.photometry_of_camera("front"));
    assert_eq!(photometry[1].exposure_ev, 1.0);
    assert!(photometry[2].is_identity());
    // The road stands about the origin of the scene.
    let near = |point: &DVec3| (point.x - 100.0).abs() < 50.0;
    assert!(!loaded.recording.ground_m.is_empty());
    assert!(loaded.recording.ground_m.iter().all(near));
}

#[test]
fn broken_bundles_get_a_sentence() {
    let decode = |bytes: &[u8]| sky_file::decode(bytes, SkyKind::Npz, DMat3::IDENTITY);
    let whole = npz(&entries());
    assert!(decode(&whole).is_ok());
    for cut in (0..whole.len()).step_by(7) {
        assert!(decode(&whole[..cut]).is_err(), "{cut}");
    }
    let changed = |name: &'static str, bytes: Vec<u8>| {
        let mut entries = entries();
        entries.retain(|(own, _)| *own != name);
        entries.push((name, bytes));
        decode(&npz(&entries)).unwrap_err().to_string()
    };
    let expect = |found: &str, part: &str| assert!(found.contains(part), "{found}");
    expect(
        &changed("format_version", floats("()", &[2.0])),
        "format_version",
    );
    expect(&changed("face_axes", texts(&["+X"])), "face_axes");
    expect(
        &changed("sky_cubemap", floats("(6, 1, 2, 3)", &[0.0; 36])),
        "[6, S, S, 3]",
    );
    expect(
        &changed("sky_cubemap", floats("(6, 1, 1, 3)", &[f32::NAN; 18])),
        "texel 0",
    );
    expect(
        &changed("affine_matrix", floats("(2, 3, 4)", &[0.0; 24])),
        "[1, 3, 4]",
    );
    expect(
        &changed("affine_matrix", floats("(1, 3, 4)", &[f32::NAN; 12])),
        "'front'",
    );
    expect(&changed("uv_convention", text("other")), "uv_convention");
}

/// A bundle that was written with the libraries that Instant NuRec uses, and the colors of its sky
/// by its table of faces.
#[test]
fn a_bundle_of_its_libraries_has_the_colors_of_its_sky() {
    let Some(path) = data("../repro/real/instant_nurec/street.ply") else {
        return;
    };
    let loaded: LoadedScene = open_scene(&path, 0.0).unwrap();
    let sky = loaded.splat_scene.sky_map.as_ref().unwrap();
    let expected = std::fs::read(path.with_file_name("expected.json")).unwrap();
    let expected: Vec<serde_json::Value> = serde_json::from_slice(&expected).unwrap();
    let triple = |value: &serde_json::Value| -> [f64; 3] {
        std::array::from_fn(|axis| value[axis].as_f64().unwrap())
    };
    let mut worst = 0.0f64;
    for row in &expected {
        let found = sky.color(DVec3::from_array(triple(&row["direction"])));
        for (found, expected) in found.iter().zip(triple(&row["sky"])) {
            worst = worst.max((found - expected).abs());
        }
    }
    println!("{} directions, {worst:.2e} at most", expected.len());
    assert!(expected.len() == 40 && worst < 1e-6, "{worst}");
    let front = loaded
        .photometry_of_camera("camera_front_wide_120fov")
        .matrix;
    let [factor, offset] = [1.2f32, 0.05].map(f64::from);
    assert_eq!(front[0], [factor, 0.0, 0.0, offset]);
    assert_eq!(front[2], [0.0, 0.0, factor, offset]);
    let left = loaded
        .photometry_of_camera("camera_cross_left_120fov")
        .matrix;
    assert_eq!(left[0], [1.0, f64::from(0.1f32), 0.0, 0.0]);
    let up = loaded.normals().iter().filter(|normal| normal[2] > 0.99);
    println!(
        "{} normals, {} up",
        loaded.normals().len(),
        up.clone().count()
    );
    assert_eq!((loaded.normals().len(), up.count()), (3000, 3000));
    let road_m = &loaded.recording.ground_m;
    assert!(road_m.len() > 900, "{}", road_m.len());
    assert!(
        road_m
            .iter()
            .all(|point| point.z.abs() < 0.1 && point.y.abs() < 4.01)
    );
}
