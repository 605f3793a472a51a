//! Mistakes that people make: each gets a sentence that says what to do, and loses nothing.

use super::*;

/// Runs each of `mistakes` in `folder`: a command line, the exit code and a part of the error that
/// are expected.
fn assert_refused(folder: &Path, mistakes: &[(&str, i32, &str)]) {
    for (line, code, part) in mistakes {
        let words: Vec<&str> = line.split(' ').collect();
        let run = Command::new(env!("CARGO_BIN_EXE_decouplegs"))
            .args(&words)
            .current_dir(folder)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&run.stderr);
        assert_eq!(run.status.code(), Some(*code), "{line}: {said}");
        assert!(said.contains(part), "{line}: {said}");
    }
}

#[test]
fn files_and_folders_of_another_kind_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    small_street(folder.path());
    fs::create_dir(at("street")).unwrap();
    fs::write(at("afile"), "\n").unwrap();
    fs::write(
        at("packed.ply"),
        b"ply\nformat binary_little_endian 1.0\n\xff\xfe",
    )
    .unwrap();
    assert_refused(
        folder.path(),
        &[
            (
                "inspect street",
                1,
                "street: it is a folder with neither a meta.json nor a point_cloud",
            ),
            (
                "convert scene.toml x.ply",
                1,
                "whose splats are in the files that it names",
            ),
            (
                "edit packed.ply --remove car --out e.toml",
                1,
                "expected a TOML file, which is text",
            ),
            (
                "drive packed.ply --planner lane-follow --out d",
                1,
                "expected a TOML file, which is text",
            ),
            (
                "lidar scene.toml --sensor afile --out sweeps",
                1,
                "line 1, the file: missing field `name`",
            ),
            (
                "drive --level easy --planner lane-follow --out afile",
                1,
                "afile is a file; expected the name of a folder",
            ),
            (
                "drive --level easy --planner lane-follow --scene none.toml --out d",
                1,
                "cannot read none.toml",
            ),
            (
                "drive --tracks none.csv --planner lane-follow --out d",
                1,
                "cannot read none.csv",
            ),
            (
                "realism traffic --tracks none.csv --out gap",
                1,
                "cannot read none.csv",
            ),
            (
                "drive --planner lane-follow --out d",
                2,
                "<SCENARIO|--level <LEVEL>|--follow-recording|--tracks <FILE>>",
            ),
        ],
    );
    assert!(!at("d").exists());
    assert_eq!(fs::read_to_string(at("afile")).unwrap(), "\n");
}

#[test]
fn numbers_are_refused_with_what_is_expected() {
    let folder = tempfile::tempdir().unwrap();
    assert_refused(
        folder.path(),
        &[
            ("view a.ply --port -1", 2, "-1 is not in 0..=65535"),
            ("view a.ply --browser-splats -1", 2, "invalid value '-1'"),
            (
                "compare a.png b.png --difference c.png --gain -1",
                2,
                "invalid value '-1'",
            ),
            (
                "synth street --background -5 --out s",
                2,
                "expected a whole number, 0 or above, found \"-5\"",
            ),
            (
                "synth street --seed x --out s",
                2,
                "expected a whole number",
            ),
            ("bench a.ply --in-flight x", 2, "expected a whole number"),
            ("conform --target a:1 --request-timeout x", 2, "expected"),
        ],
    );
}

#[test]
fn no_output_takes_the_place_of_an_input_or_of_another_output() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    small_street(folder.path());
    let scene = at("scene.toml");
    let draw = [
        "render",
        text(&scene),
        "--size",
        "8x8",
        "--format",
        "npy",
        "--out",
    ];
    let drawn = succeed(&[&draw[..], &[text(&at("out"))]].concat());
    let first = Path::new(drawn.lines().next().unwrap());
    for name in ["a.npy", "b.npy"] {
        fs::copy(first, at(name)).unwrap();
    }
    let before = fs::read(at("b.npy")).unwrap();
    assert_refused(
        folder.path(),
        &[
            (
                "compare a.npy b.npy --difference b.npy",
                1,
                "b.npy is read and would be replaced",
            ),
            (
                "compare a.npy b.npy --force --difference b.npy",
                1,
                "b.npy is read and would be replaced",
            ),
            (
                "compare a.npy b.npy --difference world.ply",
                1,
                "must end with .png",
            ),
            (
                "compare a.npy b.npy --difference none/c.png",
                1,
                "there is no folder none",
            ),
            (
                "convert world.ply w.spz --report ./w.spz",
                1,
                "named for two outputs",
            ),
            (
                "transform world.ply w.spz --scale 2 --report w.spz",
                1,
                "named for two outputs",
            ),
        ],
    );
    assert_eq!(fs::read(at("b.npy")).unwrap(), before);
    assert!(!at("w.spz").exists());
    let first = first.file_stem().unwrap().display();
    let twice = format!("render scene.toml --size 8x8 --out new --contact-sheet new/{first}.png");
    assert_refused(
        folder.path(),
        &[(twice.as_str(), 1, "named for two outputs")],
    );
    assert!(!at("new").exists());
    succeed(&[
        "compare",
        text(&at("a.npy")),
        text(&at("b.npy")),
        "--difference",
        text(&at("c.png")),
    ]);
    let again = "compare a.npy b.npy --difference c.png";
    assert_refused(folder.path(), &[(again, 1, "c.png exists already")]);
}

#[test]
fn a_run_that_could_not_begin_keeps_nobody_from_another_one() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("bad.toml"), "version = 1\nsede = 1\n").unwrap();
    assert_refused(
        folder.path(),
        &[
            (
                "drive bad.toml --planner lane-follow --render off --out run",
                1,
                "bad.toml",
            ),
            (
                "drive bad.toml --planner constant-velocity --render off --out run",
                1,
                "bad.toml",
            ),
        ],
    );
    assert!(!folder.path().join("run").exists());
}
