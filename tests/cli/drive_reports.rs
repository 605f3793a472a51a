//! Comparisons and videos of `decouplegs drive`.

use std::os::unix::fs::PermissionsExt;

use super::*;

#[test]
fn two_runs_are_compared_episode_by_episode() {
    let folder = tempfile::tempdir().unwrap();
    let run = |planner: &str, seed: &str| -> Vec<String> {
        let out = folder.path().join(format!("{planner}-{seed}"));
        let of_run = ["--planner", planner, "--seed", seed, "--out", text(&out)];
        let always = ["--level", "easy", "--episodes", "3", "--render", "off"];
        succeed(&[&["drive"], &always[..], &of_run[..]].concat());
        let logs = fs::read_dir(out.join("logs")).unwrap().flatten();
        logs.map(|log| log.path().display().to_string()).collect()
    };
    let (careful, blind) = (run("lane-follow", "1"), run("constant-velocity", "1"));
    let words = |first: &[String], second: &[String]| -> Vec<String> {
        let out = folder.path().join("compared").display().to_string();
        let words = [
            vec!["score".to_owned()],
            first.to_vec(),
            vec!["--force".into(), "--out".into(), out, "--against".into()],
        ];
        [words.concat(), second.to_vec()].concat()
    };
    let said = |words: &[String]| succeed(&words.iter().map(String::as_str).collect::<Vec<_>>());
    let differ = said(&words(&careful, &blind));
    assert!(
        differ.starts_with("first: lane-follow, second: constant-velocity; 3 pairs, 0 episodes"),
        "{differ}"
    );
    assert!(differ.contains("part at"), "{differ}");
    assert!(differ.contains("DS: driving score, SR: success rate"));
    let alone: Vec<&str> = [&["score"][..], &[&careful[0]]].concat();
    assert!(succeed(&alone).contains("DS: driving score, SR: success rate, RC: route completion"));
    let page = fs::read_to_string(folder.path().join("compared/comparison.html")).unwrap();
    assert!(page.contains("easy_0000") && page.contains("Differences of driving scores"));
    let report = fs::read_to_string(folder.path().join("compared/comparison.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let level = &report["levels"][0];
    assert!(level["difference"]["mean"].as_f64().unwrap() > 0.1);
    let rules = level["rules"].as_array().unwrap().iter();
    let all_rules = rules
        .clone()
        .find(|one| one["score"] == "all rules")
        .unwrap();
    assert!(
        all_rules["difference"]["mean"].as_f64().unwrap() > 0.1,
        "{all_rules}"
    );
    let names: Vec<&str> = rules.map(|one| one["score"].as_str().unwrap()).collect();
    assert!(
        ["progress", "PDMS", "EPDMS", "lane kept"]
            .iter()
            .all(|name| names.contains(name)),
        "{names:?}"
    );
    assert!(
        differ.contains("EPDMS") && page.contains("Rules and sub-scores"),
        "{differ}"
    );

    let same = said(&words(&careful, &careful));
    assert!(
        same.contains("+0.000 [+0.000, +0.000]") && !same.contains("part at"),
        "{same}"
    );
    let other = words(&careful, &run("lane-follow", "2"));
    let other: Vec<&str> = other.iter().map(String::as_str).collect();
    let error = fail(1, &other);
    assert!(
        error.contains("no scenario was driven in both runs"),
        "{error}"
    );
}

/// Program in place of ffmpeg: keeps the frames that it gets as `CAMERA.frames` in $KEPT.
const FFMPEG: &str = r#"#!/bin/sh
[ "$1" = -version ] && exit 0
while [ "$1" != -i ]; do shift; done
mkdir -p "$KEPT" && cp $2 "$KEPT"
for last; do :; done
echo film > "$last"
"#;

#[test]
fn overlays_are_in_the_frames_of_videos_and_not_in_the_images() {
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let ffmpeg = folder.path().join("bin/ffmpeg");
    fs::create_dir(folder.path().join("bin")).unwrap();
    fs::write(&ffmpeg, FFMPEG).unwrap();
    fs::set_permissions(&ffmpeg, fs::Permissions::from_mode(0o755)).unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let place = ["--background", "20000", "--agent-splats", "300"];
        let how = [
            "--level",
            "hard",
            "--episodes",
            "1",
            "--seed",
            "3",
            "--size",
            "320x180",
        ];
        let planner = [
            "--planner",
            "constant-velocity",
            "--all-cameras",
            "--out",
            text(&out),
        ];
        let output = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
            .args([&["drive"], &place[..], &how, &planner, more].concat())
            .env(
                "PATH",
                format!("{}:/usr/bin:/bin", folder.path().join("bin").display()),
            )
            .env("KEPT", folder.path().join(format!("{name}.frames")))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{said}");
        out.join("images/hard_0000")
    };
    let (plain, drawn) = (
        run("plain", &["--video"]),
        run("drawn", &["--video", "--overlays"]),
    );
    let left = fs::read_dir(&drawn).unwrap().flatten();
    let left: Vec<String> = left
        .map(|entry| entry.file_name().display().to_string())
        .collect();
    assert!(
        !left.iter().any(|name| name.contains("overlays")),
        "{left:?}"
    );
    assert!(drawn.join("front.mp4").is_file() && drawn.join("back.mp4").is_file());
    for camera in ["front", "back"] {
        let name = format!("{camera}_0001.png");
        assert_eq!(
            fs::read(plain.join(&name)).unwrap(),
            fs::read(drawn.join(&name)).unwrap()
        );
        let frame =
            |run: &str| Image::read(&folder.path().join(format!("{run}.frames/{name}"))).unwrap();
        let (plain, drawn) = (frame("plain"), frame("drawn"));
        assert_eq!([drawn.width, drawn.height], [320, 180]);
        let is_near = |rgb: &[f32; 3], color: [u8; 3]| {
            (0..3).all(|i| (rgb[i] - f32::from(color[i]) / 255.0).abs() < 0.02)
        };
        let count = |pixels: &[[f32; 3]], color: [u8; 3]| {
            pixels.iter().filter(|rgb| is_near(rgb, color)).count()
        };
        let white = |image: &Image| count(&image.rgb, [255; 3]);
        assert!(
            white(&drawn) > white(&plain) + 100,
            "words of the {camera} camera"
        );
        // The way ahead is in the image of the front camera, below the middle.
        let plan = [60, 220, 255];
        assert_eq!(count(&plain.rgb, plan), 0);
        assert_eq!(count(&drawn.rgb, plan) > 30, camera == "front", "{camera}");
        assert_eq!(count(&drawn.rgb[..320 * 80], plan), 0);
    }
    let usage = fail(2, &["drive", "--overlays", "--out", "nowhere"]);
    assert!(usage.contains("--video"), "{usage}");
}
