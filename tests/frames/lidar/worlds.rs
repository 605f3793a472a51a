//! Sweeps of worlds: agents are where they are at the time of each beam.

use decouplegs::AgentInstance;
use decouplegs::asset::LoadedScene;
use decouplegs::gpu::DeviceOptions;
use decouplegs::render::TracedSweep;
use decouplegs::render::reference::lidar::{LidarSplats64, SplatGroup};
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, LidarOptions, LidarRenderer, ResidentSplats,
    Storage,
};
use decouplegs::scene::lidar::{LidarModel, PointFrame, ReturnMode, ReturnOptions, Spin};
use decouplegs::scene::{Motion, Pose, Rules};
use decouplegs::session::{RigSweep, Session, SessionError, SessionOptions, World};
use glam::DVec3;

use super::{lidar_at, models, spinning, surroundings, uniform};
use crate::device::Validated;
use crate::frames::agents::coded_car;

/// A scene without agents, whose asset is a car.
fn scene() -> LoadedScene {
    LoadedScene {
        assets: vec![coded_car(3000, 9)],
        ..LoadedScene::of_world(surroundings(300, 8))
    }
}

/// A session whose validation messages fail the test.
fn validated_session() -> Session {
    Session::open(&SessionOptions {
        device: DeviceOptions {
            validation: true,
            ..DeviceOptions::default()
        },
        ..SessionOptions::default()
    })
    .unwrap()
}

#[test]
fn agents_are_where_they_are_at_the_time_of_each_beam() {
    let session = validated_session();
    let loaded = scene();
    let scene = session.add_scene(&loaded).unwrap();
    // Across, 2 m during the sweep, in front of the sensor when its beams are halfway round.
    let motion = Motion {
        velocity_mps: DVec3::new(0.0, 20.0, 0.0),
        ..Motion::REST
    };
    let at_end = Pose::from_yaw(0.4, DVec3::new(7.0, 1.0, 0.0));
    let placed = AgentInstance {
        asset: 0,
        pose: at_end,
        motion,
        sh_frame: None,
        instance: 5,
        shines: false,
    };
    let mut world = World::empty(&scene);
    world.set_agents([("car".to_owned(), placed)]).unwrap();
    let model = spinning(&uniform(40, 12.0, -20.0), 720, 360.0, Spin::Clockwise);
    let lidar = lidar_at(model, DVec3::ZERO, Motion::REST);
    let sweep_s = lidar.model.sweep_s;
    let mut renderer = session.batch_renderer();
    let mode = ReturnMode::Median;
    let traced = renderer.trace(&world, &lidar, sweep_s, mode).unwrap();

    // The same as a renderer finds, which is given the agent at the start.
    let resident =
        ResidentSplats::upload(session.gpu(), &loaded.splat_scene, Storage::Exact).unwrap();
    let mut pool = AssetPool::new(session.gpu()).unwrap();
    let asset = pool.add(&loaded.assets[0]).unwrap();
    let agents = [Agent {
        motion,
        ..Agent::new(asset, at_end.moved(&motion, -sweep_s), 5)
    }];
    let mut own = LidarRenderer::new(session.gpu(), LidarOptions::default());
    let frame_agents = FrameAgents::new(&agents[..]);
    let with_agents = FrameSplats::with_agents(&resident, &pool, &frame_agents);
    assert!(traced.states == own.trace(with_agents, &lidar, mode).unwrap().states);

    // Points on the car are in its box at their own time, and outside of it at the end.
    let sweep = traced.returns(&ReturnOptions::for_model(&lidar.model));
    let half_m = DVec3::from_array(
        loaded.assets[0]
            .dims_m
            .map(|side| 0.5 * f64::from(side) + 0.3),
    );
    let is_inside = |pose: &Pose, point: DVec3| {
        let local = pose.inverse().transform(point).abs();
        local.cmple(half_m).all()
    };
    let (mut on_car, mut at_own_time, mut at_the_end) = (0, 0, 0);
    for point in sweep.points(PointFrame::World) {
        if point.measured.instance == 5 {
            let then = at_end.moved(&motion, point.beam.time_s - sweep_s);
            on_car += 1;
            at_own_time += usize::from(is_inside(&then, point.position_m));
            at_the_end += usize::from(is_inside(&at_end, point.position_m));
        }
    }
    println!(
        "{on_car} points on the car: {at_own_time} in its box at their time, {at_the_end} at the end"
    );
    // Splats at the surface stick out.
    assert!(on_car > 200 && at_own_time * 100 > on_car * 99);
    assert!(
        at_the_end * 10 < on_car * 9,
        "the car moves during the sweep"
    );
    assert_eq!(
        session.gpu().take_validation_messages(),
        Vec::<String>::new()
    );

    let elsewhere = Session::open(&SessionOptions::default()).unwrap();
    let refused = elsewhere.batch_renderer().trace(&world, &lidar, 0.0, mode);
    assert!(matches!(refused, Err(SessionError::OtherSession { .. })));
    let mut agents = [placed];
    agents[0].motion.velocity_mps.x = f64::NAN;
    let agents = agents.map(|agent| ("car".to_owned(), agent));
    world.set_agents(agents).unwrap();
    let refused = renderer.trace(&world, &lidar, 0.0, mode).unwrap_err();
    assert!(refused.to_string().contains("NaN"), "{refused}");
}

/// Largest difference of the transmittance of beams from that of all `agents` splats by definition,
/// as a share of the latter, and the number of beams that meet some.
fn missed(gpu: &Validated, listed: &[(Pose, u64)], defined: &[(Pose, u64)]) -> (f64, usize) {
    let world = surroundings(0, 1);
    let resident = ResidentSplats::upload(gpu, &world, Storage::Exact).unwrap();
    let mut pool = AssetPool::new(gpu).unwrap();
    let mut agents = Vec::new();
    for &(pose, seed) in listed {
        let asset = pool.add(&coded_car(400, seed)).unwrap();
        agents.push(Agent::new(asset, pose, 1));
    }
    let decoded: Vec<_> = defined
        .iter()
        .map(|&(pose, seed)| (pose, coded_car(400, seed).decoded(0)))
        .collect();
    let group = |splats, world_from_splats| SplatGroup {
        splats,
        instances: &[],
        instance: 0,
        world_from_splats,
        motion: Motion::REST,
    };
    let mut groups = vec![group(&world.splats, Pose::IDENTITY)];
    groups.extend(decoded.iter().map(|(pose, splats)| group(splats, *pose)));
    let truth = LidarSplats64 {
        groups,
        rules: Rules::DEFAULT,
    };
    let mut renderer = LidarRenderer::new(gpu, LidarOptions::default());
    let (mut worst, mut met) = (0.0f64, 0);
    for (_, model) in models() {
        let lidar = lidar_at(model, DVec3::ZERO, Motion::REST);
        let frame_agents = FrameAgents::new(&agents[..]);
        let scene = FrameSplats::with_agents(&resident, &pool, &frame_agents);
        let traced = renderer.trace(scene, &lidar, ReturnMode::Median).unwrap();
        let hits = truth.hits(&lidar, &traced.beams);
        for (state, hit) in traced.states.iter().zip(&hits) {
            // Beams end below 1e-4.
            if hit.transmittance > 1e-3 {
                let share = f64::from(state.transmittance) / hit.transmittance - 1.0;
                worst = worst.max(share.abs());
                met += usize::from(hit.transmittance < 0.99);
            }
        }
    }
    (worst, met)
}

#[test]
fn no_beam_misses_a_splat_of_an_agent() {
    // The transmittance does not depend on the order: one splat that a beam misses makes it larger
    // by 1/255 or more.
    let gpu = Validated::open();
    let at = |yaw_rad, x, y| Pose::from_yaw(yaw_rad, DVec3::new(x, y, -0.4));
    let agents = [
        (at(0.3, 7.0, 4.0), 2),
        (at(-2.0, -5.0, 3.0), 3),
        (at(1.0, -9.0, 0.2), 4),
        (at(0.0, 3.0, -2.5), 5),
    ];
    let (worst, met) = missed(&gpu, &agents, &agents);
    println!("{met} beams: transmittance {worst:.1e} off at most");
    assert!(met > 1000 && worst < 1e-3, "{worst} of {met} beams");
    let (worst, _) = missed(&gpu, &agents[..3], &agents);
    assert!(worst > 0.1, "an agent that is missed is noticed");
}

/// A sweep of `model` at the origin, whose world is at its start.
fn sweep_of(model: LidarModel, mode: ReturnMode) -> RigSweep {
    RigSweep {
        lidar: lidar_at(model, DVec3::ZERO, Motion::REST),
        world_s: 0.0,
        mode,
    }
}

#[test]
fn sweeps_in_flight_are_those_that_were_waited_for() {
    let session = validated_session();
    let scene = session.add_scene(&scene()).unwrap();
    let world = World::empty(&scene);
    // The lists of later ones outgrow the room that those before found, while others are on the
    // device.
    let sizes = [(4, 90), (8, 180), (16, 720), (4, 90), (40, 720)];
    let modes = [ReturnMode::Median, ReturnMode::Dual].into_iter().cycle();
    let sweeps: Vec<RigSweep> = (sizes.into_iter().zip(modes))
        .map(|((rings, columns), mode)| {
            let elevations = uniform(rings, 12.0, -20.0);
            sweep_of(spinning(&elevations, columns, 360.0, Spin::Clockwise), mode)
        })
        .collect();
    let alone: Vec<TracedSweep> = sweeps
        .iter()
        .map(|sweep| {
            let mut renderer = session.batch_renderer();
            let RigSweep {
                lidar,
                world_s,
                mode,
            } = sweep;
            renderer.trace(&world, lidar, *world_s, *mode).unwrap()
        })
        .collect();
    let is_met = |sweep: &TracedSweep| sweep.states.iter().any(|state| state.transmittance < 0.5);
    assert!(alone.iter().all(is_met));
    assert!(alone[0].states != alone[1].states);
    let mut renderer = session.batch_renderer();
    let mut traced = Vec::new();
    let same = |traced: &[TracedSweep], alone: &[TracedSweep]| {
        assert_eq!(traced.len(), alone.len());
        for (number, (traced, alone)) in traced.iter().zip(alone).enumerate() {
            assert!(traced.states == alone.states, "sweep {number}");
            assert!(traced.echoes == alone.echoes, "echoes of sweep {number}");
        }
    };
    renderer.trace_all(&world, &sweeps, &mut traced).unwrap();
    same(&traced, &alone);
    // In memory of sweeps of other sizes.
    traced.reverse();
    renderer.trace_all(&world, &sweeps, &mut traced).unwrap();
    same(&traced, &alone);
    renderer.trace_all(&world, &[], &mut traced).unwrap();
    assert!(traced.is_empty());

    // A faulty sweep among good ones is told, and the next ones are as before.
    let mut faulty = sweeps.clone();
    faulty[3].lidar.motion.velocity_mps.x = f64::NAN;
    traced.extend(alone.iter().cloned());
    let refused = renderer.trace_all(&world, &faulty, &mut traced);
    assert!(refused.unwrap_err().to_string().contains("NaN"));
    assert!(traced.is_empty());
    renderer
        .trace_all(&world, &sweeps[1..3], &mut traced)
        .unwrap();
    same(&traced, &alone[1..3]);
    assert_eq!(
        session.gpu().take_validation_messages(),
        Vec::<String>::new()
    );
}
