//! `drive --tracks` and `realism traffic` on a small recording.

use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::run;

/// Two lanes of 400 m to the east and three cars, for 8 s: one that drives off, one that follows it
/// closely, and one beside.
pub fn recording(folder: &Path) -> PathBuf {
    let mut text = String::from(
        "<commonRoad commonRoadVersion=\"2020a\" benchmarkID=\"A\" timeStepSize=\"0.1\">",
    );
    for (id, y, beside) in [
        (1, 0.0, "<adjacentLeft ref=\"2\" drivingDir=\"same\"/>"),
        (2, 3.5, "<adjacentRight ref=\"1\" drivingDir=\"same\"/>"),
    ] {
        let bound = |name: &str, y: f64| {
            let point = |x: f64| format!("<point><x>{x}</x><y>{y}</y></point>");
            format!("<{name}>{}{}</{name}>", point(0.0), point(400.0))
        };
        let (left, right) = (bound("leftBound", y + 1.75), bound("rightBound", y - 1.75));
        let _ = write!(text, "<lanelet id=\"{id}\">{left}{right}{beside}</lanelet>");
    }
    // Place, speed, half of the acceleration, and offset to the left.
    for (id, from_m, speed_mps, half_mps2, y) in [
        (10, 60.0, 4.0, 0.7, 0.2),
        (11, 40.0, 4.0, 0.6, 0.1),
        (12, 30.0, 15.0, 0.0, 3.5),
    ] {
        let shape = "<shape><rectangle><length>4.5</length><width>1.8</width></rectangle></shape>";
        let _ = write!(text, "<dynamicObstacle id=\"{id}\"><type>car</type>{shape}");
        for step in 0..=80 {
            let s = 0.1 * f64::from(step);
            let x = from_m + speed_mps * s + half_mps2 * s * s;
            let name = if step == 0 { "initialState" } else { "state" };
            let opens = if step == 1 { "<trajectory>" } else { "" };
            let _ = write!(
                text,
                "{opens}<{name}><position><point><x>{x}</x><y>{y}</y></point></position>\
                 <orientation><exact>0.0</exact></orientation><time><exact>{step}</exact></time></{name}>"
            );
        }
        text.push_str("</trajectory></dynamicObstacle>");
    }
    text.push_str("</commonRoad>");
    let path = folder.join("two lanes.xml");
    fs::write(&path, text).unwrap();
    path
}

pub fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

pub fn succeed(arguments: &[&str]) -> String {
    let output = run(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned() + &said
}

pub fn fail(arguments: &[&str], code: i32) -> String {
    let output = run(arguments);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
    said
}

/// Drives among the tracks with an ego in the place of the first car that keeps its speed.
fn drive(tracks: &Path, out: &Path, handover: &str) -> (PathBuf, Vec<Value>) {
    let planner = ["--planner", "constant-velocity", "--render", "off"];
    let command = ["drive", "--tracks", text(tracks), "--ego-track", "10"];
    let more = ["--handover", handover, "--out", text(out)];
    let said = succeed(&[&command[..], &planner, &more].concat());
    assert!(
        said.contains("the ego is track 10; 2 road users follow theirs, for 8.0 s"),
        "{said}"
    );
    let log = out.join("logs").join("two_lanes-10.log");
    let lines = fs::read_to_string(&log).unwrap();
    let records = lines
        .lines()
        .map(|line| serde_json::from_str(&line[17..]).unwrap());
    (log.clone(), records.collect())
}

/// Agents that were handed over, with times.
fn handovers(records: &[Value]) -> Vec<(u64, f64)> {
    let all = records
        .iter()
        .filter_map(|record| record["handovers"].as_array());
    all.flatten()
        .map(|one| (one[0].as_u64().unwrap(), one[1].as_f64().unwrap()))
        .collect()
}

#[test]
fn recorded_cars_follow_their_tracks_until_the_ego_is_in_their_way() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let (log, records) = drive(&tracks, &folder.path().join("near"), "near");
    let ego = &records[0]["start"][1];
    assert_eq!((ego[0].as_f64(), ego[1].as_f64()), (Some(60.0), Some(0.2)));
    let handed = handovers(&records);
    assert_eq!(handed.len(), 1, "{handed:?}");
    assert!(handed[0].0 == 0 && handed[0].1 > 0.5, "{handed:?}");
    assert_eq!(records.last().unwrap()["end"], "time");
    let instants = records
        .iter()
        .filter_map(|record| record["instants"].as_array());
    for instant in instants.flatten() {
        let time_s = instant[0].as_f64().unwrap();
        let beside = &instant[6][1];
        let x = (30.0 + 15.0 * time_s, beside[0].as_f64().unwrap());
        assert!((x.0 - x.1).abs() < 1e-9, "at {time_s}: {x:?}");
        let ahead_m = instant[1][0].as_f64().unwrap() - instant[6][0][0].as_f64().unwrap();
        assert!(
            ahead_m > 4.5,
            "at {time_s}: {ahead_m} m from middle to middle"
        );
    }
    succeed(&["replay", text(&log), "--no-render"]);
    // On its track it runs into the ego.
    let (_, records) = drive(&tracks, &folder.path().join("never"), "never");
    assert!(handovers(&records).is_empty());
    assert_eq!(records.last().unwrap()["end"], "collision");
    let (_, records) = drive(&tracks, &folder.path().join("all"), "all");
    assert_eq!(handovers(&records), [(0, 0.0), (1, 0.0)]);
}

#[test]
fn drawn_drivers_are_in_the_log_and_replay_to_the_bit() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let drive = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let planner = ["--planner", "constant-velocity", "--render", "off"];
        let command = ["drive", "--tracks", text(&tracks), "--ego-track", "10"];
        let rest = ["--handover", "all", "--out", text(&out)];
        succeed(&[&command[..], &planner, &rest, more].concat());
        let log = out.join("logs").join("two_lanes-10.log");
        succeed(&["replay", text(&log), "--no-render"]);
        fs::read_to_string(log).unwrap()
    };
    let says_drawn = |log: &str| log.contains("drivers = \\\"drawn\\\"");
    let drawn = drive("drawn", &["--drivers", "drawn"]);
    let kinds = drive("kinds", &["--drivers", "kinds"]);
    assert!(says_drawn(&drawn) && !says_drawn(&kinds));
    assert_eq!(drawn, drive("again", &["--drivers", "drawn"]));
    assert_eq!(kinds, drive("default", &[]));
    let places = |log: &str| {
        log.lines()
            .skip(1)
            .map(|line| line[17..].to_owned())
            .collect::<String>()
    };
    assert_ne!(
        places(&drawn),
        places(&kinds),
        "drivers drive as they are drawn"
    );
}

#[test]
fn what_cannot_be_driven_among_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let [out, other] = ["out", "other"].map(|name| folder.path().join(name));
    let table = folder.path().join("a.csv");
    fs::write(&table, "t,id,class,x,y\n0,1,car,0,0\n1,1,car,20,0\n").unwrap();
    let rest = [
        "--planner",
        "lane-follow",
        "--render",
        "off",
        "--out",
        text(&out),
    ];
    let said = fail(
        &[&["drive", "--tracks", text(&table)][..], &rest].concat(),
        1,
    );
    assert!(said.contains("--map"), "{said}");
    let command = ["drive", "--tracks", text(&tracks), "--ego-track", "99"];
    let said = fail(&[&command[..], &rest[..5], &[text(&other)]].concat(), 1);
    assert!(said.contains("no track '99'"), "{said}");
    let said = fail(
        &[&["drive", "--level", "easy", "--ego-track", "1"][..], &rest].concat(),
        2,
    );
    assert!(said.contains("--ego-track"), "{said}");
}

#[test]
fn simulated_traffic_is_compared_with_what_was_recorded() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let out = folder.path().join("gap");
    let command = [
        "realism",
        "traffic",
        "--tracks",
        text(&tracks),
        "--out",
        text(&out),
    ];
    let said = succeed(&[&command[..], &["--rollouts", "2"]].concat());
    assert!(
        said.contains("all alike; free speeds: those of the map"),
        "{said}"
    );
    assert!(
        said.contains("realism.html") && said.contains("KS"),
        "{said}"
    );
    let report = fs::read_to_string(out.join("realism.json")).unwrap();
    let report: Value = serde_json::from_str(&report).unwrap();
    let models = report["models"].as_array().unwrap();
    assert_eq!(models.len(), 3);
    for model in models {
        assert_eq!(
            (model["vehicles"].as_u64(), model["placed"].as_u64()),
            (Some(3), Some(3))
        );
        let meta = model["wosac"]["meta_metric"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&meta), "{meta}");
        let speed = model["quantities"][0]["ks"].as_f64().unwrap();
        assert!((0.0..=1.0).contains(&speed), "{speed}");
    }
    // Straight on at the speed of the start, two of three cars stay behind.
    let late_m = models[2]["displacement"][3]["mean_m"].as_f64().unwrap();
    assert!(late_m > 20.0, "{late_m}");
    let page = fs::read_to_string(out.join("realism.html")).unwrap();
    assert!(page.contains("Realism of traffic") && page.contains("<svg"));
    let said = fail(&command, 1);
    assert!(said.contains("gap"), "nothing is replaced: {said}");
}

#[test]
fn a_free_speed_is_named_or_taken_from_the_first_half() {
    let folder = tempfile::tempdir().unwrap();
    let tracks = recording(folder.path());
    let compared = |name: &str, free_speed: &[&str]| -> Value {
        let out = folder.path().join(name);
        let command = ["realism", "traffic", "--tracks", text(&tracks)];
        let more = ["--rollouts", "1", "--out", text(&out)];
        succeed(&[&command[..], &more, free_speed].concat());
        let report = fs::read_to_string(out.join("realism.json")).unwrap();
        serde_json::from_str(&report).unwrap()
    };
    // Median speed of drivers on lanes.
    let median_mps = |report: &Value| {
        let speed = &report["models"][0]["quantities"][0];
        assert_eq!(speed["name"], "speed, m/s");
        speed["simulated"]["p50"].as_f64().unwrap()
    };
    let plain = compared("plain", &[]);
    assert_eq!(plain["free_speed_mps"], Value::Null);
    let slow = compared("slow", &["--free-speed", "5"]);
    assert_eq!(slow["free_speed_mps"], 5.0);
    let speeds_mps = (median_mps(&slow), median_mps(&plain));
    assert!(
        speeds_mps.0 < 7.0 && speeds_mps.0 < speeds_mps.1 - 1.0,
        "{speeds_mps:?}"
    );
    // Speeds over half a second up to 4 s are 9.25, 8.5 and 15 m/s.
    let told = compared("recorded", &["--free-speed", "recorded"]);
    let free_mps = told["free_speed_mps"].as_f64().unwrap();
    assert!((free_mps - 9.25).abs() < 1e-6, "{free_mps}");
    for wrong in ["0.5", "fast", "-3"] {
        let out = folder.path().join("wrong");
        let command = [
            "realism",
            "traffic",
            "--tracks",
            text(&tracks),
            "--out",
            text(&out),
        ];
        let said = fail(&[&command[..], &["--free-speed", wrong]].concat(), 2);
        assert!(
            said.contains("expected a speed from 1 to 70 m/s, or recorded"),
            "{said}"
        );
    }
}
