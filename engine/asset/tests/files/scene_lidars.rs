//! LiDARs of scene files: read, written, loaded, moved and packed.

use std::path::Path;

use decouplegs_asset::packed_scene::{PackOptions, pack};
use decouplegs_asset::{SceneFile, inria_ply, open_scene};
use glam::DVec3;

use crate::sample::cloud;

const MODEL: &str = "name = \"flash\"\nrate_hz = 10.0\nrange_m = [0.5, 50.0]\n\
                     rays = [[0.0, 0.0, 0.0, 0], [1.0, 0.0, 5.0, 1]]\n";

fn scene_with(more: &str) -> String {
    format!("version = 1\nbackground = \"street.ply\"\n{more}")
}

const LIDARS: &str = "[rules]\nlidar_dilation_rad = 0.001\n[[lidar]]\nname = \"roof\"\nsensor = \"xt32\"\n\
                      position_m = [0.5, 0.0, 1.1]\nyaw_rad = 0.25\n[[lidar]]\nname = \"bumper\"\n\
                      sensor = \"sensors/flash.toml\"\nposition_m = [2.0, 0.0, -0.3]\n";

#[test]
fn lidars_are_read_and_written() {
    let scene = SceneFile::parse(&scene_with(LIDARS)).unwrap();
    let [roof, bumper] = &scene.lidars[..] else {
        panic!("two LiDARs")
    };
    assert_eq!(
        (&*roof.name, roof.sensor.as_path()),
        ("roof", Path::new("xt32"))
    );
    let ahead = roof.rig_from_lidar.rotation * DVec3::X;
    assert!((ahead - DVec3::new(0.25f64.cos(), 0.25f64.sin(), 0.0)).length() < 1e-12);
    assert_eq!(
        bumper.rig_from_lidar.translation,
        DVec3::new(2.0, 0.0, -0.3)
    );
    assert_eq!(scene.rules.lidar_dilation_rad, 0.001);
    let back = SceneFile::parse(&scene.to_toml().unwrap());
    assert_eq!(back.as_ref(), Ok(&scene));
    // A scene without says nothing of them.
    let plain = SceneFile::parse(&scene_with("")).unwrap();
    let text = plain.to_toml().unwrap();
    assert!(!text.contains("lidar"), "{text}");
}

#[test]
fn wrong_lidars_are_named_by_line_and_key() {
    let camera = "[[rig]]\nname = \"roof\"\nwidth_px = 8\nheight_px = 8\nfx_px = 8.0\nfy_px = 8.0\ncx_px = 4.0\ncy_px = 4.0\n\
                  position_m = [0.0, 0.0, 0.0]\nlook = [1.0, 0.0, 0.0]\n";
    let with_camera = format!("{camera}{LIDARS}");
    for (text, key, reason) in [
        (with_camera.as_str(), "lidar[0].name", "'roof' is taken"),
        (
            &LIDARS.replace("\"bumper\"", "\"../up\""),
            "lidar[1].name",
            "no slash",
        ),
        (
            &LIDARS.replace("[0.5, 0.0, 1.1]", "[nan, 0.0, 1.1]"),
            "lidar[0].position_m",
            "finite",
        ),
        (
            &LIDARS.replace("yaw_rad", "turn_rad"),
            "turn_rad",
            "unknown field",
        ),
        (
            &LIDARS.replace("0.001", "0.5"),
            "rules.lidar_dilation_rad",
            "0.000001 to 0.1",
        ),
    ] {
        let error = SceneFile::parse(&scene_with(text)).unwrap_err();
        let said = error.to_string();
        assert!(said.contains(key) && said.contains(reason), "{key}: {said}");
    }
}

#[test]
fn models_are_loaded_from_folders_and_packages() {
    let folder = tempfile::tempdir().unwrap();
    let (near, far) = (folder.path().join("near"), folder.path().join("far"));
    std::fs::create_dir_all(near.join("sensors")).unwrap();
    std::fs::create_dir_all(&far).unwrap();
    inria_ply::write(&near.join("street.ply"), &cloud(20, 0)).unwrap();
    std::fs::write(near.join("sensors/flash.toml"), MODEL).unwrap();
    let scene = SceneFile::parse(&scene_with(LIDARS)).unwrap();
    scene.write(&near.join("scene.toml")).unwrap();
    let moved = scene.moved_to_folder(&near, &far).unwrap();
    assert_eq!(
        moved.lidars[0].sensor,
        Path::new("xt32"),
        "a name is no path"
    );
    moved.write(&far.join("scene.toml")).unwrap();
    let package = folder.path().join("street.usdz");
    let options = PackOptions::new("street");
    let packed = pack(&scene, &near, &options, &package).unwrap();
    let models = packed
        .entries
        .iter()
        .filter(|entry| entry.ends_with("flash.toml"));
    assert_eq!(models.count(), 1, "{:?}", packed.entries);
    let expected = open_scene(&near.join("scene.toml"), 0.0).unwrap();
    let rings: Vec<(String, usize)> = expected
        .rig
        .lidars()
        .map(|lidar| (lidar.name.clone(), lidar.model.rings()))
        .collect();
    assert_eq!(rings, [("roof".to_owned(), 32), ("bumper".to_owned(), 2)]);
    for path in [far.join("scene.toml"), package] {
        let loaded = open_scene(&path, 0.0).unwrap();
        assert!(loaded.rig == expected.rig, "{}", path.display());
        assert_eq!(loaded.splat_scene.rules.lidar_dilation_rad, 0.001);
    }
    std::fs::write(near.join("sensors/flash.toml"), "name = \"flash\"\n").unwrap();
    let error = open_scene(&near.join("scene.toml"), 0.0)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("flash.toml") && error.contains("LiDAR"),
        "{error}"
    );
}
