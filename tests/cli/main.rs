//! The program as a user meets it: what it writes, what it says, and how it exits.

mod ablate;
mod calibrate_light;
mod compress;
#[path = "../data.rs"]
mod data;
mod drive;
mod edit;
mod exchange;
mod first_hour;
mod hostile;
mod map;
mod register;
mod stress;

use std::fs;
use std::path::Path;
use std::process::{Command, Output};

use decouplegs::render::Image;
use serde_json::Value;

fn decouplegs(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_decouplegs")).args(arguments).output().expect("the program starts")
}

/// Standard output of a run that must succeed.
fn succeed(arguments: &[&str]) -> String {
    let output = decouplegs(arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments:?} exited with {:?}: {said}", output.status.code());
    String::from_utf8(output.stdout).expect("reports are text")
}

/// Standard error of a run that must exit with `code`.
fn fail(code: i32, arguments: &[&str]) -> String {
    let output = decouplegs(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?} said: {said}");
    assert!(output.stdout.is_empty(), "{arguments:?} failed and wrote to standard output");
    said
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&succeed(arguments)).expect("--json prints JSON")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("the folder for temporary files has a Unicode name")
}

/// A street of a few thousand splats in a folder of its own.
fn small_street(folder: &Path) {
    let sizes = ["--background", "4000", "--agents", "2", "--agent-splats", "300", "--degree", "1"];
    let rest = ["--seed", "5", "--size", "48x27", "--baked", "--out", text(folder)];
    succeed(&[["synth", "street"].as_slice(), &sizes, &rest].concat());
}

#[test]
fn nonsense_on_the_command_line_exits_with_two() {
    assert!(fail(2, &["paint"]).contains("paint"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--size", "0x9"]).contains("0x9"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--rules", "ours"]).contains("gsplat15"));
    assert!(fail(2, &["synth", "street", "--degree", "4", "--out", "a"]).contains('4'));
    assert!(fail(2, &["compare", "a.png", "b.png", "--difference", "c.png", "--gain", "0"]).contains("above zero"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--contact-sheet", "sheet.jpg"]).contains("sheet.jpg"));
    assert!(fail(2, &["render", "a.ply", "--out", "b", "--reference", "--device", "0"]).contains("--reference"));
    assert!(fail(2, &["bench", "a.ply", "--frames", "0"]).contains("--frames"));
}

#[test]
fn a_failure_exits_with_one_and_names_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.ply");
    fs::write(&path, "ply\nformat binary_little_endian 1.0\nelement vertex 7\nproperty float x\n").unwrap();
    assert!(fail(1, &["inspect", text(&path)]).contains("cut.ply"));
    let absent = folder.path().join("absent.ply");
    let said = fail(1, &["render", text(&absent), "--out", text(folder.path()), "--reference"]);
    assert!(said.starts_with("error: ") && said.contains("absent.ply"), "{said}");
    assert_eq!(said.matches("absent.ply").count(), 1, "the cause is told once: {said}");
}

#[test]
fn a_street_is_the_same_bytes_every_time_and_what_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    small_street(&first);
    small_street(&second);
    for name in ["scene.toml", "background.ply", "world.ply", "transforms.json", "assets/car_00.ply"] {
        assert!(fs::read(first.join(name)).unwrap() == fs::read(second.join(name)).unwrap(), "{name} differs");
    }
    let background = json(&["inspect", text(&first.join("background.ply")), "--json"]);
    assert_eq!((&background["splats"], &background["sh_degree"]), (&Value::from(4000), &Value::from(1)));
    assert_eq!(background["defects"]["total"], 0);
    for whole in ["world.ply", "scene.toml"] {
        assert_eq!(json(&["inspect", text(&first.join(whole)), "--json"])["splats"], 4600, "{whole}");
    }
    let report = succeed(&["inspect", text(&first.join("world.ply"))]);
    assert!(report.contains("4600") && report.contains("opacity"), "{report}");
}

#[test]
fn a_street_comes_with_its_lanes_and_the_poses_of_its_cars() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let map = decouplegs::asset::read_map(&folder.path().join("lanes.json")).unwrap();
    assert_eq!(map.lanes.len(), 32);
    assert!(map.lanes.iter().any(|lane| lane.id == "main/forward/0/before" && lane.successors.len() == 2));
    let tracks = decouplegs::asset::read_tracks(&folder.path().join("tracks.csv")).unwrap();
    assert_eq!(tracks.len(), 2);
    for track in &tracks {
        assert_eq!((track.points.len(), track.class.as_str()), (201, "car"), "20 s at 10 Hz and both ends");
        assert!((track.points[200].time_s - 20.0).abs() < 1e-9 && track.points.iter().all(|point| point.z_m.unwrap() > 0.6));
    }
}

#[test]
fn weather_changes_the_street_and_neutral_light_the_cars_only() {
    let folder = tempfile::tempdir().unwrap();
    let bytes = |name: &str, options: &[&str]| {
        let out = folder.path().join(name);
        let sizes = ["--background", "2000", "--agents", "1", "--agent-splats", "200", "--out", text(&out)];
        succeed(&[["synth", "street"].as_slice(), &sizes, options].concat());
        ["background.ply", "assets/car_00.ply"].map(|file| fs::read(out.join(file)).unwrap())
    };
    let plain = bytes("plain", &[]);
    assert!(bytes("clear", &["--weather", "clear"]) == plain, "clear is what it is without being asked for");
    for weather in ["overcast", "dusk", "night"] {
        let [background, car] = bytes(weather, &["--weather", weather]);
        assert!(background != plain[0] && car == plain[1], "{weather}");
    }
    let [background, car] = bytes("neutral", &["--neutral-assets"]);
    assert!(background == plain[0] && car != plain[1]);
    assert!(fail(2, &["synth", "street", "--weather", "hail", "--out", "a"]).contains("overcast"));
}

#[test]
fn the_reference_draws_each_camera_into_a_file_of_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let scene = street.join("scene.toml");
    let [own, given] = ["own", "given"].map(|name| folder.path().join(name));
    let sheet = folder.path().join("sheet.png");
    succeed(&["render", text(&scene), "--reference", "--format", "npy", "--out", text(&own), "--contact-sheet", text(&sheet)]);
    // The rig where the ego starts is what transforms.json holds: the same images, to the bit.
    let cameras = street.join("transforms.json");
    succeed(&["render", text(&scene), "--reference", "--format", "npy", "--out", text(&given), "--cameras", text(&cameras)]);
    let mut names: Vec<_> = fs::read_dir(&own).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    names.sort();
    assert_eq!(names.len(), 6, "{names:?}");
    for name in &names {
        let difference = json(&["compare", text(&own.join(name)), text(&given.join(name)), "--json"]);
        assert!(difference["max_abs"].as_f64().unwrap() < 1e-4, "{name:?}: {difference}");
    }
    let sheet_size = fs::read(&sheet).unwrap()[16..24].to_vec();
    assert_eq!(sheet_size, [0, 0, 0, 8 + 3 * (48 + 8), 0, 0, 0, 8 + 2 * (27 + 8)], "three columns and two rows of 48x27");

    // The comparison can fail: two cameras see different things.
    let [a, b] = [own.join(&names[0]), own.join(&names[1])];
    let image = folder.path().join("difference.png");
    let difference = json(&["compare", text(&a), text(&b), "--json", "--difference", text(&image)]);
    assert!(difference["psnr_db"].as_f64().unwrap() < 40.0, "{difference}");
    assert!(image.exists());
    let said = fail(1, &["compare", text(&a), text(&sheet)]);
    assert!(said.contains("48x27"), "sizes that differ are named: {said}");
}

#[test]
fn the_gpu_draws_what_the_reference_draws() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let rule_sets: [&[&str]; 3] = [&[], &["--rules", "gsplat15", "--antialias"], &["--rules", "inria", "--size", "37x29"]];
    for (at, rules) in rule_sets.into_iter().enumerate() {
        let [gpu, truth] = ["gpu", "truth"].map(|name| folder.path().join(format!("{name}{at}")));
        let render = |out: &Path, more: &[&str]| {
            let always = ["render", text(&scene), "--format", "npy", "--out", text(out)];
            succeed(&[&always, rules, more].concat())
        };
        let listed = render(&gpu, &[]);
        render(&truth, &["--reference"]);
        let names: Vec<_> = fs::read_dir(&truth).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!((names.len(), listed.lines().count()), (6, 6), "{listed}");
        for name in names {
            assert!(listed.contains(text(&gpu.join(&name))), "{name:?} is not among the files listed: {listed}");
            let difference = json(&["compare", text(&gpu.join(&name)), text(&truth.join(&name)), "--json"]);
            // The exact mode's bound of error at equal rules; null stands for no error at all.
            let psnr_db = difference["psnr_db"].as_f64().unwrap_or(f64::INFINITY);
            assert!(psnr_db >= 95.0, "{name:?}, {rules:?}: {difference}");
        }
    }
}

#[test]
fn png_and_exr_hold_the_same_image_and_nothing_is_drawn_on_what_is_no_terminal() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let out = folder.path().join("out");
    for format in ["png", "exr"] {
        let output = decouplegs(&["render", text(&scene), "--format", format, "--out", text(&out)]);
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{said}");
        // The device; and on a slow machine, what is done every other second. No bar, which needs a terminal.
        let is_plain = !said.contains(['\r', '\u{1b}']) && said.lines().skip(1).all(|line| line.starts_with("images: "));
        assert!(said.starts_with("on ") && is_plain, "{said:?}");
    }
    assert_eq!(fs::read_dir(&out).unwrap().count(), 12, "six images twice, and no temporary file");
    let difference = json(&["compare", text(&out.join("front.png")), text(&out.join("front.exr")), "--json"]);
    // Half a level of 8 bits, which no channel of this street exceeds by clamping.
    let max_abs = difference["max_abs"].as_f64().unwrap();
    assert!(max_abs > 0.001 && max_abs <= 0.5001 / 255.0, "{difference}");
}

#[test]
fn a_bench_reports_time_memory_and_error() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let report = folder.path().join("bench.json");
    let scene = folder.path().join("scene.toml");
    let said =
        succeed(&["bench", text(&scene), "--frames", "3", "--warm-up", "1", "--cameras-used", "2", "--json", text(&report)]);
    for word in ["images/s", "48x27", "4600 splats", "2 cameras", "rgba8", "3 frames after 1", "MiB on the device", "against f64"]
    {
        assert!(said.contains(word), "{word}: {said}");
    }
    let widest = said.lines().map(|line| line.matches('#').count()).max();
    assert_eq!(widest, Some(30), "the longest stage has the longest bar: {said}");
    let report: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
    assert_eq!((&report["cameras"], &report["frames"], &report["splats"]), (&2.into(), &3.into(), &4600.into()));
    let frame_ms = report["frame_gpu_ms"]["median"].as_f64().unwrap();
    let stages = report["stages"].as_array().unwrap();
    assert!(frame_ms > 0.0 && stages.len() > 3, "{report}");
    assert!(report["memory_bytes"]["total"].as_u64().unwrap() > 0);
    assert!(report["error"]["difference"]["max_abs"].as_f64().unwrap() <= 0.01, "{report}");
    assert!(report["outputs"]["color"] == "U8" && report["rules"] == "default" && report["frames_redrawn"] == 0, "{report}");
    let more =
        ["--frames", "1", "--warm-up", "0", "--color", "f32", "--depth", "--instance", "--size", "64x48", "--rules", "inria"];
    let said = succeed(&[&["bench", text(&scene)][..], &more].concat());
    assert!(said.contains("f32, depth, instance") && said.contains("64x48") && said.contains("rules inria"), "{said}");
    assert!(fail(1, &["bench", text(&scene), "--cameras-used", "7"]).contains("6 cameras"));
}

#[test]
fn devices_are_listed_and_an_unknown_one_is_refused_with_the_list() {
    let devices = json(&["devices", "--json"]);
    let first = devices[0]["name"].as_str().expect("there is a device to test on").to_owned();
    assert!(succeed(&["devices"]).contains(&first));
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let out = folder.path().join("out");
    let said = fail(1, &["render", text(&scene), "--out", text(&out), "--device", "no such card"]);
    assert!(said.contains("no such card") && said.contains(&first), "{said}");
}

/// Bytes of `values`, little endian.
fn bytes<const N: usize, T: Copy>(values: &[T], of: fn(T) -> [u8; N]) -> Vec<u8> {
    values.iter().flat_map(|&value| of(value)).collect()
}

/// Writes a compressed asset of degree 0 by hand, after `engine/asset/coded-asset.md`: three splats and a second level of one,
/// a ball of size 1 and one color, on the diagonal of a box of 4 x 2 x 1.5 m.
fn small_asset(path: &Path) {
    let tensors = [
        ("shapes", "F32", serde_json::json!([1, 6]), bytes(&[1f32, 0.0, 1.0, 0.0, 0.0, 1.0], f32::to_le_bytes)),
        ("codes", "U32", serde_json::json!([4]), bytes(&[16u32 << 19 | 8 << 24 | 8 << 28; 4], u32::to_le_bytes)),
        ("levels", "U32", serde_json::json!([2]), bytes(&[3u32, 1], u32::to_le_bytes)),
        ("colours", "F16", serde_json::json!([1, 1, 3]), bytes(&[0x3c00u16, 0, 0xbc00], u16::to_le_bytes)),
        (
            "positions",
            "U16",
            serde_json::json!([4, 3]),
            bytes(&[[0u16; 3], [32_768; 3], [65_535; 3], [32_768; 3]].concat(), u16::to_le_bytes),
        ),
        ("opacities", "U8", serde_json::json!([4]), vec![51, 102, 255, 204]),
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
        header[name] = serde_json::json!({ "dtype": dtype, "shape": shape, "data_offsets": offsets });
        data.extend(bytes);
    }
    let header = header.to_string();
    fs::write(path, [&(header.len() as u64).to_le_bytes(), header.as_bytes(), &data].concat()).unwrap();
}

#[test]
fn a_compressed_asset_is_described_and_decompressed() {
    let folder = tempfile::tempdir().unwrap();
    let asset = folder.path().join("ball.safetensors");
    small_asset(&asset);
    let report = succeed(&["inspect", text(&asset)]);
    for part in ["3, 1 splats", "1 shapes, 1 colors of degree 0", "4.000 x 2.000 x 1.500 m", "world's frame", "seed = 7", "ab12"]
    {
        assert!(report.contains(part), "{part}: {report}");
    }
    assert!(report.contains("ball\\u{1b}.ply") && !report.contains('\u{1b}'), "a name does not steer the terminal: {report}");
    assert_eq!(report.matches('#').count() % 40, 0, "every bin that holds something holds the most: {report}");
    let said = json(&["inspect", text(&asset), "--json"]);
    let file_bytes = fs::metadata(&asset).unwrap().len();
    assert_eq!((&said["levels"], &said["splats"], &said["file_bytes"]), (&vec![3, 1].into(), &3.into(), &file_bytes.into()));
    assert_eq!((&said["bytes_per_splat"], &said["sh_frame"]), (&(file_bytes as f64 / 4.0).into(), &"world".into()));

    for (level, splats) in [(0, 3), (1, 1)] {
        let out = folder.path().join(format!("level{level}.ply"));
        let listed = succeed(&["decompress", text(&asset), "--out", text(&out), "--level", &level.to_string()]);
        assert!(listed.contains(text(&out)) && listed.contains(&format!("{splats} splats")), "{listed}");
        let said = json(&["inspect", text(&out), "--json"]);
        assert_eq!((&said["splats"], &said["defects"]["total"]), (&splats.into(), &0.into()));
        let middle = if level == 0 { [-2.0, -1.0, 0.0] } else { [0.0, 0.0, 0.75] };
        for (axis, expected_m) in middle.into_iter().enumerate() {
            // Place 32768 lies half a step beyond the middle of the box.
            let found_m = said["bounds"]["min"][axis].as_f64().unwrap();
            assert!((found_m - expected_m).abs() < 0.51 * 4.0 / 65_535.0, "{level}: {said}");
        }
    }
    let out = folder.path().join("none.ply");
    assert!(fail(1, &["decompress", text(&asset), "--out", text(&out), "--level", "2"]).contains("2 levels"));
    assert!(fail(1, &["decompress", text(&folder.path().join("level0.ply")), "--out", text(&out)]).contains("level0.ply"));
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
    assert_eq!((&said["splats"], said["cameras"].as_array().unwrap().len()), (&4603.into(), 6));
    assert_eq!((&said["cameras"][0]["width_px"], &said["ego"]["start_s"]), (&48.into(), &0.0.into()));
    let agents = said["agents"].as_array().unwrap();
    assert_eq!((agents.len(), &agents[0]["splats"], &agents[0]["sh_frame"]), (3, &300.into(), &"canonical".into()));
    let ball = serde_json::json!({
        "instance": 3, "name": "ball", "asset": "ball.safetensors", "splats": 3, "sh_frame": "world",
        "trajectory": { "start_s": 1.0, "end_s": 3.5, "poses": 2, "length_m": 5.0 },
    });
    assert_eq!(agents[2], ball);
    let report = succeed(&["inspect", text(&scene)]);
    let listed = "3 ball: ball.safetensors, 3 splats, colors world, 1.0 s to 3.5 s, 2 poses, 5.0 m from (0.00, 0.00, 0.00) m";
    assert!(report.contains(listed) && report.contains("front: 48x27"), "{report}");
}

#[test]
fn a_scene_says_how_it_is_lit() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let scene = folder.path().join("scene.toml");
    assert!(json(&["inspect", text(&scene), "--json"])["light"].is_null());
    let unlit = fs::read_to_string(&scene).unwrap();
    fs::write(&scene, format!("{unlit}\n[light]\n[light.shadows]\n")).unwrap();
    assert!(succeed(&["inspect", text(&scene)]).contains("colors stay as captured, contact shadows"));
    // Agents of plain files are part of the world and take no light; a compressed one does.
    let asset = folder.path().join("assets/car_00.ply");
    let coded = folder.path().join("car.safetensors");
    succeed(&["compress", text(&asset), "--out", text(&coded), "--views", "4", "--view-size", "32"]);
    let one = unlit.replacen("assets/car_00.ply", "car.safetensors", 1);
    fs::write(&scene, format!("{one}\n[light]\n[light.shadows]\n")).unwrap();
    let light = &json(&["inspect", text(&scene), "--json"])["light"];
    assert_eq!(light["starts"].as_array().unwrap().len(), 1, "{light}");
    assert!(light["probes"].as_u64().unwrap() > 8 && light["field_error_of_mean"].as_f64().unwrap() < 0.02, "{light}");
    fs::write(&scene, format!("{unlit}\n[light]\nsigma_m = -1.0\n")).unwrap();
    assert!(fail(1, &["inspect", text(&scene)]).contains("light.sigma_m"));
    fs::write(&scene, format!("{unlit}\n[light]\ntransfer = \"absent.safetensors\"\n")).unwrap();
    assert!(fail(1, &["inspect", text(&scene)]).contains("absent.safetensors"));
}
