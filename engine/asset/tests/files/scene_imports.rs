//! Checkpoints with actors, as scenes. The files are written by `checkpoints.py`, after what the
//! trainers save.

use std::path::Path;

use decouplegs_asset::scene_import::{
    ImportOptions, ImportedScene, decode_checkpoint, decode_ply, read_scene,
};
use decouplegs_asset::{SceneFile, checkpoint, inria_ply, open_scene, read_splats};
use decouplegs_scene::{ShFrame, SplatCloud, Track, TrackPoint};
use glam::{DVec2, DVec3};

use crate::errors::Errors;
use crate::sample::{cone, seed};

fn scene(name: &str, options: &ImportOptions) -> ImportedScene {
    read_scene(&seed(&format!("scene_import/{name}")), options)
        .unwrap()
        .expect("it has actors")
}

fn assert_same(found: &SplatCloud, expected: &SplatCloud) {
    let errors = Errors::between(expected, found);
    assert!(
        errors.mean_m == 0.0 && errors.dc == 0.0 && errors.rest == 0.0,
        "{errors:?}"
    );
    assert!(
        errors.scale_ln < 1e-6 && errors.angle_rad < 1e-6 && errors.opacity < 1e-6,
        "{errors:?}"
    );
}

#[test]
fn drivestudio_gives_background_cars_and_their_ways() {
    let scene = scene(
        "drivestudio.pth",
        &ImportOptions {
            frame_rate_hz: 5.0,
            ..ImportOptions::default()
        },
    );
    assert_same(&scene.background, &cone());
    let names: Vec<&str> = scene
        .actors
        .iter()
        .map(|actor| actor.name.as_str())
        .collect();
    assert_eq!(
        names,
        ["rigid_000", "rigid_001"],
        "the third instance has no splats"
    );
    let of = |first: u32| cone().select(&(first..12).step_by(2).collect::<Vec<_>>());
    assert_same(&scene.actors[0].splats, &of(0));
    assert_same(&scene.actors[1].splats, &of(1));
    let way = scene.actors[0].trajectory.as_ref().unwrap().poses();
    assert_eq!(
        way.iter().map(|pose| pose.time_s).collect::<Vec<_>>(),
        [0.0, 0.2, 0.4]
    );
    assert_eq!(way[1].pose.translation, DVec3::new(2.0, 0.0, 0.75));
    let late = scene.actors[1].trajectory.as_ref().unwrap().poses();
    assert_eq!(
        (late.len(), late[0].time_s, late[0].pose.translation),
        (2, 0.2, DVec3::new(12.0, 1.0, 0.75))
    );
    // The second is not in frame 0; from half a frame before frame 1 on it is there.
    let times = |actor: usize| scene.actors[actor].present.intervals_s().to_vec();
    assert_eq!((times(0), times(1)), (vec![], vec![[0.1, 0.5]]));
    // The zenith is face +y of the cube, north -z; splats are clamped before the sky is added.
    let sky = scene.sky.as_ref().unwrap();
    assert!(sky.clamps_splats && !sky.clamps);
    for (direction, face) in [(DVec3::Z, 2.0), (DVec3::Y, 5.0), (DVec3::X, 0.0)] {
        let [red, green, blue] = sky.color(direction);
        let error = [red - 0.1 * face, green - (1.0 - 0.1 * face), blue - 1.5];
        assert!(error.iter().all(|error| error.abs() < 1e-6), "{direction}");
    }
    // w first: a quarter turn to the left.
    assert!((late[0].pose.rotation * DVec3::X - DVec3::Y).length() < 1e-6);
    for part in ["SMPLNodes", "Sky", "1 instances", "5 a second"] {
        assert!(
            scene.notes.iter().any(|note| note.contains(part)),
            "{part}: {:?}",
            scene.notes
        );
    }
}

#[test]
fn an_imported_scene_is_written_and_opened() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene("drivestudio.pth", &ImportOptions::default());
    scene.write(folder.path()).unwrap();
    let path = folder.path().join("scene.toml");
    let file = SceneFile::read(&path).unwrap();
    assert!(
        file.agents
            .iter()
            .all(|agent| agent.sh_frame == Some(ShFrame::World))
    );
    let loaded = open_scene(&path, 0.1).unwrap();
    assert_eq!(
        (loaded.splat_scene.splats.len(), loaded.agent_labels.len()),
        (24, 2)
    );
    assert_eq!(
        loaded
            .splat_scene
            .instance_from_splat
            .iter()
            .filter(|&&id| id == 2)
            .count(),
        6
    );
}

#[test]
fn street_gaussians_places_actors_where_tracks_say() {
    let point = |time_s: f64, x: f64| TrackPoint {
        time_s,
        position_m: DVec2::new(x, 2.0),
        z_m: Some(0.8),
        yaw_rad: Some(0.5),
    };
    let track = Track {
        id: "7".into(),
        class: "car".into(),
        dims_m: None,
        points: vec![point(0.0, 1.0), point(0.1, 3.0)],
    };
    let scene = scene(
        "street_gaussians.pth",
        &ImportOptions {
            tracks: vec![track],
            ..ImportOptions::default()
        },
    );
    assert_same(&scene.background, &cone());
    assert_eq!(
        scene
            .actors
            .iter()
            .map(|actor| actor.name.as_str())
            .collect::<Vec<_>>(),
        ["obj_007", "obj_012"]
    );
    // Colors that change with time: the mean is the constant term.
    let first = cone().select(&[0, 1, 2, 3]);
    let errors = Errors::between(&first, &scene.actors[0].splats);
    assert!(errors.dc < 1e-6 && errors.mean_m == 0.0, "{errors:?}");
    let way = scene.actors[0].trajectory.as_ref().unwrap();
    assert_eq!(way.poses()[1].pose.translation, DVec3::new(3.0, 2.0, 0.8));
    assert_eq!(scene.actors[1].trajectory, None);
    for part in ["1 of 2 actors", "actor_pose", "2 models have colors"] {
        assert!(
            scene.notes.iter().any(|note| note.contains(part)),
            "{part}: {:?}",
            scene.notes
        );
    }
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(scene.write(folder.path()).unwrap().agents.len(), 1);
    // The sky of the checkpoint is that of the scene which is written: +z is face 4, clamped.
    let written = open_scene(&folder.path().join("scene.toml"), 0.0).unwrap();
    let sky = written.splat_scene.sky_map.expect("it has a sky");
    assert_eq!(Some(&*sky), scene.sky.as_ref());
    let [red, green, blue] = sky.color(DVec3::Z);
    assert!((red - 0.4).abs() < 1e-6 && (green - 0.6).abs() < 1e-6 && blue == 1.0);
    assert_same(
        &read_splats(&folder.path().join("assets/obj_012.ply")).unwrap(),
        &cone().select(&(4..12).collect::<Vec<_>>()),
    );
}

/// The network of the fixture by hand: the mean embedding is 0.5, that of image 1 is 0.75; relu(1 -
/// mean) is added to the row of red, 0.125 to the others, 0.5 to the offset of blue.
#[test]
fn color_corrections_of_drivestudio_are_the_photometry_of_the_scene() {
    let of = |image: Option<usize>| {
        let options = ImportOptions {
            image,
            ..ImportOptions::default()
        };
        scene("drivestudio.pth", &options)
    };
    let matrix = |added: f64| {
        [
            [1.0 + added, added, added, added],
            [0.125, 1.125, 0.125, 0.125],
            [0.125, 0.125, 1.125, 0.625],
        ]
    };
    let mean = of(None);
    assert_eq!(mean.photometry.matrix, matrix(0.5));
    assert_eq!(of(Some(1)).photometry.matrix, matrix(0.25));
    assert!(
        mean.notes
            .iter()
            .any(|note| note.contains("mean of 2 embeddings")),
        "{:?}",
        mean.notes
    );
    // The written scene applies it to all cameras that have no calibration of their own.
    let folder = tempfile::tempdir().unwrap();
    let file = mean.write(folder.path()).unwrap();
    assert_eq!(file.photometry, mean.photometry);
    let loaded = open_scene(&folder.path().join("scene.toml"), 0.0).unwrap();
    assert_eq!(loaded.splat_scene.photometry, mean.photometry);
}

#[test]
fn color_corrections_of_street_gaussians_are_a_mean_or_that_of_one_camera() {
    let of = |image: Option<usize>| {
        let options = ImportOptions {
            image,
            ..ImportOptions::default()
        };
        read_scene(&seed("scene_import/street_gaussians.pth"), &options)
    };
    let matrix = |image| of(image).unwrap().unwrap().photometry.matrix;
    let expected = |factor: f64, offset: f64| {
        [
            [factor, 0.0, 0.0, offset],
            [0.0, factor, 0.0, offset],
            [0.0, 0.0, factor, offset],
        ]
    };
    assert_eq!(matrix(None), expected(1.5, 0.125));
    assert_eq!(matrix(Some(0)), expected(1.0, 0.0));
    assert_eq!(matrix(Some(1)), expected(2.0, 0.25));
    let message = of(Some(2)).unwrap_err().to_string();
    assert!(message.contains("images 0 to 1"), "{message}");
}

/// A PLY with an element for each of `models`.
fn several(models: &[(&str, SplatCloud)]) -> Vec<u8> {
    let mut header = "ply\nformat binary_little_endian 1.0\n".to_owned();
    let mut body = Vec::new();
    for (name, cloud) in models {
        let file = inria_ply::encode(cloud);
        let end = file
            .windows(11)
            .position(|window| window == b"end_header\n")
            .unwrap();
        let own = std::str::from_utf8(&file[..end]).unwrap();
        let (_, own) = own.split_once("1.0\n").unwrap();
        header += &own.replace("element vertex", &format!("element vertex_{name}"));
        body.extend_from_slice(&file[end + 11..]);
    }
    [header.as_bytes(), b"end_header\n", &body].concat()
}

#[test]
fn a_ply_of_several_models_is_a_scene_and_one_of_a_single_is_not() {
    let car = cone().select(&[1, 5, 9]);
    let file = several(&[
        ("background", cone()),
        ("obj_003", car.clone()),
        ("sky", car.clone()),
    ]);
    let scene = decode_ply(&file, &ImportOptions::default())
        .unwrap()
        .unwrap();
    assert_same(&scene.background, &cone());
    assert_eq!(scene.actors.len(), 1);
    assert_same(&scene.actors[0].splats, &car);
    assert!(
        scene.notes.iter().any(|note| note.contains("sky")),
        "{:?}",
        scene.notes
    );
    assert_eq!(
        decode_ply(&inria_ply::encode(&cone()), &ImportOptions::default()).unwrap(),
        None
    );
}

#[test]
fn checkpoints_of_splats_alone_are_no_scene_and_scenes_say_how_they_are_read() {
    let read = |name: &str| std::fs::read(seed(name)).unwrap();
    assert_eq!(
        decode_checkpoint(&read("checkpoint/cone.pt"), &ImportOptions::default()).unwrap(),
        None
    );
    for name in [
        "scene_import/drivestudio.pth",
        "scene_import/street_gaussians.pth",
    ] {
        let message = checkpoint::decode(&read(name)).unwrap_err().to_string();
        assert!(message.contains("convert"), "{message}");
    }
    assert_eq!(
        read_scene(&seed("splat/cone.splat"), &ImportOptions::default()).unwrap(),
        None
    );
    assert!(
        read_scene(Path::new("absent.pth"), &ImportOptions::default())
            .unwrap_err()
            .to_string()
            .contains("absent.pth")
    );
}

#[test]
fn broken_checkpoints_of_scenes_are_errors() {
    for name in ["drivestudio.pth", "street_gaussians.pth"] {
        let whole = std::fs::read(seed(&format!("scene_import/{name}"))).unwrap();
        for length in (0..whole.len()).step_by(7) {
            assert!(
                decode_checkpoint(&whole[..length], &ImportOptions::default()).is_err(),
                "{name} cut to {length}"
            );
        }
        let mut refused = 0;
        let mut bytes = whole;
        for at in 0..bytes.len() {
            for flip in [0x01, 0x80] {
                bytes[at] ^= flip;
                refused +=
                    usize::from(decode_checkpoint(&bytes, &ImportOptions::default()).is_err());
                bytes[at] ^= flip;
            }
        }
        assert!(refused > 0, "{name}");
    }
}
