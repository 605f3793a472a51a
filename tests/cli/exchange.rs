//! `decouplegs convert` and `decouplegs pack`.

use std::path::PathBuf;

use decouplegs::asset::{SceneFile, open_scene, read_splats};
use glam::DVec3;

use super::*;

/// A file that seeds the fuzz targets of the readers.
fn seed(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../engine/asset/fuzz/seeds")
        .join(name)
}

#[test]
fn a_ply_is_converted_to_every_format_and_says_what_it_lost() {
    let folder = tempfile::tempdir().unwrap();
    let (source, report) = (
        seed("inria_ply/cone.ply"),
        folder.path().join("report.json"),
    );
    for (name, position_max_m, rest_max) in [
        ("a.ply", 0.0, 0.0),
        ("a.glb", 0.0, 0.0),
        ("a.spz", 1e-3, 0.01),
        ("a.sog", 1e-3, 0.01),
        ("a.splat", 0.0, 1.0),
        ("a.compressed.ply", 1e-3, 0.032),
    ] {
        let out = folder.path().join(name);
        let said = succeed(&[
            "convert",
            text(&source),
            text(&out),
            "--force",
            "--report",
            text(&report),
        ]);
        assert!(
            said.contains(name) && said.contains("12 of 12 splats") && said.contains("position, m"),
            "{said}"
        );
        let value: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
        assert_eq!(
            (&value["splats_out"], &value["bytes_out"]),
            (
                &Value::from(12),
                &Value::from(fs::metadata(&out).unwrap().len())
            )
        );
        let loss = |attribute: &str| value["loss"][attribute]["max"].as_f64().unwrap();
        assert!(
            loss("position_m") <= position_max_m
                && loss("sh_rest") <= rest_max
                && loss("opacity") < 0.003,
            "{name}: {value:#}"
        );
        assert_eq!(read_splats(&out).unwrap().len(), 12);
        // And back.
        let back = folder.path().join("back.ply");
        succeed(&["convert", text(&out), text(&back), "--force"]);
        assert_eq!(json(&["inspect", text(&back), "--json"])["splats"], 12);
    }
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        8,
        "no temporary file is left"
    );
}

#[test]
fn a_compressed_asset_is_compared_splat_by_splat_though_its_order_is_another() {
    let folder = tempfile::tempdir().unwrap();
    let (out, report) = (
        folder.path().join("a.safetensors"),
        folder.path().join("report.json"),
    );
    let said = succeed(&[
        "convert",
        text(&seed("inria_ply/cone.ply")),
        text(&out),
        "--report",
        text(&report),
    ]);
    assert!(said.contains("another order"), "{said}");
    let value: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
    // 12 splats have a shape and a color each: what is lost is the grid of positions, over 0.75 m.
    assert!(
        value["loss"]["position_m"]["max"].as_f64().unwrap() < 1e-4,
        "{value:#}"
    );
    assert!(
        value["loss"]["scale_relative"]["max"].as_f64().unwrap() < 0.2,
        "{value:#}"
    );
    assert_eq!(value["loss"]["rotation_rad"], Value::Null);
}

#[test]
fn what_cannot_be_converted_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().unwrap();
    let out = |name: &str| folder.path().join(name);
    let ply = seed("inria_ply/cone.ply");
    assert!(fail(1, &["convert", text(&ply), text(&out("a.obj"))]).contains(".obj"));
    assert!(
        fail(
            1,
            &["convert", text(&out("absent.sog")), text(&out("a.ply"))]
        )
        .contains("absent.sog")
    );
    assert!(
        fail(
            2,
            &["convert", text(&ply), text(&out("a.ply")), "--degree", "4"]
        )
        .contains('4')
    );
    assert!(
        fail(
            2,
            &["convert", text(&ply), text(&out("a.ply")), "--to", "obj"]
        )
        .contains("glb")
    );
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
    let degree = succeed(&[
        "convert",
        text(&ply),
        text(&out("a.bin")),
        "--to",
        "spz",
        "--degree",
        "1",
    ]);
    assert!(degree.contains("degree 1 where 3 was"), "{degree}");
}

#[test]
fn a_checkpoint_with_actors_becomes_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("scene");
    let checkpoint = seed("scene_import/drivestudio.pth");
    let said = succeed(&[
        "convert",
        text(&checkpoint),
        text(&out),
        "--frame-rate",
        "5",
    ]);
    assert!(
        said.contains("2 of 2 actors") && said.contains("SMPLNodes") && said.contains("Sky"),
        "{said}"
    );
    let scene = SceneFile::read(&out.join("scene.toml")).unwrap();
    assert_eq!(
        (scene.agents.len(), scene.agents[0].trajectory.end_s()),
        (2, 0.4)
    );
    // At 0 s the second actor, of 6 splats, is absent.
    let listed = json(&["inspect", text(&out.join("scene.toml")), "--json"]);
    assert_eq!(listed["splats"], 18);
    assert_eq!(scene.agents[1].present.intervals_s(), [[0.1, 0.5]]);
    assert!(scene.sky_map.is_some() && out.join("sky.exr").exists());
    assert!(fail(1, &["convert", text(&checkpoint), text(&out)]).contains("exists already"));
    assert!(
        fail(
            1,
            &[
                "convert",
                text(&checkpoint),
                text(&folder.path().join("b")),
                "--to",
                "ply"
            ]
        )
        .contains("--to")
    );
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        1,
        "no temporary folder is left"
    );
}

#[test]
fn a_packed_scene_is_a_zip_that_others_read_and_opens_as_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (scene, package) = (street.join("scene.toml"), folder.path().join("street.usdz"));
    let map = folder.path().join("map.xodr");
    let lane = "<lane id=\"-1\" type=\"driving\"><width sOffset=\"0\" a=\"3\" b=\"0\" c=\"0\" d=\"0\"/></lane>";
    let road = format!(
        "<road id=\"1\" length=\"9\"><planView><geometry s=\"0\" x=\"0\" y=\"0\" hdg=\"0\" length=\"9\"><line/></geometry></planView>\
         <lanes><laneSection s=\"0\"><right>{lane}</right></laneSection></lanes></road>"
    );
    let header = "<header><geoReference><![CDATA[+lat_0=49 +lon_0=8]]></geoReference></header>";
    fs::write(&map, format!("<OpenDRIVE>{header}{road}</OpenDRIVE>")).unwrap();
    let empty = folder.path().join("empty.xodr");
    fs::write(&empty, "").unwrap();
    let refused = fail(
        1,
        &[
            "pack",
            text(&scene),
            "--usdz",
            text(&package),
            "--map",
            text(&empty),
        ],
    );
    assert!(
        refused.contains("empty.xodr") && !package.exists(),
        "{refused}"
    );
    let said = succeed(&[
        "pack",
        text(&scene),
        "--usdz",
        text(&package),
        "--map",
        text(&map),
    ]);
    assert!(
        said.contains("'street'") && said.contains("6 cameras, 2 agents"),
        "{said}"
    );
    let file = SceneFile::read(&scene).unwrap();
    let [plain, packed] = [&scene, &package].map(|path| open_scene(path, 0.5).unwrap());
    assert_eq!(plain, packed);
    // The road of the street is at 0, and the middle of its ego 0.85 m above it.
    let below = said.split("on the ground, ").nth(1).unwrap();
    let below_m: f64 = below[..5].parse().unwrap();
    assert!((below_m - 0.85).abs() < 0.03, "{said}");
    check_with_python(&package, &file, below_m);
    // OpenDRIVE is written of other maps.
    let lanes = street.join("lanes.json");
    let said = succeed(&[
        "pack",
        text(&scene),
        "--usdz",
        text(&package),
        "--map",
        text(&lanes),
        "--no-ground",
        "--force",
    ]);
    assert!(
        said.contains("OpenDRIVE is written of") && !said.contains("geoReference"),
        "{said}"
    );
    check_with_python(&package, &file, 0.75);
    let bytes = fs::read(&package).unwrap();
    let holds = |text: &str| {
        bytes
            .windows(text.len())
            .any(|window| window == text.as_bytes())
    };
    assert!(holds("<OpenDRIVE>") && holds("<laneOffset s="));
    // The map of a package is read wherever a map is.
    let [own, packed] = [&lanes, &package].map(|map| json(&["map", text(map), "--json"]));
    assert!(own["lanes"].as_u64() > Some(0), "{own}");
    assert_eq!(own["lanes"], packed["lanes"], "{packed}");
    assert!(fail(2, &["pack", text(&scene), "--usdz", "a.zip"]).contains("a.zip"));
    // Cameras as a simulator's configuration calls them.
    let named = |camera: &str| -> Vec<String> {
        let words = [
            "pack",
            text(&scene),
            "--usdz",
            text(&package),
            "--no-ground",
            "--force",
            "--camera",
        ];
        words
            .iter()
            .copied()
            .chain([camera])
            .map(str::to_owned)
            .collect()
    };
    let words = named("front=camera_front_wide_120fov");
    succeed(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let names: Vec<String> = open_scene(&package, 0.0)
        .unwrap()
        .rig
        .cameras()
        .map(|camera| camera.name.clone())
        .collect();
    assert_eq!(names[0], "camera_front_wide_120fov");
    assert_eq!(names.len(), 6);
    for (camera, code, reason) in [
        ("front", 2, "front=camera_front_wide_120fov"),
        ("roof=a", 1, "no camera \"roof\""),
        ("front=back", 1, "two sensors would be called \"back\""),
    ] {
        let words = named(camera);
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        let said = fail(code, &words);
        assert!(said.contains(reason), "{said}");
    }
    assert!(
        fail(
            1,
            &[
                "pack",
                text(&scene),
                "--usdz",
                text(&package),
                "--force",
                "--scene-id",
                "a/b"
            ]
        )
        .contains("scene id")
    );
}

/// Bytes of an entry of a package.
fn entry(package: &Path, name: &str) -> Vec<u8> {
    let script = "import sys, zipfile; sys.stdout.buffer.write(zipfile.ZipFile(sys.argv[1]).read(sys.argv[2]))";
    let mut python = Command::new("python3");
    let output = python.args(["-c", script, text(package), name]).output();
    output.unwrap().stdout
}

#[test]
fn packages_become_folders_and_are_packed_again() {
    let folder = tempfile::tempdir().unwrap();
    let place = |name: &str| folder.path().join(name);
    let street = place("street");
    small_street(&street);
    let (scene, lanes) = (street.join("scene.toml"), street.join("lanes.json"));
    let [package, nurec] = ["a.usdz", "b.usdz"].map(place);
    let pack = |scene: &Path, package: &Path, more: &[&str]| {
        let words = ["pack", text(scene), "--usdz", text(package), "--no-ground"];
        succeed(&[&words, more].concat())
    };
    pack(&scene, &package, &["--map", text(&lanes)]);
    pack(&scene, &nurec, &["--map", text(&lanes), "--nurec"]);
    let opened = |path: &Path| open_scene(path, 0.5).unwrap();
    // Of this program: the same scene, id and map.
    let out = place("out");
    let said = succeed(&["convert", text(&package), text(&out)]);
    assert!(said.contains("6 cameras, 2 agents"), "{said}");
    assert!(opened(&out.join("scene.toml")) == opened(&package));
    let map = entry(&package, "map.xodr");
    assert!(map.len() > 100 && fs::read(out.join("map.xodr")).unwrap() == map);
    let again = place("again.usdz");
    let said = pack(&package, &again, &[]);
    assert!(said.contains("scene 'street'"), "{said}");
    assert!(opened(&again) == opened(&package));
    assert_eq!(entry(&again, "map.xodr"), map);
    // Of NuRec's form.
    let said = pack(&nurec, &place("of_nurec.usdz"), &[]);
    assert!(
        said.contains("scene 'street'") && said.contains("2 agents"),
        "{said}"
    );
    let [before, after] = [nurec.clone(), place("of_nurec.usdz")].map(|path| opened(&path));
    assert!(before.rig == after.rig && before.agents.len() == after.agents.len());
    assert_eq!(
        before.splat_scene.splats.len(),
        after.splat_scene.splats.len()
    );
    let count = |map: &Path| json(&["map", text(map), "--json"])["lanes"].clone();
    succeed(&["convert", text(&nurec), text(&place("unpacked"))]);
    assert_eq!(count(&place("unpacked/lanes.json")), count(&lanes));
    assert_eq!(count(&place("of_nurec.usdz")), count(&lanes));
    // Nothing is left of what was unpacked, and nothing is replaced.
    let files = fs::read_dir(folder.path()).unwrap();
    let mut names: Vec<_> = files.map(|file| file.unwrap().file_name()).collect();
    names.sort();
    let expected = [
        "a.usdz",
        "again.usdz",
        "b.usdz",
        "of_nurec.usdz",
        "out",
        "street",
        "unpacked",
    ];
    assert_eq!(names, expected);
    let said = fail(1, &["convert", text(&package), text(&out)]);
    assert!(said.contains("is left as it is"), "{said}");
    let said = fail(
        1,
        &["convert", text(&package), text(&place("c")), "--to", "ply"],
    );
    assert!(said.contains("--to") && !place("c").exists(), "{said}");
    // Where a scene file is needed, the way to one is told.
    let said = fail(
        1,
        &[
            "edit",
            text(&package),
            "--out",
            text(&place("d.toml")),
            "--remove-haze",
        ],
    );
    assert!(
        said.contains("found a package; `decouplegs convert "),
        "{said}"
    );
}

/// Reads the package as others do: by Python's zipfile and json, the fields that their readers
/// name.
fn check_with_python(package: &Path, scene: &SceneFile, rig_below_m: f64) {
    let script = r#"
import json, struct, sys, zipfile
with open(sys.argv[1], "rb") as file, zipfile.ZipFile(file) as archive:
    assert archive.testzip() is None
    infos = archive.infolist()
    assert infos[0].filename == "default.usda"
    for info in infos:
        assert info.compress_type == zipfile.ZIP_STORED
        file.seek(info.header_offset + 26)
        name, extra = struct.unpack("<HH", file.read(4))
        assert (info.header_offset + 30 + name + extra) % 64 == 0, info.filename
    read = lambda name: json.loads(archive.read(name))
    rig, tracks, data = read("rig_trajectories.json"), read("sequence_tracks.json"), read("data_info.json")
    assert b"scene_id: \"street\"" in archive.read("metadata.yaml") and archive.read("map.xodr")
    way = rig["rig_trajectories"][0]
    times = way["T_rig_world_timestamps_us"]
    assert times == sorted(set(times)) and len(times) == len(way["T_rig_worlds"])
    assert len(rig["world_to_nre"]["matrix"]) == 4 and max(abs(row[3]) for row in rig["T_world_base"][:3]) > 4e6
    for key, frames in way["cameras_frame_timestamps_us"].items():
        assert key in rig["camera_calibrations"] and all(end > start for start, end in frames) and frames
    box = way["rig_bbox"]
    assert len(box["centroid"]) == len(box["dim"]) == 3 and not any(box["rot"])
    (only,) = tracks.values()
    fields = only["tracks_data"]
    columns = [fields[f"tracks_{name}"] for name in ("id", "label_class", "flags", "timestamps_us", "poses")]
    columns.append(only["cuboidtracks_data"]["cuboids_dims"])
    assert len({len(column) for column in columns}) == 1
    assert all(len(pose) == 7 for poses in columns[4] for pose in poses)
    assert data["pose-range"]["start-timestamp_us"] == times[0] >= 1_000_000
    for frames in way["cameras_frame_timestamps_us"].values():
        assert frames[0][0] >= times[0] + 200_000 and frames[-1][1] <= times[-1]
        assert {end - start for start, end in frames} == {30_000}
    print(json.dumps({"rig": [row[3] for row in way["T_rig_worlds"][0][:3]], "agents": columns[0], "first": columns[4][0][0]}))
"#;
    let output = Command::new("python3")
        .args(["-c", script, text(package)])
        .output()
        .expect("python3 runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let said: Value = serde_json::from_slice(&output.stdout).unwrap();
    let numbers = |value: &Value| -> Vec<f64> {
        value
            .as_array()
            .unwrap()
            .iter()
            .map(|x| x.as_f64().unwrap())
            .collect()
    };
    let ego = scene.ego.as_ref().unwrap();
    let rig = ego
        .at(ego.start_s())
        .transform(DVec3::new(-1.35, 0.0, -rig_below_m))
        - scene.origin;
    assert!(
        (DVec3::from_slice(&numbers(&said["rig"])) - rig).length() < 1e-3,
        "{said}"
    );
    let names: Vec<&str> = scene
        .agents
        .iter()
        .map(|agent| agent.name.as_str())
        .collect();
    assert_eq!(said["agents"], Value::from(names));
    let first = numbers(&said["first"]);
    let way = &scene.agents[0].trajectory;
    let pose = way.at(way.start_s().max(ego.start_s()));
    assert!(
        (DVec3::from_slice(&first[..3]) - (pose.translation - scene.origin)).length() < 1e-9,
        "{said}"
    );
    assert!(
        (first[6].abs() - pose.rotation.w.abs()).abs() < 1e-12,
        "the quaternion's w comes last"
    );
}

#[test]
fn an_output_that_exists_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::copy(seed("inria_ply/cone.ply"), at("in.ply")).unwrap();
    fs::write(at("old.ply"), "old").unwrap();
    let [input, old] = [at("in.ply"), at("old.ply")];
    let before = fs::read(&input).unwrap();
    for force in [&[][..], &["--force"]] {
        let in_place = [
            &["convert", text(&input), text(&input), "--degree", "0"],
            force,
        ]
        .concat();
        assert!(fail(1, &in_place).contains("is read"));
    }
    assert_eq!(fs::read(&input).unwrap(), before);
    assert!(fail(1, &["convert", text(&input), text(&old)]).contains("--force"));
    assert_eq!(fs::read(&old).unwrap(), b"old");
    succeed(&["convert", text(&input), text(&old), "--force"]);
    // Before the scene is read: there is none.
    let render = |out: &str| fail(1, &["render", "absent.toml", "--out", text(&at(out))]);
    assert!(render("old.ply").contains("is a file"));
    assert!(render("images.png").contains("name of a file"));
    let synth = ["synth", "street", "--out", text(folder.path())];
    assert!(fail(1, &synth).contains("--force"));
    let lidar = ["lidar", "absent.toml", "--out", text(folder.path())];
    assert!(fail(1, &lidar).contains("--force"));
    let pose = [
        "register",
        "--map",
        "absent.xodr",
        "--tracks",
        "absent.csv",
        "--out",
    ];
    // Nor are drawings and figures replaced.
    let others: [&[&str]; 7] = [
        &["map", "absent.xodr", "--svg"],
        &["map", "absent.xodr", "--lanes"],
        &[
            "open-loop",
            "absent.log",
            "--planner",
            "vision",
            "--other",
            "rendered",
            "--json",
        ],
        &[
            "calibrate-light",
            "absent.ply",
            "--probes",
            "absent",
            "--out",
        ],
        &["bench", "absent.toml", "--json"],
        &["stress", "absent.toml", "--json"],
        &["conform", "--target", "localhost:1", "--json"],
    ];
    for words in others {
        assert!(
            fail(1, &[words, &[text(&old)]].concat()).contains("--force"),
            "{words:?}"
        );
    }
    fs::write(at("poses.csv"), "old").unwrap();
    assert!(fail(1, &[&pose[..], &[text(&at("poses.csv"))]].concat()).contains("--force"));
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        3,
        "nothing is left"
    );
}
