//! Frames that are submitted before others are finished.

use decouplegs::render::{
    Agent, AssetPool, Capacity, FrameAgents, FrameSplats, RenderError, RenderOptions, Renderer,
};
use decouplegs::scene::{Camera, Pose};
use glam::DVec3;

use super::agents::{background, camera_towards, coded_car};
use crate::device::Validated;

fn camera(frame: usize) -> [Camera; 1] {
    let eye = DVec3::new(0.2 * frame as f64, 0.0, 0.5);
    [camera_towards(
        "front",
        eye,
        eye + DVec3::new(1.0, 0.05 * frame as f64, 0.0),
        (120, 80),
    )]
}

#[test]
fn frames_in_flight_are_those_drawn_one_by_one() {
    let gpu = Validated::open();
    let world = background(3000, 71);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(500, 72)).unwrap();
    let agents = |frame: usize| {
        let pose = Pose::from_yaw(
            0.1 * frame as f64,
            DVec3::new(8.0 + 0.3 * frame as f64, 0.0, 0.0),
        );
        [Agent::new(asset, pose, 1)]
    };
    let mut one_by_one = Renderer::new(
        &gpu,
        RenderOptions {
            overlap: false,
            frames_in_flight: 1,
            ..RenderOptions::default()
        },
    );
    let resident = one_by_one.upload(&world).unwrap();
    let expected: Vec<_> = (0..8)
        .map(|frame| {
            one_by_one
                .render(
                    FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(agents(frame))),
                    &camera(frame),
                )
                .unwrap();
            one_by_one.read_images().unwrap()
        })
        .collect();
    for frames_in_flight in [1, 2, 3] {
        // Too little room: frames that are in flight already are drawn again as well.
        let capacity = Capacity {
            records: 900,
            pairs: 900,
            partials: 1,
            tiles: 1,
        };
        let options = RenderOptions {
            frames_in_flight,
            ..RenderOptions::default()
        };
        let mut renderer = Renderer::new(&gpu, options).with_capacity(capacity);
        let mut redrawn = 0;
        for step in 0..8 + frames_in_flight - 1 {
            if step < 8 {
                renderer
                    .submit(
                        FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(agents(step))),
                        &camera(step),
                    )
                    .unwrap();
            }
            if step + 1 >= frames_in_flight {
                let statistics = renderer.finish().unwrap();
                redrawn += statistics.redrawn;
                assert_eq!(
                    statistics.queues.len(),
                    2,
                    "frame and agents are submitted apart"
                );
                let frame = step + 1 - frames_in_flight;
                assert!(
                    renderer.read_images().unwrap() == expected[frame],
                    "frame {frame} of {frames_in_flight} in flight"
                );
            }
        }
        assert!(redrawn > 0, "the room cannot have been enough");
        assert!(matches!(
            renderer.finish(),
            Err(RenderError::NothingInFlight)
        ));
    }
}

#[test]
fn one_frame_too_many_is_refused_and_the_others_are_kept() {
    let gpu = Validated::open();
    let world = background(300, 81);
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            frames_in_flight: 2,
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    renderer.submit(&resident, &camera(0)).unwrap();
    renderer.submit(&resident, &camera(1)).unwrap();
    let error = renderer.submit(&resident, &camera(2)).unwrap_err();
    assert!(
        error.to_string().contains("2 frames are in flight"),
        "{error}"
    );
    renderer.finish().unwrap();
    let first = renderer.read_images().unwrap();
    renderer.finish().unwrap();
    assert!(renderer.read_images().unwrap() != first);
    renderer.render(&resident, &camera(0)).unwrap();
    assert!(renderer.read_images().unwrap() == first);
}

#[test]
fn a_drive_is_recorded_once() {
    let gpu = Validated::open();
    let world = background(3000, 73);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(500, 74)).unwrap();
    // Four to seven of them are in view.
    let agents = |frame: usize| {
        let position = |agent: usize| DVec3::new(8.0 + agent as f64, 0.1 * frame as f64, 0.0);
        let agent = |agent: usize| Agent::new(asset, Pose::from_yaw(0.1, position(agent)), 1);
        (0..4 + frame % 4).map(agent).collect::<Vec<_>>()
    };
    let mut renderer = Renderer::new(&gpu, RenderOptions::default());
    let resident = renderer.upload(&world).unwrap();
    let draw = |renderer: &mut Renderer, frame: usize| {
        let (agents, camera) = (agents(frame), camera(frame));
        let frame_agents = FrameAgents::new(&agents[..]);
        let scene = FrameSplats::with_agents(&resident, &pool, &frame_agents);
        let statistics = renderer.render(scene, &camera).unwrap();
        assert_eq!(statistics.agents, 4 + frame % 4);
        (statistics.repeated, renderer.read_images().unwrap())
    };
    let drawn: Vec<_> = (0..20).map(|frame| draw(&mut renderer, frame)).collect();
    let recorded: Vec<usize> = (0..20).filter(|&frame| !drawn[frame].0).collect();
    assert!(
        recorded.iter().all(|&frame| frame < 6),
        "the commands of frames {recorded:?} are new"
    );
    for frame in [7, 13, 19] {
        let mut fresh = Renderer::new(&gpu, RenderOptions::default());
        let (repeated, images) = draw(&mut fresh, frame);
        assert!(!repeated && images == drawn[frame].1, "frame {frame}");
    }
    // What changes commands is not missed.
    renderer.time_stages(true);
    let timed = [18, 17, 18].map(|frame| draw(&mut renderer, frame).0);
    assert_eq!(timed, [false, true, true]);
}
