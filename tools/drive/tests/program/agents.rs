//! `drive --agents` and `realism traffic --agents`, with programs in Python.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::tracks::{fail, recording, succeed, text};

/// A driver of agents whose `drive` has this body, and `name` and `begin` may be told before it.
fn driver(folder: &Path, name: &str, body: &str) -> String {
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("../planner_client");
    let path = folder.join(format!("{name}.py"));
    let program = format!(
        "import sys, time\nsys.path.insert(0, {client:?})\nimport decouplegs_planner as protocol\n\
         class Mine(protocol.AgentDriver):\n    name = 'mine'\n    def drive(self, seen):\n        {body}\n\
         protocol.run(Mine)\n"
    );
    fs::write(&path, program).unwrap();
    format!("exec:python3 {:?}", path.display().to_string())
}

/// Everything that a drive among the tracks takes, less `--agents` and what comes after it.
fn command<'a>(tracks: &'a Path, out: &'a Path) -> Vec<&'a str> {
    let planner = ["--planner", "constant-velocity", "--render", "off"];
    let command = ["drive", "--tracks", text(tracks), "--ego-track", "10"];
    let more = ["--handover", "never", "--out", text(out)];
    [&command[..], &planner, &more].concat()
}

fn log(out: &Path) -> (PathBuf, Vec<Value>) {
    let path = out.join("logs").join("two_lanes-10.log");
    let lines = fs::read_to_string(&path).unwrap();
    let records = lines.lines();
    let records = records.map(|line| serde_json::from_str(&line[17..]).unwrap());
    (path.clone(), records.collect())
}

#[test]
fn a_program_drives_all_vehicles_and_the_log_replays_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    // The first brakes; the other is told a curvature that no car can drive.
    let body = "return [(one.agent, -1.5) if one.agent == 0 else (one.agent, 0.0, 9.0) for one in seen.agents]";
    let agents = driver(folder.path(), "braking", body);
    let out = folder.path().join("run");
    let said = succeed(&[&command(&tracks, &out)[..], &["--agents", &agents]].concat());
    assert!(
        said.contains("agents: mine drove 2 vehicles in 1 episodes"),
        "{said}"
    );
    let (log, records) = log(&out);
    assert_eq!(records[0]["agent_driver"], "mine");
    let first = &records[1]["commands"];
    assert_eq!(first[0], serde_json::json!([0, -1.5, null, false]));
    assert_eq!(first[1], serde_json::json!([1, 0.0, 9.0, true]));
    // 4 m/s, less 1.5 m/s^2 over the first step of half a second.
    let after = &records[1]["instants"].as_array().unwrap().last().unwrap()[6];
    assert!(
        (after[0][3].as_f64().unwrap() - 3.25).abs() < 0.2,
        "{after}"
    );
    let handed = records[1]["handovers"].as_array().unwrap();
    assert_eq!(handed.len(), 2, "who leaves a track is told: {handed:?}");
    // Nobody is there who could be asked.
    fs::remove_file(folder.path().join("braking.py")).unwrap();
    let said = succeed(&["replay", text(&log), "--no-render"]);
    assert!(said.contains("all vehicles move as in the log"), "{said}");
    let report = fs::read_to_string(out.join("report.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let told = &report["episodes"][0]["agents"];
    assert_eq!(told["driver"], "mine");
    assert!(told["limited"].as_u64().unwrap() > 0, "{told}");
}

#[test]
fn a_program_that_drives_nobody_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let agents = driver(folder.path(), "idle", "return []");
    let (with, without) = (folder.path().join("with"), folder.path().join("without"));
    succeed(&[&command(&tracks, &with)[..], &["--agents", &agents]].concat());
    succeed(&command(&tracks, &without));
    let (with, without) = (log(&with).1, log(&without).1);
    assert_eq!(with[1..], without[1..]);
    assert_eq!(without[0].get("agent_driver"), None);
    assert!(
        without
            .iter()
            .all(|record| record.get("commands").is_none())
    );
}

#[test]
fn programs_that_fail_end_the_run_with_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let cases = [
        (
            "ghost",
            "return [(7, 0.0)]",
            "agent 7 takes no commands now",
        ),
        (
            "twice",
            "return [(0, 0.0), (0, 1.0)]",
            "agent 0 has two commands",
        ),
        ("nan", "return [(0, float('nan'))]", "failed: ValueError"),
        ("broken", "raise KeyError('x')", "failed: KeyError"),
        ("gone", "sys.exit(3)", "closed the connection"),
        ("late", "time.sleep(600)", "within 1 s"),
    ];
    for (name, body, says) in cases {
        let agents = driver(folder.path(), name, body);
        let out = folder.path().join(format!("{name} run"));
        let timeout = if name == "late" { "1" } else { "60" };
        let more = ["--planner-timeout", timeout, "--agents", &agents];
        let said = fail(&[&command(&tracks, &out)[..], &more].concat(), 1);
        assert!(
            said.contains("the agents were not driven at 0.0 s"),
            "{name}: {said}"
        );
        assert!(said.contains(says), "{name}: {said}");
    }
    let out = folder.path().join("planner run");
    let client = Path::new(env!("CARGO_MANIFEST_DIR")).join("../planner_client/example_planner.py");
    let planner = format!("exec:python3 {:?}", client.display().to_string());
    let said = fail(
        &[&command(&tracks, &out)[..], &["--agents", &planner]].concat(),
        1,
    );
    assert!(said.contains("introduced itself as a planner"), "{said}");
    let said = fail(
        &[&command(&tracks, &out)[..], &["--agents", "lane-follow"]].concat(),
        2,
    );
    assert!(
        said.contains("expected exec:COMMAND ARGUMENTS, unix:PATH or onnx:MODEL"),
        "{said}"
    );
    let missing = ["--agents", "onnx:missing.onnx"];
    let said = fail(&[&command(&tracks, &out)[..], &missing].concat(), 1);
    assert!(said.contains("missing.onnx"), "{said}");
}

#[test]
fn realism_measures_a_program_beside_the_models_and_shows_it_the_recording() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let body =
        "return [(one.agent, 30.0 if one.driven_by == 'track' else 1.3) for one in seen.agents]";
    let agents = driver(folder.path(), "faster", body);
    let out = folder.path().join("gap");
    let command = [
        "realism",
        "traffic",
        "--tracks",
        text(&tracks),
        "--agents",
        &agents,
    ];
    let more = ["--rollouts", "1", "--out", text(&out)];
    let said = succeed(&[&command[..], &more].concat());
    assert!(said.contains("agents: driven by mine"), "{said}");
    let report = fs::read_to_string(out.join("realism.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    assert_eq!(report["agents"], "mine");
    let models = report["models"].as_array().unwrap();
    assert_eq!(models.last().unwrap()["name"], "agents");
    assert_eq!(models.len(), 4);
    // Two of three were recorded with 1.4 and 1.2 m/s^2: after a second they are near, and the
    // third, which kept its speed, is not.
    let mean_m = models[3]["displacement"][0]["mean_m"].as_f64().unwrap();
    assert!((0.05..1.5).contains(&mean_m), "{mean_m}");
    // Shown what was recorded, it drives nobody, whatever it says.
    let said = succeed(&[&command[..], &["--show-recording"]].concat());
    assert!(said.contains("80 moments were shown to mine"), "{said}");
}
