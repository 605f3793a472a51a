//! `lidar`: sweeps as files.

use super::*;

#[test]
fn sweeps_are_written_in_every_format() {
    let folder = tempfile::tempdir().unwrap();
    let (street, out) = (folder.path().join("street"), folder.path().join("out"));
    small_street(&street);
    let sensor = folder.path().join("small.toml");
    let model = "name = \"small\"\nrow_elevations_deg = [2.0, -2.0, -6.0, -12.0]\ncolumns = 90\nrate_hz = 10.0\nrange_m = [0.5, 100.0]\n";
    fs::write(&sensor, model).unwrap();
    let scene = street.join("scene.toml");
    let sweep = |more: &[&str]| {
        let command = [
            "lidar",
            text(&scene),
            "--sensor",
            text(&sensor),
            "--force",
            "--out",
            text(&out),
        ];
        succeed(&[&command[..], more].concat())
    };
    for (format, file) in [
        ("kitti", "small_000001.bin"),
        ("nuscenes", "small_000001.pcd.bin"),
        ("av2", "small_000001.feather"),
        ("pcd", "small_000001.pcd"),
        ("ply", "small_000001.ply"),
        ("npy", "small_000001.npy"),
        ("mcap", "small.mcap"),
    ] {
        let printed = sweep(&["--format", format, "--sweeps", "2"]);
        assert!(printed.contains(file), "{format}: {printed}");
        assert!(out.join(file).is_file(), "{format}");
    }
    let kitti = fs::read(out.join("small_000001.bin")).unwrap();
    assert_eq!(kitti.len() % 16, 0);
    let points = kitti.len() / 16;
    assert!(points > 100, "{points} of 360 beams return");
    // The first sweep again, alone: the same bytes.
    let first = fs::read(out.join("small_000000.npy")).unwrap();
    sweep(&["--format", "npy", "--previews"]);
    assert!(first == fs::read(out.join("small_000000.npy")).unwrap());
    for preview in ["above", "ranges", "front"] {
        assert!(out.join(format!("small_000000.{preview}.png")).is_file());
    }
    let described = fs::read_to_string(out.join("small_000000.json")).unwrap();
    assert!(described.contains("uncalibrated"), "{described}");
    // Agents of plain splats are part of the background, which stands still.
    assert!(
        described.contains("\"class\": \"car\"") && described.contains("\"moving\": false"),
        "{described}"
    );

    // The same sensor of the scene file gives the same bytes.
    let mut file = fs::read_to_string(&scene).unwrap();
    file.push_str(
        "\n[[lidar]]\nname = \"roof\"\nsensor = \"../small.toml\"\nposition_m = [0.0, 0.0, 1.1]\n",
    );
    let equipped = street.join("equipped.toml");
    fs::write(&equipped, file).unwrap();
    succeed(&[
        "lidar",
        text(&equipped),
        "--out",
        text(&out),
        "--force",
        "--format",
        "npy",
    ]);
    assert!(first == fs::read(out.join("roof_000000.npy")).unwrap());

    let bad = folder.path().join("bad.toml");
    fs::write(
        &bad,
        "name = \"bad\"\nrate_hz = 10.0\nrange_m = [0.5, 100.0]\n",
    )
    .unwrap();
    for (sensor, reason) in [
        (Some(text(&bad)), "row_elevations_deg or columns is missing"),
        (Some("no_such_sensor"), "no model (at128, "),
        (None, "has no LiDAR: name a model with --sensor"),
    ] {
        let arguments = ["lidar", text(&scene), "--out", "out"];
        let sensor = sensor.into_iter().flat_map(|sensor| ["--sensor", sensor]);
        let message = fail(1, &arguments.into_iter().chain(sensor).collect::<Vec<_>>());
        assert!(message.contains(reason), "{message}");
    }
}

#[test]
fn an_episode_with_a_lidar_repeats_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let model = "name = \"small\"\nrow_elevations_deg = [2.0, -2.0, -6.0, -12.0]\ncolumns = 90\nrate_hz = 10.0\n\
                 range_m = [0.5, 100.0]\nrange_noise_m = 0.02\n";
    let (sensor, scenario) = (at("small.toml"), at("short.toml"));
    fs::write(&sensor, model).unwrap();
    fs::write(
        &scenario,
        "version = 1\nname = \"short\"\nseed = 1\nduration_s = 1.0\n[place.street]\nweather = \"clear\"\nbackground = 20000\n\
         agent_splats = 400\nseed = 1\n[ego]\nroute = [\"main/forward/1/before\"]\nstart_m = 330.0\nend_m = 360.0\n\
         speed_mps = 8.0\ncruise_mps = 8.0\n",
    )
    .unwrap();
    let drive = |out: &Path, lidar: &[&str]| {
        let words = [
            "drive",
            text(&scenario),
            "--planner",
            "constant-velocity",
            "--size",
            "80x45",
        ];
        succeed(&[&words[..], &["--images", "all", "--out", text(out)], lidar].concat());
        fs::read_to_string(out.join("logs/short.log")).unwrap()
    };
    let with = drive(&at("with"), &["--lidar", text(&sensor)]);
    let again = drive(&at("again"), &["--lidar", text(&sensor)]);
    let without = drive(&at("without"), &[]);
    assert!(with == again && !without.contains("lidar"));
    // Cameras and motion are what they are without a LiDAR.
    let hashes = |log: &str, sensor: &str| -> Vec<String> {
        let start = format!("[\"{sensor}\",\"");
        let found = log.split(&start).skip(1);
        found.map(|rest| rest[..32].to_owned()).collect()
    };
    assert_eq!(hashes(&with, "front"), hashes(&without, "front"));
    assert_eq!(hashes(&with, text(&sensor)).len(), 2);
    let images = at("with").join("images/short");
    for file in [
        "small_0001.pcd",
        "sweep_0000.above.png",
        "sweep_0001.ranges.png",
    ] {
        assert!(images.join(file).is_file(), "{file}");
    }
    let report = fs::read_to_string(at("with").join("report.html")).unwrap();
    assert!(report.contains("ranges by column and row"));

    let log = at("with").join("logs/short.log");
    let replayed = succeed(&["replay", text(&log)]);
    assert!(
        replayed.contains("4 images and sweeps: the same, to the last bit"),
        "{replayed}"
    );
    // Another noise is noticed.
    fs::write(&sensor, model.replace("0.02", "0.03")).unwrap();
    let replayed = decouplegs(&["replay", text(&log)]);
    let message = String::from_utf8_lossy(&replayed.stderr);
    assert_eq!(replayed.status.code(), Some(1));
    assert!(
        message.contains("2 of 4 images and sweeps are not those of the log"),
        "{message}"
    );
}
