//! Agents that are in a scene at some times alone.

use decouplegs::asset::SceneFile;
use decouplegs::render::Renderer;
use decouplegs::scene::Presence;
use decouplegs::session::{Session, SessionOptions, World, WorldView};

use super::editing::{Site, cameras, loaded, options};
use crate::device::Validated;

/// Names of the agents that are absent until 1 s and after 2 s in the test below.
const ABSENT: [&str; 3] = ["plain", "behind", "behind left"];

#[test]
fn absent_agents_are_in_no_image_and_throw_no_shadow() {
    let gpu = Validated::open();
    let site = Site::new();
    let mut file = site.file.clone();
    // Plain splats last, so that the ids of the others stay when they are removed.
    let plain = file.remove_agent("plain").unwrap();
    file.add_agent(plain).unwrap();
    let (mut shown, mut without) = (file.clone(), file.clone());
    for name in ABSENT {
        without.remove_agent(name).unwrap();
        let present = Presence::new(vec![[1.0, 2.0]]).unwrap();
        file.set_presence(name, present).unwrap();
    }
    let at = |file: &SceneFile, time_s: f64| {
        let loaded = file.load(site.folder.path(), time_s).unwrap();
        let mut renderer = Renderer::new(&gpu, options());
        let session = Session::on(&gpu, &options().into());
        let scene = session.add_scene(&loaded).unwrap();
        let mut world = World::new(&scene);
        world.set_time(time_s);
        let agents = world.frame_agents();
        let views = cameras(&loaded);
        scene
            .lend(&agents, |splats| renderer.render(splats, &views))
            .unwrap();
        (
            renderer.read_images().unwrap(),
            agents.shadows.len(),
            loaded.baked(time_s).instance_from_splat,
        )
    };
    for time_s in [0.5, 2.5] {
        assert!(at(&file, time_s) == at(&without, time_s), "{time_s} s");
    }
    let present = at(&file, 1.5);
    assert!(present == at(&shown, 1.5) && present != at(&without, 1.5));

    // Worlds of a session: set by time, and by hand. Plain splats are as the file was loaded.
    shown.remove_agent("plain").unwrap();
    file.remove_agent("plain").unwrap();
    let session = Session::on(
        &gpu,
        &SessionOptions {
            render: options(),
            ..SessionOptions::default()
        },
    );
    let timed = loaded(&file, site.folder.path());
    let scene = session.add_scene(&timed).unwrap();
    let (mut renderer, mut world) = (session.batch_renderer(), World::new(&scene));
    let views = cameras(&timed);
    let mut draw = |world: &World| {
        let view = WorldView {
            world,
            cameras: &views,
        };
        renderer.draw_images(&[view]).unwrap().0.remove(0)
    };
    let hidden = |world: &World| {
        let agents = world.agents().iter();
        agents.filter(|agent| !agent.present).count()
    };
    assert!(hidden(&world) == 2 && draw(&world) == at(&without, 0.0).0);
    world.set_time(1.5);
    let always = session.add_scene(&loaded(&shown, site.folder.path()));
    let mut always = World::new(&always.unwrap());
    always.set_time(1.5);
    assert!(hidden(&world) == 0 && draw(&world) == draw(&always));
    world.set_time(2.5);
    assert!(hidden(&world) == 2 && draw(&world) == at(&without, 2.5).0);
    let behind = &world.agents()[3];
    assert_eq!(behind.name, "behind");
    let pose = behind.placed.pose;
    world.move_to("behind", pose).unwrap();
    shown.remove_agent("behind left").unwrap();
    assert!(hidden(&world) == 1 && draw(&world) == at(&shown, 2.5).0);
}
