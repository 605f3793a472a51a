//! Paths of the libraries, and linking of programs with them.

use std::env;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The folder of the package.
pub const FOLDER: &str = env!("CARGO_MANIFEST_DIR");

/// Name by which programs ask for the shared library.
pub const SHARED: &str = "libdecouplegs_c.so.1";

/// Kind of linking of a program.
#[derive(Clone, Copy, Debug)]
pub enum Linked {
    Shared,
    Static,
}

/// The library called `name`, which Cargo builds before the tests of its package and puts beside
/// them.
pub fn library(name: &str) -> PathBuf {
    let test = env::current_exe().expect("a test knows its own path");
    let beside = test.parent().expect("a test is in a folder");
    let path = beside.join(name);
    assert!(
        path.is_file(),
        "{} is missing: build it with `cargo build --package decouplegs-c`",
        path.display()
    );
    path
}

/// Output of `program`.
pub fn run(program: &str, arguments: impl FnOnce(&mut Command) -> &mut Command) -> Output {
    let output = arguments(&mut Command::new(program)).output();
    output.unwrap_or_else(|error| {
        panic!("{program} cannot be run ({error}): `make packages` installs what is missing")
    })
}

/// Standard output of what must have gone well.
pub fn succeed(output: Output) -> String {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (said, complained) = (text(&output.stdout), text(&output.stderr));
    assert!(
        output.status.success(),
        "{}\n{said}\n{complained}",
        output.status
    );
    said
}

/// The program of `source`, relative to the package, in `folder`; compiled as strictly as can be.
pub fn compiled(source: &str, linked: Linked, folder: &Path) -> PathBuf {
    let source = Path::new(FOLDER).join(source);
    let program = folder.join(source.file_stem().expect("a source has a name"));
    let built = run("cc", |command| {
        command.args([
            "-std=c99",
            "-D_POSIX_C_SOURCE=200809L",
            "-g",
            "-Wall",
            "-Wextra",
            "-Wpedantic",
            "-Werror",
            "-pthread",
        ]);
        // `make asan` watches the programs and the library by it.
        let more = env::var("DECOUPLEGS_CFLAGS").unwrap_or_default();
        command
            .args(more.split_whitespace())
            .arg("-I")
            .arg(Path::new(FOLDER).join("include"))
            .arg(&source)
            .arg("-o")
            .arg(&program);
        match linked {
            Linked::Shared => {
                let library = library("libdecouplegs_c.so");
                let beside = library.parent().expect("a library is in a folder");
                // Programs ask for the name that it is installed by.
                let installed = folder.join(SHARED);
                if !installed.exists() {
                    symlink(&library, installed).expect("a link can be made");
                }
                // An older library in a folder of LD_LIBRARY_PATH, as Cargo sets it, must not come
                // first: DT_RPATH does.
                command
                    .arg("-L")
                    .arg(beside)
                    .arg("-ldecouplegs_c")
                    .arg("-Wl,--disable-new-dtags")
                    .arg(format!("-Wl,-rpath,{}", folder.display()))
            }
            Linked::Static => command.arg(library("libdecouplegs_c.a")).arg("-ldl"),
        };
        command.arg("-lm")
    });
    succeed(built);
    program
}
