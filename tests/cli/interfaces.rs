//! One scene through several interfaces: the same image.

use decouplegs::session::{HostImages, Session, SessionOptions, World, WorldView};

use super::*;

/// 8-bit RGB of each camera by `render`.
fn by_program(scene: &Path, out: &Path, names: &[String]) -> Vec<Vec<[u8; 3]>> {
    succeed(&["render", text(scene), "--out", text(out)]);
    let read = |name: &String| {
        let image = Image::read(&out.join(format!("{name}.png"))).expect("`render` wrote it");
        let byte = |value: f32| (value * 255.0).round() as u8;
        image.rgb.iter().map(|rgb| rgb.map(byte)).collect()
    };
    names.iter().map(read).collect()
}

/// 8-bit RGB of each camera by a session.
fn by_session(session: &Session, scene: &Path) -> (Vec<String>, Vec<Vec<[u8; 3]>>) {
    let scene = session.open_scene(scene).expect("the scene opens");
    let (mut renderer, mut world) = (session.batch_renderer(), World::new(&scene));
    let time_s = scene.ego().start_s();
    world.set_time(time_s);
    let cameras = scene.rig().driving(scene.ego(), time_s);
    let view = WorldView {
        world: &world,
        cameras: &cameras,
    };
    let mut images = HostImages::default();
    renderer
        .draw(&[view], &mut images)
        .expect("a small scene fits");
    let rgb = |camera: usize| -> Vec<[u8; 3]> {
        let pixels = images.rgba(0, camera).chunks_exact(4);
        pixels.map(|pixel| [pixel[0], pixel[1], pixel[2]]).collect()
    };
    let names = scene.rig().cameras().map(|camera| camera.name.clone());
    (names.collect(), (0..cameras.len()).map(rgb).collect())
}

#[test]
fn the_program_and_a_session_render_the_same_bytes_by_the_rules_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    small_street(folder.path());
    let plain = folder.path().join("scene.toml");
    let inria = folder.path().join("inria.toml");
    let scene = fs::read_to_string(&plain).unwrap();
    let (default, other) = (r#"name = "default""#, r#"name = "inria""#);
    assert!(scene.contains(default), "the street names its rules");
    fs::write(&inria, scene.replacen(default, other, 1)).unwrap();

    let session = Session::open(&SessionOptions::default()).expect("a device");
    let mut seen = Vec::new();
    for scene in [&plain, &inria] {
        let (names, in_process) = by_session(&session, scene);
        let out = folder.path().join(scene.file_stem().unwrap());
        assert!(
            by_program(scene, &out, &names) == in_process,
            "{}",
            scene.display()
        );
        seen.push(in_process);
    }
    assert!(seen[0] != seen[1], "the rules of the second scene show");
}
