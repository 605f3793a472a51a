//! Episodes in the viewer: from logs, driven while a page looks, and compared.

use super::*;

/// Images at the steps of a log are compared with its hashes, and the badge says so: also when the
/// scene was changed afterwards.
#[test]
fn an_episode_shows_the_bits_of_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let street = folder.path().join("street");
    small_street(&street);
    let (scene, lanes) = (street.join("scene.toml"), street.join("lanes.json"));
    let out = folder.path().join("run");
    let place = ["drive", "--scene", text(&scene), "--map", text(&lanes)];
    let what = ["--level", "extreme", "--episodes", "1", "--size", "96x54"];
    let how = ["--planner", "constant-velocity", "--all-cameras"];
    succeed(&[&place[..], &what, &how, &["--out", text(&out)]].concat());
    let log = out.join("logs/extreme_0000.log");
    let badge = |panes: &[Value], time_s: f64| {
        let viewer = Viewer::start(&[text(&log)]);
        let (mut page, facts) = viewer.connect_with_facts();
        page.send("look", looks(panes));
        page.update_of(0.0);
        page.send("time", json!({"time_s": time_s}));
        let state = page.update_of(time_s).state;
        (state["badge"].as_str().unwrap().to_owned(), state, facts)
    };
    let all = ["front", "front_left"].map(|name| named(0, name, [96, 54]));
    let (same, state, facts) = badge(&all, 1.0);
    assert_eq!(same, "exact, same bits as the log");
    let log_facts = &facts["change"]["sources"][0]["log"];
    assert_eq!(log_facts["planner"], "constant-velocity");
    assert_eq!(log_facts["departs_s"], Value::Null);
    assert!(!facts["sources"][0]["lanes"].as_array().unwrap().is_empty());
    let speeds = log_facts["speed_mps"].as_array().unwrap();
    assert_eq!(
        speeds.len(),
        log_facts["time_to_collision_s"].as_array().unwrap().len()
    );
    let report = fs::read(out.join("report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let scored = &report["episodes"][0]["driving_score"];
    assert_eq!(&log_facts["score"]["driving_score"], scored);
    // The plan starts below the middle of the ego's box and goes ahead.
    let plan = state["sources"][0]["plan"].as_array().unwrap();
    let ego = &state["sources"][0]["ego"]["position_m"];
    assert!(
        plan.len() > 2 && plan[0][0] == ego[0] && plan[0][1] == ego[1],
        "{plan:?} {ego}"
    );

    // Between steps, at another size or without agents there is nothing to compare.
    assert_eq!(badge(&all, 1.1).0, "exact");
    assert_eq!(badge(&[named(0, "front", [48, 27])], 1.0).0, "exact");
    let mut bare = all[0].clone();
    bare["agents"] = false.into();
    assert_eq!(badge(&[bare], 1.0).0, "exact");

    let file = fs::read_to_string(&scene).unwrap();
    fs::write(
        &scene,
        file.replacen(r#"name = "default""#, r#"name = "inria""#, 1),
    )
    .unwrap();
    assert_eq!(badge(&all, 1.0).0, "exact, other bits than the log");
    assert!(fail(1, &["view", text(&log), "--time", "1"]).contains("leave out"));
    assert!(fail(1, &["view", text(&scene), "--base", "."]).contains("--base"));
}

/// A planner that drives while a page looks drives as it does in `drive`: the same log, byte by
/// byte.
#[test]
fn a_live_episode_is_that_of_drive() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let place = ["drive", "--background", "3000", "--agent-splats", "200"];
    let what = ["--level", "extreme", "--episodes", "1", "--size", "64x36"];
    let how = ["--planner", "constant-velocity", "--out", text(&out)];
    succeed(&[&place[..], &what, &how].concat());
    let log = out.join("logs/extreme_0000.log");
    let scenario = out.join("scenarios/extreme_0000.toml");
    // Its files are relative to the folder that `drive` was started in: it has none.
    let live = ["--size", "64x36", "--against", text(&log)];
    let planner = ["--planner", "constant-velocity"];
    let viewer = Viewer::start_in(
        folder.path(),
        &[&[text(&scenario)], &planner[..], &live].concat(),
    );
    let (mut page, facts) = viewer.connect_with_facts();
    assert_eq!(facts["change"]["sources"][0]["log"]["goes_on"], true);
    let mut other = named(32, "front", [64, 36]);
    other["source"] = 1.into();
    let both = [named(0, "front", [64, 36]), other];
    page.look(&both);
    let unfinished = page.ask("save_log", json!({"file": "live.log"}));
    assert!(unfinished.unwrap_err().contains("goes on"));
    // Steps at the end drive on.
    page.ask("step", json!({"by": 1})).unwrap();
    let second = page.look(&both);
    let time_s = second.state["time_s"].as_f64().unwrap();
    assert!((time_s - 0.5).abs() < 1e-9, "{time_s}");
    assert!(second.rgb(folder.path(), 0) == second.rgb(folder.path(), 1));
    page.ask("step", json!({"by": -1})).unwrap();
    let first = page.look(&both);
    assert_eq!(first.state["badge"], "exact, same bits as the log");
    // Playing drives to the end.
    page.ask(
        "play",
        json!({"playing": true, "speed": 10.0, "looping": false}),
    )
    .unwrap();
    let change = loop {
        let Message::Text(text) = page.socket.read().unwrap() else {
            continue;
        };
        let message: Value = serde_json::from_str(&text).unwrap();
        if message["type"] == "frame" {
            page.send("shown", json!({"update": message["update"]}));
        }
        if message["type"] == "change" && message["sources"][0]["log"]["goes_on"] == false {
            break message;
        }
    };
    assert_eq!(change["parts_s"], Value::Null);
    let [live, driven] = [0, 1].map(|index| &change["sources"][index]["log"]["score"]);
    assert_eq!(live, driven);
    page.ask("save_log", json!({"file": "live.log"})).unwrap();
    assert!(fs::read(folder.path().join("live.log")).unwrap() == fs::read(&log).unwrap());
    assert!(
        page.ask("save_log", json!({"file": "live.log"}))
            .unwrap_err()
            .contains("exists")
    );
    let edit = page.ask("edit", json!({"edit": "remove", "agent": "lead"}));
    assert!(edit.unwrap_err().contains("not edited"));
    drop(viewer);

    // Another planner parts from the log at some moment, which the page is told.
    let viewer = Viewer::start(&[text(&log), "--against", "lane-follow"]);
    let (_, facts) = viewer.connect_with_facts();
    let parts_s = facts["change"]["parts_s"].as_f64().unwrap();
    assert!(parts_s > 0.0 && parts_s < 5.0, "{parts_s}");
    assert!(fail(1, &["view", text(&log), "--against", "nowhere"]).contains("--against"));
    assert!(fail(1, &["view", text(&log), "--planner", "vision"]).contains("--against"));
}
