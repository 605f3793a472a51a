//! The time that the viewer shows first, and the commands of reports that give it.

use super::*;

/// Texts between `<code class="command">` and `</code>`.
fn commands(page: &str) -> Vec<String> {
    let parts = page.split("<code class=\"command\">").skip(1);
    let texts = parts.map(|part| part.split("</code>").next().unwrap_or_default());
    texts.map(|text| text.replace("&quot;", "\"")).collect()
}

/// Words of a command, as a shell reads them.
fn words(command: &str) -> Vec<String> {
    let script = format!("printf '%s\\n' {command}");
    let output = Command::new("sh").args(["-c", &script]).output().unwrap();
    let lines = String::from_utf8(output.stdout).unwrap();
    lines.lines().map(str::to_owned).collect()
}

#[test]
fn a_report_has_commands_that_open_the_viewer_at_the_time_of_an_infraction() {
    let folder = tempfile::tempdir().unwrap();
    let place = ["drive", "--background", "3000", "--agent-splats", "200"];
    let what = ["--level", "hard", "--episodes", "1", "--seed", "3"];
    let how = ["--planner", "constant-velocity", "--size", "64x36"];
    let out = ["--out", "my run"];
    let driven = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
        .args([&place[..], &what, &how, &out].concat())
        .current_dir(folder.path())
        .output()
        .unwrap();
    assert!(driven.status.success(), "{driven:?}");
    let page = fs::read_to_string(folder.path().join("my run/report.html")).unwrap();
    let report = fs::read(folder.path().join("my run/report.json")).unwrap();
    let report: Value = serde_json::from_slice(&report).unwrap();
    let infractions = report["episodes"][0]["infractions"].as_array().unwrap();
    let commands = commands(&page);
    assert!(!infractions.is_empty());
    assert_eq!(commands.len(), 1 + infractions.len(), "{commands:?}");
    assert_eq!(commands[0], "decouplegs view 'my run/logs/hard_0000.log'");
    let crash_s = infractions[0]["time_s"].as_f64().unwrap();
    let words = words(&commands[1]);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    assert_eq!(words[..2], ["decouplegs", "view"]);
    assert_eq!(words[3], "--time");
    let viewer = Viewer::start_in(folder.path(), &words[2..]);
    let (mut page, facts) = viewer.connect_with_facts();
    let first_s = facts["clock"]["time_s"].as_f64().unwrap();
    assert!((first_s - crash_s).abs() < 1e-3 && first_s > 0.0, "{facts}");
    let state = page.look(&[named(0, "front", [64, 36])]).state;
    assert_eq!(state["time_s"], facts["clock"]["time_s"]);
    // What was before is still there.
    page.ask("time", json!({"time_s": 0.0})).unwrap();
    assert_eq!(
        page.look(&[named(0, "front", [64, 36])]).state["time_s"],
        0.0
    );
    drop((page, viewer));

    let log = folder.path().join("my run/logs/hard_0000.log");
    let late = fail(1, &["view", text(&log), "--time", "1000", "--port", "0"]);
    assert!(
        late.contains("--time 1000") && late.contains("between"),
        "{late}"
    );
    // A scenario is driven until then.
    let scenario = folder.path().join("my run/scenarios/hard_0000.toml");
    let live = [text(&scenario), "--size", "64x36", "--time", "1"];
    let viewer = Viewer::start_in(folder.path(), &live);
    let (_, facts) = viewer.connect_with_facts();
    assert_eq!(facts["clock"]["time_s"], 1.0);
    let log = &facts["change"]["sources"][0]["log"];
    assert_eq!(log["goes_on"], true);
}

#[test]
fn a_scene_is_shown_from_a_time_on_and_splats_have_none() {
    let folder = tempfile::tempdir().unwrap();
    coded_street(folder.path());
    let scene = folder.path().join("scene.toml");
    let from_start = Viewer::start(&[text(&scene)]).connect_with_facts().1;
    let span_s = &from_start["change"]["span_s"];
    assert_eq!(from_start["clock"]["time_s"], 0.0);
    let viewer = Viewer::start(&[text(&scene), "--time", "0.7"]);
    let (mut page, facts) = viewer.connect_with_facts();
    assert_eq!(facts["clock"]["time_s"], 0.7);
    assert_eq!(&facts["change"]["span_s"], span_s);
    let out = folder.path().join("later");
    let what = [
        "render",
        text(&scene),
        "--time",
        "0.7",
        "--cameras",
        "front",
    ];
    succeed(&[&what[..], &["--out", text(&out)]].concat());
    let rendered = rgb_of(&out.join("front.png"));
    let later = page.look(&[named(0, "front", [4096, 4096])]);
    assert!(later.rgb(folder.path(), 0) == rendered);
    page.ask("time", json!({"time_s": 0.0})).unwrap();
    let first = page.look(&[named(0, "front", [4096, 4096])]);
    assert!(first.rgb(folder.path(), 0) != rendered);
    drop((page, viewer));

    let splats = folder.path().join("background.ply");
    let none = fail(1, &["view", text(&splats), "--time", "1", "--port", "0"]);
    assert!(none.contains("leave out --time"), "{none}");
    assert!(fail(2, &["view", text(&scene), "--time", "soon"]).contains("--time"));
}
