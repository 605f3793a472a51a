//! One splat file, one image: framing, and the example that does it.

use std::path::{Path, PathBuf};

use decouplegs::render::Image;
use decouplegs::{Session, SessionOptions};
use glam::DVec3;

#[path = "../../engine/examples/render_ply.rs"]
#[allow(dead_code, reason = "an example has a main of its own")]
mod render_ply;

fn cone() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("engine/asset/fuzz/seeds/inria_ply/cone.ply")
}

#[test]
fn the_example_writes_an_image_of_the_whole_file() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("cone.png");
    render_ply::draw(&cone(), &out).unwrap();
    let image = Image::read(&out).unwrap();
    assert_eq!((image.width, image.height), (1280, 720));
    let is_lit = |x: usize, y: usize| image.rgb[y * 1280 + x].iter().any(|&value| value > 0.05);
    let lit = (0..720).flat_map(|y| (0..1280).map(move |x| (x, y)));
    let lit: Vec<(usize, usize)> = lit.filter(|&(x, y)| is_lit(x, y)).collect();
    assert!(lit.len() > 10_000, "{} pixels are lit", lit.len());
    // Around the middle, and not at the left and right edges.
    assert!(lit.iter().all(|&(x, _)| (100..1180).contains(&x)));
    let absent = folder.path().join("absent.ply");
    let refused = render_ply::draw(&absent, &out).unwrap_err().to_string();
    assert!(refused.contains("absent.ply"), "{refused}");
}

#[test]
fn what_cannot_be_framed_is_not() {
    let session = Session::open(&SessionOptions::default()).unwrap();
    let scene = session.open_scene(&cone()).unwrap();
    let camera = scene
        .frame([64, 48], Some(DVec3::X), Some(DVec3::Z))
        .unwrap();
    let ahead = camera.world_from_camera.rotation * DVec3::Z;
    assert!((ahead + DVec3::X).length() < 1e-9, "{ahead}");
    for (size_px, direction, up) in [
        ([0, 48], None, None),
        ([64, 70_000], None, None),
        ([64, 48], Some(DVec3::ZERO), None),
        ([64, 48], Some(DVec3::Z), Some(DVec3::Z)),
        ([64, 48], None, Some(DVec3::ZERO)),
        ([64, 48], None, Some(DVec3::NAN)),
        ([64, 48], Some(DVec3::INFINITY), None),
    ] {
        assert!(
            scene.frame(size_px, direction, up).is_none(),
            "{size_px:?} {direction:?} {up:?}"
        );
    }
}
