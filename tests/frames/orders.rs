//! Orders that are kept from frame to frame: the same bytes as a full sort, and what a stale one costs.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use decouplegs::render::metrics::Difference;
use decouplegs::render::{Agent, AssetPool, OrderMode, OrderPath, RenderOptions, Renderer, Scene};
use decouplegs::scene::{Camera, Pose};
use glam::{DQuat, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::{Splat, camera_at, world_of};
use crate::device::Validated;

/// Frames of the recorded drive.
const FRAMES: usize = 200;

/// Where the ego is and where it looks: straight on, a stop, slow and fast turns, teleports, camera cuts, turns on the spot,
/// and the jitter of a hand.
fn drive(frame: usize) -> (DVec3, f64) {
    let t = frame as f64;
    match frame {
        0..50 => (DVec3::new(0.05 * t, 0.01 * t, 0.5), 0.0),
        50..60 => (DVec3::new(2.5, 0.5, 0.5), 0.0),
        60..90 => (DVec3::new(0.05 * t, 0.0, 0.5), 0.000_004 * (t - 59.0)),
        90..110 => (DVec3::new(0.05 * t, 0.0, 0.5), 0.035 * (t - 89.0)),
        110..120 => (DVec3::new(6.0, 1.0, 0.5), 0.71),
        120..125 => (DVec3::new(30.0, 3.0, 1.0), 3.0),
        125..140 => (DVec3::new(0.0, 0.1 * (t - 125.0), 0.5), if frame.is_multiple_of(2) { 0.0 } else { PI }),
        140..170 => (DVec3::new(0.05 * (t - 140.0), 0.0, 0.5), 0.000_03 * (t * 7.3).sin()),
        _ => (DVec3::new(3.0 - 0.1 * (t - 170.0), 0.0, 0.8), 0.002 * (t - 169.0)),
    }
}

fn rig(frame: usize) -> [Camera; 2] {
    let (eye, yaw) = drive(frame);
    let towards = |turn: f64| eye + DQuat::from_rotation_z(yaw + turn) * DVec3::X;
    [camera_towards("front", eye, towards(0.0), (96, 64)), camera_towards("side", eye, towards(1.0), (64, 64))]
}

#[test]
fn a_drive_gives_the_same_bytes_however_the_order_is_found() {
    let gpu = Validated::open();
    let world = background(6000, 4);
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&coded_car(300, 5)).unwrap();
    let orders = [OrderMode::Full, OrderMode::Exact];
    let mut renderers = orders.map(|order| Renderer::new(&gpu, RenderOptions { order, ..RenderOptions::default() }));
    let resident = renderers[0].upload(&world).unwrap();
    let mut paths = BTreeMap::<String, usize>::new();
    let mut straight = Vec::new();
    for frame in 0..FRAMES {
        let t = frame as f64;
        let agent = |world_from_agent, instance| Agent::new(asset, world_from_agent, instance);
        let agents = [
            agent(Pose::from_yaw(0.1, DVec3::new(6.0 + 0.1 * t, 0.5, 0.0)), 1),
            agent(Pose::from_yaw(3.0 - 0.01 * t, DVec3::new(15.0 - 0.05 * t, -2.0, 0.0)), 2),
        ];
        let pictures = renderers.each_mut().map(|renderer| {
            let statistics = renderer.render(Scene::with_agents(&resident, &pool, &agents), &rig(frame)).unwrap();
            if renderer.options().order == OrderMode::Exact {
                for path in &statistics.orders {
                    *paths.entry(format!("{path:?}")).or_default() += 1;
                }
                straight.push(statistics.orders.iter().all(|path| path.is_free_of_sorting()));
            } else {
                assert!(statistics.orders.iter().all(|&path| path == OrderPath::Sorted));
            }
            renderer.read_pictures().unwrap()
        });
        assert!(pictures[0] == pictures[1], "frame {frame} differs");
    }
    println!("{paths:?}");
    // The ranks of two views are found in the second and third frame; from then on nothing is sorted as long as it drives
    // straight on, or stands.
    assert!(straight[3..60].iter().all(|&free| free), "driving straight on sorted: {straight:?}");
    for path in ["Sorted", "Found", "Kept", "Repaired"] {
        assert!(paths.contains_key(path), "no view was {path}: the drive proves too little");
    }
}

#[test]
fn a_repair_that_is_not_enough_is_noticed_and_sorted() {
    let gpu = Validated::open();
    // Splats close behind each other far to the side: a turn of 40 microradians reorders them over thousands of places.
    let splats: Vec<Splat> = (0..9000)
        .map(|i| {
            let (side, row) = (((i % 90) as f32 - 45.0) * 2.0, (i / 90) as f32);
            Splat {
                scale_m: [0.3; 3],
                opacity: 0.2,
                rgb: [(i % 7) as f32 / 7.0, 0.5, (i % 3) as f32 / 3.0],
                ..Splat::at(side, row * 0.1 - 5.0, 60.0 + ((i * 37) % 9000) as f32 * 2e-7)
            }
        })
        .collect();
    let world = world_of(&splats);
    let turned = |angle: f64| {
        let camera = camera_at(DVec3::ZERO, 160, 90);
        [Camera { world_from_camera: Pose::new(DQuat::from_rotation_y(angle), DVec3::ZERO), ..camera }]
    };
    let mut exact = Renderer::new(&gpu, RenderOptions::default());
    let mut full = Renderer::new(&gpu, RenderOptions { order: OrderMode::Full, ..RenderOptions::default() });
    let resident = exact.upload(&world).unwrap();
    let mut paths = Vec::new();
    // Every angle is another by more than the last tenth of what is repaired: none is worth finding ranks for.
    for angle in [0.0, 0.0, 0.0].into_iter().chain((0..12).map(|i| 0.000_04 + 0.000_015 * f64::from(i % 2))) {
        let statistics = exact.render(&resident, &turned(angle)).unwrap();
        paths.push(statistics.orders[0]);
        assert_eq!(statistics.inversions[0] > 0, statistics.orders[0] == OrderPath::RepairFailed);
        full.render(&resident, &turned(angle)).unwrap();
        assert!(exact.read_pictures().unwrap() == full.read_pictures().unwrap(), "at {angle}: {paths:?}");
    }
    println!("{paths:?}");
    assert_eq!(paths[..4], [OrderPath::Sorted, OrderPath::Found, OrderPath::Kept, OrderPath::RepairFailed]);
    assert!(!paths[4..].contains(&OrderPath::RepairFailed), "after a failure only smaller turns are repaired: {paths:?}");
}

#[test]
fn a_stale_order_says_what_it_costs() {
    let gpu = Validated::open();
    let world = background(6000, 6);
    let mut bounded = Renderer::new(
        &gpu,
        RenderOptions { order: OrderMode::Bounded { angle_rad: 0.2, measured_one_of: 1 }, ..RenderOptions::default() },
    );
    let mut full = Renderer::new(&gpu, RenderOptions { order: OrderMode::Full, ..RenderOptions::default() });
    let resident = bounded.upload(&world).unwrap();
    let mut draw = |yaw: f64| {
        let forward = DQuat::from_rotation_z(yaw) * DVec3::X;
        let cameras = [camera_towards("front", DVec3::ZERO, forward, (160, 96))];
        let statistics = bounded.render(&resident, &cameras).unwrap();
        full.render(&resident, &cameras).unwrap();
        let difference = Difference::between(&bounded.read_pictures().unwrap()[0], &full.read_pictures().unwrap()[0]).unwrap();
        (statistics, difference)
    };
    for yaw in [0.0, 0.0] {
        let (_, difference) = draw(yaw);
        assert_eq!(difference.max_abs, 0.0);
    }
    let mut last = 0.0;
    for yaw in [0.002, 0.02, 0.15] {
        let (statistics, difference) = draw(yaw);
        let error = statistics.order_error.unwrap();
        println!(
            "{yaw}: {:?}, {} inversions, said {error:?}, is {:.5}",
            statistics.orders, statistics.inversions[0], difference.max_abs
        );
        assert_eq!(statistics.orders, [OrderPath::Stale]);
        assert!(statistics.inversions[0] > 0 && error.max > last, "a wider turn costs more");
        last = error.max;
        // To first order: what is said and what is found are of one size.
        let found = difference.max_abs as f32;
        assert!(found <= 3.0 * error.max && error.max <= 30.0 * found.max(1e-4), "said {}, found {found}", error.max);
    }
    let (statistics, difference) = draw(0.5);
    assert_eq!((statistics.orders[0], difference.max_abs), (OrderPath::Sorted, 0.0), "beyond the angle it is sorted");
}

#[test]
fn a_frame_that_is_refused_leaves_no_order_behind_that_was_never_found() {
    let gpu = Validated::open();
    let world = background(2000, 8);
    let mut exact = Renderer::new(&gpu, RenderOptions::default());
    let resident = exact.upload(&world).unwrap();
    exact.render(&resident, &rig(0)).unwrap();
    // The second frame would find ranks; it has no room for its pictures.
    let mut huge = rig(1);
    for camera in &mut huge {
        camera.intrinsics = camera.intrinsics.resized(65_536, 65_536);
    }
    assert!(exact.render(&resident, &huge).is_err());
    let mut full = Renderer::new(&gpu, RenderOptions { order: OrderMode::Full, ..RenderOptions::default() });
    full.render(&resident, &rig(1)).unwrap();
    for _ in 0..4 {
        exact.render(&resident, &rig(1)).unwrap();
        assert!(exact.read_pictures().unwrap() == full.read_pictures().unwrap());
    }
}
