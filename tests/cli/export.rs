//! Episodes as data sets: tables that hold together, boxes where pixels are, and images of the log.

use std::collections::{BTreeMap, BTreeSet};

use decouplegs::asset::SceneFile;
use decouplegs::logs::read_episode_log;
use decouplegs::render::metrics::Difference;

use super::*;

/// An episode with images of two cameras of a camera rig, on a small street.
fn episode(folder: &Path) -> std::path::PathBuf {
    let out = folder.join("run");
    let place = ["drive", "--background", "3000", "--agent-splats", "300"];
    let what = [
        "--level",
        "hard",
        "--episodes",
        "1",
        "--size",
        "96x54",
        "--seed",
        "3",
    ];
    let how = ["--planner", "constant-velocity", "--all-cameras"];
    succeed(&[&place[..], &what, &how, &["--out", text(&out)]].concat());
    out.join("logs/hard_0000.log")
}

fn read(path: &Path) -> Value {
    let bytes = fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_slice(&bytes).unwrap()
}

#[test]
fn episodes_become_data_sets_with_the_images_of_the_log() {
    let folder = tempfile::tempdir().unwrap();
    let log = episode(folder.path());
    let base = folder.path();
    let export = |format: &str, more: &[&str]| {
        let out = base.join(format);
        let whole = ["export", text(&log), "--as", format, "--out", text(&out)];
        let said = succeed(&[&whole, more].concat());
        assert!(said.contains("images have the bits of the log"), "{said}");
        out
    };
    let nuscenes = export("nuscenes", &["--lidar", "vlp32c"]);
    let samples = check_nuscenes(&nuscenes, &log, &base.join("images"));
    check_coco(&export("coco", &["--cameras", "front,back"]), samples);
    let kitti = ["--cameras", "front", "--lidar", "vlp32c"];
    check_kitti(&export("kitti", &kitti), samples);
    check_refusals(&log, base);
}

/// Plans of `lane-follow` along an episode that it drove are those that it drove.
#[test]
fn plans_of_another_planner_are_written_along_an_episode() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let how = ["--planner", "lane-follow", "--render", "off"];
    let what = ["--level", "hard", "--episodes", "1", "--out", text(&run)];
    succeed(&[&["drive"], &what[..], &how].concat());
    let log = run.join("logs/hard_0000.log");
    let episode = read_episode_log(&log).unwrap();
    let plans = |planner: &str, out: &str| -> Vec<Value> {
        let out = folder.path().join(out);
        let planner = ["--as", "plans", "--planner", planner];
        let said = succeed(&[&["export", text(&log), "--out", text(&out)], &planner[..]].concat());
        let count = episode.steps.len();
        let expected = format!("at {count} of {count} steps");
        assert!(said.contains(&expected), "{said}");
        let lines = fs::read_to_string(out.join("plans.jsonl")).unwrap();
        let lines = lines
            .lines()
            .map(|line| serde_json::from_str(line).unwrap());
        lines.collect()
    };
    let own = plans("lane-follow", "own");
    assert_eq!(own.len(), episode.steps.len());
    for (line, step) in own.iter().zip(&episode.steps) {
        let points = step.plan.points().iter();
        let points = points.map(|point| [point.time_s, point.position_m.x, point.position_m.y]);
        assert_eq!(
            line["points"],
            serde_json::json!(points.collect::<Vec<_>>())
        );
        assert_eq!(line["step"], step.step);
    }
    let start_mps = episode.start.ego.speed_mps;
    assert_eq!(own[0]["ego"]["speed_mps"].as_f64(), Some(start_mps));
    assert!(own[0]["guidance"]["cruise_mps"].as_f64() > Some(0.0));
    assert_ne!(plans("constant-velocity", "other"), own);
    let out = folder.path().join("seen");
    let blind = ["--as", "plans", "--planner", "vision", "--out", text(&out)];
    let said = fail(1, &[&["export", text(&log)], &blind[..]].concat());
    assert!(said.contains("open-loop") && !out.exists(), "{said}");
}

/// An episode with five steps a second: each third is a sample, the steps between are sweeps.
#[test]
fn steps_between_keyframes_are_sweeps_of_nuscenes() {
    let folder = tempfile::tempdir().unwrap();
    let (run, out) = (folder.path().join("run"), folder.path().join("nuscenes"));
    let place = ["drive", "--level", "hard", "--episodes", "1", "--seed", "3"];
    let how = ["--background", "3000", "--agent-splats", "300"];
    let driven = ["--planner", "constant-velocity", "--step", "0.2"];
    let kept = ["--render", "off", "--out", text(&run)];
    succeed(&[&place[..], &how, &driven, &kept].concat());
    let log = run.join("logs/hard_0000.log");
    let what = [
        "export",
        text(&log),
        "--as",
        "nuscenes",
        "--out",
        text(&out),
    ];
    let view = ["--cameras", "front", "--size", "48x27"];
    succeed(&[&what[..], &view].concat());
    let table = |name: &str| {
        let rows = read(&out.join(format!("v1.0-decouplegs/{name}.json")));
        rows.as_array().unwrap().clone()
    };
    let (samples, readings) = (table("sample"), table("sample_data"));
    assert!(samples.len() > 3);
    // The first and every third step; nothing follows the last sample.
    assert_eq!(readings.len(), 3 * samples.len() - 2);
    assert_eq!(table("ego_pose").len(), readings.len());
    for (index, reading) in readings.iter().enumerate() {
        let is_key = index % 3 == 0;
        assert_eq!(reading["is_key_frame"], is_key, "{index}");
        let name = reading["filename"].as_str().unwrap();
        let begins = if is_key {
            "samples/CAM_FRONT/"
        } else {
            "sweeps/CAM_FRONT/"
        };
        assert!(
            name.starts_with(begins) && out.join(name).is_file(),
            "{name}"
        );
        // A reading belongs to the sample that follows it.
        let sample = &samples[index.div_ceil(3)];
        assert_eq!(reading["sample_token"], sample["token"]);
        let next = readings
            .get(index + 1)
            .map_or("", |next| next["token"].as_str().unwrap());
        assert_eq!(reading["next"], next);
        assert!(reading["timestamp"].as_i64() <= sample["timestamp"].as_i64());
    }
    let files = fs::read_dir(out.join("sweeps/CAM_FRONT")).unwrap().count();
    assert_eq!(files, readings.len() - samples.len());
    for annotation in table("sample_annotation") {
        assert!(
            samples
                .iter()
                .any(|sample| sample["token"] == annotation["sample_token"])
        );
    }
    check_imported(&out, &log, folder.path(), table("sample_annotation").len());
}

/// Checks that the data set in `out` is imported with the poses, the camera and the boxes of `log`.
fn check_imported(out: &Path, log: &Path, folder: &Path, boxes: usize) {
    let (street, imported) = (folder.join("street"), folder.join("imported"));
    small_street(&street);
    let episode = read_episode_log(log).unwrap();
    let scenario = &episode.head.scenario;
    let middle = format!("0,0,{}", 0.5 * scenario.ego.size.height_m);
    let splats = street.join("background.ply");
    let what = ["import", "nuscenes", text(out), "--splats", text(&splats)];
    let how = [
        "--middle",
        &middle,
        "--hold-out",
        "2",
        "--origin",
        "100,0,0",
    ];
    let to = ["--out", text(&imported)];
    let printed = succeed(&[&what[..], &how, &to].concat());
    assert!(printed.contains("around 100.000"), "{printed}");
    let scene = SceneFile::read(&imported.join("scene.toml")).unwrap();
    assert_eq!(scene.origin, glam::DVec3::X * 100.0);
    let way = scene.ego.unwrap();
    let mut checked = 0;
    for tick in episode.instants() {
        if let Some(timed) = way
            .poses()
            .iter()
            .find(|timed| (timed.time_s - tick.time_s).abs() < 1e-5)
        {
            let apart_m = timed
                .pose
                .translation
                .truncate()
                .distance(tick.ego.position_m);
            assert!(apart_m < 1e-6, "{apart_m} m at {} s", tick.time_s);
            checked += 1;
        }
    }
    assert_eq!(checked, way.poses().len());
    let rig = decouplegs::episode::rig_of(&scenario.place, Path::new("")).unwrap();
    let own = rig.cameras().find(|camera| camera.name == "front").unwrap();
    let camera = scene.rig.cameras().next().unwrap();
    assert_eq!(camera.name, "front");
    assert!((camera.intrinsics.cx_px - 24.0).abs() < 1e-9);
    let (on_rig, found) = (own.rig_from_camera, camera.rig_from_camera);
    assert!(on_rig.translation.distance(found.translation) < 1e-9);
    assert!(on_rig.rotation.angle_between(found.rotation) < 1e-6);
    let views = read(&imported.join("cameras.json"));
    let views = views["frames"].as_array().unwrap().len();
    let held_out = fs::read_to_string(imported.join("held_out.txt")).unwrap();
    assert!(views > 3 && (1..views).contains(&held_out.lines().count()));
    let tracks = fs::read_to_string(imported.join("tracks.csv")).unwrap();
    assert_eq!(tracks.lines().count(), 1 + boxes);
    let said = fail(
        1,
        &[
            &what[..],
            &["--scene", "none"],
            &["--out", text(&folder.join("no"))],
        ]
        .concat(),
    );
    assert!(said.contains("expected the name of one"), "{said}");
}

/// Checks that each token that a row names is that of a row, and that lists are linked both ways.
fn check_tables(tables: &BTreeMap<String, Vec<Value>>) {
    assert_eq!(tables.len(), 13);
    let tokens: BTreeMap<&str, BTreeSet<&str>> = tables
        .iter()
        .map(|(name, rows)| {
            (
                name.as_str(),
                rows.iter()
                    .map(|row| row["token"].as_str().unwrap())
                    .collect(),
            )
        })
        .collect();
    for (name, rows) in tables {
        assert_eq!(
            tokens[name.as_str()].len(),
            rows.len(),
            "tokens of {name} differ"
        );
        for row in rows {
            for (key, value) in row.as_object().unwrap() {
                let Some(table) = key.strip_suffix("_token") else {
                    continue;
                };
                let table = match table {
                    "first_sample" | "last_sample" => "sample",
                    "first_annotation" | "last_annotation" => "sample_annotation",
                    table => table,
                };
                assert!(
                    tokens[table].contains(value.as_str().unwrap()),
                    "{name}.{key}"
                );
            }
            if let Some(next) = row
                .get("next")
                .and_then(Value::as_str)
                .filter(|next| !next.is_empty())
            {
                let other = rows.iter().find(|other| other["token"] == next).unwrap();
                assert_eq!(other["prev"], row["token"]);
            }
        }
    }
}

/// Checks tables and files; returns the number of samples.
fn check_nuscenes(out: &Path, log: &Path, images: &Path) -> usize {
    let tables: BTreeMap<String, Vec<Value>> = fs::read_dir(out.join("v1.0-decouplegs"))
        .unwrap()
        .map(|entry| {
            let path = entry.unwrap().path();
            let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
            (name, read(&path).as_array().unwrap().clone())
        })
        .collect();
    check_tables(&tables);
    let samples = tables["sample"].len();
    assert_eq!(
        tables["sample_data"].len(),
        7 * samples,
        "six cameras and a LiDAR"
    );
    for reading in &tables["sample_data"] {
        let file = out.join(reading["filename"].as_str().unwrap());
        assert!(
            fs::metadata(&file).is_ok_and(|file| file.len() > 50),
            "{}",
            file.display()
        );
    }
    let annotations = &tables["sample_annotation"];
    assert!(
        annotations
            .iter()
            .any(|row| row["num_lidar_pts"].as_u64().unwrap() > 20)
    );
    assert!(annotations.iter().any(|row| row["visibility_token"] == "4"));
    // The image of the front camera at the first step is that which `replay` writes.
    succeed(&["replay", text(log), "--images", text(images)]);
    let front = tables["sample_data"]
        .iter()
        .find(|row| row["filename"].as_str().unwrap().contains("CAM_FRONT/"));
    let front = out.join(front.unwrap()["filename"].as_str().unwrap());
    let same = Image::read(&front).unwrap() == Image::read(&images.join("front_0000.png")).unwrap();
    assert!(same);
    samples
}

/// Checks that masks have as many pixels as areas say, inside their boxes.
fn check_coco(out: &Path, samples: usize) {
    let coco = read(&out.join("annotations.json"));
    let annotations = coco["annotations"].as_array().unwrap();
    assert_eq!(coco["images"].as_array().unwrap().len(), 2 * samples);
    assert!(!annotations.is_empty());
    for annotation in annotations {
        let number = |value: &Value| value.as_f64().unwrap();
        let counts: Vec<usize> = annotation["segmentation"]["counts"]
            .as_array()
            .unwrap()
            .iter()
            .map(|count| count.as_u64().unwrap() as usize)
            .collect();
        assert_eq!(counts.iter().sum::<usize>(), 96 * 54);
        assert_eq!(
            counts.iter().skip(1).step_by(2).sum::<usize>() as f64,
            number(&annotation["area"])
        );
        let first = counts[0];
        let edges: Vec<f64> = annotation["bbox"]
            .as_array()
            .unwrap()
            .iter()
            .map(number)
            .collect();
        assert_eq!(
            (first / 54) as f64,
            edges[0],
            "the mask begins at the left edge of its box"
        );
    }
    check_panoptic(out, 2 * samples, annotations.len());
}

/// Checks that panoptic images have as many pixels of each segment as their table says.
fn check_panoptic(out: &Path, images: usize, objects: usize) {
    let table = read(&out.join("panoptic.json"));
    let annotations = table["annotations"].as_array().unwrap();
    assert_eq!(annotations.len(), images);
    let mut segments = 0;
    for annotation in annotations {
        let name = annotation["file_name"].as_str().unwrap();
        let image = image::open(out.join("panoptic").join(name))
            .unwrap()
            .to_rgb8();
        let mut pixels: BTreeMap<u64, u64> = BTreeMap::new();
        for image::Rgb([red, green, blue]) in image.pixels() {
            let id = u64::from(*red) + 256 * u64::from(*green) + 65536 * u64::from(*blue);
            *pixels.entry(id).or_default() += 1;
        }
        pixels.remove(&0);
        let listed: BTreeMap<u64, u64> = annotation["segments_info"]
            .as_array()
            .unwrap()
            .iter()
            .map(|info| (info["id"].as_u64().unwrap(), info["area"].as_u64().unwrap()))
            .collect();
        assert_eq!(pixels, listed, "{name}");
        segments += listed.len();
    }
    assert_eq!(segments, objects, "each mask is a segment");
}

/// Checks that the middle of the floor of each box, projected by the calibration, is in the columns
/// of the 2D box, unless that is cut.
fn check_kitti(out: &Path, samples: usize) {
    let mut whole = 0;
    for step in 0..samples {
        let file = |kind: &str, ending: &str| out.join(format!("{kind}/{step:06}.{ending}"));
        let calibration = fs::read_to_string(file("calib", "txt")).unwrap();
        let p2 = calibration
            .lines()
            .find_map(|line| line.strip_prefix("P2: "))
            .unwrap();
        let p: Vec<f64> = p2
            .split(' ')
            .map(|number| number.parse().unwrap())
            .collect();
        assert_eq!(p.len(), 12);
        assert_eq!(fs::metadata(file("velodyne", "bin")).unwrap().len() % 16, 0);
        for line in fs::read_to_string(file("label_2", "txt")).unwrap().lines() {
            let words: Vec<&str> = line.split(' ').collect();
            assert_eq!(words.len(), 15, "{line}");
            let n: Vec<f64> = words[1..]
                .iter()
                .map(|word| word.parse().unwrap())
                .collect();
            if n[0] > 0.0 || n[12] < 1.0 {
                continue;
            }
            let x_px = (p[0] * n[10] + p[2] * n[12]) / n[12];
            assert!(n[3] - 1.0 <= x_px && x_px <= n[5] + 1.0, "{line}: {x_px}");
            // Wheels on the ground: below the camera.
            assert!(n[11] > 0.5 && n[11] < 4.0, "{line}");
            whole += 1;
        }
    }
    assert!(whole > 0);
}

/// Checks that what cannot be written is said, and that nothing is left of it.
fn check_refusals(log: &Path, base: &Path) {
    let out = base.join("again");
    let arguments = |more: &[&'static str]| -> Vec<String> {
        let all = [&["export", text(log), "--out", text(&out)], more].concat();
        all.into_iter().map(str::to_owned).collect()
    };
    for (more, word) in [
        (&["--as", "kitti"][..], "--cameras"),
        (&["--as", "coco", "--cameras", "roof"], "roof"),
        (&["--as", "coco", "--lidar", "nowhere"], "nowhere"),
    ] {
        let all = arguments(more);
        let all: Vec<&str> = all.iter().map(String::as_str).collect();
        assert!(fail(1, &all).contains(word), "{more:?}");
        assert!(!out.exists());
    }
    assert!(
        fail(
            1,
            &["export", text(log), "--as", "coco", "--out", text(base)]
        )
        .contains("exists already")
    );
    assert_eq!(
        fs::read_dir(base)
            .unwrap()
            .filter(|entry| entry
                .as_ref()
                .unwrap()
                .file_name()
                .to_string_lossy()
                .starts_with('.'))
            .count(),
        0
    );
}

/// Another background is another image: the log's hashes notice.
#[test]
fn images_that_are_not_those_of_the_log_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (scene, lanes) = (street.join("scene.toml"), street.join("lanes.json"));
    let out = folder.path().join("run");
    let place = ["drive", "--scene", text(&scene), "--map", text(&lanes)];
    let what = ["--level", "easy", "--episodes", "1", "--size", "48x27"];
    succeed(
        &[
            &place[..],
            &what,
            &["--planner", "constant-velocity", "--render", "3"],
            &["--out", text(&out)],
        ]
        .concat(),
    );
    let log = out.join("logs/easy_0000.log");
    let file = fs::read_to_string(&scene).unwrap();
    fs::write(
        &scene,
        file.replacen(r#"name = "default""#, r#"name = "inria""#, 1),
    )
    .unwrap();
    let coco = folder.path().join("coco");
    let export = ["export", text(&log), "--as", "coco", "--out", text(&coco)];
    let said = fail(1, &export);
    assert!(
        said.contains("not those of the log") && said.contains("--unchecked"),
        "{said}"
    );
    assert!(!coco.exists());
    succeed(&[&export[..], &["--unchecked"]].concat());
    assert!(coco.join("annotations.json").exists());
}

#[test]
fn an_episode_becomes_a_scene_that_shows_what_it_showed() {
    let folder = tempfile::tempdir().unwrap();
    let log = episode(folder.path());
    let (scene, images) = (folder.path().join("scene"), folder.path().join("images"));
    let export = ["export", text(&log), "--as", "scene", "--out", text(&scene)];
    let said = succeed(&export);
    assert!(said.contains("scene.toml with "), "{said}");
    let scene_file = scene.join("scene.toml");
    let file = SceneFile::read(&scene_file).unwrap();
    let episode = read_episode_log(&log).unwrap();
    let (mut compared, mut ways) = (0, 0);
    for (index, agent) in episode.head.scenario.agents.iter().enumerate() {
        let Some(shown) = file.agents.iter().find(|one| one.name == agent.name) else {
            continue;
        };
        assert_eq!(shown.class.as_deref(), Some(agent.kind.name()));
        ways += 1;
        for tick in episode.instants() {
            let there = shown.present.includes(tick.time_s);
            if let Some(state) = tick.agents[index].as_ref().filter(|_| there) {
                let at = shown.trajectory.at(tick.time_s).translation.truncate();
                let off_m = at.distance(state.position_m);
                assert!(
                    off_m < 1e-6,
                    "{} at {} s: {off_m} m",
                    agent.name,
                    tick.time_s
                );
                compared += 1;
            }
        }
    }
    assert!(
        ways > 5 && compared > 100,
        "{ways} agents, {compared} places"
    );
    let way = file.ego.unwrap();
    for tick in episode.instants() {
        let at = way.at(tick.time_s).translation.truncate();
        assert!(at.distance(tick.ego.position_m) < 1e-6);
    }
    // An image of the episode, and the scene's at that time.
    succeed(&["replay", text(&log), "--images", text(&images)]);
    let rendered = folder.path().join("rendered");
    succeed(&[
        "render",
        text(&scene_file),
        "--cameras",
        "front",
        "--size",
        "96x54",
        "--time",
        "1",
        "--out",
        text(&rendered),
    ]);
    let (shown, again) = (images.join("front_0002.png"), rendered.join("front.png"));
    let [shown, again] = [shown, again].map(|path| Image::read(&path).unwrap());
    let error = Difference::between(&shown, &again).unwrap().psnr_db;
    assert!(error > 40.0, "{error} dB");
    // It is packed and driven like any other.
    let package = folder.path().join("scene.usdz");
    succeed(&["pack", text(&scene_file), "--usdz", text(&package)]);
}
