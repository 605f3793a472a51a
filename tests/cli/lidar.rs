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
}

#[test]
fn sensors_that_are_none_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let sensor = folder.path().join("bad.toml");
    fs::write(
        &sensor,
        "name = \"bad\"\nrate_hz = 10.0\nrange_m = [0.5, 100.0]\n",
    )
    .unwrap();
    for (sensor, reason) in [
        (text(&sensor), "row_elevations_deg or columns is missing"),
        ("no_such_sensor", "no_such_sensor"),
    ] {
        let arguments = ["lidar", "none.ply", "--sensor", sensor, "--out", "out"];
        let message = fail(1, &arguments);
        assert!(message.contains(reason), "{message}");
    }
}
