//! The program by itself: users meet it through `decouplegs`, as `tests/cli` does.

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_decouplegs-view"));
    program
        .args(arguments)
        .output()
        .expect("the program starts")
}

#[test]
fn exit_codes_tell_an_error_from_a_command_line_without_sense() {
    for (code, arguments, says) in [
        (
            2,
            &["view", "--nonsense"] as &[&str],
            "Usage: decouplegs-view",
        ),
        (
            1,
            &["view", "--address", "0.0.0.0", "--no-token"],
            "error: 0.0.0.0",
        ),
        (
            2,
            &["view", "--export", "a.html", "--port", "1"],
            "cannot be used with",
        ),
        (2, &["view", "--export", "a.png"], "ends in .html"),
        (2, &["view", "--force"], "--export"),
        (
            2,
            &["view", "--export", "a.html", "--browser-splats", "0"],
            "at least 1",
        ),
    ] {
        let output = run(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(says) && output.stdout.is_empty(), "{said}");
    }
}
