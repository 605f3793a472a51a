//! The library as it is installed: programs find it through pkg-config and CMake.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};

use crate::library::{FOLDER, SHARED, library, run, succeed};
use crate::street::small_street;

/// Version that is installed: 0 as the major one, as it is today.
const VERSION: &str = "0.8.7";

/// The library under `prefix`.
fn install(prefix: &Path) {
    let built = library("libdecouplegs_c.so");
    let said = succeed(run("sh", |command| {
        command
            .arg(Path::new(FOLDER).join("install/install.sh"))
            .arg(built.parent().unwrap())
            .args([prefix, Path::new(VERSION)])
    }));
    assert!(said.contains(SHARED), "{said}");
}

/// Words of pkg-config on the library under `prefix`.
fn pkg_config(prefix: &Path, asked: &[&str]) -> Vec<String> {
    let said = succeed(run("pkg-config", |command| {
        command
            .env("PKG_CONFIG_PATH", prefix.join("lib/pkgconfig"))
            .args(asked)
            .arg("decouplegs")
    }));
    said.split_whitespace().map(str::to_owned).collect()
}

/// The PNG that a session of this process writes of `splats`, as the example does.
fn by_session(splats: &Path, out: &Path) -> Vec<u8> {
    let session = Session::open(&SessionOptions::default()).unwrap();
    let scene = session.open_scene(splats).unwrap();
    let camera = scene.frame([1280, 720], None, None).unwrap();
    let (world, mut images) = (World::new(&scene), HostImages::default());
    let view = WorldView {
        world: &world,
        cameras: &[camera],
    };
    session.batch_renderer().draw(&[view], &mut images).unwrap();
    images.save_png(0, 0, out).unwrap();
    fs::read(out).unwrap()
}

/// Runs `program`, which finds the library under `prefix` alone.
fn draws(program: &Path, prefix: &Path, arguments: [&Path; 2]) {
    let said = succeed(run(program.to_str().unwrap(), |command: &mut Command| {
        command
            .env("LD_LIBRARY_PATH", prefix.join("lib"))
            .args(arguments)
    }));
    assert!(said.contains("1280x720 pixels"), "{said}");
}

#[test]
fn a_program_is_built_with_pkg_config_and_draws_one_file() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path(), [64, 48]);
    let at = |name: &str| folder.path().join(name);
    install(&at("first"));
    // A second time, too, and what is installed may be moved.
    install(&at("first"));
    let prefix = at("moved");
    fs::rename(at("first"), &prefix).unwrap();
    assert_eq!(pkg_config(&prefix, &["--modversion"]), [VERSION]);
    let flags = pkg_config(&prefix, &["--cflags", "--libs"]);
    let example = Path::new(FOLDER).join("examples/render_ply.c");
    let program = at("render_ply");
    succeed(run("cc", |command| {
        command
            .args(["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror"])
            .arg(&example)
            .args(&flags)
            .arg("-o")
            .arg(&program)
    }));
    let (splats, image) = (at("background.ply"), at("image.png"));
    draws(&program, &prefix, [&splats, &image]);
    assert!(
        fs::read(&image).unwrap() == by_session(&splats, &at("expected.png")),
        "C and a session write the same file"
    );
    // Without the library of its version, the program does not start.
    let old = prefix.join("lib").join(SHARED);
    fs::rename(&old, prefix.join("lib/libdecouplegs_c.so.0")).unwrap();
    let refused = run(program.to_str().unwrap(), |command| {
        command.env("LD_LIBRARY_PATH", prefix.join("lib"))
    });
    let complained = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(
        !refused.status.success() && complained.contains(SHARED),
        "{complained}"
    );
}

#[test]
fn cmake_finds_it_by_version() {
    if Command::new("cmake").arg("--version").output().is_err() {
        eprintln!("skipped: cmake is not installed");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    install(&at("prefix"));
    let example = Path::new(FOLDER).join("examples/render_ply.c");
    let configured = |version: &str, build: &PathBuf| {
        let lists = format!(
            "cmake_minimum_required(VERSION 3.10)\nproject(try C)\nfind_package(decouplegs {version} REQUIRED)\n\
             add_executable(render_ply {})\ntarget_link_libraries(render_ply decouplegs::decouplegs)\n",
            example.display()
        );
        fs::write(at("CMakeLists.txt"), lists).unwrap();
        run("cmake", |command| {
            command
                .arg(format!("-DCMAKE_PREFIX_PATH={}", at("prefix").display()))
                .args(["-G", "Unix Makefiles", "-S"])
                .arg(folder.path())
                .arg("-B")
                .arg(build)
        })
    };
    for version in ["", "0.8", "0.8.7"] {
        succeed(configured(version, &at("build")));
    }
    succeed(run("cmake", |command| {
        command.arg("--build").arg(at("build"))
    }));
    assert!(at("build/render_ply").is_file());
    for version in ["0.7", "1.8", "9.8.7"] {
        assert!(!configured(version, &at("other")).status.success());
    }
}

#[test]
fn the_name_of_the_library_has_the_version_of_its_interface() {
    let header = fs::read_to_string(Path::new(FOLDER).join("include/decouplegs.h")).unwrap();
    let version = SHARED.rsplit_once('.').unwrap().1;
    assert!(header.contains(&format!("#define DGS_ABI_VERSION {version}\n")));
    let build = fs::read_to_string(Path::new(FOLDER).join("build.rs")).unwrap();
    assert!(build.contains(&format!("-soname,{SHARED}\"")));
}
