//! `decouplegs transform`.

use std::path::PathBuf;

use decouplegs::asset::{inria_ply, read_splats};
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, Similarity, SplatCloud};
use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};
use glam::{DQuat, DVec3, EulerRot};

use super::*;

/// Twelve splats of degree 3.
fn cone() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../engine/asset/fuzz/seeds/inria_ply/cone.ply")
}

/// The options that undo a transform, as its report says them.
fn way_back(said: &str) -> Vec<String> {
    let (_, options) = said.split_once("back with ").expect("a way back");
    let line = options.lines().next().unwrap();
    line.split(' ').map(str::to_owned).collect()
}

fn largest(a: &[[f32; 3]], b: &[[f32; 3]]) -> f32 {
    let pairs = a.as_flattened().iter().zip(b.as_flattened());
    pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

#[test]
fn splats_are_turned_and_come_back() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let (turned, back, report) = (at("turned.ply"), at("back.ply"), at("report.json"));
    let source = cone();
    let files = [
        "transform",
        text(&source),
        text(&turned),
        "--report",
        text(&report),
    ];
    let said = succeed(&[&files[..], &MOVES].concat());
    assert!(
        said.contains("12 of 12 splats") && said.contains("position, m"),
        "{said}"
    );
    assert!(said.contains("spherical harmonics by at most"), "{said}");
    let loss: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
    assert_eq!(loss["loss"]["position_m"]["max"], 0.0);

    let [before, after] = [cone(), turned.clone()].map(|path| read_splats(&path).unwrap());
    let expected = before.transformed(&moved());
    assert!(largest(&after.means, &expected.means) < 1e-6);
    assert!(largest(&after.sh_rest, &expected.sh_rest) < 1e-6);
    assert!(
        largest(&after.sh_rest, &before.sh_rest) > 0.01,
        "colors turn"
    );

    let undo = way_back(&said);
    let undo: Vec<&str> = undo.iter().map(String::as_str).collect();
    succeed(&[&["transform", text(&turned), text(&back)][..], &undo].concat());
    let restored = read_splats(&back).unwrap();
    assert!(largest(&restored.means, &before.means) < 2e-6);
    assert!(largest(&restored.scales, &before.scales) < 1e-6);
    assert!(largest(&restored.sh_rest, &before.sh_rest) < 1e-6);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        3,
        "no temporary file is left"
    );
}

/// Options of a turn, a scale and a move.
const MOVES: [&str; 8] = [
    "--axes",
    "-y:z",
    "--rotate-deg",
    "10,-20,30",
    "--scale",
    "2.5",
    "--translate",
    "-1,2,0.5",
];

/// The similarity that [`MOVES`] are.
fn moved() -> Similarity {
    let [x, y, z] = [10.0, -20.0, 30.0].map(f64::to_radians);
    Similarity::from_translation(DVec3::new(-1.0, 2.0, 0.5))
        .then(&Similarity::from_scale(2.5))
        .then(&Similarity::from_rotation(DQuat::from_euler(
            EulerRot::ZYX,
            z,
            y,
            x,
        )))
        .then(&Similarity::from_axes(DVec3::NEG_Y, DVec3::Z))
}

#[test]
fn a_turned_file_looks_the_same_to_a_turned_camera() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let [turned, unturned_colors] = [at("turned.ply"), at("colors.ply")];
    succeed(&[&["transform", text(&cone()), text(&turned)][..], &MOVES].concat());
    let (before, after) = (read_splats(&cone()).unwrap(), read_splats(&turned).unwrap());
    let stale = SplatCloud {
        sh_rest: before.sh_rest.clone(),
        ..after
    };
    inria_ply::write(&unturned_colors, &stale).unwrap();

    let bounds = before.bounds();
    let center = DVec3::from_array(bounds.center().map(f64::from));
    let radius_m = f64::from(bounds.half_extent().into_iter().fold(0.0, f32::max));
    let eye = center + DVec3::new(1.0, -0.6, -1.5) * 2.5 * radius_m;
    let camera = Camera {
        name: "camera".into(),
        intrinsics: Intrinsics::from_horizontal_fov(96, 64, 1.0),
        world_from_camera: Pose::look_at(eye, center, DVec3::NEG_Y).unwrap(),
        motion: Motion::REST,
    };
    let turned_camera = Camera {
        world_from_camera: moved().placed(&camera.world_from_camera),
        ..camera.clone()
    };
    let session = Session::open(&SessionOptions::default()).unwrap();
    let image = |path: &Path, camera: &Camera| {
        let (scene, mut images) = (session.open_scene(path).unwrap(), HostImages::default());
        let world = World::new(&scene);
        let view = WorldView {
            world: &world,
            cameras: std::slice::from_ref(camera),
        };
        session.batch_renderer().draw(&[view], &mut images).unwrap();
        images.rgba(0, 0).to_vec()
    };
    // Of bytes: 48 dB are one step everywhere.
    let psnr_db = |a: &[u8], b: &[u8]| {
        let squares = a
            .iter()
            .zip(b)
            .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2));
        let mean = squares.sum::<f64>() / a.len() as f64;
        20.0 * (255.0 / mean.sqrt().max(1e-9)).log10()
    };
    let original = image(&cone(), &camera);
    assert!(original.iter().any(|&byte| byte > 60), "something is seen");
    let same = psnr_db(&original, &image(&turned, &turned_camera));
    assert!(same > 60.0, "{same} dB");
    let colors = psnr_db(&original, &image(&unturned_colors, &turned_camera));
    let place = psnr_db(&original, &image(&turned, &camera));
    assert!(colors < 50.0 && place < 50.0, "{colors} dB, {place} dB");
}

#[test]
fn splats_are_cut_dropped_and_merged_in_the_order_that_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let splats = |arguments: &[&str]| -> (usize, String) {
        let out = at("out.ply");
        let input = at("in.ply");
        let files = ["transform", text(&input), text(&out), "--force"];
        let said = succeed(&[&files[..], arguments].concat());
        (read_splats(&out).unwrap().len(), said)
    };
    // A row along x, ever fainter.
    let count = 10;
    let row = SplatCloud {
        means: (0..count).map(|i| [i as f32, 0.0, 0.0]).collect(),
        scales: vec![[0.1; 3]; count],
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
        opacities: (0..count).map(|i| 1.0 - 0.1 * i as f32).collect(),
        sh_degree: 0,
        sh_dc: vec![[0.0; 3]; count],
        sh_rest: vec![],
    };
    inria_ply::write(&at("in.ply"), &row).unwrap();
    let (kept, said) = splats(&["--crop-box", "-1,-1,-1,4.5,1,1"]);
    assert_eq!(kept, 5);
    assert!(
        said.contains("--crop-box -1,-1,-1,4.5,1,1: 5 splats left out"),
        "{said}"
    );
    assert_eq!(splats(&["--crop-sphere", "5,0,0,1.5"]).0, 3);
    // The same box before and behind a move.
    assert_eq!(
        splats(&["--crop-box", "0,-1,-1,4.5,1,1", "--translate", "2,0,0"]).0,
        5
    );
    assert_eq!(
        splats(&["--translate", "2,0,0", "--crop-box", "0,-1,-1,4.5,1,1"]).0,
        3
    );
    assert_eq!(
        splats(&["--scale", "0.5", "--crop-sphere", "0,0,0,1.1"]).0,
        3
    );
    assert_eq!(splats(&["--drop-faint", "0.45"]).0, 6);
    let other = text(&at("in.ply")).to_owned();
    let (merged, said) = splats(&[
        "--translate",
        "0,5,0",
        "--merge",
        &other,
        "--drop-faint",
        "0.45",
    ]);
    assert_eq!(merged, 12);
    assert!(
        said.contains("10 splats more") && !said.contains("back with"),
        "{said}"
    );
    let both = read_splats(&at("out.ply")).unwrap();
    assert_eq!((both.means[0], both.means[6]), ([0.0, 5.0, 0.0], [0.0; 3]));
    assert_eq!(splats(&["--drop-floaters=0.001"]).0, 10);

    // Every format that convert writes.
    for name in [
        "a.ply",
        "a.spz",
        "a.sog",
        "a.glb",
        "a.splat",
        "a.safetensors",
        "a.compressed.ply",
    ] {
        let said = succeed(&[
            "transform",
            text(&at("in.ply")),
            text(&at(name)),
            "--axes",
            "z-up",
        ]);
        assert!(said.contains(name), "{said}");
        let means = read_splats(&at(name)).unwrap().means;
        assert!(
            means.len() == 10 && means.iter().any(|mean| (mean[0] - 9.0).abs() < 0.01),
            "{name}"
        );
    }
}

#[test]
fn nothing_is_replaced_and_nonsense_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::copy(cone(), at("in.ply")).unwrap();
    fs::copy(cone(), at("other.ply")).unwrap();
    let (input, other) = (at("in.ply"), at("other.ply"));
    let before = fs::read(&input).unwrap();
    let (input, other) = (text(&input), text(&other));
    assert!(fail(1, &["transform", input, other, "--scale", "2"]).contains("--force"));
    let in_place = ["transform", input, input, "--scale", "2", "--force"];
    assert!(fail(1, &in_place).contains("is read"));
    let onto_merged = ["transform", input, other, "--merge", other, "--force"];
    assert!(fail(1, &onto_merged).contains("is read"));
    let new = at("new.ply");
    let new = text(&new);
    assert!(fail(2, &["transform", input, new]).contains("--translate"));
    for wrong in ["0", "-1", "NaN", "inf"] {
        assert!(fail(2, &["transform", input, new, "--scale", wrong]).contains("expected"));
    }
    assert!(
        fail(2, &["transform", input, new, "--translate", "1,inf,2"]).contains("three numbers")
    );
    let far = ["transform", input, new, "--crop-sphere", "1000,0,0,1"];
    assert!(fail(1, &far).contains("leaves no splat"));
    let huge = [
        ["transform", input, new].as_slice(),
        &["--scale", "1e9"].repeat(5),
    ]
    .concat();
    assert!(fail(1, &huge).contains("beyond 3e38"));
    assert!(fail(1, &["transform", input, new, "--merge", "absent.ply"]).contains("absent.ply"));
    assert_eq!(fs::read(input).unwrap(), before);
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        2,
        "nothing is left"
    );
}
