//! Folders of HUGSIM, as scenes. The files are written by `checkpoints.py`, in the layout that
//! HUGSIM's trainer saves.

use std::path::PathBuf;

use decouplegs_asset::open_scene;
use decouplegs_asset::scene_import::{
    HugsimFiles, ImportOptions, ImportedScene, decode_checkpoint, decode_hugsim, read_scene,
};
use decouplegs_scene::{Pose, Rules, SplatCloud, sh};
use glam::{DMat3, DQuat, DVec3};

use crate::errors::Errors;
use crate::sample::{cone, seed};

fn folder() -> PathBuf {
    seed("scene_import/hugsim")
}

fn scene(options: &ImportOptions) -> ImportedScene {
    read_scene(&folder(), options).unwrap().expect("a scene")
}

/// Turn from x right, y down, z forward to x forward, y left, z up.
fn turn() -> Pose {
    let columns = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X);
    Pose::new(DQuat::from_mat3(&columns), DVec3::ZERO)
}

/// Color of a splat towards `direction`, before the half that is added to it.
fn color(splats: &SplatCloud, splat: usize, direction: DVec3) -> [f64; 3] {
    let basis = sh::basis(direction);
    let rest = splats.rest_of(splat);
    std::array::from_fn(|channel| {
        let terms = rest.iter().zip(&basis[1..]);
        let rest: f64 = terms.map(|(c, y)| f64::from(c[channel]) * y).sum();
        f64::from(splats.sh_dc[splat][channel]) * basis[0] + rest
    })
}

fn assert_close(found: &SplatCloud, expected: &SplatCloud) {
    let errors = Errors::between(expected, found);
    assert!(
        errors.mean_m < 1e-6 && errors.dc == 0.0 && errors.rest < 1e-6,
        "{errors:?}"
    );
    assert!(
        errors.scale_ln < 1e-6 && errors.angle_rad < 1e-6 && errors.opacity < 1e-6,
        "{errors:?}"
    );
}

#[test]
fn a_folder_of_hugsim_gives_background_and_ground_with_z_up() {
    let scene = scene(&ImportOptions::default());
    let (count, ground) = (cone().len(), scene.background.len() - cone().len());
    assert_eq!(ground, 12);
    let of = |from: usize, to: usize| {
        let order: Vec<u32> = (from as u32..to as u32).collect();
        scene.background.select(&order)
    };
    assert_close(&of(0, count), &cone().placed(&turn(), true));
    for splat in count..2 * count {
        let [forward_m, _, up_m] = scene.background.means[splat];
        assert!((up_m + 1.5).abs() < 1e-6 && forward_m >= -1e-6, "{splat}");
        // Ground splats are thin along the vertical: y of the source.
        let scales = scene.background.scales[splat];
        assert!((scales[1] - 1e-3).abs() < 1e-8, "{scales:?}");
        assert_eq!(scales[2], cone().scales[splat - count][1]);
    }
    assert_eq!(scene.rules, Rules::GSPLAT16);
    let notes = scene.notes.join("\n");
    for expected in ["12 splats of the ground", "feats3D", "500 m"] {
        assert!(notes.contains(expected), "{notes}");
    }
}

#[test]
fn colors_keep_their_direction_when_the_world_is_turned() {
    let scene = scene(&ImportOptions::default());
    let direction = DVec3::new(0.3, -0.5, 0.8).normalize();
    for splat in 0..4 {
        let before = color(&cone(), splat, direction);
        let turned = turn().rotation * direction;
        let static_splat = color(&scene.background, splat, turned);
        // Actors' colors are in the frame of the world too.
        let moving = color(&scene.actors[0].splats, splat, turned);
        for found in [static_splat, moving] {
            for (found, before) in found.into_iter().zip(before) {
                assert!((found - before).abs() < 1e-5, "{found} {before}");
            }
        }
    }
}

#[test]
fn an_actor_of_hugsim_drives_in_the_axes_of_its_box() {
    let scene = scene(&ImportOptions::default());
    let [actor] = &scene.actors[..] else {
        panic!("{}", scene.actors.len())
    };
    assert_eq!(actor.name, "dynamic_3");
    // The source's box has y to the right and z down: half a turn about x.
    let half = Pose::new(DQuat::from_rotation_x(std::f64::consts::PI), DVec3::ZERO);
    let order: Vec<u32> = (0..4).collect();
    let expected = cone().select(&order).placed(&half, false);
    for (found, expected) in actor.splats.means.iter().zip(&expected.means) {
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-6);
        }
    }
    let poses = actor.trajectory.as_ref().unwrap().poses();
    assert_eq!(poses.len(), 2);
    for (timed, (time_s, x_m)) in poses.iter().zip([(0.5, 12.0), (1.0, 14.0)]) {
        assert!((timed.time_s - time_s).abs() < 1e-9);
        let at = timed.pose.translation - DVec3::new(x_m, -3.0, -0.75);
        assert!(at.length() < 1e-9, "{at}");
        let ahead = timed.pose.rotation * DVec3::X - DVec3::X;
        let up = timed.pose.rotation * DVec3::Z - DVec3::Z;
        assert!(ahead.length() < 1e-9 && up.length() < 1e-9, "{timed:?}");
    }
    assert_eq!(actor.present.intervals_s(), [[0.25, 1.25]]);
}

#[test]
fn cameras_and_the_path_of_the_ego_come_from_the_metadata() {
    let scene = scene(&ImportOptions::default());
    let ego = scene.ego.as_ref().unwrap();
    let path: Vec<DVec3> = ego.poses().iter().map(|t| t.pose.translation).collect();
    for (found, x_m) in path.iter().zip([0.0, 4.0, 8.0]) {
        assert!(
            (*found - DVec3::new(x_m, 0.0, -1.5)).length() < 1e-6,
            "{found}"
        );
    }
    let cameras: Vec<_> = scene.rig.cameras().collect();
    assert_eq!(cameras[0].name, "CAM_FRONT");
    assert_eq!(cameras[1].name, "CAM_BACK");
    let back = &cameras[1].rig_from_camera;
    assert!((back.translation - DVec3::new(-1.0, 0.0, 1.5)).length() < 1e-6);
    assert!((back.rotation * DVec3::Z + DVec3::X).length() < 1e-9);
    let lens = cameras[0].intrinsics;
    assert_eq!(
        (
            lens.width_px,
            lens.fx_px,
            lens.fy_px,
            lens.cx_px,
            lens.cy_px
        ),
        (800, 400.0, 410.0, 401.0, 226.0)
    );
    let lanes = scene.lanes.as_ref().unwrap();
    assert_eq!(lanes.lanes[0].centerline.len(), 3);
    assert!((lanes.lanes[0].left[1] - DVec3::new(4.0, 1.75, -1.5)).length() < 1e-6);
}

#[test]
fn cameras_of_one_folder_are_told_apart_by_their_order() {
    let read = |name: &str| std::fs::read(folder().join(name)).unwrap();
    let text = String::from_utf8(read("meta_data.json")).unwrap();
    let metadata = text.replace("CAM_FRONT/", "").replace("CAM_BACK/", "");
    let files = HugsimFiles {
        scene: &read("scene.pth"),
        metadata: Some(metadata.as_bytes()),
        actors: &[],
    };
    let found = decode_hugsim(&files, &ImportOptions::default()).unwrap();
    let names: Vec<&str> = found.rig.cameras().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["camera", "camera_2"]);
    let poses = [&found, &scene(&ImportOptions::default())].map(|scene| {
        let cameras = scene.rig.cameras();
        cameras.map(|c| c.rig_from_camera).collect::<Vec<_>>()
    });
    assert_eq!(poses[0], poses[1]);
}

#[test]
fn the_color_network_is_evaluated_for_each_camera() {
    let scene = scene(&ImportOptions::default());
    // The offset of red is 0.05 relu(cos(pi x / 60)); cameras stand at x = 0.
    let [front, back] = [0, 1].map(|camera| {
        let cameras: Vec<_> = scene.rig.cameras().collect();
        cameras[camera].intrinsics.photometry.matrix
    });
    assert_eq!(front, back);
    let expected = [
        [1.0, 0.0, 0.0, 0.05],
        [0.25, 1.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
    ];
    for (found, expected) in front.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((found - expected).abs() < 1e-6, "{front:?}");
    }
    let absent = read_scene(
        &folder(),
        &ImportOptions {
            image: Some(6),
            ..ImportOptions::default()
        },
    );
    let message = absent.unwrap_err().to_string();
    assert!(message.contains("images 0 to 5"), "{message}");
}

#[test]
fn a_hugsim_scene_is_written_and_opened_again() {
    let out = tempfile::tempdir().unwrap();
    scene(&ImportOptions::default()).write(out.path()).unwrap();
    let opened = open_scene(&out.path().join("scene.toml"), 0.5).unwrap();
    assert_eq!(opened.plain_agents.len(), 1);
    let lanes = decouplegs_asset::read_map(&out.path().join("lanes.json")).unwrap();
    assert_eq!(lanes.lanes[0].id, "recorded");
}

#[test]
fn one_file_of_hugsim_is_a_background_that_says_what_is_missing() {
    let bytes = std::fs::read(folder().join("scene.pth")).unwrap();
    let scene = decode_checkpoint(&bytes, &ImportOptions::default())
        .unwrap()
        .unwrap();
    assert_eq!((scene.background.len(), scene.actors.len()), (24, 0));
    assert!(scene.notes.join("\n").contains("convert its folder"));
}

#[test]
fn faults_of_a_hugsim_folder_name_the_file() {
    let read = |name: &str| std::fs::read(folder().join(name)).unwrap();
    let (scene, metadata) = (read("scene.pth"), read("meta_data.json"));
    let actors = [("3".to_owned(), read("dynamic_3.pth"))];
    let text = String::from_utf8(metadata.clone()).unwrap();
    let decode = |metadata: &[u8], actors: &[(String, Vec<u8>)]| {
        let files = HugsimFiles {
            scene: &scene,
            metadata: Some(metadata),
            actors,
        };
        decode_hugsim(&files, &ImportOptions::default())
    };
    assert!(decode(&metadata, &actors).is_ok());
    let broken = [("3".to_owned(), actors[0].1[..400].to_vec())];
    assert_eq!(
        decode(&metadata, &broken).unwrap_err().file,
        "dynamic_3.pth"
    );
    let replaced = |from: &str, to: &str| text.replacen(from, to, 1).into_bytes();
    for (metadata, expected) in [
        (b"{}".to_vec(), "frames"),
        (br#"{"frames": []}"#.to_vec(), "no frames"),
        (replaced("[1, 0, 0, 0]", "[2, 0, 0, 0]"), "frame 0"),
        (replaced("[1, 0, 0, 0]", "[1, 0, 0]"), "4 x 4"),
        (replaced("[400, 0, 401]", "[-400, 0, 401]"), "CAM_FRONT"),
        (replaced("[400, 0, 401]", "[400, 0]"), "intrinsics"),
    ] {
        let fault = decode(&metadata, &actors).unwrap_err();
        let message = fault.error.to_string();
        assert_eq!(fault.file, "meta_data.json", "{message}");
        assert!(message.contains(expected), "{message}");
    }
    // Cut anywhere, the metadata is an error and never a panic.
    for length in (0..metadata.len() - 2).step_by(3) {
        assert!(decode(&metadata[..length], &actors).is_err(), "{length}");
    }
    for length in (0..scene.len()).step_by(101) {
        assert!(decode_checkpoint(&scene[..length], &ImportOptions::default()).is_err());
    }
}

#[test]
fn cameras_without_number_are_no_metadata_and_images_take_no_search() {
    let frames = |count: usize, rgb_path: &dyn Fn(usize) -> String| {
        let frame = |index: usize| {
            format!(
                "{{\"rgb_path\": \"{}\", \"camtoworld\": [[1,0,0,0],[0,1,0,0],[0,0,1,{index}],[0,0,0,1]], \"intrinsics\": [[400,0,400],[0,400,300],[0,0,1]], \"width\": 800, \"height\": 600}}",
                rgb_path(index)
            )
        };
        let all: Vec<String> = (0..count).map(frame).collect();
        format!("{{\"frames\": [{}]}}", all.join(", "))
    };
    let scene = std::fs::read(folder().join("scene.pth")).unwrap();
    let decode = |metadata: &str| {
        let files = HugsimFiles {
            scene: &scene,
            metadata: Some(metadata.as_bytes()),
            actors: &[],
        };
        decode_hugsim(&files, &ImportOptions::default())
    };
    let own = frames(1001, &|index| format!("images/c{index}/1.jpg"));
    let fault = decode(&own).unwrap_err().error.to_string();
    assert!(fault.contains("more than 1000 cameras"), "{fault}");
    let many = frames(1000, &|index| format!("images/c{index}/1.jpg"));
    assert_eq!(decode(&many).unwrap().rig.cameras().count(), 1000);
    // Images of one camera that say no time are counted, each by one step.
    let one = decode(&frames(5000, &|_| "images/front/1.jpg".into())).unwrap();
    let ego = one.ego.unwrap();
    let step_s = 1.0 / ImportOptions::default().frame_rate_hz;
    assert!(
        (ego.end_s() - 4999.0 * step_s).abs() < 1e-6,
        "{}",
        ego.end_s()
    );
}

#[test]
fn what_is_no_file_under_the_name_of_the_scene_is_said() {
    let out = tempfile::tempdir().unwrap();
    let read = || read_scene(out.path(), &ImportOptions::default());
    assert_eq!(read().unwrap(), None);
    let path = out.path().join("scene.pth");
    let said = |word: &str| {
        let message = read().unwrap_err().to_string();
        assert!(
            message.contains("scene.pth") && message.contains(word),
            "{message}"
        );
    };
    std::fs::create_dir(&path).unwrap();
    said("folder");
    std::fs::remove_dir(&path).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
    said("regular file");
    std::fs::remove_file(&path).unwrap();
    std::os::unix::fs::symlink("nowhere", &path).unwrap();
    said("cannot read");
}
