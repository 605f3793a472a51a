//! The way from a recording to a drive: `import`, `drive --follow-recording`, and what was seen.

use decouplegs::asset::{SceneFile, SeenFrom};
use decouplegs::logs::read_episode_log;
use decouplegs::scene::Pose;
use glam::{DQuat, DVec3};
use serde_json::json;

use super::*;

/// Images of two cameras along the first meters of the ego's way of the street in `folder`, as a
/// file of nerfstudio: names with a frame and a camera, one image each 0.5 m.
pub fn write_recording(folder: &Path, frames: u32) -> std::path::PathBuf {
    let scene = SceneFile::read(&folder.join("scene.toml")).unwrap();
    let way = scene.ego.unwrap();
    let speed_mps = way.motion_at(way.start_s() + 0.1).velocity_mps.length();
    // Camera axes: x to the right, y down, z ahead; then OpenGL's.
    let ahead = DQuat::from_mat3(&glam::DMat3::from_cols(
        DVec3::NEG_Y,
        DVec3::NEG_Z,
        DVec3::X,
    ));
    let mut images = Vec::new();
    for frame in 0..frames {
        let ego = way.at(way.start_s() + 0.5 * f64::from(frame) / speed_mps);
        for (number, left_m) in [(2, 0.0), (3, -0.5)] {
            let on_rig = Pose::new(ahead, DVec3::new(0.3, left_m, 0.75));
            let Pose {
                rotation,
                translation,
            } = ego.then(&on_rig);
            let axes = [
                rotation * DVec3::X,
                rotation * DVec3::NEG_Y,
                rotation * DVec3::NEG_Z,
            ];
            let row = |axis: usize| {
                json!([
                    axes[0][axis],
                    axes[1][axis],
                    axes[2][axis],
                    translation[axis]
                ])
            };
            images.push(json!({
                "file_path": format!("images/{frame:06}_{number}.png"),
                "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
            }));
        }
    }
    let file = folder.join("recorded.json");
    let text = json!({
        "camera_model": "PINHOLE", "w": 96, "h": 54, "fl_x": 60.0, "fl_y": 60.0, "cx": 48.0, "cy": 27.0, "frames": images,
    });
    fs::write(&file, text.to_string()).unwrap();
    file
}

/// Imports the recording of a small street; the folder of the new scene.
pub fn imported(folder: &Path, frames: u32) -> std::path::PathBuf {
    small_street(folder);
    let recording = write_recording(folder, frames);
    let out = folder.join("imported");
    let splats = folder.join("background.ply");
    succeed(&[
        "import",
        "nerfstudio",
        text(&recording),
        "--splats",
        text(&splats),
        "--out",
        text(&out),
        "--rate",
        "10",
    ]);
    out
}

#[test]
fn a_recording_becomes_a_scene_that_is_driven_as_it_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let scene = imported(folder.path(), 50);
    let file = SceneFile::read(&scene.join("scene.toml")).unwrap();
    let way = file.ego.clone().unwrap();
    assert_eq!(way.poses().len(), 50);
    assert!((way.end_s() - 4.9).abs() < 1e-9);
    assert_eq!(
        file.recording.seen_from,
        Some(SeenFrom::Cameras("cameras.json".into()))
    );
    let names: Vec<_> = file
        .rig
        .cameras()
        .map(|camera| camera.name.as_str())
        .collect();
    assert_eq!(names, ["front", "images_3"]);
    // The vehicle is where the street's ego was: the cameras were put on it.
    let truth = SceneFile::read(&folder.path().join("scene.toml"))
        .unwrap()
        .ego
        .unwrap();
    let off_m = way
        .at(0.0)
        .translation
        .distance(truth.at(truth.start_s()).translation);
    assert!(off_m < 1e-6, "{off_m} m");
    let run = folder.path().join("run");
    let map = scene.join("lanes.json");
    let scene_file = scene.join("scene.toml");
    succeed(&[
        "drive",
        "--scene",
        text(&scene_file),
        "--map",
        text(&map),
        "--follow-recording",
        "--planner",
        "constant-velocity",
        "--step",
        "0.5",
        "--size",
        "96x54",
        "--images",
        "all",
        "--out",
        text(&run),
    ]);
    let log = run.join("logs/recording.log");
    let episode = read_episode_log(&log).unwrap();
    // At each moment the ego is where it was recorded, whatever was planned.
    for tick in episode.instants() {
        let pose = way.at(tick.time_s);
        assert!(tick.ego.position_m.distance(pose.translation.truncate()) < 1e-9);
    }
    // What is drawn is what `render` draws from the recorded poses: same bytes.
    let images = folder.path().join("images");
    for (step, time) in [(0, "0"), (3, "1.5"), (6, "3")] {
        succeed(&[
            "render",
            text(&scene_file),
            "--time",
            time,
            "--force",
            "--out",
            text(&images),
        ]);
        let drawn = fs::read(run.join(format!("images/recording/front_{step:04}.png"))).unwrap();
        assert!(
            drawn == fs::read(images.join("front.png")).unwrap(),
            "step {step}"
        );
    }
    let replayed = succeed(&["replay", text(&log)]);
    assert!(replayed.contains("bit"), "{replayed}");
    let seen = fs::read_to_string(run.join("logs/recording.seen.csv")).unwrap();
    assert!(
        seen.lines()
            .skip(1)
            .all(|line| line.split(',').nth(1) == Some("1")),
        "{seen}"
    );
    // Nothing that exists is replaced.
    let recording = folder.path().join("recorded.json");
    let splats = folder.path().join("background.ply");
    let again = [
        "import",
        "nerfstudio",
        text(&recording),
        "--splats",
        text(&splats),
        "--out",
        text(&scene),
    ];
    assert!(fail(1, &again).contains("is not empty"));
}

#[test]
fn generated_episodes_stay_near_the_views_and_others_are_marked() {
    let folder = tempfile::tempdir().unwrap();
    let scene = imported(folder.path(), 80);
    let (map, scene_file) = (scene.join("lanes.json"), scene.join("scene.toml"));
    let run = folder.path().join("run");
    let drive = |more: &[&str], out: &Path| {
        let own = [
            "drive",
            "--scene",
            text(&scene_file),
            "--map",
            text(&map),
            "--render",
            "off",
        ];
        succeed(&[&own[..], more, &["--out", text(out)]].concat())
    };
    let said = drive(
        &[
            "--level",
            "easy",
            "--episodes",
            "4",
            "--planner",
            "lane-follow",
        ],
        &run,
    );
    assert!(!said.contains("shown badly"), "{said}");
    let report: Value =
        serde_json::from_slice(&fs::read(run.join("report.json")).unwrap()).unwrap();
    for episode in report["episodes"].as_array().unwrap() {
        assert_eq!(episode["seen"]["left_share"], 0.0, "{episode}");
    }
    // The same, but on to where no camera was: the lane goes on for 40 m.
    let scenario = run.join("scenarios/easy_0000.toml");
    let longer = fs::read_to_string(&scenario).unwrap();
    let end = longer
        .lines()
        .find(|line| line.starts_with("end_m"))
        .unwrap();
    let longer = longer.replace(end, "end_m = 85.0");
    let own = folder.path().join("longer.toml");
    fs::write(&own, longer).unwrap();
    let out = folder.path().join("beyond");
    let said = succeed(&[
        "drive",
        text(&own),
        "--planner",
        "lane-follow",
        "--render",
        "off",
        "--out",
        text(&out),
    ]);
    assert!(said.contains("shown badly in 1 of 1"), "{said}");
    let report: Value =
        serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
    let seen = &report["episodes"][0]["seen"];
    assert!(seen["left_at_s"].as_f64().unwrap() > 0.0, "{seen}");
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(
        page.contains("was not seen from"),
        "the page has no warning"
    );
}

#[test]
fn what_cannot_be_imported_is_said() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let splats = folder.path().join("background.ply");
    let out = folder.path().join("out");
    let import = |form: &str, path: &Path| {
        fail(
            1,
            &[
                "import",
                form,
                text(path),
                "--splats",
                text(&splats),
                "--out",
                text(&out),
            ],
        )
    };
    assert!(import("kitti", folder.path()).contains("calib_imu_to_velo.txt"));
    // Six cameras of one moment are no drive.
    let cameras = folder.path().join("transforms.json");
    assert!(import("nerfstudio", &cameras).contains("another camera"));
    assert!(!out.exists());
}
