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
    let kept = ["--render", "2", "--out", text(&out)];
    succeed(&[&place[..], &what, &how, &kept].concat());
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
    // The plan starts below the middle of the ego's box, which the ground tilts, and goes ahead.
    let plan = state["sources"][0]["plan"].as_array().unwrap();
    let ego = &state["sources"][0]["ego"]["position_m"];
    let coordinate = |at: &Value, axis: usize| at[axis].as_f64().unwrap();
    for axis in [0, 1] {
        let by_m = coordinate(&plan[0], axis) - coordinate(ego, axis);
        assert!(by_m.abs() < 0.02, "{by_m}");
    }
    assert!(plan.len() > 2 && coordinate(&plan[2], 0) > coordinate(&plan[0], 0));

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
    assert!(fail(1, &["view", text(&log), "--antialias"]).contains("leave out"));
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
    let change = play_to_the_end(&mut page);
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
    drop(viewer);

    // Facts name the moment at which another planner departs from the log.
    let viewer = Viewer::start(&[text(&log), "--against", "lane-follow"]);
    let (mut page, facts) = viewer.connect_with_facts();
    let edit = page.ask("edit", json!({"edit": "remove", "agent": "lead"}));
    assert!(edit.unwrap_err().contains("not edited"));
    let parts_s = facts["change"]["parts_s"].as_f64().unwrap();
    assert!(parts_s > 0.0 && parts_s < 5.0, "{parts_s}");
    assert!(fail(1, &["view", text(&log), "--against", "nowhere"]).contains("--against"));
    assert!(fail(1, &["view", text(&log), "--planner", "vision"]).contains("--against"));
}

/// Plays a live episode, which drives it. What changed last.
fn play_to_the_end(page: &mut Page) -> Value {
    let play = json!({"playing": true, "speed": 10.0, "looping": false});
    page.ask("play", play).unwrap();
    loop {
        let Message::Text(text) = page.socket.read().unwrap() else {
            continue;
        };
        let message: Value = serde_json::from_str(&text).unwrap();
        if message["type"] == "frame" {
            page.send("shown", json!({"update": message["update"]}));
        }
        if message["type"] == "change" && message["sources"][0]["log"]["goes_on"] == false {
            return message;
        }
    }
}

/// A scenario that is edited begins anew, and is saved as what was driven.
#[test]
fn an_edited_scenario_is_driven_as_it_is_saved() {
    let folder = tempfile::tempdir().unwrap();
    let place = ["drive", "--background", "3000", "--agent-splats", "200"];
    let what = ["--level", "hard", "--episodes", "1", "--size", "64x36"];
    let how = ["--planner", "lane-follow", "--render", "off"];
    let out = folder.path().join("run");
    succeed(&[&place[..], &what, &how, &["--out", text(&out)]].concat());
    let scenario = out.join("scenarios/hard_0000.toml");
    let viewer = Viewer::start_in(folder.path(), &[text(&scenario), "--size", "64x36"]);
    let mut page = viewer.connect();
    let pane = [named(0, "front", [64, 36])];
    let agents = |update: &Update| update.state["sources"][0]["agents"].clone();
    let place_of = |update: &Update, name: &str| -> Option<Vec<f64>> {
        let agents = agents(update);
        let agent = agents
            .as_array()?
            .iter()
            .find(|agent| agent["name"] == name)?;
        let at = agent["pose"]["position_m"].as_array()?;
        Some(at.iter().map(|x| x.as_f64().unwrap()).collect())
    };
    let start = page.look(&pane);
    let names: Vec<String> = (agents(&start).as_array().unwrap().iter())
        .map(|agent| agent["name"].as_str().unwrap().to_owned())
        .filter(|name| name.starts_with("car"))
        .collect();
    page.ask("step", json!({"by": 1})).unwrap();
    page.ask("edit", json!({"edit": "remove", "agent": names[0]}))
        .unwrap();
    let shift = |forward_m: f64| json!({"edit": "shift", "agent": names[1], "later_s": 0.0, "forward_m": forward_m, "left_m": 0.0});
    page.ask("edit", shift(1.5)).unwrap();
    let edited = page.look(&pane);
    assert_eq!(edited.state["time_s"], 0.0, "it begins anew");
    assert!(place_of(&edited, &names[0]).is_none());
    let [from, to] = [&start, &edited].map(|update| place_of(update, &names[1]).unwrap());
    let by_m = (to[0] - from[0]).hypot(to[1] - from[1]);
    assert!((by_m - 1.5).abs() < 0.01, "{by_m}");

    for (fields, word) in [
        (
            json!({"edit": "turn", "agent": names[1], "by_rad": 0.1}),
            "lanes",
        ),
        (json!({"edit": "remove", "agent": "nobody"}), "nobody"),
        (json!({"edit": "save", "file": "hard_0000.toml"}), "exists"),
        // Off its lane.
        (shift(5000.0), "hard_0000-edited"),
    ] {
        let error = page.ask("edit", fields).unwrap_err();
        assert!(error.contains(word), "{error}");
    }
    assert!(page.look(&pane).rgb(folder.path(), 0) == edited.rgb(folder.path(), 0));

    page.ask(
        "edit",
        json!({"edit": "save", "file": "hard_0000-edited.toml"}),
    )
    .unwrap();
    play_to_the_end(&mut page);
    page.ask("save_log", json!({"file": "live.log"})).unwrap();
    let saved = out.join("scenarios/hard_0000-edited.toml");
    let again = folder.path().join("again");
    let drive = [
        "drive",
        text(&saved),
        "--size",
        "64x36",
        "--planner",
        "lane-follow",
    ];
    succeed(&[&drive[..], &["--out", text(&again)]].concat());
    let log = fs::read(again.join("logs/hard_0000-edited.log")).unwrap();
    assert!(log == fs::read(folder.path().join("live.log")).unwrap());

    page.ask("edit", json!({"edit": "undo"})).unwrap();
    page.ask("edit", json!({"edit": "undo"})).unwrap();
    let undone = page.look(&pane);
    assert!(undone.rgb(folder.path(), 0) == start.rgb(folder.path(), 0));
    assert_eq!(agents(&undone), agents(&start));
}

/// A planner that does not answer does not hold up the end of the viewer, nor do steps that wait.
#[test]
fn the_first_ctrl_c_ends_a_viewer_whose_planner_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let place = ["drive", "--background", "3000", "--agent-splats", "200"];
    let what = ["--level", "easy", "--episodes", "1", "--size", "64x36"];
    let how = ["--planner", "constant-velocity", "--render", "off"];
    let out = folder.path().join("run");
    succeed(&[&place[..], &what, &how, &["--out", text(&out)]].concat());
    let script = folder.path().join("planner.sh");
    let id = folder.path().join("id");
    let says =
        r#"{"type":"hello","protocol":1,"name":"hangs","cameras":"none","privileged":false}"#;
    let lines = format!(
        "echo $$ > {}\nread -r line; echo '{says}'\nread -r line; echo '{{\"type\":\"ready\"}}'\nexec sleep 600\n",
        text(&id)
    );
    fs::write(&script, lines).unwrap();
    let scenario = out.join("scenarios/easy_0000.toml");
    let exec = format!("exec:sh {}", text(&script));
    let planner = [text(&scenario), "--size", "64x36", "--planner", &exec];
    let viewer = Viewer::start_in(folder.path(), &planner);
    let mut page = viewer.connect();
    // A planner is given ten seconds for each.
    for _ in 0..3 {
        page.send("step", json!({"by": 1}));
    }
    std::thread::sleep(Duration::from_millis(500));
    // Meanwhile other commands are answered, before the steps.
    let steps = page.sequence;
    page.send("state", json!({}));
    let answered = loop {
        let message = page.text();
        if message["type"] == "ack" {
            break message;
        }
    };
    assert_eq!(answered["sequence"], steps + 1, "{answered}");
    assert_eq!(answered["result"]["time_s"], 0.0);
    let since = Instant::now();
    drop(viewer);
    let took = since.elapsed();
    assert!(took < Duration::from_secs(8), "{took:?}");
    let planner = fs::read_to_string(id).unwrap();
    let lives = || Path::new("/proc").join(planner.trim()).exists();
    while lives() {
        assert!(
            since.elapsed() < PATIENCE,
            "the planner outlives the viewer"
        );
        std::thread::sleep(Duration::from_millis(50));
    }
}
