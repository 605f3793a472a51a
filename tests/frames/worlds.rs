//! Worlds that share a background: each camera sees the agents and shadows of its own world and no
//! others.

use std::sync::Arc;

use decouplegs::asset::{LoadedAgent, LoadedScene};
use decouplegs::gpu::DeviceOptions;
use decouplegs::render::{
    Agent, AssetPool, ColorFormat, FrameAgents, FrameSplats, ImageBytes, Outputs, Plane,
    RenderError, RenderOptions, Renderer,
};
use decouplegs::scene::{Camera, GroundShadow, Pose, Presence, Rules, ShFrame, Trajectory};
use decouplegs::session::{
    HostImages, Scene, Session, SessionError, SessionOptions, World, WorldView,
};
use glam::DVec3;

use super::agents::{background, camera_towards, coded_car};
use super::light::{shadow, some_transfer};
use crate::device::Validated;

pub fn cameras(shift: f64) -> Vec<Camera> {
    let eye = DVec3::new(0.3 * shift, 0.2 * shift, 0.4);
    vec![
        camera_towards("ahead", eye, DVec3::new(10.0, 0.0, 0.0), (150, 90)),
        camera_towards(
            "above",
            DVec3::new(9.0, -7.0 + shift, 5.0),
            DVec3::new(10.0, 0.0, 0.0),
            (97, 64),
        ),
    ]
}

#[test]
fn cameras_see_the_agents_and_shadows_of_their_own_world() {
    let gpu = Validated::open();
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: super::all_outputs(),
            ..RenderOptions::default()
        },
    );
    let world = renderer.upload(&background(3000, 5)).unwrap();
    let mut pool = AssetPool::new(&gpu).unwrap();
    let assets = [
        pool.add(&coded_car(500, 6)).unwrap(),
        pool.add(&coded_car(300, 7)).unwrap(),
    ];

    // Two worlds of two cameras each: other cars, other light, other shadows.
    let agent = |asset: usize, x: f64, relit: Option<u64>, cameras: u32| Agent {
        relight: relit.map(some_transfer),
        cameras,
        ..Agent::new(
            assets[asset],
            Pose::from_yaw(0.1 * x, DVec3::new(x, 0.3 * x - 3.0, 0.0)),
            1 + x as u16,
        )
    };
    let agents = [
        agent(0, 8.0, Some(1), 0b0011),
        agent(1, 9.0, None, 0b0011),
        agent(0, 11.0, Some(2), 0b1100),
    ];
    let shadows = [
        shadow(DVec3::new(8.0, 1.0, -0.6), 0.3, 0.9),
        shadow(DVec3::new(9.5, 0.0, -0.5), 1.3, 0.7),
        shadow(DVec3::new(11.0, -2.0, 0.2), 0.0, 1.0),
    ];
    let all: Vec<Camera> = cameras(0.0).into_iter().chain(cameras(1.0)).collect();
    let mut draw = |agents: &FrameAgents, cameras: &[Camera]| {
        let splats = FrameSplats::with_agents(&world, &pool, agents);
        renderer.render(splats, cameras).unwrap();
        renderer.read_images().unwrap()
    };

    let together = FrameAgents {
        agents: agents.to_vec(),
        shadows: shadows.to_vec(),
        shadow_cameras: vec![0b0011, 0b1100, 0b1100],
    };
    let together_drawn = draw(&together, &all);
    let unmasked = |agent: &Agent| Agent {
        cameras: u32::MAX,
        ..*agent
    };
    let everywhere = |agents: &[Agent], shadows: &[GroundShadow]| FrameAgents {
        agents: agents.iter().map(unmasked).collect(),
        shadows: shadows.to_vec(),
        shadow_cameras: Vec::new(),
    };
    let first = everywhere(&agents[..2], &shadows[..1]);
    let second = everywhere(&agents[2..], &shadows[1..]);
    let alone = draw(&first, &all[..2]);
    let other = draw(&second, &all[2..]);
    assert!(
        together_drawn[..2] == alone[..],
        "the first world's cameras see the first world"
    );
    assert!(
        together_drawn[2..] == other[..],
        "the second world's see the second"
    );

    let mut added = FrameAgents::default();
    added.add_for_cameras(first, 0b0011);
    added.add_for_cameras(second, 0b1100);
    assert_eq!(added, together);

    // And it can fail: without masks all worlds see all agents.
    let mixed = draw(&everywhere(&agents, &shadows), &all);
    assert!(
        (0..4).all(|camera| mixed[camera] != together_drawn[camera]),
        "every camera would see another world's cars or shadows"
    );
    let unmasked_shadows = FrameAgents {
        shadow_cameras: Vec::new(),
        ..together
    };
    assert!(
        draw(&unmasked_shadows, &all) != together_drawn,
        "shadows are masked by themselves"
    );
}

pub fn loaded(seed: u64) -> LoadedScene {
    let agent = |name: &str, asset: usize, instance: u16, x: f64| LoadedAgent {
        name: name.into(),
        asset,
        instance,
        sh_frame: ShFrame::Canonical,
        trajectory: Trajectory::standing(Pose::from_yaw(0.2, DVec3::new(x, 0.5, 0.0))),
        present: Presence::ALWAYS,
    };
    LoadedScene {
        assets: vec![coded_car(400, seed + 1), coded_car(250, seed + 2)],
        agents: vec![agent("a", 0, 1, 8.0), agent("b", 1, 2, 12.0)],
        ..LoadedScene::of_world(background(2000, seed))
    }
}

pub fn session(outputs: Outputs) -> Session {
    let mut options = SessionOptions {
        device: DeviceOptions {
            validation: true,
            ..DeviceOptions::default()
        },
        ..SessionOptions::default()
    };
    options.render.outputs = outputs;
    options.render.taken_max = 3;
    Session::open(&options).unwrap()
}

pub fn assert_silent(session: &Session) {
    assert_eq!(
        session.gpu().take_validation_messages(),
        Vec::<String>::new()
    );
}

/// World `index` over `scene`: its cars stand somewhere else in each.
pub fn world(scene: &Arc<Scene>, index: usize) -> World {
    let mut world = World::new(scene);
    let x = 6.0 + 0.25 * index as f64;
    world
        .move_to(
            "a",
            Pose::from_yaw(0.1 * x, DVec3::new(x, 1.0 - 0.1 * x, 0.0)),
        )
        .unwrap();
    match index % 3 {
        0 => {}
        1 => drop(world.remove("b").unwrap()),
        _ => drop(
            world
                .place(
                    "c",
                    1,
                    Pose::from_yaw(0.0, DVec3::new(10.0, -2.0, 0.0)),
                    None,
                )
                .unwrap(),
        ),
    }
    world
}

#[test]
fn worlds_of_a_session_are_drawn_together_as_alone() {
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scenes = [1, 50].map(|seed| session.add_scene(&loaded(seed)).unwrap());
    // More cameras than a frame has, and a change of scene in the middle.
    let worlds: Vec<World> = (0..24)
        .map(|index| world(&scenes[usize::from(index >= 19)], index))
        .collect();
    let cameras: Vec<Vec<Camera>> = (0..24).map(|index| cameras(0.05 * index as f64)).collect();
    let views: Vec<WorldView<'_>> = worlds
        .iter()
        .zip(&cameras)
        .map(|(world, cameras)| WorldView { world, cameras })
        .collect();
    let (mut renderer, mut images, mut alone) = (
        session.batch_renderer(),
        HostImages::default(),
        HostImages::default(),
    );
    let frames = renderer.draw(&views, &mut images).unwrap();
    assert_eq!(
        frames.len(),
        3,
        "38 cameras over one scene are two frames, those over the other one"
    );
    assert_eq!((images.views(), images.cameras(23)), (24, 2));
    let mut one = session.batch_renderer();
    for (index, view) in views.iter().enumerate() {
        one.draw(&[*view], &mut alone).unwrap();
        for camera in 0..2 {
            assert_eq!(images.size_px(index, camera), alone.size_px(0, camera));
            assert!(
                images.rgba(index, camera) == alone.rgba(0, camera),
                "world {index}, camera {camera}"
            );
        }
    }
    assert!(
        (1..24).all(|index| images.rgba(index, 0) != images.rgba(0, 0)),
        "all worlds look different"
    );
    assert_silent(&session);
}

#[test]
fn submissions_are_finished_in_their_order_and_show_worlds_as_they_were() {
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = session.add_scene(&loaded(3)).unwrap();
    let (mut renderer, mut alone) = (session.batch_renderer(), session.batch_renderer());
    let (mut images, mut expected) = (HostImages::default(), HostImages::default());
    let cameras = cameras(0.0);
    fn view<'a>(world: &'a World, cameras: &'a [Camera]) -> WorldView<'a> {
        WorldView { world, cameras }
    }
    let mut world = World::new(&scene);
    let pose =
        |step: usize| Pose::from_yaw(0.0, DVec3::new(8.0 + step as f64, 0.5 * step as f64, 0.0));
    // More submissions than frames in flight: the last ones wait on the host.
    let steps = session.options().render.frames_in_flight + 2;
    for step in 0..steps {
        world.move_to("a", pose(step)).unwrap();
        // The second submission is of two frames: 36 cameras over one scene.
        let views = vec![view(&world, &cameras); if step == 1 { 18 } else { 1 }];
        renderer.submit(&views).unwrap();
    }
    assert!(matches!(
        renderer.draw(&[view(&world, &cameras)], &mut images),
        Err(SessionError::Unfinished { submissions }) if submissions == steps
    ));
    let mut first_images = Vec::new();
    for step in 0..steps {
        let frames = renderer.finish(&mut images).unwrap();
        assert_eq!(frames.len(), if step == 1 { 2 } else { 1 });
        world.move_to("a", pose(step)).unwrap();
        alone
            .draw(&[view(&world, &cameras)], &mut expected)
            .unwrap();
        let last = images.views() - 1;
        assert!(images.rgba(last, 1) == expected.rgba(0, 1), "step {step}");
        assert!(
            !first_images.contains(&images.rgba(0, 0).to_vec()),
            "the agent has moved"
        );
        first_images.push(images.rgba(0, 0).to_vec());
    }
    assert!(matches!(
        renderer.finish(&mut images),
        Err(SessionError::NothingSubmitted)
    ));

    // A submission that fails takes the others with it, and the next one is drawn.
    renderer.submit(&[view(&world, &cameras)]).unwrap();
    let none = WorldView {
        world: &world,
        cameras: &[],
    };
    assert!(matches!(
        renderer.submit(&[none]),
        Err(SessionError::NoCameras)
    ));
    renderer
        .draw(&[view(&world, &cameras)], &mut images)
        .unwrap();
    assert!(images.rgba(0, 1) == expected.rgba(0, 1));
    assert_silent(&session);
}

#[test]
fn what_a_world_cannot_do_is_said() {
    let session = session(Outputs {
        planes: [Plane::Depth].into(),
        ..Outputs::default()
    });
    let scene = session.add_scene(&loaded(3)).unwrap();
    let mut world = World::new(&scene);
    let text = |error: SessionError| error.to_string();
    assert!(
        text(world.move_to("x", Pose::IDENTITY).unwrap_err())
            .contains("no agent \"x\": it has a, b")
    );
    assert!(text(world.remove("x").unwrap_err()).contains("\"x\""));
    assert!(
        text(world.place("c", 2, Pose::IDENTITY, None).unwrap_err())
            .contains("no asset 2: it has 2")
    );
    assert_eq!(world.place("c", 1, Pose::IDENTITY, None).unwrap(), 3);
    assert_eq!(
        world.place("c", 0, Pose::IDENTITY, None).unwrap(),
        3,
        "who is placed again keeps his id"
    );
    let (mut renderer, cameras) = (session.batch_renderer(), cameras(0.0));
    let view = [WorldView {
        world: &world,
        cameras: &cameras,
    }];
    assert!(matches!(
        renderer.draw(&view, &mut HostImages::default()),
        Err(SessionError::NotBytes)
    ));
    assert!(matches!(
        renderer.draw_images(&[WorldView {
            cameras: &[],
            ..view[0]
        }]),
        Err(SessionError::NoCameras)
    ));
    let (good, _) = renderer.draw_images(&view).unwrap();
    assert!(good[0][0].depth().is_some());
    let elsewhere = self::session(Outputs {
        planes: [Plane::Depth].into(),
        ..Outputs::default()
    });
    let other = World::new(&elsewhere.add_scene(&loaded(3)).unwrap());
    let foreign = [
        view[0],
        WorldView {
            world: &other,
            cameras: &cameras,
        },
    ];
    assert!(matches!(
        renderer.draw_images(&foreign),
        Err(SessionError::OtherSession { view: 1 })
    ));
    // A frame that cannot be drawn leaves the batch renderer as good as before.
    let mut lost = World::new(&scene);
    lost.move_to(
        "a",
        Pose {
            translation: DVec3::NAN,
            ..Pose::IDENTITY
        },
    )
    .unwrap();
    let nowhere = [
        view[0],
        WorldView {
            world: &lost,
            cameras: &cameras,
        },
    ];
    assert!(matches!(
        renderer.draw_images(&nowhere),
        Err(SessionError::Render(RenderError::AgentPose { .. }))
    ));
    assert!(renderer.draw_images(&view).unwrap().0 == good);
    assert!(
        text(
            session
                .open_scene("nowhere/scene.toml".as_ref())
                .map(|_| ())
                .unwrap_err()
        )
        .contains("nowhere/scene.toml")
    );
    assert_silent(&session);
}

#[test]
fn images_that_are_held_stay_and_their_memory_comes_back() {
    let session = session(Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    });
    let scene = session.add_scene(&loaded(9)).unwrap();
    let cameras = cameras(0.0);
    let (mut renderer, mut expected) = (session.batch_renderer(), HostImages::default());
    let worlds: Vec<World> = (0..4).map(|index| world(&scene, index)).collect();
    let mut take = |index: usize| {
        let view = [WorldView {
            world: &worlds[index],
            cameras: &cameras,
        }];
        renderer
            .draw_on_device(&view)
            .map(|(mut taken, _)| taken.remove(0))
    };
    let held: Vec<_> = (0..3).map(|index| take(index).unwrap()).collect();
    assert!(matches!(
        take(3),
        Err(SessionError::Render(RenderError::TooManyTaken { max: 3 }))
    ));
    let mut again = session.batch_renderer();
    for (index, taken) in held.iter().enumerate() {
        again
            .draw(
                &[WorldView {
                    world: &worlds[index],
                    cameras: &cameras,
                }],
                &mut expected,
            )
            .unwrap();
        let words = session.gpu().read(&taken.buffers().images_u8).unwrap();
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        assert_eq!(taken.ranges(), [(0, [150, 90]), (150 * 90, [97, 64])]);
        assert!(
            bytes[..4 * 150 * 90] == *expected.rgba(0, 0)
                && bytes[4 * 150 * 90..] == *expected.rgba(0, 1),
            "{index}"
        );
        assert!(taken.frame().is_done().unwrap());
    }
    drop(held);
    let bytes = session.gpu().memory().total_bytes;
    (0..40).for_each(|step| drop(take(step % 4).unwrap()));
    assert_eq!(
        session.gpu().memory().total_bytes,
        bytes,
        "memory is used again"
    );
    // Images outlive their batch renderer.
    let last = take(0).unwrap();
    drop(renderer);
    assert!(
        !session
            .gpu()
            .read(&last.buffers().images_u8)
            .unwrap()
            .is_empty()
    );
    assert_silent(&session);
}

#[test]
fn a_session_draws_each_scene_by_its_own_rules() {
    let outputs = Outputs {
        color: ColorFormat::U8,
        ..Outputs::default()
    };
    let (session, cameras) = (session(outputs), cameras(0.5));
    let own = [
        Rules::DEFAULT,
        Rules {
            antialias: true,
            ..Rules::DEFAULT
        },
        Rules::GSPLAT15,
        Rules::NUREC,
    ];
    let loaded = own.map(|rules| {
        let mut loaded = loaded(3);
        loaded.splat_scene.rules = rules;
        loaded
    });
    let scenes = loaded
        .each_ref()
        .map(|loaded| session.add_scene(loaded).unwrap());
    let worlds = scenes.each_ref().map(World::new);
    let views = worlds.each_ref().map(|world| WorldView {
        world,
        cameras: &cameras,
    });
    let mut images = HostImages::default();
    session.batch_renderer().draw(&views, &mut images).unwrap();
    for (view, loaded) in loaded.iter().enumerate() {
        // As one renderer by itself draws.
        let mut renderer = Renderer::new(
            session.gpu(),
            RenderOptions {
                rules: loaded.splat_scene.rules,
                outputs,
                ..RenderOptions::default()
            },
        );
        worlds[view]
            .lend(|splats| renderer.render(splats, &cameras))
            .unwrap();
        let mut bytes = ImageBytes::default();
        renderer.read_bytes(&mut bytes).unwrap();
        for camera in 0..cameras.len() {
            assert!(
                images.rgba(view, camera) == bytes.rgba(camera),
                "scene {view}, camera {camera}: the same bytes"
            );
        }
        assert!(
            view == 0 || images.rgba(view, 0) != images.rgba(0, 0),
            "rules {view} show in the image"
        );
    }
    // Unless the session has rules for all.
    let options = SessionOptions {
        rules: Some(Rules::DEFAULT),
        ..session.options().clone()
    };
    let other = Session::on(session.gpu(), &options);
    let scenes = loaded
        .each_ref()
        .map(|loaded| other.add_scene(loaded).unwrap());
    let worlds = scenes.each_ref().map(World::new);
    let views = worlds.each_ref().map(|world| WorldView {
        world,
        cameras: &cameras,
    });
    let mut same = HostImages::default();
    other.batch_renderer().draw(&views, &mut same).unwrap();
    assert!((0..4).all(|view| same.rgba(view, 0) == images.rgba(0, 0)));
    assert_silent(&session);
}
