//! Agents: what is drawn through codebooks against the same splats decoded, placed and drawn by
//! definition.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, Image, RenderOptions, Renderer, reference,
};
use decouplegs::scene::{
    AgentPlacement, Bounds, Camera, CodedCloud, Fog, Intrinsics, Motion, Pose, Rules, ShFrame,
    SplatCodes, SplatScene,
};
use glam::{DQuat, DVec3};

use super::{ERROR_MAX, PSNR_MIN_DB, Splat, all_outputs, world_of};
use crate::device::Validated;
use crate::stages::Random;

/// A coded cloud of random splats in a box of a car's size, degree 3, of two levels of detail.
pub fn coded_car(count: usize, seed: u64) -> CodedCloud {
    let mut random = Random(seed);
    let coarse = count / 8;
    let splats = (0..count + coarse).map(|_| {
        SplatCodes {
            position: std::array::from_fn(|_| random.below(65_536) as u16),
            opacity: 20 + random.below(236) as u8,
            size: random.below(256) as u8,
            shape: random.below(64) as u16,
            color: random.below(100) as u16,
            dc_residual: [
                random.below(32) as i8 - 16,
                random.below(16) as i8 - 8,
                random.below(16) as i8 - 8,
            ],
        }
        .into()
    });
    let splats = splats.collect();
    let shape = |random: &mut Random| {
        let mut off = || random.between(-1.0, 1.0);
        let [yx, zx, zy] = [off(), off(), off()];
        [
            random.across_scales(0.1, 2.0),
            yx,
            random.across_scales(0.1, 2.0),
            zx,
            zy,
            random.across_scales(0.01, 2.0),
        ]
    };
    CodedCloud {
        bounds: Bounds {
            min: [-2.2, -0.9, -0.75],
            max: [2.2, 0.9, 0.75],
        },
        log2_size_min: -7.0,
        log2_size_step: 4.0 / 255.0,
        dc_residual_step: [0.03, 0.02, 0.02],
        splats,
        levels: vec![count, coarse],
        shapes: (0..64).map(|_| shape(&mut random)).collect(),
        sh_degree: 3,
        colors: (0..1600)
            .map(|i| {
                std::array::from_fn(|_| {
                    if i % 16 == 0 {
                        random.between(-1.0, 1.5)
                    } else {
                        random.between(-0.2, 0.2)
                    }
                })
            })
            .collect(),
        sh_frame: ShFrame::Canonical,
        dims_m: [4.4, 1.8, 1.5],
    }
}

/// A wall of splats 12 m ahead and scattered ones before it; world axes: x forward, y left, z up.
pub fn background(count: usize, seed: u64) -> SplatScene {
    let mut random = Random(seed);
    let splats: Vec<Splat> = (0..count)
        .map(|_| Splat {
            mean_m: [
                random.between(2.0, 40.0),
                random.between(-12.0, 12.0),
                random.between(-3.0, 4.0),
            ],
            scale_m: std::array::from_fn(|_| random.across_scales(0.01, 0.4)),
            rotation: std::array::from_fn(|_| random.between(-1.0, 1.0)),
            opacity: random.between(0.05, 0.95),
            rgb: std::array::from_fn(|_| random.between(0.0, 1.0)),
        })
        .collect();
    let mut world = world_of(&splats);
    world.splats = world.splats.in_spatial_order();
    world
}

/// A camera at `eye` that looks at `target`.
pub fn camera_towards(name: &str, eye: DVec3, target: DVec3, size: (u32, u32)) -> Camera {
    let pose = Pose::look_at(eye, target, DVec3::Z).unwrap();
    Camera {
        name: name.into(),
        intrinsics: Intrinsics::from_horizontal_fov(size.0, size.1, 1.2),
        world_from_camera: pose,
        motion: Motion::REST,
    }
}

fn poses() -> Vec<(Pose, ShFrame)> {
    let turned =
        DQuat::from_rotation_z(2.1) * DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(-0.2);
    vec![
        (
            Pose::from_yaw(0.3, DVec3::new(8.0, 1.0, 0.0)),
            ShFrame::Canonical,
        ),
        (
            Pose::new(turned, DVec3::new(11.0, -3.0, 0.5)),
            ShFrame::Canonical,
        ),
        (Pose::new(turned, DVec3::new(9.0, 2.0, 0.2)), ShFrame::World),
        (
            Pose::from_yaw(-1.0, DVec3::new(-20.0, 0.0, 0.0)),
            ShFrame::Canonical,
        ),
    ]
}

/// `world` with the decoded cars baked into it.
fn baked(world: &SplatScene, cars: &[CodedCloud], poses: &[(Pose, ShFrame)]) -> SplatScene {
    let mut baked = world.clone();
    for (i, &(pose, sh_frame)) in poses.iter().enumerate() {
        let placement = AgentPlacement {
            name: format!("{i}"),
            asset: 0,
            world_from_agent: pose,
            sh_frame,
        };
        baked
            .bake_agent(&cars[i % cars.len()].decoded(0), &placement)
            .unwrap();
    }
    baked
}

#[test]
fn agents_are_the_decoded_splats_placed_in_the_world() {
    let gpu = Validated::open();
    let mut world = background(3000, 1);
    world.origin = DVec3::new(4.5e6, 0.7e6, 30.0);
    let moved: Vec<(Pose, ShFrame)> = poses()
        .into_iter()
        .map(|(pose, frame)| {
            (
                Pose {
                    translation: pose.translation + world.origin,
                    ..pose
                },
                frame,
            )
        })
        .collect();
    let cars = [coded_car(700, 2), coded_car(300, 3)];
    let cameras = [
        camera_towards(
            "ahead",
            world.origin,
            world.origin + DVec3::new(10.0, 0.0, 0.2),
            (200, 120),
        ),
        camera_towards(
            "beside",
            world.origin + DVec3::new(9.0, -7.0, 1.0),
            world.origin + DVec3::new(10.0, 0.0, 0.0),
            (150, 130),
        ),
        camera_towards(
            "inside",
            world.origin + DVec3::new(8.2, 1.1, 0.1),
            world.origin + DVec3::new(10.0, 0.0, 0.0),
            (90, 70),
        ),
    ];
    for fog in [None, Some(Fog::new(0.05, [0.6, 0.7, 0.8]))] {
        world.fog = fog;
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                outputs: all_outputs(),
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        let mut pool = AssetPool::new(&gpu).unwrap();
        let assets = cars.each_ref().map(|car| pool.add(car).unwrap());
        let agents: Vec<Agent> = moved
            .iter()
            .enumerate()
            .map(|(i, &(world_from_agent, sh_frame))| Agent {
                sh_frame: Some(sh_frame),
                ..Agent::new(assets[i % 2], world_from_agent, i as u16 + 1)
            })
            .collect();
        let statistics = renderer
            .render(
                FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
                &cameras,
            )
            .unwrap();
        assert_eq!(
            statistics.agents, 3,
            "the one behind all cameras is not sent to the device"
        );
        let truth = baked(&world, &cars, &moved);
        for (image, camera) in renderer.read_images().unwrap().iter().zip(&cameras) {
            let expected = reference::render(&truth, camera, &Rules::DEFAULT).to_image();
            let difference = Difference::between(image, &expected).unwrap();
            println!(
                "{}: {:.1} dB, max {:.5}",
                camera.name, difference.psnr_db, difference.max_abs
            );
            assert!(
                difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
                "{}: {difference:?}",
                camera.name
            );
            let ids = |image: &Image| image.instance().unwrap().to_vec();
            let other = ids(image)
                .iter()
                .zip(ids(&expected))
                .filter(|(a, b)| **a != *b)
                .count();
            assert!(
                other * 500 <= ids(image).len(),
                "{other} pixels belong to another instance"
            );
        }
    }
}

/// Draws `agents` before `world` by a renderer of its own.
fn draw_agents(
    gpu: &Validated,
    world: &SplatScene,
    pool: &AssetPool,
    agents: &[Agent],
    cameras: &[Camera],
) -> Vec<Image> {
    let mut renderer = Renderer::new(
        gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(world).unwrap();
    renderer
        .render(
            FrameSplats::with_agents(&resident, pool, &FrameAgents::new(agents)),
            cameras,
        )
        .unwrap();
    renderer.read_images().unwrap()
}

#[test]
fn agents_come_go_change_and_move_between_frames() {
    let gpu = Validated::open();
    let world = background(1500, 21);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let [red, blue] = [coded_car(300, 22), coded_car(500, 23)].map(|car| pool.add(&car).unwrap());
    let cameras = [camera_towards("ahead", DVec3::ZERO, DVec3::X, (120, 80))];
    let agent = |asset, x: f64, instance| {
        Agent::new(
            asset,
            Pose::from_yaw(0.2 * x, DVec3::new(x, 0.3 * x - 2.0, 0.0)),
            instance,
        )
    };
    let frames = [
        vec![],
        vec![agent(red, 8.0, 1)],
        vec![agent(red, 8.0, 1), agent(blue, 9.0, 2)],
        vec![agent(blue, 8.0, 1), agent(red, 9.5, 2)],
        vec![agent(blue, 9.5, 2)],
        vec![],
    ];
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    for (index, agents) in frames.iter().enumerate() {
        renderer
            .render(
                FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
                &cameras,
            )
            .unwrap();
        let images = renderer.read_images().unwrap();
        assert!(
            images == draw_agents(&gpu, &world, &pool, agents, &cameras),
            "frame {index} remembers another"
        );
        let seen = |id: u16| images[0].instance().unwrap().contains(&id);
        assert_eq!(
            [seen(1), seen(2)],
            [1, 2].map(|id| agents.iter().any(|agent| agent.instance == id)),
            "frame {index}"
        );
    }
}

#[test]
fn an_asset_removed_is_drawn_by_the_frames_in_flight_and_by_no_other() {
    let gpu = Validated::open();
    let world = background(800, 31);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(300, 32)).unwrap();
    let cameras = [camera_towards("ahead", DVec3::ZERO, DVec3::X, (120, 80))];
    let pose = Pose::from_yaw(0.4, DVec3::new(8.0, 0.0, 0.0));
    let agents = [Agent::new(asset, pose, 1)];
    let expected = draw_agents(&gpu, &world, &pool, &agents, &cameras);
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    renderer
        .submit(
            FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
            &cameras,
        )
        .unwrap();
    pool.remove(asset).unwrap();
    // Its place is taken by another at once, and the pool grows.
    let others: Vec<Agent> = (0..3)
        .map(|i| Agent {
            asset: pool.add(&coded_car(400, 40 + i)).unwrap(),
            instance: 2,
            ..agents[0]
        })
        .collect();
    renderer
        .submit(
            FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&others[..])),
            &cameras,
        )
        .unwrap();
    renderer.finish().unwrap();
    assert!(
        renderer.read_images().unwrap() == expected,
        "the frame in flight lost its asset"
    );
    renderer.finish().unwrap();
    assert!(renderer.read_images().unwrap() == draw_agents(&gpu, &world, &pool, &others, &cameras));
    let stale = renderer
        .submit(
            FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
            &cameras,
        )
        .unwrap_err();
    assert!(stale.to_string().contains("removed"), "{stale}");
    let nowhere = [Agent {
        world_from_agent: Pose {
            translation: DVec3::NAN,
            ..pose
        },
        ..others[0]
    }];
    let error = renderer
        .submit(
            FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&nowhere[..])),
            &cameras,
        )
        .unwrap_err();
    assert!(error.to_string().contains("not finite"), "{error}");
}

#[test]
fn turning_world_agents_and_camera_together_changes_nothing() {
    let gpu = Validated::open();
    let world = background(1200, 51);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(400, 52)).unwrap();
    let pose = Pose::from_yaw(0.7, DVec3::new(9.0, 1.0, 0.1));
    let camera = camera_towards("ahead", DVec3::ZERO, DVec3::X, (160, 100));
    let agent = |world_from_agent| [Agent::new(asset, world_from_agent, 1)];
    let here = draw_agents(
        &gpu,
        &world,
        &pool,
        &agent(pose),
        std::slice::from_ref(&camera),
    );
    for turn in [
        DQuat::from_rotation_z(1.3),
        DQuat::from_rotation_x(2.0) * DQuat::from_rotation_y(0.4),
    ] {
        let turned = Pose::new(turn, DVec3::new(100.0, -40.0, 7.0));
        let moved = SplatScene {
            splats: world.splats.clone().placed(&turned, true),
            ..world.clone()
        };
        let there = Camera {
            world_from_camera: turned.then(&camera.world_from_camera),
            ..camera.clone()
        };
        let images = draw_agents(&gpu, &moved, &pool, &agent(turned.then(&pose)), &[there]);
        let difference = Difference::between(&images[0], &here[0]).unwrap();
        println!(
            "{:.1} dB, max {:.5}",
            difference.psnr_db, difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{difference:?}"
        );
    }
}

#[test]
fn a_far_agent_is_drawn_at_a_coarser_level() {
    let gpu = Validated::open();
    let world = background(200, 61);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let car = coded_car(800, 62);
    let asset = pool.add(&car).unwrap();
    let camera = [camera_towards("ahead", DVec3::ZERO, DVec3::X, (120, 80))];
    let drawn = |x: f64, level_pitch_px| {
        let mut renderer = Renderer::new(
            &gpu,
            RenderOptions {
                level_pitch_px,
                ..RenderOptions::default()
            },
        );
        let resident = renderer.upload(&world).unwrap();
        let agents = [Agent::new(asset, Pose::from_yaw(0.0, DVec3::X * x), 1)];
        renderer
            .render(
                FrameSplats::with_agents(&resident, &pool, &FrameAgents::new(&agents[..])),
                &camera,
            )
            .unwrap()
            .agent_splats
    };
    // Of 800 and 100 splats on about 30 m^2: 0.19 m and 0.55 m apart; 88 px a meter at 1 m.
    assert_eq!([drawn(10.0, None), drawn(200.0, None)], [800, 800]);
    assert_eq!(
        [drawn(10.0, Some(1.0)), drawn(200.0, Some(1.0))],
        [800, 100]
    );
    let worst = car.decoded(1);
    assert_eq!(worst.len(), 100);
}
