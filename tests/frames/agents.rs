//! Agents: what is drawn through codebooks against the same splats decoded, placed and drawn by definition.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{Agent, AssetPool, OrderMode, RenderOptions, Renderer, Scene, reference};
use decouplegs::scene::{AgentPlacement, Bounds, Camera, CodedCloud, Intrinsics, Pose, Rules, ShFrame, SplatCodes, World};
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
            colour: random.below(100) as u16,
            dc_residual: [random.below(32) as i8 - 16, random.below(16) as i8 - 8, random.below(16) as i8 - 8],
        }
        .into()
    });
    let splats = splats.collect();
    let shape = |random: &mut Random| {
        let mut off = || random.between(-1.0, 1.0);
        let [yx, zx, zy] = [off(), off(), off()];
        [random.across_scales(0.1, 2.0), yx, random.across_scales(0.1, 2.0), zx, zy, random.across_scales(0.01, 2.0)]
    };
    CodedCloud {
        bounds: Bounds { min: [-2.2, -0.9, -0.75], max: [2.2, 0.9, 0.75] },
        log2_size_min: -7.0,
        log2_size_step: 4.0 / 255.0,
        dc_residual_step: [0.03, 0.02, 0.02],
        splats,
        levels: vec![count, coarse],
        shapes: (0..64).map(|_| shape(&mut random)).collect(),
        sh_degree: 3,
        colours: (0..1600)
            .map(|i| std::array::from_fn(|_| if i % 16 == 0 { random.between(-1.0, 1.5) } else { random.between(-0.2, 0.2) }))
            .collect(),
        sh_frame: ShFrame::Canonical,
        dims_m: [4.4, 1.8, 1.5],
    }
}

/// A wall of splats 12 m ahead and scattered ones before it; world axes: x forward, y left, z up.
pub fn background(count: usize, seed: u64) -> World {
    let mut random = Random(seed);
    let splats: Vec<Splat> = (0..count)
        .map(|_| Splat {
            mean_m: [random.between(2.0, 40.0), random.between(-12.0, 12.0), random.between(-3.0, 4.0)],
            scale_m: std::array::from_fn(|_| random.across_scales(0.01, 0.4)),
            rotation: std::array::from_fn(|_| random.between(-1.0, 1.0)),
            opacity: random.between(0.05, 0.95),
            rgb: std::array::from_fn(|_| random.between(0.0, 1.0)),
        })
        .collect();
    let mut world = world_of(&splats);
    world.splats = world.splats.select(&world.splats.spatial_order());
    world
}

/// A camera at `eye` that looks at `target`.
pub fn camera_towards(name: &str, eye: DVec3, target: DVec3, size: (u32, u32)) -> Camera {
    let pose = Pose::look_at(eye, target, DVec3::Z).unwrap();
    Camera { name: name.into(), intrinsics: Intrinsics::from_horizontal_fov(size.0, size.1, 1.2), world_from_camera: pose }
}

fn poses() -> Vec<(Pose, ShFrame)> {
    let turned = DQuat::from_rotation_z(2.1) * DQuat::from_rotation_x(0.4) * DQuat::from_rotation_y(-0.2);
    vec![
        (Pose::from_yaw(0.3, DVec3::new(8.0, 1.0, 0.0)), ShFrame::Canonical),
        (Pose::new(turned, DVec3::new(11.0, -3.0, 0.5)), ShFrame::Canonical),
        (Pose::new(turned, DVec3::new(9.0, 2.0, 0.2)), ShFrame::World),
        (Pose::from_yaw(-1.0, DVec3::new(-20.0, 0.0, 0.0)), ShFrame::Canonical),
    ]
}

/// `world` with the decoded cars baked into it.
fn baked(world: &World, cars: &[CodedCloud], poses: &[(Pose, ShFrame)]) -> World {
    let mut baked = world.clone();
    for (i, &(pose, sh_frame)) in poses.iter().enumerate() {
        let placement = AgentPlacement { name: format!("{i}"), asset: 0, world_from_agent: pose, sh_frame };
        baked.bake_agent(&cars[i % cars.len()].decoded(0), &placement).unwrap();
    }
    baked
}

#[test]
fn agents_are_the_decoded_splats_placed_in_the_world() {
    let gpu = Validated::open();
    let mut world = background(3000, 1);
    world.origin = DVec3::new(4.5e6, 0.7e6, 30.0);
    let moved: Vec<(Pose, ShFrame)> =
        poses().into_iter().map(|(pose, frame)| (Pose { translation: pose.translation + world.origin, ..pose }, frame)).collect();
    let cars = [coded_car(700, 2), coded_car(300, 3)];
    let cameras = [
        camera_towards("ahead", world.origin, world.origin + DVec3::new(10.0, 0.0, 0.2), (200, 120)),
        camera_towards(
            "beside",
            world.origin + DVec3::new(9.0, -7.0, 1.0),
            world.origin + DVec3::new(10.0, 0.0, 0.0),
            (150, 130),
        ),
        camera_towards("inside", world.origin + DVec3::new(8.2, 1.1, 0.1), world.origin + DVec3::new(10.0, 0.0, 0.0), (90, 70)),
    ];
    let mut renderer = Renderer::new(&gpu, RenderOptions { outputs: all_outputs(), ..RenderOptions::default() });
    let resident = renderer.upload(&world).unwrap();
    let mut pool = AssetPool::new(&gpu).unwrap();
    let assets = cars.each_ref().map(|car| pool.add(car).unwrap());
    let agents: Vec<Agent> = moved
        .iter()
        .enumerate()
        .map(|(i, &(world_from_agent, sh_frame))| Agent {
            asset: assets[i % 2],
            world_from_agent,
            sh_frame: Some(sh_frame),
            instance: i as u16 + 1,
        })
        .collect();
    let statistics = renderer.render(Scene { world: &resident, agents: Some((&pool, &agents)) }, &cameras).unwrap();
    assert_eq!(statistics.agents, 3, "the one behind all cameras is not sent to the device");
    let truth = baked(&world, &cars, &moved);
    for (picture, camera) in renderer.read_pictures().unwrap().iter().zip(&cameras) {
        let expected = reference::render(&truth, camera, &Rules::DEFAULT).to_picture();
        let difference = Difference::between(picture, &expected).unwrap();
        println!("{}: {:.1} dB, max {:.5}", camera.name, difference.psnr_db, difference.max_abs);
        assert!(difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX, "{}: {difference:?}", camera.name);
        let ids = |picture: &decouplegs::render::Picture| picture.instance.clone().unwrap();
        let other = ids(picture).iter().zip(ids(&expected)).filter(|(a, b)| **a != *b).count();
        assert!(other * 500 <= ids(picture).len(), "{other} pixels belong to another instance");
    }
}

#[test]
fn a_drive_gives_the_same_bytes_however_the_order_is_found() {
    let gpu = Validated::open();
    let world = background(9000, 4);
    let car = coded_car(400, 5);
    let orders = [OrderMode::Full, OrderMode::Exact];
    let mut renderers = orders.map(|order| Renderer::new(&gpu, RenderOptions { order, ..RenderOptions::default() }));
    let resident = renderers[0].upload(&world).unwrap();
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&car).unwrap();
    let mut paths = std::collections::BTreeMap::<String, usize>::new();
    for frame in 0..60 {
        let (eye, yaw) = drive(frame);
        let forward = DQuat::from_rotation_z(yaw) * DVec3::X;
        let side = DQuat::from_rotation_z(yaw + 1.0) * DVec3::X;
        let cameras = [camera_towards("front", eye, eye + forward, (160, 96)), camera_towards("side", eye, eye + side, (96, 96))];
        let agents = [
            Agent {
                asset,
                world_from_agent: Pose::from_yaw(0.1, DVec3::new(6.0 + 0.1 * frame as f64, 0.5, 0.0)),
                sh_frame: None,
                instance: 1,
            },
            Agent {
                asset,
                world_from_agent: Pose::from_yaw(3.0 - 0.01 * frame as f64, DVec3::new(15.0 - 0.2 * frame as f64, -2.0, 0.0)),
                sh_frame: None,
                instance: 2,
            },
        ];
        let pictures = renderers.each_mut().map(|renderer| {
            let statistics = renderer.render(Scene { world: &resident, agents: Some((&pool, &agents)) }, &cameras).unwrap();
            if renderer.options().order == OrderMode::Exact {
                for path in &statistics.orders {
                    *paths.entry(format!("{path:?}")).or_default() += 1;
                }
            }
            renderer.read_pictures().unwrap()
        });
        assert!(pictures[0] == pictures[1], "frame {frame} differs");
    }
    println!("{paths:?}");
}

/// Where the ego is and where it looks: straight on, slow and fast turns, a stop, a cut and a turn on the spot.
fn drive(frame: usize) -> (DVec3, f64) {
    let t = frame as f64;
    match frame {
        0..15 => (DVec3::new(0.1 * t, 0.0, 0.5), 0.0),
        15..30 => (DVec3::new(0.1 * t, 0.0, 0.5), 0.0004 * (t - 14.0)),
        30..40 => (DVec3::new(0.1 * t, 0.0, 0.5), 0.035 * (t - 29.0)),
        40..45 => (DVec3::new(4.0, 0.0, 0.5), 0.35),
        45..50 => (DVec3::new(30.0, 3.0, 1.0), 3.0),
        _ => (DVec3::new(0.0, 0.1 * (t - 50.0), 0.5), if frame % 2 == 0 { 0.0 } else { std::f64::consts::PI }),
    }
}
