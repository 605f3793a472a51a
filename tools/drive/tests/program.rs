//! The program by itself: users meet it through `decouplegs`, as `tests/cli` does.

#[path = "program/agents.rs"]
mod agents;
#[path = "program/egos.rs"]
mod egos;
#[path = "program/tracks.rs"]
mod tracks;

use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_decouplegs-drive"));
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
            &["drive", "--nonsense"] as &[&str],
            "Usage: decouplegs-drive",
        ),
        (1, &["score", "absent.log"], "error: cannot read absent.log"),
    ] {
        let output = run(arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(says) && output.stdout.is_empty(), "{said}");
    }
}
