//! `drive` with several egos: planners of their own, one log, a score for each.

use std::fs;
use std::path::Path;

use serde_json::Value;

use super::tracks::{fail, succeed, text};

/// A drive of one generated scenario of `level` with `egos` egos, less `--out` and what comes after
/// it.
fn command<'a>(level: &'a str, egos: &'a str) -> Vec<&'a str> {
    let what = ["drive", "--level", level, "--episodes", "1", "--seed", "5"];
    let how = [
        "--egos",
        egos,
        "--planner",
        "lane-follow",
        "--render",
        "off",
    ];
    [&what[..], &how].concat()
}

/// Names of the egos beside the first in a scenario file.
fn other_egos(scenario: &Path) -> Vec<String> {
    let text = fs::read_to_string(scenario).unwrap();
    let tables = text.split("[[other_ego]]\nname = \"").skip(1);
    let names = tables.map(|table| table.split('"').next().unwrap().to_owned());
    names.collect()
}

#[test]
fn three_egos_have_planners_of_their_own_one_log_and_a_score_each() {
    let folder = tempfile::tempdir().unwrap();
    let draft = folder.path().join("draft");
    succeed(&[&command("medium", "3")[..], &["--out", text(&draft)]].concat());
    let scenario = draft.join("scenarios/medium_0000.toml");
    let names = other_egos(&scenario);
    assert_eq!(names.len(), 2, "{names:?}");

    let run = folder.path().join("run");
    let client =
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/planners/route_planner.py");
    let program = format!(
        "{}=exec:python3 {:?}",
        names[0],
        client.display().to_string()
    );
    let straight = format!("{}=constant-velocity", names[1]);
    let drive = [
        "drive",
        text(&scenario),
        "--planner",
        "lane-follow",
        "--ego-planner",
        &program,
        "--ego-planner",
        &straight,
        "--render",
        "off",
        "--out",
        text(&run),
    ];
    let said = succeed(&drive);
    assert!(said.contains("egos of episodes with several:"), "{said}");
    assert!(said.contains("medium_0000/ego, lane-follow: DS "), "{said}");
    let other = format!("medium_0000/{}, constant-velocity: DS ", names[1]);
    assert!(said.contains(&other), "{said}");
    let report: Value =
        serde_json::from_slice(&fs::read(run.join("report.json")).unwrap()).unwrap();
    let episodes = report["episodes"].as_array().unwrap();
    assert_eq!(episodes.len(), 3);
    assert!(episodes.iter().all(|episode| episode["ego"].is_string()));

    let log = run.join("logs/medium_0000.log");
    let bytes = fs::read(&log).unwrap();
    let said = succeed(&["replay", text(&log), "--base", text(&run), "--no-render"]);
    assert!(said.contains("all vehicles move as in the log"), "{said}");
    let said = succeed(&["score", text(&log)]);
    assert!(said.contains(&other), "{said}");
    assert!(succeed(&drive).contains("nothing was left to drive"));
    assert_eq!(fs::read(&log).unwrap(), bytes);
}

#[test]
fn a_run_without_egos_writes_what_it_wrote_before() {
    let folder = tempfile::tempdir().unwrap();
    let run = folder.path().join("run");
    let one = [
        "drive",
        "--level",
        "medium",
        "--episodes",
        "1",
        "--seed",
        "5",
    ];
    let how = [
        "--planner",
        "lane-follow",
        "--render",
        "off",
        "--out",
        text(&run),
    ];
    let said = succeed(&[&one[..], &how].concat());
    assert!(!said.contains("egos of episodes"), "{said}");
    let settings = fs::read_to_string(run.join("run.json")).unwrap();
    let scenario = fs::read_to_string(run.join("scenarios/medium_0000.toml")).unwrap();
    let log = fs::read_to_string(run.join("logs/medium_0000.log")).unwrap();
    for written in [settings, scenario, log] {
        assert!(!written.contains("other_ego") && !written.contains("\"ego\":"));
    }
}

#[test]
fn egos_that_cannot_be_driven_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let refused = |egos: &str, more: &[&str]| {
        let command = [&command("easy", egos)[..], more, &["--out", text(&out)]].concat();
        fail(&command, 1)
    };
    let said = refused("8", &[]);
    assert!(
        said.contains("expected fewer egos or more traffic"),
        "{said}"
    );
    let said = refused("2", &["--ego-planner", "nobody=vision"]);
    assert!(
        said.contains("no scenario has an ego of this name; there are "),
        "{said}"
    );
    let said = refused("2", &["--ego-planner", "ego=vision"]);
    assert!(said.contains("vision drives by what it sees"), "{said}");
    let many = [&command("easy", "9")[..], &["--out", text(&out)]].concat();
    assert!(fail(&many, 2).contains("--egos"));
}
