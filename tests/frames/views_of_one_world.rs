//! Views of one world, each without the agent that its cameras are on.

use decouplegs::render::{ColorFormat, Outputs};
use decouplegs::scene::{Camera, Pose};
use decouplegs::session::{HostImages, World, WorldView};
use glam::DVec3;

use super::worlds::{assert_silent, cameras, loaded, session};

/// Agents of the world of the test.
const NAMES: [&str; 5] = ["a", "b", "c", "d", "e"];

#[test]
fn views_of_one_world_are_drawn_as_worlds_alone_at_the_cost_of_one() {
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = session.add_scene(&loaded(1)).unwrap();
    let mut world = World::new(&scene);
    for (number, name) in NAMES[2..].iter().enumerate() {
        let pose = Pose::from_yaw(0.3, DVec3::new(8.0 + number as f64, -1.5, 0.0));
        world.place(name, 1, pose, None).unwrap();
    }
    let without: Vec<World> = NAMES
        .iter()
        .map(|name| {
            let mut alone = world.clone();
            alone.remove(name).unwrap();
            alone
        })
        .collect();
    let instances = world.agents().iter().map(|agent| agent.placed.instance);
    let views = world.without_each(&instances.collect::<Vec<u16>>());
    for (view, alone) in views.iter().zip(&without) {
        assert_eq!(view.agents(), alone.agents());
    }
    let cameras: Vec<Vec<Camera>> = (0..5)
        .map(|index| cameras(0.1 * f64::from(index)))
        .collect();
    fn pairs<'a>(worlds: &'a [World], cameras: &'a [Vec<Camera>]) -> Vec<WorldView<'a>> {
        let pairs = worlds.iter().zip(cameras);
        pairs
            .map(|(world, cameras)| WorldView { world, cameras })
            .collect()
    }
    let (mut renderer, mut apart) = (session.batch_renderer(), session.batch_renderer());
    let (mut images, mut expected) = (HostImages::default(), HostImages::default());
    let shared = renderer
        .draw(&pairs(&views, &cameras), &mut images)
        .unwrap();
    let copied = apart
        .draw(&pairs(&without, &cameras), &mut expected)
        .unwrap();
    assert_eq!(
        (shared.len(), copied.len()),
        (1, 1),
        "ten cameras, one frame"
    );
    assert_eq!((shared[0].agents, copied[0].agents), (5, 20));
    assert!(shared[0].relit <= 5, "{} relit codebooks", shared[0].relit);
    for (index, view) in pairs(&views, &cameras).into_iter().enumerate() {
        let mut alone = HostImages::default();
        apart.draw(&[view], &mut alone).unwrap();
        for camera in 0..2 {
            let drawn = images.rgba(index, camera);
            assert!(drawn == expected.rgba(index, camera), "view {index}");
            assert!(drawn == alone.rgba(0, camera), "view {index} alone");
        }
    }
    assert_silent(&session);
}

#[test]
fn a_view_that_changes_is_a_world_of_its_own() {
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = session.add_scene(&loaded(1)).unwrap();
    let world = World::new(&scene);
    let instances: Vec<u16> = (world.agents().iter())
        .map(|agent| agent.placed.instance)
        .collect();
    let mut views = world.without_each(&instances);
    let pose = Pose::from_yaw(0.0, DVec3::new(7.0, 0.5, 0.0));
    views[1].move_to("a", pose).unwrap();
    let cameras = cameras(0.0);
    let view = |world| WorldView {
        world,
        cameras: &cameras,
    };
    let mut renderer = session.batch_renderer();
    let (mut images, mut alone) = (HostImages::default(), HostImages::default());
    renderer
        .draw(&[view(&views[0]), view(&views[1])], &mut images)
        .unwrap();
    renderer.draw(&[view(&views[1])], &mut alone).unwrap();
    assert!(images.rgba(1, 0) == alone.rgba(0, 0));
    assert_silent(&session);
}
