//! The first hour of a user with a splat file and nothing else.

use super::*;

#[test]
fn splats_without_cameras_are_drawn_from_all_sides() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (world, out) = (folder.path().join("world.ply"), folder.path().join("out"));
    let said = succeed(&[
        "render",
        text(&world),
        "--size",
        "64x36",
        "--up",
        "z",
        "--planes",
        "depth,instance",
        "--out",
        text(&out),
    ]);
    assert_eq!(
        said.lines().count(),
        24,
        "eight views, each with its two planes: {said}"
    );
    let mut images = Vec::new();
    for view in 0..8 {
        let [image, depth, instance] = ["png", "depth.npy", "instance.npy"]
            .map(|end| out.join(format!("orbit_{view:03}.{end}")));
        let image = Image::read(&image).unwrap();
        assert!(
            image
                .rgb
                .iter()
                .any(|rgb| rgb.iter().any(|&value| value > 0.1)),
            "view {view} shows something"
        );
        let depth = fs::read(depth).unwrap();
        assert_eq!(depth.len(), 128 + 64 * 36 * 4);
        let deepest = depth[128..]
            .chunks_exact(4)
            .map(|four| f32::from_le_bytes(four.try_into().unwrap()))
            .fold(0.0, f32::max);
        assert!(deepest > 1.0, "{deepest}");
        assert_eq!(fs::read(instance).unwrap().len(), 128 + 64 * 36 * 2);
        images.push(image);
    }
    assert!(images[0] != images[4], "the two sides differ");
    let said = succeed(&[
        "render",
        text(&world),
        "--force",
        "--orbit",
        "2",
        "--look-at",
        "0,0,1",
        "--distance",
        "20",
        "--out",
        text(&out),
    ]);
    assert_eq!(said.lines().count(), 2, "{said}");
}

#[test]
fn a_size_of_another_shape_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (scene, out) = (folder.path().join("scene.toml"), folder.path().join("out"));
    let warnings = |size: &str, more: &[&str]| {
        let render = ["render", text(&scene), "--size", size, "--force"];
        let output = decouplegs(&[&render[..], &["--out", text(&out)], more].concat());
        assert_eq!(output.status.code(), Some(0));
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        said.matches("squeezed").count()
    };
    assert_eq!((warnings("60x60", &[]), warnings("64x36", &[])), (6, 0));
    // Cameras that are not drawn squeeze nothing.
    assert_eq!(warnings("60x60", &["--cameras", "front,back"]), 2);
    assert_eq!(warnings("60x60", &["--view", "0,0,2,0,0,0,1,60"]), 0);
    let path = folder.path().join("path.json");
    let keys = r#"{"camera_path": 1, "keys": [{"time_s": 0, "position_m": [0, 0, 2], "rotation": [0, 0, 0, 1], "fov_deg": 60}]}"#;
    fs::write(&path, keys).unwrap();
    assert_eq!(warnings("60x60", &["--camera-path", text(&path)]), 0);
}

#[test]
fn a_full_standard_error_is_no_panic_and_nonsense_is_a_usage_error() {
    let full = fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let status = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
        .args(["inspect", "absent.ply"])
        .stderr(full)
        .status()
        .unwrap();
    assert_eq!(status.code(), Some(1));
    for nonsense in [
        &["render", "a.toml", "--out", "o", "--time", "nan"][..],
        &["render", "a.toml", "--out", "o", "--level-pitch", "nan"],
        &["bench", "a.toml", "--step", "inf"],
        &["bench", "a.toml", "--level-pitch", "-1"],
        &["render", "a.ply", "--out", "o", "--look-at", "1,2"],
    ] {
        fail(2, nonsense);
    }
}

#[test]
fn cameras_of_colmap_and_of_nerf_synthetic_are_read() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (world, out) = (folder.path().join("world.ply"), folder.path().join("out"));
    let model = folder.path().join("sparse/0");
    fs::create_dir_all(&model).unwrap();
    fs::write(model.join("cameras.txt"), "1 PINHOLE 96 54 60 60 48 27\n").unwrap();
    fs::write(
        model.join("images.txt"),
        "1 0.5 -0.5 0.5 -0.5 0 1 2 1 first.jpg\n\n",
    )
    .unwrap();
    let said = succeed(&[
        "render",
        text(&world),
        "--cameras",
        text(folder.path()),
        "--out",
        text(&out),
    ]);
    assert!(said.contains("first.png"), "{said}");
    assert_eq!(Image::read(&out.join("first.png")).unwrap().width, 96);
    let synthetic = folder.path().join("transforms_train.json");
    let pose = "[[0,0,1,2],[1,0,0,0],[0,1,0,1],[0,0,0,1]]";
    fs::write(
        &synthetic,
        format!("{{\"camera_angle_x\": 0.7, \"frames\": [{{\"file_path\": \"./train/r_0\", \"transform_matrix\": {pose}}}]}}"),
    )
    .unwrap();
    let render = [
        "render",
        text(&world),
        "--cameras",
        text(&synthetic),
        "--force",
        "--out",
        text(&out),
    ];
    assert!(fail(1, &render).contains("--size"));
    succeed(&[&render[..], &["--size", "40x40"]].concat());
    assert_eq!(Image::read(&out.join("train_r_0.png")).unwrap().width, 40);
}

#[test]
fn a_street_that_was_made_can_be_driven_in() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    let sizes = [
        "--background",
        "20000",
        "--agents",
        "2",
        "--agent-splats",
        "300",
        "--degree",
        "0",
        "--all-lanes",
    ];
    let said = succeed(&[&["synth", "street", "--out", text(&street)][..], &sizes].concat());
    assert!(
        said.contains("scene.toml") && said.contains("decouplegs drive"),
        "{said}"
    );
    let [scene, map] = ["scene.toml", "lanes.json"].map(|name| street.join(name));
    let out = folder.path().join("run");
    let run = [
        "drive",
        "--level",
        "easy",
        "--episodes",
        "1",
        "--planner",
        "lane-follow",
        "--size",
        "48x27",
        "--render",
        "20",
    ];
    let place = [
        "--scene",
        text(&scene),
        "--map",
        text(&map),
        "--out",
        text(&out),
    ];
    assert!(succeed(&[&run[..], &place].concat()).contains("easy"));
}

#[test]
fn lanes_are_exported_and_drawn_with_their_ids() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let [lanes, again, svg] =
        ["lanes.json", "again.json", "map.svg"].map(|name| folder.path().join(name));
    succeed(&[
        "map",
        text(&lanes),
        "--lanes",
        text(&again),
        "--svg",
        text(&svg),
    ]);
    assert_eq!(fs::read(&again).unwrap(), fs::read(&lanes).unwrap());
    let map: Value = serde_json::from_slice(&fs::read(&again).unwrap()).unwrap();
    let id = map["lanes"][0]["id"].as_str().unwrap();
    assert!(fs::read_to_string(&svg).unwrap().contains(id));
}

#[test]
fn cameras_of_a_rig_are_chosen_by_name_and_a_scene_is_no_scenario() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let [all, some, none] = ["all", "some", "none"].map(|name| folder.path().join(name));
    let render = |out| ["render", text(&scene), "--out", text(out)];
    succeed(&render(&all));
    let names = "back,front";
    let said = succeed(&[&render(&some)[..], &["--cameras", names]].concat());
    assert_eq!(said.lines().count(), 2, "{said}");
    for name in ["front.png", "back.png"] {
        let bytes = |out: &Path| fs::read(out.join(name)).unwrap();
        assert!(bytes(&all) == bytes(&some), "{name}");
    }
    let unknown = fail(1, &[&render(&none)[..], &["--cameras", "roof"]].concat());
    assert!(
        unknown.contains("--cameras roof") && unknown.contains("front"),
        "{unknown}"
    );
    assert!(!none.exists());
    let drive = [
        "drive",
        text(&scene),
        "--planner",
        "lane-follow",
        "--out",
        text(&none),
    ];
    let said = fail(1, &drive);
    assert!(
        said.contains("is a scene") && said.contains("--level easy"),
        "{said}"
    );
    let size = fail(2, &[&render(&none)[..], &["--size", "-5x10"]].concat());
    assert!(size.contains("expected WIDTHxHEIGHT"), "{size}");
}
