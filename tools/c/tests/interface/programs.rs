//! C programs that use the library, well and badly.

use std::fs;
use std::path::Path;

use decouplegs::scene::lidar::{PointFrame, ReturnMode, ReturnOptions};
use decouplegs::scene::{Motion, Pose, RigLidar};
use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};
use glam::DVec3;

use crate::library::{FOLDER, Linked, compiled, run, succeed};
use crate::street::small_street;

/// Pixels of a PPM file behind its header.
fn ppm_pixels(path: &Path) -> Vec<u8> {
    let bytes = fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let header = b"P6\n64 48\n255\n";
    assert!(
        bytes.starts_with(header) && bytes.len() == header.len() + 3 * 64 * 48,
        "{}",
        path.display()
    );
    bytes[header.len()..].to_vec()
}

/// RGB of both cameras at `time_s`, by a session in this process.
fn by_session(scene: &Path, time_s: f64) -> Vec<Vec<u8>> {
    let session = Session::open(&SessionOptions::default()).unwrap();
    let scene = session.open_scene(scene).unwrap();
    let mut world = World::new(&scene);
    world.set_time(time_s);
    let cameras = scene.rig().driving(scene.ego(), time_s);
    let view = WorldView {
        world: &world,
        cameras: &cameras,
    };
    let mut images = HostImages::default();
    session.batch_renderer().draw(&[view], &mut images).unwrap();
    let rgb = |camera| -> Vec<u8> {
        let pixels = images.rgba(0, camera).chunks_exact(4);
        pixels.flat_map(|pixel| pixel[..3].to_vec()).collect()
    };
    (0..2).map(rgb).collect()
}

/// Files that the example writes: of two worlds, two cameras each. The first world is as the scene
/// file says.
fn assert_two_worlds(out: &Path, said: &str, expected: &[Vec<u8>]) {
    let mut names: Vec<_> = fs::read_dir(out)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    names.sort();
    assert_eq!(names.len(), 4, "{said}");
    let images: Vec<Vec<u8>> = names.iter().map(|path| ppm_pixels(path)).collect();
    assert!(
        images
            .iter()
            .all(|image| image.iter().any(|&byte| byte != image[0])),
        "no image is of one color"
    );
    assert!(
        images[..2] == *expected,
        "C and a session render the same bytes"
    );
    assert!(
        images[0] != images[2],
        "the car stands elsewhere in the second world"
    );
    for part in ["2 cameras, 1 agents", "0.1 s: ", " ms on the device"] {
        assert!(said.contains(part), "{part}: {said}");
    }
}

#[test]
fn the_example_draws_two_worlds_as_a_session_does() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small_street(folder.path(), [64, 48]);
    for linked in [Linked::Shared, Linked::Static] {
        let out = folder.path().join(format!("{linked:?}"));
        fs::create_dir(&out).unwrap();
        let program = compiled("examples/render_rig.c", linked, &out);
        let images = out.join("images");
        fs::create_dir(&images).unwrap();
        let said = succeed(run(program.to_str().unwrap(), |command| {
            command.args([&scene, &images]).arg("2")
        }));
        assert_two_worlds(&images, &said, &by_session(&scene, 0.1));
    }
}

#[test]
fn misuse_is_told_and_nothing_breaks() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small_street(folder.path(), [64, 48]);
    let program = compiled("tests/interface/misuse.c", Linked::Static, folder.path());
    let said = succeed(run(program.to_str().unwrap(), |command| {
        command.arg(&scene)
    }));
    assert_eq!(said, "0 failures\n");
}

#[test]
fn images_of_every_kind_agree() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small_street(folder.path(), [64, 48]);
    let program = compiled("tests/interface/images.c", Linked::Shared, folder.path());
    let said = succeed(run(program.to_str().unwrap(), |command| {
        command.arg(&scene)
    }));
    assert!(said.contains("pixels are the agent's"), "{said}");
}

#[test]
fn cameras_of_every_kind_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path(), [64, 48]);
    let program = compiled("tests/interface/cameras.c", Linked::Static, folder.path());
    let splats = folder.path().join("background.ply");
    let said = succeed(run(program.to_str().unwrap(), |command| {
        command.args([&splats, folder.path()])
    }));
    assert_eq!(said, "all kinds of cameras\n");
    let image = fs::read(folder.path().join("pinhole.png")).unwrap();
    assert!(image.starts_with(b"\x89PNG"));
}

#[test]
fn a_sweep_is_that_of_a_session() {
    let folder = tempfile::tempdir().unwrap();
    let path = small_street(folder.path(), [64, 48]);
    let program = compiled("tests/interface/sweep.c", Linked::Static, folder.path());
    let out = folder.path().join("points");
    let said = succeed(run(program.to_str().unwrap(), |command| {
        command.args([&path, &out])
    }));
    let session = Session::open(&SessionOptions::default()).unwrap();
    let scene = session.open_scene(&path).unwrap();
    let mut world = World::new(&scene);
    world.set_time(0.5);
    let roof = scene.rig().lidars().next().unwrap();
    let motion = Motion {
        velocity_mps: DVec3::new(12.0, 0.0, 0.0),
        turn_rad_per_s: DVec3::new(0.0, 0.0, 0.5),
    };
    let sensor = RigLidar {
        rig_from_lidar: Pose::IDENTITY,
        ..roof.clone()
    };
    let lidar = sensor.sweep_until(&roof.rig_from_lidar, &motion);
    let sweep_s = lidar.model.sweep_s;
    let mode = ReturnMode::Expected;
    let traced = session
        .batch_renderer()
        .trace(&world, &lidar, sweep_s, mode);
    let sweep = traced.unwrap().returns(&ReturnOptions {
        mode,
        opacity_min: 0.25,
        seed: 0,
    });
    let mut expected = Vec::new();
    for point in sweep.points(PointFrame::World) {
        let [x, y, z] = point.position_m.as_vec3().to_array();
        let found = &point.measured;
        for value in [x, y, z, found.range_m, found.intensity] {
            expected.extend(value.to_ne_bytes());
        }
        let offset_ns = (1e9 * point.beam.time_s).round() as u32;
        for value in [offset_ns, point.beam.column] {
            expected.extend(value.to_ne_bytes());
        }
        for value in [point.beam.ring, point.beam.laser, found.instance] {
            expected.extend(value.to_ne_bytes());
        }
        expected.extend([found.number, found.count]);
    }
    assert!(sweep.returns.len() > 1000 && sweep.returns.iter().any(|found| found.instance > 0));
    let points = sweep.returns.len();
    let beams = sweep.beams.len();
    assert_eq!(said, format!("{points} of {beams} beams in 0.1 s\n"));
    assert!(fs::read(&out).unwrap() == expected, "the same bytes");
}

#[test]
fn the_example_touches_only_its_own_memory_and_leaks_none() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small_street(folder.path(), [64, 48]);
    let program = compiled("examples/render_rig.c", Linked::Shared, folder.path());
    let out = folder.path().join("images");
    fs::create_dir(&out).unwrap();
    let suppressions = Path::new(FOLDER).join("tests/interface/valgrind.supp");
    let watched = run("valgrind", |command| {
        command.args([
            "--error-exitcode=99",
            "--leak-check=full",
            "--show-leak-kinds=definite",
            "--errors-for-leak-kinds=definite",
        ]);
        command
            .arg(format!("--suppressions={}", suppressions.display()))
            .arg(&program)
            .args([&scene, &out])
            .arg("2");
        // The validation layer is watched elsewhere, and takes minutes here.
        command.env("DECOUPLEGS_VALIDATION", "0")
    });
    let said = succeed(watched);
    assert_two_worlds(&out, &said, &by_session(&scene, 0.1));
}
