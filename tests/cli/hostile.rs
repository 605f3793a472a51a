//! Files and surroundings that once broke the program: each ends with a sentence, soon, and nothing
//! is lost.

use std::path::PathBuf;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::*;

/// A file that broke the program, beside the public test files. None, with a word of it, where they
/// are missing.
fn reproduction(name: &str) -> Option<PathBuf> {
    data::file(
        &format!("the reproduction {name}"),
        &format!("../repro/{name}"),
    )
}

/// Runs the program with 1 GB of address space beyond what it maps at the start; exit status,
/// standard error and seconds.
fn bounded(arguments: &[&str]) -> (Option<i32>, String, f64) {
    let since = Instant::now();
    let limited = "ulimit -v 2500000; exec \"$0\" \"$@\"";
    let output = Command::new("sh")
        .args(["-c", limited, env!("CARGO_BIN_EXE_decouplegs")])
        .args(arguments)
        .output()
        .unwrap();
    (
        output.status.code(),
        String::from_utf8_lossy(&output.stderr).into_owned(),
        since.elapsed().as_secs_f64(),
    )
}

#[test]
fn files_that_broke_the_program_are_errors_within_two_seconds() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.ply");
    let checkpoints = [
        "ds_0frames_2e30.pth",
        "ds_0frames_2e60.pth",
        "ds_0frames_2e63.pth",
        "ds_ids_zero_dims.pth",
        "gs_opac_overflow.pt",
        "sg_terms_2e26.pth",
        "sg_terms_2e60.pth",
    ];
    let mut cases: Vec<(PathBuf, Vec<String>)> = Vec::new();
    let words = |words: &[&str]| {
        words
            .iter()
            .map(|&word| word.to_owned())
            .collect::<Vec<_>>()
    };
    for name in checkpoints {
        let Some(path) = reproduction(name) else {
            continue;
        };
        cases.push((path.clone(), words(&["convert", text(&path), text(&out)])));
        if !name.starts_with("gs_") {
            // With actors, it would become a folder.
            cases.push((
                path.clone(),
                words(&["convert", text(&path), text(&folder.path().join("scene"))]),
            ));
        }
        cases.push((path.clone(), words(&["inspect", text(&path)])));
    }
    for name in ["xml_attrs_100k.xodr", "xml_ns_nested.xodr"] {
        let Some(path) = reproduction(name) else {
            continue;
        };
        cases.push((path.clone(), words(&["map", text(&path)])));
    }
    if let Some(path) = reproduction("png_bomb_1bit_16k.png") {
        cases.push((path.clone(), words(&["compare", text(&path), text(&path)])));
    }
    if let Some(path) = reproduction("concurrent_drive_corrupt.log") {
        cases.push((path.clone(), words(&["score", text(&path)])));
    }
    for (path, arguments) in cases {
        let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
        let (code, said, seconds) = bounded(&arguments);
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        assert!(
            code == Some(1) && said.contains(&name),
            "{arguments:?}: {code:?}, {said}"
        );
        // Two seconds on a free processor; tests run beside others.
        assert!(seconds < 30.0, "{arguments:?} took {seconds:.1} s");
        assert!(!out.exists() && !folder.path().join("scene").exists());
    }
}

#[test]
fn what_is_no_file_is_refused_and_what_is_no_file_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (scene, fifo) = (
        folder.path().join("device.toml"),
        folder.path().join("fifo.ply"),
    );
    assert!(
        Command::new("mkfifo")
            .arg(&fifo)
            .status()
            .unwrap()
            .success()
    );
    for background in ["/dev/zero", text(&fifo)] {
        fs::write(
            &scene,
            format!("version = 1\nbackground = {background:?}\n"),
        )
        .unwrap();
        assert!(fail(1, &["inspect", text(&scene)]).contains("regular file"));
    }
    let lanes = folder.path().join("lanes.json");
    succeed(&["map", text(&lanes), "--svg", "/dev/null"]);
    assert!(
        !fs::metadata("/dev/null").unwrap().is_file(),
        "/dev/null is still a device"
    );
    let world = folder.path().join("world.ply");
    assert!(
        succeed(&["convert", text(&world), "/dev/null", "--to", "spz"]).contains("not read back")
    );
    assert!(fail(1, &["inspect", "/no\u{1b}[2Jsuch.ply"]).contains("/no\\u{1b}[2Jsuch.ply"));
}

#[test]
fn what_the_memory_cannot_hold_is_a_sentence() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let (many, out) = (folder.path().join("many.toml"), folder.path().join("out"));
    let agent = |at: usize| {
        format!(
            "[[agent]]\nname = \"a{at}\"\nasset = \"world.ply\"\nposition_m = [{at}.0, 0.0, 0.0]\n"
        )
    };
    let agents: String = (0..60_000).map(agent).collect();
    fs::write(
        &many,
        format!("version = 1\nbackground = \"background.ply\"\n{agents}"),
    )
    .unwrap();
    let huge = ["--size", "65536x65536", "--reference"];
    let scene = folder.path().join("scene.toml");
    let cases: [Vec<&str>; 4] = [
        vec!["inspect", text(&many)],
        [&["render", text(&scene), "--out", text(&out)][..], &huge].concat(),
        vec![
            "synth",
            "street",
            "--background",
            "1000000000000",
            "--out",
            text(&out),
        ],
        vec![
            "synth",
            "street",
            "--agents",
            "60000",
            "--agent-splats",
            "9223372036854775807",
            "--out",
            text(&out),
        ],
    ];
    for arguments in cases {
        let (code, said, seconds) = bounded(&arguments);
        assert!(
            code == Some(1) && said.contains("memory") || said.contains("more than"),
            "{arguments:?}: {code:?} {said}"
        );
        assert!(
            seconds < 60.0 && !out.exists(),
            "{arguments:?} took {seconds:.1} s"
        );
    }
}

/// Waits until `holds`, for at most `seconds`.
fn soon(seconds: u64, holds: impl Fn() -> bool) -> bool {
    let since = Instant::now();
    while since.elapsed() < Duration::from_secs(seconds) {
        if holds() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    false
}

/// A run whose planner `command` writes its process number to `number` in the folder and hangs, and
/// that number.
fn hanging(folder: &Path, command: &str) -> (Child, String) {
    let number = folder.join("number");
    let run = [
        "drive",
        "--level",
        "easy",
        "--episodes",
        "1",
        "--render",
        "off",
        "--planner-timeout",
        "600",
    ];
    let child = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
        .args(run)
        .args([
            "--planner",
            &format!("exec:{command}"),
            "--out",
            text(&folder.join("run")),
        ])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    assert!(soon(60, || number.exists()), "the planner is started");
    let number = fs::read_to_string(number).unwrap().trim().to_owned();
    (child, number)
}

fn is_alive(process: &str) -> bool {
    Path::new("/proc").join(process).exists()
}

#[test]
fn a_planner_dies_with_the_run_however_that_ends() {
    for signal in ["KILL", "TERM", "INT", "HUP"] {
        let folder = tempfile::tempdir().unwrap();
        let script = folder.path().join("hang.sh");
        fs::write(
            &script,
            "echo $$ > $1.part; mv $1.part $1; sleep 1000 & wait\n",
        )
        .unwrap();
        let number = folder.path().join("number");
        let (mut run, planner) = hanging(
            folder.path(),
            &format!("sh {} {}", text(&script), text(&number)),
        );
        assert!(is_alive(&planner));
        assert!(
            Command::new("kill")
                .args(["-s", signal, &run.id().to_string()])
                .status()
                .unwrap()
                .success()
        );
        run.wait().unwrap();
        assert!(
            soon(60, || !is_alive(&planner)),
            "the planner outlives SIG{signal}"
        );
    }
}

#[test]
fn a_second_run_in_the_same_folder_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    // Its planner answers when it is asked for its name, and hangs when it is asked for a plan: the
    // run has begun.
    let script = folder.path().join("hang.py");
    let (client, number) = (
        concat!(env!("CARGO_MANIFEST_DIR"), "/planner_client"),
        text(&folder.path().join("number")).to_owned(),
    );
    let planner = format!(
        "import os, sys, time\nsys.path.insert(0, {client:?})\nimport decouplegs_planner\n\nclass Hangs(decouplegs_planner.Planner):\n    \
         name = 'hangs'\n    def plan(self, observation):\n        open({number:?} + '.part', 'w').write(str(os.getpid()))\n        \
         os.rename({number:?} + '.part', {number:?})\n        time.sleep(1000)\n\ndecouplegs_planner.run(Hangs)\n"
    );
    fs::write(&script, planner).unwrap();
    let (mut first, planner) = hanging(folder.path(), &format!("python3 {}", text(&script)));
    let again = [
        "drive",
        "--level",
        "easy",
        "--episodes",
        "1",
        "--render",
        "off",
        "--planner",
        "constant-velocity",
    ];
    let said = fail(
        1,
        &[&again[..], &["--out", text(&folder.path().join("run"))]].concat(),
    );
    assert!(
        said.contains("in use") && said.contains(&first.id().to_string()),
        "{said}"
    );
    first.kill().unwrap();
    first.wait().unwrap();
    assert!(soon(60, || !is_alive(&planner)));
}

#[test]
fn a_damaged_log_is_kept_aside_and_driven_again() {
    let folder = tempfile::tempdir().unwrap();
    let run = [
        "drive",
        "--level",
        "easy",
        "--episodes",
        "1",
        "--render",
        "off",
        "--planner",
        "constant-velocity",
    ];
    let command = [&run[..], &["--out", text(folder.path())]].concat();
    succeed(&command);
    let log = folder.path().join("logs/easy_0000.log");
    let whole = fs::read(&log).unwrap();
    fs::write(&log, &whole[..whole.len() / 2]).unwrap();
    let output = decouplegs(&command);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.success() && said.contains("driven again"),
        "{said}"
    );
    assert_eq!(fs::read(&log).unwrap(), whole);
    assert_eq!(
        fs::read(log.with_extension("log.damaged")).unwrap(),
        whole[..whole.len() / 2]
    );
}
