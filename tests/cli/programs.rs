//! Subcommands that are programs of their own.

use std::io::Write;
use std::os::unix::fs::symlink;
use std::process::Stdio;

use super::*;

/// Runs `program`, which finds others in the folders of `path`, with "in" on standard input.
fn run(program: &Path, path: &Path, arguments: &[&str]) -> Output {
    let mut child = Command::new(program)
        .args(arguments)
        .env("PATH", path)
        .current_dir(path)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut stdin = child.stdin.take().expect("it is piped");
    // The program may end before it reads.
    let _ = stdin.write_all(b"in");
    drop(stdin);
    child.wait_with_output().expect("it ends")
}

#[test]
fn a_program_is_found_beside_this_one_then_on_the_path_and_takes_its_place() {
    // A link to a program needs its file system.
    let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
    let [beside, path] = ["beside", "path"].map(|name| folder.path().join(name));
    for folder in [&beside, &path] {
        fs::create_dir(folder).unwrap();
    }
    let program = beside.join("decouplegs");
    fs::hard_link(env!("CARGO_BIN_EXE_decouplegs"), &program).unwrap();

    let output = run(&program, &path, &["view", "--port", "0"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    for part in [
        "'decouplegs view'",
        "decouplegs-view",
        "'make install'",
        text(&beside),
    ] {
        assert!(said.contains(part), "{part}: {said}");
    }

    // A shell in place of the viewer: it runs the file `view`, its first argument.
    let shell = Path::new("/bin/sh").canonicalize().unwrap();
    symlink(&shell, path.join("decouplegs-view")).unwrap();
    fs::write(
        path.join("view"),
        "read word; echo \"$word $*\"; echo err >&2; exit 7",
    )
    .unwrap();
    let output = run(&program, &path, &["view", "--port", "0"]);
    assert_eq!(
        (output.status.code(), &output.stdout[..], &output.stderr[..]),
        (Some(7), &b"in --port 0\n"[..], &b"err\n"[..])
    );

    // One that always ends well, beside the program: it comes first.
    let well = ["/bin/true", "/usr/bin/true"].map(Path::new).into_iter();
    let well = well
        .filter_map(|file| file.canonicalize().ok())
        .next()
        .unwrap();
    symlink(well, beside.join("decouplegs-view")).unwrap();
    let output = run(&program, &path, &["view", "--port", "0"]);
    assert_eq!((output.status.code(), output.stdout.len()), (Some(0), 0));
}

#[test]
fn help_lists_all_subcommands_and_each_helps_in_the_name_of_decouplegs() {
    let help = succeed(&["--help"]);
    for name in [
        "render",
        "inspect",
        "convert",
        "transform",
        "decompress",
        "compress",
        "compare",
        "synth",
        "devices",
        "lidar",
        "edit",
        "pack",
        "map",
        "register",
        "calibrate-light",
        "drive",
        "replay",
        "open-loop",
        "score",
        "export",
        "view",
        "conform",
        "bench",
        "stress",
        "ablate",
    ] {
        assert!(
            help.lines().any(|line| line.trim_start().starts_with(name)),
            "{name}: {help}"
        );
        let own = succeed(&[name, "--help"]);
        assert!(own.contains(&format!("Usage: decouplegs {name}")), "{own}");
        assert_eq!(own, succeed(&["help", name]));
    }
}
