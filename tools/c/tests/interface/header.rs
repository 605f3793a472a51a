//! The header is what the sources say, and compilers take it without a word.

use std::path::Path;
use std::{env, fs};

use crate::library::{FOLDER, run, succeed};

/// Sources in the order in which the header has them.
const SOURCES: [&str; 9] = [
    "status",
    "boundary",
    "types",
    "session",
    "scene",
    "world",
    "batch_renderer",
    "lidar",
    "rig",
];

/// The header of the sources as they are.
fn generated() -> String {
    let folder = Path::new(FOLDER);
    let config = cbindgen::Config::from_file(folder.join("cbindgen.toml"))
        .expect("cbindgen.toml can be read");
    let sources = SOURCES.map(|source| folder.join("src").join(source).with_extension("rs"));
    let builder = sources.into_iter().fold(
        cbindgen::Builder::new().with_config(config),
        cbindgen::Builder::with_src,
    );
    let mut text = Vec::new();
    builder
        .generate()
        .expect("the sources can be read")
        .write(&mut text);
    String::from_utf8(text).expect("a header is text")
}

#[test]
fn the_header_is_what_the_sources_say() {
    let path = Path::new(FOLDER).join("include/decouplegs.h");
    let generated = generated();
    if env::var("DECOUPLEGS_WRITE").is_ok_and(|value| value == "1") {
        fs::write(&path, &generated).expect("the header can be written");
    }
    let kept = fs::read_to_string(&path).expect("the header is there");
    let differs = kept
        .lines()
        .zip(generated.lines())
        .position(|(kept, generated)| kept != generated);
    assert!(
        kept == generated,
        "tools/c/include/decouplegs.h is not what the sources say, from line {} on. Write it anew:\n  \
         DECOUPLEGS_WRITE=1 cargo nextest run --workspace -E 'test(the_header_is_what_the_sources_say)'\n\
         and think of DGS_ABI_VERSION where a struct or function became another.",
        differs.unwrap_or(kept.lines().count().min(generated.lines().count())) + 1
    );
}

#[test]
fn every_function_is_in_the_header_and_explained() {
    let kept = fs::read_to_string(Path::new(FOLDER).join("include/decouplegs.h"))
        .expect("the header is there");
    let lines: Vec<&str> = kept.lines().collect();
    let mut functions = 0;
    for source in SOURCES {
        let text = fs::read_to_string(
            Path::new(FOLDER)
                .join("src")
                .join(source)
                .with_extension("rs"),
        )
        .unwrap();
        for line in text.lines() {
            let Some((_, rest)) = line.split_once("extern \"C\" fn ") else {
                continue;
            };
            let name = &rest[..rest.find('(').expect("a function has parameters")];
            // Comments name functions too.
            let declares = |line: &str| {
                line.contains(&format!("{name}(")) && !line.trim_start().starts_with(['*', '/'])
            };
            let at = lines
                .iter()
                .position(|line| declares(line))
                .unwrap_or_else(|| panic!("{name} is not in the header"));
            let above = lines[at - 1];
            assert!(
                above.trim_end().ends_with("*/"),
                "{name} has no comment above it, but {above:?}"
            );
            functions += 1;
        }
    }
    assert!(functions > 30, "only {functions} functions were found");
}

#[test]
fn compilers_take_the_header_without_a_word() {
    let folder = tempfile::tempdir().unwrap();
    let strict = [
        "-Wall",
        "-Wextra",
        "-Wpedantic",
        "-Werror",
        "-fsyntax-only",
        "-I",
    ];
    for (compiler, standard, name) in [
        ("cc", "-std=c99", "a.c"),
        ("cc", "-std=c11", "b.c"),
        ("c++", "-std=c++11", "a.cpp"),
        ("c++", "-std=c++20", "b.cpp"),
    ] {
        let source = folder.path().join(name);
        fs::write(&source, "#include \"decouplegs.h\"\n#include \"decouplegs.h\"\nint main() { return DGS_STATUS_OK; }\n")
            .unwrap();
        let include = Path::new(FOLDER).join("include");
        succeed(run(compiler, |command| {
            command.arg(standard).args(strict).args([&include, &source])
        }));
        // And it can fail.
        fs::write(
            &source,
            "#include \"decouplegs.h\"\nint main() { return dgs_device_count(); }\n",
        )
        .unwrap();
        let refused = run(compiler, |command| {
            command.arg(standard).args(strict).args([&include, &source])
        });
        assert!(
            !refused.status.success(),
            "{compiler} {standard} takes a call without its argument"
        );
    }
}
