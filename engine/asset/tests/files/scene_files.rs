//! Scene files: the documented example, round trips, complaints, and loading.

use std::path::Path;

use decouplegs_asset::{AssetError, SceneFile, SeenFrom, inria_ply, open_scene, write_coded};
use decouplegs_scene::{CapturedViews, Lens, Pose, Rules, ShFrame, SplatScene};
use glam::{DQuat, DVec3};

use crate::sample::{cloud, coded_cone};
use crate::scene_lights::lit_example;

/// The example of the format's page.
pub fn example() -> String {
    let page = std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("scene-file.md"))
        .unwrap();
    let from = page.find("```toml\n").expect("the page has an example") + "```toml\n".len();
    let length = page[from..].find("```").expect("the example ends");
    page[from..from + length].to_owned()
}

/// Writes the cameras that the example was seen from: one, 10 m along x, that looks along y.
pub fn write_views(directory: &Path) {
    let cameras = serde_json::json!([{
        "id": 0, "img_name": "a", "width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "position": [10.0, 0.0, 1.0],
        "rotation": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    }]);
    std::fs::write(directory.join("cameras.json"), cameras.to_string()).unwrap();
}

#[test]
fn the_documented_example_means_what_it_says() {
    let scene = SceneFile::parse(&example()).unwrap();
    assert_eq!(scene.origin, DVec3::new(458_000.0, 5_428_000.0, 112.0));
    assert_eq!(
        (scene.background.to_str(), scene.sky, scene.rules),
        (Some("street.ply"), [0.53, 0.68, 0.86], Rules::DEFAULT)
    );
    let cameras: Vec<_> = scene.rig.cameras().collect();
    let [front, left, below] = cameras[..] else {
        panic!("three cameras")
    };
    assert!(
        front.intrinsics.lens == Lens::Pinhole && matches!(below.intrinsics.lens, Lens::Fisheye(_))
    );
    assert_eq!(
        (
            front.name.as_str(),
            front.intrinsics.width_px,
            front.intrinsics.cx_px
        ),
        ("front", 1600, 816.3)
    );
    assert!(
        (front.rig_from_camera.rotation * DVec3::Z - DVec3::X).length() < 1e-12,
        "the front camera looks along x"
    );
    let looks = left.rig_from_camera.rotation * DVec3::Z;
    assert!((looks - DVec3::new(0.57, 0.82, 0.0).normalize()).length() < 1e-12);
    assert!(
        (left.rig_from_camera.rotation * DVec3::Y + DVec3::Z).length() < 1e-12,
        "image down is vehicle down"
    );
    assert_eq!(scene.ego_height_m, Some(0.8));
    let seen_from = scene.recording.seen_from;
    assert_eq!(seen_from, Some(SeenFrom::Cameras("cameras.json".into())));
    let ego = scene.ego.unwrap();
    assert!((ego.at(1.0).translation.x - 458_010.0).abs() < 1e-9);
    assert!(
        ego.at(2.0)
            .rotation
            .angle_between(DQuat::from_rotation_z(0.1))
            < 1e-6
    );
    let [parked, oncoming] = scene.agents.as_slice() else {
        panic!("two agents")
    };
    assert_eq!(
        (parked.name.as_str(), parked.sh_frame, oncoming.sh_frame),
        ("parked", Some(ShFrame::Canonical), None)
    );
    assert_eq!(
        (
            parked.trajectory.poses().len(),
            oncoming.trajectory.poses().len()
        ),
        (1, 2)
    );
    assert!((oncoming.trajectory.at(2.0).translation.x - 458_035.0).abs() < 1e-9);
}

#[test]
fn what_is_written_reads_back_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("scene.toml");
    let mut scene = SceneFile::parse(&lit_example()).unwrap();
    scene.rules = Rules {
        antialias: true,
        near_m: 0.3,
        ..Rules::INRIA
    };
    scene.agents[1].sh_frame = Some(ShFrame::World);
    scene.write(&path).unwrap();
    let back = SceneFile::read(&path).unwrap();
    assert_eq!(back, scene);
    let bare = SceneFile::of_background("b.spz");
    assert_eq!(SceneFile::parse(&bare.to_toml().unwrap()).unwrap(), bare);
    scene.rules.alpha_max = 0.5;
    assert!(scene.to_toml().unwrap_err().reason().contains("no name"));
}

#[test]
fn complaints_name_file_line_and_key() {
    let text = example();
    let line_of = |part: &str, nth: usize| {
        1 + text
            .lines()
            .enumerate()
            .filter(|(_, line)| line.contains(part))
            .nth(nth)
            .unwrap()
            .0
    };
    for (from, to, key, part) in [
        ("version = 1", "version = 2", "version", "reads version 1"),
        (
            "background = ",
            "backround = ",
            "backround",
            "unknown field",
        ),
        (
            "name = \"default\"",
            "name = \"fast\"",
            "rules.name",
            "gsplat15",
        ),
        ("near_m = 0.01", "near_m = -1.0", "rules.near_m", "positive"),
        ("cx_px = 826.6", "cx_px = nan", "rig[1].cx_px", "finite"),
        ("fx_px = 1266.4", "fx_px = 0.0", "rig[0].fx_px", "positive"),
        ("width_px = 1600", "width_px = -4", "width_px", "u32"),
        (
            "rotation_wxyz = [0.5, -0.5, 0.5, -0.5]",
            "rotation_wxyz = [1.0, -0.5, 0.5, -0.5]",
            "rig[0].rotation_wxyz",
            "unit",
        ),
        (
            "look = [0.57, 0.82, 0.0]",
            "look = [0.0, 0.0, 1.0]",
            "rig[1].look",
            "vertical",
        ),
        (
            "name = \"front_left\"",
            "name = \"front\"",
            "rig[1].name",
            "taken",
        ),
        (
            "name = \"front_left\"",
            "name = \"../front\"",
            "rig[1].name",
            "slash",
        ),
        ("time_s = 2.0", "time_s = 0.0", "ego[1].time_s", "later"),
        (
            "ego_height_m = 0.8",
            "ego_height_m = 80.0",
            "ego_height_m",
            "0 to 10 meters",
        ),
        (
            "vehicle_size_m = [4.8,",
            "vehicle_size_m = [-4.8,",
            "recording.vehicle_size_m",
            "0.1 to 30 meters",
        ),
        (
            "seen_from = \"cameras.json\"",
            "seen_from = \"\"",
            "recording.seen_from",
            "everywhere",
        ),
        (
            "name = \"oncoming\"",
            "name = \"\"",
            "agent[1].name",
            "empty",
        ),
        (
            "time_s = 4.0",
            "time_s = inf",
            "agent[1].trajectory[1].time_s",
            "finite",
        ),
        (
            "present = [[0.0, 4.0]]",
            "present = [[4.0, 0.0]]",
            "agent[1].present",
            "interval 0 is [4, 0]",
        ),
        (
            "lens = {",
            "photometry = { gamma = [1.0, 0.0, 1.0] }\nlens = {",
            "rig[2].photometry",
            "gamma",
        ),
        (
            "present = [[0.0, 4.0]]",
            "present = []",
            "agent[1].present",
            "no interval",
        ),
        (
            "sh_frame = \"canonical\"",
            "sh_frame = \"body\"",
            "sh_frame",
            "canonical",
        ),
    ] {
        let at = if from.starts_with("name = \"default") {
            "name = \"default\""
        } else {
            from
        };
        let error = SceneFile::parse(&text.replacen(from, to, 1)).unwrap_err();
        assert_eq!(
            (error.line, error.key.as_str()),
            (line_of(at, 0), key),
            "{error}"
        );
        assert!(error.reason.contains(part), "{error}");
    }
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("broken.toml");
    std::fs::write(&path, text.replacen("version = 1", "version = ", 1)).unwrap();
    let error = SceneFile::read(&path).unwrap_err().to_string();
    assert!(
        error.contains("broken.toml") && error.contains("line 1"),
        "{error}"
    );
    std::fs::write(&path, b"version = 1\n# \xff\n").unwrap();
    assert!(
        SceneFile::read(&path)
            .unwrap_err()
            .to_string()
            .contains("line 2")
    );
}

#[test]
fn a_pose_is_given_once() {
    let twice = example().replacen(
        "yaw_rad = 3.14159",
        "yaw_rad = 3.14159\nrotation_wxyz = [1.0, 0.0, 0.0, 0.0]",
        1,
    );
    assert!(
        SceneFile::parse(&twice)
            .unwrap_err()
            .reason
            .contains("either")
    );
    let both = example().replacen(
        "name = \"oncoming\"",
        "name = \"oncoming\"\nposition_m = [0.0, 0.0, 0.0]",
        1,
    );
    assert!(
        SceneFile::parse(&both)
            .unwrap_err()
            .reason
            .contains("trajectory")
    );
    let none = example().replacen("look = [0.57, 0.82, 0.0]", "", 1);
    assert!(SceneFile::parse(&none).unwrap_err().reason.contains("look"));
}

#[test]
fn a_scene_is_loaded_with_its_agents_where_they_are() {
    let directory = tempfile::tempdir().unwrap();
    write_views(directory.path());
    let (background, car) = (cloud(400, 1), cloud(30, 2));
    inria_ply::write(&directory.path().join("street.ply"), &background).unwrap();
    inria_ply::write(&directory.path().join("car.ply"), &car).unwrap();
    let path = directory.path().join("scene.toml");
    std::fs::write(&path, example()).unwrap();
    let early = open_scene(&path, 0.0).unwrap();
    let late = open_scene(&path, 2.0).unwrap();
    assert_eq!(
        (
            early.splat_scene.splats.len(),
            early.splat_scene.splats.sh_degree,
            early.rig.cameras().count()
        ),
        (460, 2, 3)
    );
    let Some(CapturedViews::From(views)) = &early.recording.views else {
        panic!("{:?}", early.recording)
    };
    assert_eq!(views[0].position_m, DVec3::new(10.0, 0.0, 1.0));
    assert!((views[0].ahead - DVec3::Y).length() < 1e-9, "{views:?}");
    let lidar = early.rig.lidars().next().unwrap();
    assert_eq!((&*lidar.name, lidar.model.rings()), ("roof", 32));
    let names: Vec<&str> = early
        .agent_labels
        .iter()
        .map(|label| &*label.name)
        .collect();
    assert_eq!(names, ["parked", "oncoming"]);
    let of_instance = |id: u16| {
        early
            .splat_scene
            .instance_from_splat
            .iter()
            .filter(|&&instance| instance == id)
            .count()
    };
    assert_eq!(
        [of_instance(0), of_instance(1), of_instance(2)],
        [400, 30, 30]
    );
    assert_eq!(
        early.splat_scene.splats.means[..430],
        late.splat_scene.splats.means[..430],
        "background and parked car stand"
    );
    let moved = late.splat_scene.splats.means[430][0] - early.splat_scene.splats.means[430][0];
    assert!((moved + 25.0).abs() < 1e-3, "{moved}");
    // Means are relative to the origin, so they are small whatever the world coordinates are.
    assert!(
        early
            .splat_scene
            .splats
            .means
            .iter()
            .flatten()
            .all(|x| x.abs() < 200.0)
    );
    let order = background.spatial_order();
    assert_eq!(
        early.splat_scene.splats.means[0],
        background.means[order[0] as usize]
    );
    assert!(
        (early.ego.at(0.0).translation - DVec3::new(458_000.0, 5_428_000.0, 112.8)).length() < 1e-9
    );
}

#[test]
fn a_splat_file_is_a_scene_without_cameras() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.ply");
    inria_ply::write(&path, &cloud(50, 0)).unwrap();
    let scene = open_scene(&path, 0.0).unwrap();
    assert_eq!(
        (
            scene.splat_scene.splats.len(),
            scene.splat_scene.origin,
            scene.rig.sensors.len()
        ),
        (50, DVec3::ZERO, 0)
    );
    assert_eq!(scene.ego.at(3.0), Pose::IDENTITY);
    assert!(
        scene
            .splat_scene
            .splats
            .spatial_order()
            .iter()
            .enumerate()
            .all(|(i, &splat)| i as u32 == splat),
        "already in order"
    );
}

#[test]
fn a_missing_asset_is_named() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("scene.toml");
    std::fs::write(&path, example()).unwrap();
    let error = open_scene(&path, 0.0).unwrap_err();
    assert!(
        matches!(&error, AssetError::Read { path, .. } if path.ends_with("street.ply")),
        "{error}"
    );
}

/// The example with `car.ply` replaced for one of its agents: `parked` or `oncoming`.
fn example_with_asset(agent: &str, asset: &str) -> String {
    let from = format!("name = \"{agent}\"\nasset = \"car.ply\"");
    let to = format!("name = \"{agent}\"\nasset = \"{asset}\"");
    assert!(example().contains(&from));
    example().replacen(&from, &to, 1)
}

#[test]
fn agents_of_coded_assets_are_kept_apart_with_the_ids_of_their_place() {
    let directory = tempfile::tempdir().unwrap();
    write_views(directory.path());
    inria_ply::write(&directory.path().join("street.ply"), &cloud(400, 1)).unwrap();
    inria_ply::write(&directory.path().join("car.ply"), &cloud(30, 2)).unwrap();
    write_coded(&directory.path().join("cone.safetensors"), &coded_cone()).unwrap();
    let path = directory.path().join("scene.toml");
    // Before a plain agent and behind it: neither shifts the other's id.
    for (agent, instance, plain_instance) in [("parked", 1, 2), ("oncoming", 2, 1)] {
        std::fs::write(&path, example_with_asset(agent, "cone.safetensors")).unwrap();
        let scene = open_scene(&path, 0.0).unwrap();
        let of_instance = |splat_scene: &SplatScene, id: u16| {
            splat_scene
                .instance_from_splat
                .iter()
                .filter(|&&found| found == id)
                .count()
        };
        assert_eq!(
            (
                scene.agent_labels.len(),
                scene.assets.len(),
                scene.agents.len()
            ),
            (2, 1, 1)
        );
        assert_eq!(
            (
                scene.agents[0].name.as_str(),
                scene.agents[0].asset,
                scene.agents[0].instance
            ),
            (agent, 0, instance)
        );
        assert_eq!(
            (
                scene.splat_scene.splats.len(),
                of_instance(&scene.splat_scene, plain_instance)
            ),
            (430, 30)
        );
        assert_eq!(scene.assets[0], coded_cone().cloud);

        let twin = scene.baked(2.0);
        assert_eq!(
            (
                twin.splats.len(),
                of_instance(&twin, instance),
                of_instance(&twin, plain_instance)
            ),
            (442, 12, 30)
        );
        let pose = scene.agents[0].trajectory.at(2.0);
        let decoded = coded_cone().cloud.decoded(0);
        for (splat, mean) in decoded.means.iter().enumerate() {
            let expected =
                pose.transform(glam::Vec3::from_array(*mean).as_dvec3()) - scene.splat_scene.origin;
            let found = glam::Vec3::from_array(twin.splats.means[430 + splat]).as_dvec3();
            assert!(
                (found - expected).length() < 1e-5,
                "{splat}: {found} {expected}"
            );
        }
    }
}

#[test]
fn an_asset_is_read_once_and_its_frame_of_colors_holds_unless_the_scene_says_otherwise() {
    let directory = tempfile::tempdir().unwrap();
    write_views(directory.path());
    inria_ply::write(&directory.path().join("street.ply"), &cloud(40, 1)).unwrap();
    write_coded(&directory.path().join("cone.safetensors"), &coded_cone()).unwrap();
    let path = directory.path().join("scene.toml");
    std::fs::write(&path, example().replace("car.ply", "cone.safetensors")).unwrap();
    let scene = open_scene(&path, 0.0).unwrap();
    assert_eq!(
        (
            scene.assets.len(),
            scene.agents.len(),
            scene.splat_scene.instance_from_splat.len()
        ),
        (1, 2, 0)
    );
    let found: Vec<_> = scene
        .agents
        .iter()
        .map(|agent| (agent.asset, agent.instance, agent.sh_frame))
        .collect();
    assert_eq!(coded_cone().cloud.sh_frame, ShFrame::World);
    assert_eq!(
        found,
        [(0, 1, ShFrame::Canonical), (0, 2, ShFrame::World)],
        "the first agent of the example says canonical"
    );
    // The parked cone stands turned by half a turn: its coefficients turn, those of the other do
    // not.
    let (twin, decoded) = (scene.baked(0.0), coded_cone().cloud.decoded(0));
    assert_eq!(
        twin.instance_from_splat
            .iter()
            .filter(|&&instance| instance == 0)
            .count(),
        40
    );
    assert_ne!(twin.splats.rest_of(40), decoded.rest_of(0));
    assert_eq!(twin.splats.rest_of(52), decoded.rest_of(0));
}

#[test]
fn a_coded_asset_alone_is_a_scene_and_a_broken_one_is_named() {
    let directory = tempfile::tempdir().unwrap();
    write_views(directory.path());
    let path = directory.path().join("cone.safetensors");
    write_coded(&path, &coded_cone()).unwrap();
    assert_eq!(open_scene(&path, 0.0).unwrap().splat_scene.splats.len(), 12);
    inria_ply::write(&directory.path().join("street.ply"), &cloud(40, 1)).unwrap();
    std::fs::write(&path, b"{}").unwrap();
    let scene = directory.path().join("scene.toml");
    std::fs::write(&scene, example_with_asset("parked", "cone.safetensors")).unwrap();
    let error = open_scene(&scene, 0.0).unwrap_err().to_string();
    assert!(
        error.contains("cone.safetensors: not a readable coded asset file"),
        "{error}"
    );
}
