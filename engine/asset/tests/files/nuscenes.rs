//! Scenes of nuScenes: small tables that are made here, and what are no such tables.

use std::fs;
use std::path::Path;

use decouplegs_asset::nuscenes::{NuscenesScene, Tables, decode};
use decouplegs_asset::tracks::nuscenes as annotated;
use decouplegs_scene::explain::explain;
use glam::DVec3;
use proptest::prelude::*;
use serde_json::{Value, json};

/// First sample, microseconds: as large as real ones.
const START_US: i64 = 1_532_402_927_647_951;
const NAMES: [&str; 9] = [
    "scene",
    "sample",
    "instance",
    "category",
    "sample_annotation",
    "sample_data",
    "ego_pose",
    "calibrated_sensor",
    "sensor",
];

/// Turn of a camera that looks ahead, as w, x, y, z.
const AHEAD: [f64; 4] = [0.5, -0.5, 0.5, -0.5];

/// Tables of two scenes. The first has two samples 0.5 s apart, a front camera with a sweep between
/// them, and a LiDAR; its vehicle drives 10 m/s to the north far from the origin.
fn tables() -> Vec<Value> {
    let north = std::f64::consts::FRAC_1_SQRT_2;
    let (mut readings, mut poses) = (Vec::new(), Vec::new());
    let mut read = |sample: &str, sensor: &str, at_us: i64, is_key: bool| {
        let token = format!("{sensor}{at_us}");
        let up_m = 10.0 * at_us as f64 * 1e-6;
        poses.push(json!({"token": token, "timestamp": START_US + at_us,
            "translation": [411_234.5, 1180.25 + up_m, 0.5], "rotation": [north, 0.0, 0.0, north]}));
        let is_camera = sensor == "front";
        readings.push(json!({
            "token": format!("r{token}"), "sample_token": sample, "ego_pose_token": token,
            "calibrated_sensor_token": sensor, "timestamp": START_US + at_us,
            "is_key_frame": is_key, "height": if is_camera { 900 } else { 0 },
            "width": if is_camera { 1600 } else { 0 },
            "filename": format!("samples/{sensor}/n015-2018__{at_us}.jpg"),
        }));
    };
    read("a", "front", 12_000, true);
    read("a", "top", 0, true);
    read("a", "front", -40_000, false);
    read("b", "front", 262_000, false);
    read("b", "front", 512_000, true);
    read("b", "top", 500_000, true);
    read("c", "front", 90_000_000, true);
    vec![
        json!([{"token": "s1", "name": "scene-0061"}, {"token": "s2", "name": "scene-0103"}]),
        json!([{"token": "b", "scene_token": "s1", "timestamp": START_US + 500_000},
            {"token": "a", "scene_token": "s1", "timestamp": START_US},
            {"token": "c", "scene_token": "s2", "timestamp": START_US + 90_000_000}]),
        json!([{"token": "i", "category_token": "car"}]),
        json!([{"token": "car", "name": "vehicle.car"}]),
        json!([{"sample_token": "b", "instance_token": "i", "translation": [411_240.0, 1200.0, 1.0],
            "size": [1.9, 4.6, 1.7], "rotation": [1.0, 0.0, 0.0, 0.0]}]),
        Value::Array(readings),
        Value::Array(poses),
        json!([
            {"token": "front", "sensor_token": "cam", "translation": [1.7, 0.0, 1.5], "rotation": AHEAD,
                "camera_intrinsic": [[1266.4, 0.0, 816.2], [0.0, 1266.4, 491.5], [0.0, 0.0, 1.0]]},
            {"token": "top", "sensor_token": "lidar", "translation": [0.94, 0.0, 1.84],
                "rotation": [north, 0.0, 0.0, -north], "camera_intrinsic": []}]),
        json!([{"token": "cam", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "lidar", "channel": "LIDAR_TOP", "modality": "lidar"}]),
    ]
}

fn read(tables: &[Value], scene: Option<&str>) -> Result<NuscenesScene, String> {
    let texts: Vec<String> = tables.iter().map(Value::to_string).collect();
    read_bytes(std::array::from_fn(|at| texts[at].as_bytes()), scene)
}

fn read_bytes(
    [
        scenes,
        samples,
        instances,
        categories,
        annotations,
        readings,
        ego_poses,
        calibrated,
        sensors,
    ]: [&[u8]; 9],
    scene: Option<&str>,
) -> Result<NuscenesScene, String> {
    let annotated = annotated::Tables {
        scenes,
        samples,
        instances,
        categories,
        annotations,
    };
    let tables = Tables {
        annotated,
        readings,
        ego_poses,
        calibrated,
        sensors,
    };
    decode(&tables, scene).map_err(|error| error.to_string())
}

fn write(tables: &[Value], folder: &Path) {
    fs::create_dir_all(folder).unwrap();
    for (name, table) in NAMES.iter().zip(tables) {
        fs::write(folder.join(format!("{name}.json")), table.to_string()).unwrap();
    }
}

#[test]
fn a_scene_is_read_by_name_and_number() {
    let scene = read(&tables(), Some("scene-0061")).unwrap();
    assert_eq!(Some(&scene), read(&tables(), Some("0")).as_ref().ok());
    // A pose for each reading after the first sample.
    let times: Vec<f64> = scene.ego.poses().iter().map(|timed| timed.time_s).collect();
    assert_eq!(times, [0.0, 0.012, 0.262, 0.5, 0.512]);
    let end = scene.ego.at(0.5);
    let at = DVec3::new(411_234.5, 1185.25, 0.5);
    assert!(end.translation.abs_diff_eq(at, 1e-9), "{end:?}");
    assert!((end.rotation * DVec3::X).abs_diff_eq(DVec3::Y, 1e-12));
    let [camera] = scene.cameras.as_slice() else {
        panic!("{scene:?}");
    };
    assert_eq!(camera.channel, "CAM_FRONT");
    assert_eq!(
        [camera.intrinsics.width_px, camera.intrinsics.height_px],
        [1600, 900]
    );
    assert!((camera.intrinsics.cx_px - 816.7).abs() < 1e-9);
    let ahead = camera.ego_from_camera.rotation * DVec3::Z;
    assert!(ahead.abs_diff_eq(DVec3::X, 1e-12), "{ahead}");
    let images: Vec<(f64, bool)> = camera
        .images
        .iter()
        .map(|image| (image.time_s, image.is_keyframe))
        .collect();
    assert_eq!(images, [(0.012, true), (0.262, false), (0.512, true)]);
    // Each image has the pose of its own time.
    let moved_m = camera.images[1].world_from_ego.translation.y - 1180.25;
    assert!((moved_m - 2.62).abs() < 1e-9, "{moved_m}");
    let lidar = scene.ego_from_lidar.unwrap();
    let forward = lidar.rotation * DVec3::Y;
    assert!(forward.abs_diff_eq(DVec3::X, 1e-12), "{forward}");
    assert_eq!(
        (scene.tracks.len(), scene.tracks[0].class.as_str()),
        (1, "car")
    );
    // The other scene has no LiDAR and no box.
    let other = read(&tables(), Some("1")).unwrap();
    assert_eq!((other.name.as_str(), other.tracks.len()), ("scene-0103", 0));
    assert_eq!((other.ego.poses().len(), other.ego_from_lidar), (1, None));
}

#[test]
fn folders_of_data_sets_and_of_tables_are_read() {
    let root = tempfile::tempdir().unwrap();
    let why = |folder: &Path| explain(&NuscenesScene::read(folder, Some("0")).unwrap_err());
    assert!(why(root.path()).contains("v1.0-mini"));
    assert!(why(&root.path().join("absent")).contains("absent"));
    let mini = root.path().join("v1.0-mini");
    write(&tables(), &mini);
    let scene = NuscenesScene::read(&mini, Some("scene-0061")).unwrap();
    assert_eq!(scene, NuscenesScene::read(root.path(), Some("0")).unwrap());
    // A test set has no annotations.
    for name in ["sample_annotation", "instance", "category"] {
        fs::remove_file(mini.join(format!("{name}.json"))).unwrap();
    }
    assert!(
        NuscenesScene::read(root.path(), Some("0"))
            .unwrap()
            .tracks
            .is_empty()
    );
    fs::remove_file(mini.join("ego_pose.json")).unwrap();
    assert!(why(root.path()).contains("ego_pose.json"));
    write(&tables(), &root.path().join("v1.0-test"));
    assert!(why(root.path()).contains("v1.0-mini, v1.0-test"));
}

#[test]
fn what_tables_lack_is_said() {
    let broken = |table: usize, pointer: &str, value: Value| {
        let mut tables = tables();
        *tables[table].pointer_mut(pointer).unwrap() = value;
        read(&tables, Some("0")).unwrap_err()
    };
    for (table, pointer, value, part) in [
        (
            5,
            "/1/ego_pose_token",
            json!("x"),
            "ego_pose.json has no pose x",
        ),
        (
            5,
            "/1/calibrated_sensor_token",
            json!("y"),
            "calibrated_sensor.json has no row y",
        ),
        (5, "/1", json!({}), "sample_data.json: missing field"),
        (6, "/0/rotation", json!([0.0, 0.0, 0.0, 0.0]), "is no pose"),
        (6, "/0/translation/0", json!(1e300), "is no pose"),
        (7, "/0/sensor_token", json!("z"), "sensor.json has no row z"),
        (7, "/0/camera_intrinsic", json!([]), "3 x 3"),
        (7, "/0/camera_intrinsic/0/0", json!(-1.0), "is no camera"),
        (5, "/0/width", json!(0), "is no camera"),
        (1, "", json!([]), "no sample of the scene scene-0061"),
        (5, "", json!([]), "no way"),
        (8, "/0/modality", json!("radar"), "no image of the scene"),
    ] {
        let said = broken(table, pointer, value);
        assert!(said.contains(part), "{part}: {said}");
    }
    let said = read(&tables(), Some("scene-9")).unwrap_err();
    assert!(said.contains("2 scenes (scene-0061, scene-0103)"), "{said}");
    assert!(read(&tables(), None).is_err());
    assert!(read(&tables(), Some("2")).is_err());
}

proptest! {
    #[test]
    fn any_bytes_are_tables_or_refused(
        table in 0_usize..9,
        place in any::<prop::sample::Index>(),
        bytes in prop::collection::vec(any::<u8>(), 0..40),
    ) {
        let mut texts: Vec<Vec<u8>> =
            tables().iter().map(|table| table.to_string().into_bytes()).collect();
        let from = place.index(texts[table].len());
        let to = (from + bytes.len()).min(texts[table].len());
        texts[table].splice(from..to, bytes);
        let _ = read_bytes(std::array::from_fn(|at| texts[at].as_slice()), Some("0"));
    }

    #[test]
    fn any_numbers_make_poses_or_none(
        numbers in prop::array::uniform7(any::<f64>()),
        timestamp in any::<i64>(),
    ) {
        let mut tables = tables();
        tables[6][0]["translation"] = json!(numbers[..3]);
        tables[6][0]["rotation"] = json!(numbers[3..]);
        tables[5][3]["timestamp"] = json!(timestamp);
        if let Ok(scene) = read(&tables, Some("0")) {
            for timed in scene.ego.poses() {
                prop_assert!(timed.pose.translation.is_finite());
                let is_turn = timed.pose.rotation.length() - 1.0;
                prop_assert!(is_turn.abs() < 1e-6);
            }
        }
    }
}
