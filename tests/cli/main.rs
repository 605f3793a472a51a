//! The program as a user meets it: what it writes, what it says, and how it exits.

mod ablate;
mod calibrate_light;
mod compress;
#[path = "../data.rs"]
mod data;
mod drive;
mod drive_devices;
mod drive_images;
mod drive_reports;
mod edit;
mod exchange;
mod export;
mod field;
mod first_hour;
mod ground_truth;
mod hd_scores;
mod hostile;
mod hugsim_scenarios;
mod interfaces;
mod lidar;
mod map;
mod mistakes;
mod power_cut;
mod programs;
mod realism;
mod recording;
mod register;
mod rendering;
mod scanned_street;
mod stress;
mod transform;
mod view;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use decouplegs::render::Image;
use serde_json::Value;

fn decouplegs(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_decouplegs"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

/// Standard output of a run that must succeed.
fn succeed(arguments: &[&str]) -> String {
    let output = decouplegs(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "{arguments:?} exited with {:?}: {said}",
        output.status.code()
    );
    String::from_utf8(output.stdout).expect("reports are text")
}

/// Standard error of a run that must exit with `code`.
fn fail(code: i32, arguments: &[&str]) -> String {
    let output = decouplegs(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?} said: {said}"
    );
    assert!(
        output.stdout.is_empty(),
        "{arguments:?} failed and wrote to standard output"
    );
    said
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).expect("--json prints JSON")
}

fn text(path: &Path) -> &str {
    path.to_str()
        .expect("the folder for temporary files has a Unicode name")
}

/// A street of a few thousand splats in a folder of its own.
fn small_street(folder: &Path) {
    street(folder, &[]);
}

/// The same street with cars that move.
fn coded_street(folder: &Path) {
    street(folder, &["--movable"]);
}

fn street(folder: &Path, more: &[&str]) {
    let sizes = [
        "--background",
        "4000",
        "--agents",
        "2",
        "--agent-splats",
        "300",
        "--degree",
        "1",
    ];
    let rest = [
        "--seed",
        "5",
        "--size",
        "48x27",
        "--baked",
        "--out",
        text(folder),
    ];
    succeed(&[["synth", "street"].as_slice(), &sizes, &rest, more].concat());
}

#[test]
fn nonsense_on_the_command_line_exits_with_two() {
    assert!(fail(2, &["paint"]).contains("paint"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--size", "0x9"]).contains("0x9"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--rules", "ours"]).contains("gsplat15"));
    assert!(fail(2, &["synth", "street", "--degree", "4", "--out", "a"]).contains('4'));
    assert!(
        fail(
            2,
            &[
                "compare",
                "a.png",
                "b.png",
                "--difference",
                "c.png",
                "--gain",
                "0"
            ]
        )
        .contains("above zero")
    );
    assert!(
        fail(
            2,
            &[
                "render",
                "a.ply",
                "--out",
                "b",
                "--contact-sheet",
                "sheet.jpg"
            ]
        )
        .contains("sheet.jpg")
    );
    assert!(
        fail(
            2,
            &[
                "render",
                "a.ply",
                "--out",
                "b",
                "--reference",
                "--device",
                "0"
            ]
        )
        .contains("--reference")
    );
    assert!(fail(2, &["bench", "a.ply", "--frames", "0"]).contains("--frames"));
}

#[test]
fn a_failure_exits_with_one_and_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.ply");
    fs::write(
        &path,
        "ply\nformat binary_little_endian 1.0\nelement vertex 7\nproperty float x\n",
    )
    .unwrap();
    assert!(fail(1, &["inspect", text(&path)]).contains("cut.ply"));
    let absent = folder.path().join("absent.ply");
    let said = fail(
        1,
        &[
            "render",
            text(&absent),
            "--out",
            text(&folder.path().join("out")),
            "--reference",
        ],
    );
    assert!(
        said.starts_with("error: ") && said.contains("absent.ply"),
        "{said}"
    );
    assert_eq!(
        said.matches("absent.ply").count(),
        1,
        "the cause is told once: {said}"
    );
}

#[test]
fn a_street_is_the_same_bytes_every_time_and_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    small_street(&first);
    small_street(&second);
    for name in [
        "scene.toml",
        "background.ply",
        "world.ply",
        "transforms.json",
        "assets/car_00.ply",
    ] {
        assert!(
            fs::read(first.join(name)).unwrap() == fs::read(second.join(name)).unwrap(),
            "{name} differs"
        );
    }
    let background = json(&["inspect", text(&first.join("background.ply")), "--json"]);
    assert_eq!(
        (&background["splats"], &background["sh_degree"]),
        (&Value::from(4000), &Value::from(1))
    );
    assert_eq!(background["defects"]["total"], 0);
    for whole in ["world.ply", "scene.toml"] {
        assert_eq!(
            json(&["inspect", text(&first.join(whole)), "--json"])["splats"],
            4600,
            "{whole}"
        );
    }
    let report = succeed(&["inspect", text(&first.join("world.ply"))]);
    assert!(
        report.contains("4600") && report.contains("opacity"),
        "{report}"
    );
}

#[test]
fn a_street_comes_with_its_lanes_and_the_poses_of_its_cars() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let map = decouplegs::asset::read_map(&folder.path().join("lanes.json")).unwrap();
    assert_eq!(map.lanes.len(), 32);
    assert!(
        map.lanes
            .iter()
            .any(|lane| lane.id == "main/forward/0/before" && lane.successors.len() == 2)
    );
    let tracks = decouplegs::asset::read_tracks(&folder.path().join("tracks.csv")).unwrap();
    assert_eq!(tracks.len(), 2);
    for track in &tracks {
        assert_eq!(
            (track.points.len(), track.class.as_str()),
            (201, "car"),
            "20 s at 10 Hz and both ends"
        );
        assert!(
            (track.points[200].time_s - 20.0).abs() < 1e-9
                && track.points.iter().all(|point| point.z_m.unwrap() > 0.6)
        );
    }
}

#[test]
fn weather_changes_the_street_and_neutral_light_the_cars_only() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        let sizes = [
            "--background",
            "2000",
            "--agents",
            "1",
            "--agent-splats",
            "200",
            "--force",
            "--out",
            text(&out),
        ];
        succeed(&[["synth", "street"].as_slice(), &sizes, options].concat());
        ["background.ply", "assets/car_00.ply"].map(|file| fs::read(out.join(file)).unwrap())
    };
    let plain = bytes("plain", &[]);
    assert!(
        bytes("clear", &["--weather", "clear"]) == plain,
        "clear is what it is without being asked for"
    );
    for weather in ["overcast", "dusk", "night"] {
        let [background, car] = bytes(weather, &["--weather", weather]);
        assert!(background != plain[0] && car == plain[1], "{weather}");
    }
    let [background, car] = bytes("neutral", &["--neutral-assets"]);
    assert!(background == plain[0] && car != plain[1]);
    for (weather, sun, lamps) in [
        ("clear", true, false),
        ("overcast", false, false),
        ("night", false, true),
    ] {
        bytes("shadows", &["--weather", weather, "--shadows"]);
        let scene = folder.path().join("shadows/scene.toml");
        let light = &json(&["inspect", text(&scene), "--json"])["light"];
        assert!(light["shadows"] == true, "{light}");
        assert_eq!(light["sun"].is_object(), sun, "{weather}");
        assert_eq!(light["lamps"] != 0, lamps, "{weather}");
    }
    assert!(fail(2, &["synth", "street", "--weather", "hail", "--out", "a"]).contains("overcast"));
}

#[test]
fn devices_are_listed_and_an_unknown_one_is_refused_with_the_list() {
    let devices = json(&["devices", "--json"]);
    let first = devices[0]["name"]
        .as_str()
        .expect("there is a device to test on")
        .to_owned();
    assert!(succeed(&["devices"]).contains(&first));
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let out = folder.path().join("out");
    let said = fail(
        1,
        &[
            "render",
            text(&scene),
            "--out",
            text(&out),
            "--device",
            "no such card",
        ],
    );
    assert!(
        said.contains("no such card") && said.contains(&first),
        "{said}"
    );
}

/// Bytes of `values`, little endian.
fn bytes<const N: usize, T: Copy>(values: &[T], of: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| of(value)).collect()
}

/// Writes a compressed asset of degree 0 by hand, after `engine/asset/coded-asset.md`: three splats
/// and a second level of one, a ball of size 1 and one color, on the diagonal of a box of 4 x 2 x
/// 1.5 m.
fn small_asset(path: &Path) {
    let tensors = [
        (
            "shapes",
            "F32",
            serde_json::json!([1, 6]),
            bytes(&[1f32, 0.0, 1.0, 0.0, 0.0, 1.0], f32::to_le_bytes),
        ),
        (
            "codes",
            "U32",
            serde_json::json!([4]),
            bytes(&[16u32 << 19 | 8 << 24 | 8 << 28; 4], u32::to_le_bytes),
        ),
        (
            "levels",
            "U32",
            serde_json::json!([2]),
            bytes(&[3u32, 1], u32::to_le_bytes),
        ),
        (
            "colours",
            "F16",
            serde_json::json!([1, 1, 3]),
            bytes(&[0x3c00u16, 0, 0xbc00], u16::to_le_bytes),
        ),
        (
            "positions",
            "U16",
            serde_json::json!([4, 3]),
            bytes(
                &[[0u16; 3], [32_768; 3], [65_535; 3], [32_768; 3]].concat(),
                u16::to_le_bytes,
            ),
        ),
        (
            "opacities",
            "U8",
            serde_json::json!([4]),
            vec![51, 102, 255, 204],
        ),
        ("sizes", "U8", serde_json::json!([4]), vec![0, 16, 32, 48]),
    ];
    let mut header = serde_json::json!({ "__metadata__": {
        "format": "decouplegs-asset", "version": "1", "tool_version": "0.1.0", "source": "ball\u{1b}.ply", "source_sha256": "ab12",
        "bounds_min_m": "[-2.0, -1.0, 0.0]", "bounds_max_m": "[2.0, 1.0, 1.5]", "dims_m": "[4.0, 2.0, 1.5]",
        "log2_size_min": "-6.0", "log2_size_step": "0.0625", "dc_residual_step": "[0.1, 0.1, 0.1]",
        "sh_degree": "0", "sh_frame": "world", "settings.seed": "7",
    } });
    let mut data = Vec::new();
    for (name, dtype, shape, bytes) in tensors {
        let offsets = [data.len(), data.len() + bytes.len()];
        header[name] =
            serde_json::json!({ "dtype": dtype, "shape": shape, "data_offsets": offsets });
        data.extend(bytes);
    }
    let header = header.to_string();
    fs::write(
        path,
        [
            &(header.len() as u64).to_le_bytes(),
            header.as_bytes(),
            &data,
        ]
        .concat(),
    )
    .unwrap();
}

#[test]
fn a_compressed_asset_is_described_and_decompressed() {
    let folder = tempfile::tempdir().unwrap();
    let asset = folder.path().join("ball.safetensors");
    small_asset(&asset);
    let report = succeed(&["inspect", text(&asset)]);
    for part in [
        "3, 1 splats",
        "1 shapes, 1 colors of degree 0",
        "4.000 x 2.000 x 1.500 m",
        "world's frame",
        "seed = 7",
        "ab12",
    ] {
        assert!(report.contains(part), "{part}: {report}");
    }
    assert!(
        report.contains("ball\\u{1b}.ply") && !report.contains('\u{1b}'),
        "a name does not steer the terminal: {report}"
    );
    assert_eq!(
        report.matches('#').count() % 40,
        0,
        "every bin that holds something holds the most: {report}"
    );
    let said = json(&["inspect", text(&asset), "--json"]);
    let file_bytes = fs::metadata(&asset).unwrap().len();
    assert_eq!(
        (&said["levels"], &said["splats"], &said["file_bytes"]),
        (&vec![3, 1].into(), &3.into(), &file_bytes.into())
    );
    assert_eq!(
        (&said["bytes_per_splat"], &said["sh_frame"]),
        (&(file_bytes as f64 / 4.0).into(), &"world".into())
    );

    for (level, splats) in [(0, 3), (1, 1)] {
        let out = folder.path().join(format!("level{level}.ply"));
        let listed = succeed(&[
            "decompress",
            text(&asset),
            "--out",
            text(&out),
            "--level",
            &level.to_string(),
        ]);
        assert!(
            listed.contains(text(&out)) && listed.contains(&format!("{splats} splats")),
            "{listed}"
        );
        let said = json(&["inspect", text(&out), "--json"]);
        assert_eq!(
            (&said["splats"], &said["defects"]["total"]),
            (&splats.into(), &0.into())
        );
        let middle = if level == 0 {
            [-2.0, -1.0, 0.0]
        } else {
            [0.0, 0.0, 0.75]
        };
        for (axis, expected_m) in middle.into_iter().enumerate() {
            // Place 32768 lies half a step beyond the middle of the box.
            let found_m = said["bounds"]["min"][axis].as_f64().unwrap();
            assert!(
                (found_m - expected_m).abs() < 0.51 * 4.0 / 65_535.0,
                "{level}: {said}"
            );
        }
    }
    let out = folder.path().join("none.ply");
    assert!(
        fail(
            1,
            &[
                "decompress",
                text(&asset),
                "--out",
                text(&out),
                "--level",
                "2"
            ]
        )
        .contains("2 levels")
    );
    assert!(
        fail(
            1,
            &[
                "decompress",
                text(&folder.path().join("level0.ply")),
                "--out",
                text(&out)
            ]
        )
        .contains("level0.ply")
    );
    assert!(fail(2, &["decompress", text(&asset), "--out", "ball.spz"]).contains(".ply"));
    assert!(!out.exists());
}

#[test]
fn a_scene_is_listed_with_its_cameras_its_ego_and_its_agents() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    small_asset(&folder.path().join("ball.safetensors"));
    let scene = folder.path().join("scene.toml");
    let agent = "\n[[agent]]\nname = \"ball\"\nasset = \"ball.safetensors\"\n";
    let ways = "[[agent.trajectory]]\ntime_s = 1.0\nposition_m = [0.0, 0.0, 0.0]\n\
                [[agent.trajectory]]\ntime_s = 3.5\nposition_m = [3.0, 4.0, 0.0]\n";
    fs::write(&scene, fs::read_to_string(&scene).unwrap() + agent + ways).unwrap();
    let said = json(&["inspect", text(&scene), "--json"]);
    assert_eq!(
        (&said["splats"], said["cameras"].as_array().unwrap().len()),
        (&4603.into(), 6)
    );
    assert_eq!(
        (&said["cameras"][0]["width_px"], &said["ego"]["start_s"]),
        (&48.into(), &0.0.into())
    );
    let agents = said["agents"].as_array().unwrap();
    assert_eq!(
        (agents.len(), &agents[0]["splats"], &agents[0]["sh_frame"]),
        (3, &300.into(), &"canonical".into())
    );
    let ball = serde_json::json!({
        "instance": 3, "name": "ball", "asset": "ball.safetensors", "splats": 3, "sh_frame": "world",
        "trajectory": { "start_s": 1.0, "end_s": 3.5, "poses": 2, "length_m": 5.0 },
    });
    assert_eq!(agents[2], ball);
    let report = succeed(&["inspect", text(&scene)]);
    let listed = "3 ball: ball.safetensors, 3 splats, colors world, 1.0 s to 3.5 s, 2 poses, 5.0 m from (0.00, 0.00, 0.00) m";
    assert!(
        report.contains(listed) && report.contains("front: 48x27"),
        "{report}"
    );
}

#[test]
fn a_scene_says_how_it_is_lit() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    assert!(json(&["inspect", text(&scene), "--json"])["light"].is_null());
    let unlit = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, format!("{unlit}\n[light]\n[light.shadows]\n")).unwrap();
    assert!(
        succeed(&["inspect", text(&scene)]).contains("colors stay as captured, contact shadows")
    );
    // Agents of plain files are part of the world and take no light; a compressed one does.
    let asset = folder.path().join("assets/car_00.ply");
    let coded = folder.path().join("car.safetensors");
    succeed(&[
        "compress",
        text(&asset),
        "--out",
        text(&coded),
        "--views",
        "4",
        "--view-size",
        "32",
    ]);
    let one = unlit.replacen("assets/car_00.ply", "car.safetensors", 1);
    fs::write(&scene, format!("{one}\n[light]\n[light.shadows]\n")).unwrap();
    let light = &json(&["inspect", text(&scene), "--json"])["light"];
    assert_eq!(light["starts"].as_array().unwrap().len(), 1, "{light}");
    assert!(
        light["probes"].as_u64().unwrap() > 8
            && light["field_error_of_mean"].as_f64().unwrap() < 0.02,
        "{light}"
    );
    fs::write(&scene, format!("{unlit}\n[light]\nsigma_m = -1.0\n")).unwrap();
    assert!(fail(1, &["inspect", text(&scene)]).contains("light.sigma_m"));
    fs::write(
        &scene,
        format!("{unlit}\n[light]\ntransfer = \"absent.safetensors\"\n"),
    )
    .unwrap();
    assert!(fail(1, &["inspect", text(&scene)]).contains("absent.safetensors"));
}
