//! `decouplegs drive`, `replay`, `score` and `open-loop`, small.

use std::process::Stdio;
use std::time::{Duration, Instant};

use super::*;

/// Two easy and two hard episodes of nobody who sees: fast, and with collisions.
pub fn blind(out: &Path, more: &[&str]) -> String {
    let run = [
        "drive",
        "--level",
        "easy,hard",
        "--planner",
        "constant-velocity",
        "--episodes",
        "2",
        "--render",
        "off",
    ];
    succeed(&[&run[..], &["--out", text(out)], more].concat())
}

/// Drawn episodes, their images small and their street coarse.
fn drawn(out: &Path, planner: &str, more: &[&str]) -> String {
    let run = [
        "drive",
        "--level",
        "easy",
        "--planner",
        planner,
        "--size",
        "64x36",
    ];
    let street = ["--background", "6000", "--agent-splats", "300"];
    succeed(&[&run[..], &street, &["--out", text(out)], more].concat())
}

/// Names and bytes of all logs.
pub fn logs(out: &Path) -> Vec<(String, Vec<u8>)> {
    let entries = fs::read_dir(out.join("logs"))
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut logs: Vec<_> = entries
        .map(|path| {
            (
                path.file_name().unwrap().to_string_lossy().into_owned(),
                fs::read(path).unwrap(),
            )
        })
        .collect();
    logs.sort();
    logs
}

fn only_log(out: &Path) -> std::path::PathBuf {
    let logs = logs(out);
    assert_eq!(
        logs.len(),
        1,
        "{:?}",
        logs.iter().map(|(name, _)| name).collect::<Vec<_>>()
    );
    out.join("logs").join(&logs[0].0)
}

#[test]
fn episodes_are_driven_scored_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let said = blind(folder.path(), &[]);
    assert!(
        said.lines().any(|line| line.starts_with("easy"))
            && said.lines().any(|line| line.starts_with("hard")),
        "{said}"
    );
    let report: Value =
        serde_json::from_slice(&fs::read(folder.path().join("report.json")).unwrap()).unwrap();
    let episodes = report["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 4);
    for level in ["easy", "hard", "all"] {
        let mean = |figure: &str| report["levels"][level][figure]["mean"].as_f64().unwrap();
        assert!(
            mean("success_rate") <= mean("route_completion")
                && mean("driving_score") <= mean("route_completion"),
            "{report}"
        );
    }
    stress::assert_page_stands_alone(
        &fs::read_to_string(folder.path().join("report.html")).unwrap(),
    );
    // The same again finds everything done.
    let before = logs(folder.path());
    let again = blind(folder.path(), &[]);
    assert_eq!(logs(folder.path()), before);
    let table = |said: &str| said.lines().take(4).map(str::to_owned).collect::<Vec<_>>();
    assert_eq!(table(&again), table(&said));
    // And the logs alone give the same scores.
    let paths: Vec<String> = before
        .iter()
        .map(|(name, _)| folder.path().join("logs").join(name).display().to_string())
        .collect();
    let scored = succeed(&[vec!["score"], paths.iter().map(String::as_str).collect()].concat());
    assert_eq!(table(&scored), table(&said));
}

#[test]
fn the_same_seed_gives_the_same_bytes_whoever_works() {
    let folder = tempfile::tempdir().unwrap();
    let [one, two, other] = ["one", "two", "other"].map(|name| folder.path().join(name));
    blind(&one, &[]);
    blind(&two, &["--workers", "2"]);
    blind(&other, &["--seed", "2"]);
    assert_eq!(logs(&one), logs(&two));
    assert!(
        logs(&one) != logs(&other),
        "another seed drives other scenarios"
    );
    let [one, two] = ["drawn one", "drawn two"].map(|name| folder.path().join(name));
    let short = ["--episodes", "2", "--render", "3"];
    drawn(&one, "vision", &short);
    drawn(&two, "vision", &[&short[..], &["--workers", "2"]].concat());
    assert_eq!(logs(&one), logs(&two), "hashes of images are in the logs");
}

#[test]
fn a_log_replays_to_the_last_bit_and_a_changed_one_does_not() {
    let folder = tempfile::tempdir().unwrap();
    drawn(
        folder.path(),
        "lane-follow",
        &["--episodes", "1", "--images", "all", "--render", "3"],
    );
    let log = only_log(folder.path());
    let said = succeed(&["replay", text(&log)]);
    assert!(
        said.contains("to the last bit") && said.contains("images: the same"),
        "{said}"
    );
    let images = folder.path().join("again");
    succeed(&["replay", text(&log), "--images", text(&images)]);
    let name = log.file_stem().unwrap().to_string_lossy().into_owned();
    let kept = folder
        .path()
        .join("images")
        .join(name)
        .join("front_0003.png");
    assert!(fs::read(kept).unwrap() == fs::read(images.join("front_0003.png")).unwrap());
    // One digit of a plan.
    let bytes = fs::read(&log).unwrap();
    let at = bytes.len() / 2
        + bytes[bytes.len() / 2..]
            .iter()
            .position(u8::is_ascii_digit)
            .unwrap();
    let mut changed = bytes.clone();
    changed[at] = if bytes[at] == b'1' { b'2' } else { b'1' };
    fs::write(&log, changed).unwrap();
    let said = fail(1, &["replay", text(&log)]);
    assert!(said.contains("checksum") && said.contains("line"), "{said}");
}

#[test]
fn a_run_that_is_killed_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let [whole, killed] = ["whole", "killed"].map(|name| folder.path().join(name));
    let run = |out: &Path| {
        let mut run = Command::new(env!("CARGO_BIN_EXE_decouplegs"));
        let arguments = [
            "drive",
            "--level",
            "all",
            "--planner",
            "lane-follow",
            "--episodes",
            "12",
            "--render",
            "off",
            "--out",
            text(out),
        ];
        run.args(arguments)
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        run
    };
    assert!(run(&whole).status().unwrap().success());
    let mut child = run(&killed).spawn().unwrap();
    let (since, wait) = (Instant::now(), Duration::from_secs(60));
    while since.elapsed() < wait && fs::read_dir(killed.join("logs")).map_or(0, Iterator::count) < 3
    {
        std::thread::sleep(Duration::from_millis(1));
    }
    // SIGKILL.
    child.kill().unwrap();
    child.wait().unwrap();
    let finished: Vec<_> = logs(&killed)
        .into_iter()
        .filter(|(name, _)| name.ends_with(".log"))
        .collect();
    assert!(
        !finished.is_empty() && finished.len() < 48,
        "{} of 48 episodes were done when it was killed",
        finished.len()
    );
    assert!(run(&killed).status().unwrap().success());
    assert_eq!(
        logs(&whole),
        logs(&killed),
        "what was lost was driven again"
    );
}

#[test]
fn a_disk_that_is_full_ends_the_run_with_the_file_and_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    // A process may write files of so many blocks of 512 bytes, and is told so by the call that
    // writes.
    let limited = |blocks: u32| {
        let program = env!("CARGO_BIN_EXE_decouplegs");
        let drive = format!(
            "trap '' XFSZ; ulimit -f {blocks}; exec '{program}' drive --level extreme --planner lane-follow --episodes 1 --render off --out '{}'",
            text(folder.path())
        );
        Command::new("bash").args(["-c", &drive]).output().unwrap()
    };
    let output = limited(16);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("extreme_0000") && !said.contains("panicked"),
        "{said}"
    );
    assert!(
        logs(folder.path())
            .iter()
            .all(|(name, _)| !name.ends_with(".log")),
        "half a log is none"
    );
    let again = limited(1_000_000);
    assert!(
        again.status.success(),
        "{}",
        String::from_utf8_lossy(&again.stderr)
    );
    assert!(
        logs(folder.path())
            .iter()
            .all(|(name, _)| name.ends_with(".log")),
        "what was half is gone"
    );
}

#[test]
fn what_cannot_be_driven_is_said_before_anything_is() {
    let folder = tempfile::tempdir().unwrap();
    let taken = folder.path().join("taken");
    fs::write(&taken, "a file").unwrap();
    let blind = [
        "drive",
        "--level",
        "easy",
        "--planner",
        "constant-velocity",
        "--render",
        "off",
        "--out",
    ];
    assert!(fail(1, &[&blind[..], &[text(&taken)]].concat()).contains("taken"));
    assert!(
        fail(
            2,
            &[
                "drive",
                "--level",
                "mild",
                "--planner",
                "vision",
                "--out",
                "a"
            ]
        )
        .contains("extreme")
    );
    assert!(fail(2, &["drive", "--planner", "vision", "--out", "a"]).contains("SCENARIO"));
    let negative = fail(
        2,
        &[
            "drive",
            "--planner",
            "vision",
            "--episodes",
            "-1",
            "--out",
            "a",
        ],
    );
    assert!(negative.contains("invalid value '-1'"), "{negative}");
    let unseen = [
        "drive",
        "--level",
        "easy",
        "--planner",
        "vision",
        "--render",
        "off",
        "--out",
        text(&taken),
    ];
    assert!(fail(1, &unseen).contains("draws nothing"));
    let scenario = folder.path().join("mine.toml");
    fs::write(&scenario, "version = 1\nname = \"mine\"\nseed = \"one\"\n").unwrap();
    let said = fail(
        1,
        &[
            "drive",
            text(&scenario),
            "--planner",
            "constant-velocity",
            "--render",
            "off",
            "--out",
            text(&folder.path().join("unused")),
        ],
    );
    assert!(said.contains("mine.toml"), "{said}");
    let other = folder.path().join("run");
    succeed(&[&blind[..], &[text(&other), "--episodes", "1"]].concat());
    let said = fail(
        1,
        &[
            &blind[..],
            &[text(&other), "--episodes", "1", "--seed", "9"],
        ]
        .concat(),
    );
    assert!(said.contains("seed = 1") && said.contains('9'), "{said}");
}

#[test]
fn a_scenario_that_was_written_can_be_edited_and_driven() {
    let folder = tempfile::tempdir().unwrap();
    let made = folder.path().join("made");
    succeed(&[
        "drive",
        "--level",
        "medium",
        "--planner",
        "lane-follow",
        "--episodes",
        "1",
        "--render",
        "off",
        "--out",
        text(&made),
    ]);
    let scenario = fs::read_to_string(made.join("scenarios/medium_0000.toml")).unwrap();
    let mine = folder.path().join("mine.toml");
    let edited = |line: &str| match line.starts_with("duration_s") {
        true => "duration_s = 3.0\n".to_owned(),
        false => format!("{}\n", line.replace("medium_0000", "mine")),
    };
    let edited: String = scenario.lines().map(edited).collect();
    fs::write(&mine, edited).unwrap();
    let run = folder.path().join("run");
    let said = succeed(&[
        "drive",
        text(&mine),
        "--planner",
        "lane-follow",
        "--render",
        "off",
        "--out",
        text(&run),
    ]);
    assert!(said.contains("medium"), "{said}");
    let episode = decouplegs::logs::read_episode_log(&run.join("logs/mine.log")).unwrap();
    assert_eq!(
        (episode.steps.len(), episode.head.scenario.duration_s),
        (6, 3.0)
    );
}

#[test]
fn a_planner_of_others_that_fails_ends_its_episode_and_not_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let client = concat!(env!("CARGO_MANIFEST_DIR"), "/planner_client");
    let faults = [
        ("nan", "JSON"),
        ("huge", "points"),
        ("late", "within 1.5 s"),
        ("crash", "exit status: 3"),
    ];
    for (fault, reason) in faults {
        let script = folder.path().join(format!("{fault}.py"));
        let answer = match fault {
            "nan" => "return [(1.0, float('nan'), 0.0)]",
            "huge" => "return [(0.001 * k + 0.001, 1.0, 0.0) for k in range(5000)]",
            "late" => "time.sleep(5); return [(1.0, 5.0, 0.0)]",
            _ => "sys.exit(3)",
        };
        let planner = format!(
            "import sys, time\nsys.path.insert(0, {client:?})\nimport decouplegs_planner\n\nclass Broken(decouplegs_planner.Planner):\n    \
             name = 'broken'\n    def plan(self, observation):\n        {answer}\n\ndecouplegs_planner.run(Broken)\n"
        );
        fs::write(&script, planner).unwrap();
        let out = folder.path().join(fault);
        let exec = format!("exec:python3 {}", text(&script));
        let run = [
            "drive",
            "--level",
            "easy",
            "--planner",
            &exec,
            "--episodes",
            "2",
            "--render",
            "off",
            "--planner-timeout",
            "1.5",
        ];
        // The table is printed, and the run has failed all the same.
        let output = decouplegs(&[&run[..], &["--out", text(&out)]].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{said}");
        assert!(said.contains("failed in all 2 episodes"), "{said}");
        let report: Value =
            serde_json::from_slice(&fs::read(out.join("report.json")).unwrap()).unwrap();
        let endings: Vec<&str> = report["episodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|episode| episode["ending"].as_str().unwrap())
            .collect();
        assert!(
            endings.len() == 2
                && endings
                    .iter()
                    .all(|ending| ending.starts_with("planner failed") && ending.contains(reason)),
            "{fault}: {endings:?}"
        );
    }
}

#[test]
fn two_sources_of_images_are_compared_by_what_a_planner_makes_of_them() {
    let folder = tempfile::tempdir().unwrap();
    drawn(
        folder.path(),
        "vision",
        &["--episodes", "1", "--images", "all"],
    );
    let log = only_log(folder.path());
    let images = folder.path().join("images").join(log.file_stem().unwrap());
    let figures = folder.path().join("open.json");
    let common = [
        "open-loop",
        text(&log),
        "--planner",
        "vision",
        "--force",
        "--json",
        text(&figures),
    ];
    let same = succeed(
        &[
            &common[..],
            &["--reference", "rendered", "--other", text(&images)],
        ]
        .concat(),
    );
    assert!(
        same.starts_with("plans differ by 0.000") && same.contains("longer by up to 0.00 s"),
        "the images on disk are those that were drawn: {same}"
    );
    let dark = folder.path().join("dark");
    fs::create_dir(&dark).unwrap();
    for entry in fs::read_dir(&images).unwrap().map(|entry| entry.unwrap()) {
        let mut image = Image::read(&entry.path()).unwrap();
        image.rgb.iter_mut().for_each(|rgb| *rgb = [0.0; 3]);
        fs::write(
            dark.join(entry.file_name()),
            image
                .encode(decouplegs::render::rendered_image::ImageFileFormat::Png)
                .unwrap(),
        )
        .unwrap();
    }
    succeed(
        &[
            &common[..],
            &["--reference", text(&images), "--other", text(&dark)],
        ]
        .concat(),
    );
    let report: Value = serde_json::from_slice(&fs::read(&figures).unwrap()).unwrap();
    let differences = report["plan_difference_m"].as_array().unwrap();
    assert!(
        differences
            .iter()
            .any(|meters| meters.as_f64().is_some_and(|meters| meters > 0.05)),
        "{report}"
    );
}

#[test]
fn open_scenario_files_are_driven_and_what_is_skipped_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("cut_in.xosc");
    let scenario = include_str!("../../engine/asset/fuzz/seeds/open_scenario/cut_in.xosc");
    let road = include_str!("../../engine/asset/fuzz/seeds/open_drive/three_lanes.xodr");
    fs::write(&file, scenario).unwrap();
    fs::write(folder.path().join("road.xodr"), road).unwrap();
    let out = folder.path().join("run");
    let words = [
        "drive",
        text(&file),
        "--planner",
        "constant-velocity",
        "--render",
        "off",
        "--out",
        text(&out),
    ];
    let output = decouplegs(&words);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        said.contains("cut_in.xosc: line 46, <EnvironmentAction>"),
        "{said}"
    );
    let skipped = fs::read_to_string(out.join("scenarios/cut_in.skipped.txt")).unwrap();
    // The last: the object without a size has no position either, so it stands nowhere.
    assert_eq!(skipped.lines().count(), 4, "{skipped}");
    // The scenario that is written gives the same log.
    let written = out.join("scenarios/cut_in.toml");
    let again = folder.path().join("again");
    succeed(&[
        "drive",
        text(&written),
        "--planner",
        "constant-velocity",
        "--render",
        "off",
        "--out",
        text(&again),
    ]);
    let log = |run: &Path| fs::read(run.join("logs/cut_in.log")).unwrap();
    assert_eq!(log(&out), log(&again));

    fs::write(&file, scenario.replace("road.xodr", "none.xodr")).unwrap();
    let output = fail(1, &words);
    assert!(output.contains("none.xodr"), "{output}");
}

#[test]
fn scenarios_of_a_run_can_all_be_won_where_that_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let street = [
            "drive",
            "--level",
            "hard",
            "--seed",
            "101",
            "--episodes",
            "8",
        ];
        let driven = ["--planner", "lane-follow", "--render", "off"];
        succeed(&[&street[..], &driven, &["--out", text(&out)], more].concat());
        let report = drive_devices::report(&out);
        let episodes = report["episodes"].as_array().unwrap();
        let won = episodes.iter().filter(|one| one["success"] == true).count();
        (won, logs(&out))
    };
    let (won, _) = run("any", &[]);
    assert!(won < 8, "{won} of 8");
    let (won, first) = run("winnable", &["--winnable"]);
    assert_eq!(won, 8);
    let measured = fs::read(folder.path().join("winnable/difficulty.json")).unwrap();
    let measured: Value = serde_json::from_slice(&measured).unwrap();
    let measured = measured.as_object().unwrap();
    assert_eq!(measured.len(), 8);
    for (name, one) in measured {
        assert_eq!(one["won"]["lane-follow"], true, "{name}");
        assert_eq!(one["won"].as_object().unwrap().len(), 3, "{name}");
    }
    let reaction_s = |one: &Value| one["reaction_s"].as_f64();
    assert!(measured.values().filter_map(reaction_s).count() > 0);
    assert!(!folder.path().join("any/difficulty.json").exists());
    let (_, again) = run("again", &["--winnable", "--workers", "2"]);
    assert!(first == again, "the same seed gives the same scenarios");
}
