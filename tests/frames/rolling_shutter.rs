//! Rolling shutters against the f64 definition: each row is that of an image with all poses at its
//! own time.

use std::borrow::Cow;
use std::sync::Arc;

use decouplegs::render::metrics::Difference;
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, Image, RenderOptions, Renderer, reference,
};
use decouplegs::scene::{
    AgentPlacement, Camera, Intrinsics, Motion, Pose, Rules, ShFrame, Shutter, ShutterDirection,
    SplatScene,
};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::{DMat3, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::sky::noise;
use super::{Splat, all_outputs, camera_at, draw, world_of};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

const READOUT_S: f64 = 0.03;

/// Least PSNR on a street: one order per image and one linear motion per splat are approximations.
const PSNR_MIN_DB: f64 = 49.0;

/// Least PSNR behind a vehicle, where splats of the road come into view during the readout.
const BEHIND_PSNR_MIN_DB: f64 = 37.0;

/// Least PSNR for splats as near as 2 m, which come 0.9 m nearer during the readout.
const HARD_PSNR_MIN_DB: f64 = 40.0;

const ROLLING: [ShutterDirection; 4] = [
    ShutterDirection::TopToBottom,
    ShutterDirection::BottomToTop,
    ShutterDirection::LeftToRight,
    ShutterDirection::RightToLeft,
];

/// 30 m/s along x of the world, and 1 rad/s about its z.
fn fast(camera: &Camera) -> Motion {
    Motion {
        velocity_mps: DVec3::X * 30.0,
        turn_rad_per_s: camera.world_from_camera.rotation.conjugate() * DVec3::Z,
    }
}

fn rolling(camera: &Camera, direction: ShutterDirection, motion: Motion) -> Camera {
    let k = camera.intrinsics;
    Camera {
        intrinsics: Intrinsics {
            shutter: Shutter::new(direction, READOUT_S, [k.width_px, k.height_px]),
            ..k
        },
        motion,
        ..camera.clone()
    }
}

/// Cameras ahead and to the side of a vehicle, pinholes and a fisheye.
fn cameras() -> Vec<Camera> {
    let eye = DVec3::new(0.0, 0.0, 0.3);
    let size = (120, 80);
    let ahead = camera_towards("ahead", eye, DVec3::new(10.0, 0.5, 0.0), size);
    let side = camera_towards("side", eye, DVec3::new(6.0, 9.0, 0.0), size);
    let fisheye = Camera {
        name: "fisheye".into(),
        intrinsics: lens_rig()[2].intrinsics.resized(120, 80),
        ..ahead.clone()
    };
    vec![ahead, side, fisheye]
}

fn psnr_db(image: &Image, truth: &Image) -> f64 {
    Difference::between(image, truth).unwrap().psnr_db
}

#[test]
fn a_fast_camera_in_four_directions() {
    let gpu = Validated::open();
    let world = background(1500, 7);
    for camera in cameras() {
        let motion = fast(&camera);
        let cameras = ROLLING.map(|direction| rolling(&camera, direction, motion));
        let images = draw(&gpu, &world, &cameras, Rules::DEFAULT);
        let still = &draw(&gpu, &world, std::slice::from_ref(&camera), Rules::DEFAULT)[0];
        for ((image, rolling), direction) in images.iter().zip(&cameras).zip(ROLLING) {
            let truth = reference::render(&world, rolling, &Rules::DEFAULT).to_image();
            let (db, still_db) = (psnr_db(image, &truth), psnr_db(still, &truth));
            let name = &camera.name;
            println!("{name} {direction:?}: {db:.1} dB; with a global shutter {still_db:.1} dB");
            assert!(db >= HARD_PSNR_MIN_DB, "{name} {direction:?}: {db:.1} dB");
            assert!(still_db < db - 15.0, "the global shutter is as good");
        }
    }
}

#[test]
fn a_street_at_30_meters_per_second() {
    let gpu = Validated::open();
    let street = Street::generate(&StreetOptions {
        background: 200_000,
        agents: 4,
        agent_splats: 1000,
        sh_degree: 1,
        ..StreetOptions::default()
    });
    let mut world = SplatScene {
        sky: street.sky,
        ..SplatScene::from_splats(street.background.clone())
    };
    for agent in &street.agents {
        let asset = &street.assets[agent.asset];
        world.bake_agent(asset, agent).unwrap();
    }
    let ego = street.ego[0].1;
    let motion = Motion {
        velocity_mps: ego.rotation * DVec3::X * 30.0,
        turn_rad_per_s: DVec3::Z,
    };
    let mut rig = street.rig.clone();
    for (camera, direction) in rig.cameras_mut().zip(ROLLING.into_iter().cycle()) {
        camera.intrinsics = Intrinsics {
            shutter: Shutter::new(direction, READOUT_S, [128, 72]),
            ..camera.intrinsics.resized(128, 72)
        };
    }
    let cameras = rig.moving_at(&ego, &motion);
    let images = draw(&gpu, &world, &cameras, Rules::DEFAULT);
    for (image, camera) in images.iter().zip(&cameras) {
        let truth = reference::render(&world, camera, &Rules::DEFAULT).to_image();
        let (db, direction) = (
            psnr_db(image, &truth),
            camera.intrinsics.shutter.direction(),
        );
        println!("{} {direction:?}: {db:.1} dB", camera.name);
        let least = if camera.name == "back" {
            BEHIND_PSNR_MIN_DB
        } else {
            PSNR_MIN_DB
        };
        assert!(db >= least, "{}: {db:.1} dB", camera.name);
    }
}

/// Three cars ahead: one that crosses, one that turns, one at rest.
fn moving_cars() -> [(Pose, Motion); 3] {
    let motion = |x_mps: f64, y_mps: f64, turn: f64| Motion {
        velocity_mps: DVec3::new(x_mps, y_mps, 0.0),
        turn_rad_per_s: DVec3::Z * turn,
    };
    let at = |yaw_rad: f64, x: f64, y: f64| Pose::from_yaw(yaw_rad, DVec3::new(x, y, 0.0));
    [
        (at(1.5, 9.0, 1.0), motion(0.0, 20.0, 0.0)),
        (at(0.4, 11.0, -3.0), motion(5.0, -2.0, 0.5)),
        (at(0.0, 8.0, 4.0), Motion::REST),
    ]
}

fn draw_cars(
    gpu: &Validated,
    world: &SplatScene,
    cars: &[(Pose, Motion)],
    cameras: &[Camera],
) -> Vec<Image> {
    let options = RenderOptions {
        outputs: all_outputs(),
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(gpu, options);
    let resident = renderer.upload(world).unwrap();
    let mut pool = AssetPool::new(gpu).unwrap();
    let asset = pool.add(&coded_car(600, 2)).unwrap();
    let agents: Vec<Agent> = cars
        .iter()
        .zip(1..)
        .map(|(&(pose, motion), instance)| Agent {
            motion,
            ..Agent::new(asset, pose, instance)
        })
        .collect();
    let frame_agents = FrameAgents::new(&agents[..]);
    let scene = FrameSplats::with_agents(&resident, &pool, &frame_agents);
    renderer.render(scene, cameras).unwrap();
    renderer.read_images().unwrap()
}

fn with_cars(world: &SplatScene, cars: &[(Pose, Motion)], time_s: f64) -> SplatScene {
    let mut world = world.clone();
    let car = coded_car(600, 2).decoded(0);
    for (index, (pose, motion)) in cars.iter().enumerate() {
        let placement = AgentPlacement {
            name: index.to_string(),
            asset: 0,
            world_from_agent: pose.moved(motion, time_s),
            sh_frame: ShFrame::Canonical,
        };
        world.bake_agent(&car, &placement).unwrap();
    }
    world
}

#[test]
fn moving_agents_before_a_moving_camera_and_one_at_rest() {
    let gpu = Validated::open();
    let world = background(300, 1);
    let cars = moving_cars();
    let eye = DVec3::new(0.0, 0.0, 0.3);
    let camera = camera_towards("ahead", eye, DVec3::new(10.0, 0.5, 0.0), (120, 80));
    for motion in [fast(&camera), Motion::REST] {
        let cameras = [ShutterDirection::TopToBottom, ShutterDirection::RightToLeft]
            .map(|direction| rolling(&camera, direction, motion));
        let images = draw_cars(&gpu, &world, &cars, &cameras);
        for (image, camera) in images.iter().zip(&cameras) {
            let world_at = |time_s: f64| Cow::Owned(with_cars(&world, &cars, time_s));
            let truth = reference::render_moving(&world_at, camera, &Rules::DEFAULT).to_image();
            let db = psnr_db(image, &truth);
            let direction = camera.intrinsics.shutter.direction();
            println!("{direction:?}: {db:.1} dB");
            assert!(db >= PSNR_MIN_DB, "{direction:?}: {db:.1} dB");
        }
    }
}

#[test]
fn nothing_that_stands_still_changes_a_bit() {
    let gpu = Validated::open();
    let world = background(500, 3);
    let resting = moving_cars().map(|(pose, _)| (pose, Motion::REST));
    for camera in cameras() {
        let global = draw_cars(&gpu, &world, &resting, std::slice::from_ref(&camera));
        let rolled = rolling(&camera, ShutterDirection::LeftToRight, Motion::REST);
        assert!(global == draw_cars(&gpu, &world, &resting, &[rolled]));
        // A camera that moves while all its pixels are exposed at once shows the moment.
        let at_once = Camera {
            motion: fast(&camera),
            ..camera.clone()
        };
        assert!(global == draw_cars(&gpu, &world, &moving_cars(), &[at_once]));
        let moves = rolling(&camera, ShutterDirection::LeftToRight, fast(&camera));
        assert!(global != draw_cars(&gpu, &world, &resting, &[moves]));
    }
}

#[test]
fn a_car_that_moves_with_the_camera_is_not_sheared() {
    let gpu = Validated::open();
    let nothing = world_of(&[Splat {
        opacity: 0.001,
        ..Splat::at(0.0, 0.0, -5.0)
    }]);
    let eye = DVec3::new(0.0, 0.0, 0.3);
    let camera = camera_towards("ahead", eye, DVec3::new(10.0, 0.5, 0.0), (120, 80));
    let motion = Motion {
        velocity_mps: DVec3::new(17.0, 8.0, -1.0),
        turn_rad_per_s: DVec3::ZERO,
    };
    let car = |motion| [(Pose::from_yaw(0.3, DVec3::new(8.0, 0.0, 0.0)), motion)];
    let rolled = rolling(&camera, ShutterDirection::TopToBottom, motion);
    let [with, without] = [motion, Motion::REST].map(|of_car| {
        draw_cars(&gpu, &nothing, &car(of_car), std::slice::from_ref(&rolled)).remove(0)
    });
    let still = draw_cars(&gpu, &nothing, &car(Motion::REST), &[camera]).remove(0);
    assert!(
        psnr_db(&with, &still) > 90.0,
        "{:.1} dB",
        psnr_db(&with, &still)
    );
    assert!(psnr_db(&without, &still) < 40.0);
}

/// Center of gravity of a row's alpha, pixels.
fn center_of_row(image: &Image, row: u32) -> f64 {
    let first = (row * image.width) as usize;
    let alphas = &image.alpha[first..first + image.width as usize];
    let sum: f64 = alphas.iter().map(|&alpha| f64::from(alpha)).sum();
    let moment = |(column, &alpha): (usize, &f32)| (column as f64 + 0.5) * f64::from(alpha);
    alphas.iter().enumerate().map(moment).sum::<f64>() / sum
}

#[test]
fn a_pole_beside_the_road_leans_by_the_way_of_a_readout() {
    let gpu = Validated::open();
    // Splats at 10 m, one above the other.
    let pole: Vec<Splat> = (-100..=100)
        .map(|step| Splat {
            scale_m: [0.05; 3],
            ..Splat::at(0.3, 0.05 * step as f32, 10.0)
        })
        .collect();
    let camera = camera_at(DVec3::ZERO, 160, 120);
    let motion = Motion {
        velocity_mps: DVec3::X * 30.0,
        ..Motion::REST
    };
    let rolled = rolling(&camera, ShutterDirection::TopToBottom, motion);
    let image = &draw(&gpu, &world_of(&pole), &[rolled], Rules::DEFAULT)[0];
    let (low, high) = (20, 100);
    let slope = (center_of_row(image, high) - center_of_row(image, low)) / f64::from(high - low);
    let expected = -30.0 * READOUT_S / (120.0 * 10.0) * camera.intrinsics.fx_px;
    assert!(
        (slope / expected - 1.0).abs() < 0.005,
        "{slope} instead of {expected}"
    );
}

#[test]
fn small_splats_stand_where_their_rows_see_them() {
    let gpu = Validated::open();
    let mut far_px = Vec::new();
    for camera in cameras() {
        let motion = fast(&camera);
        for direction in ROLLING {
            let rolled = rolling(&camera, direction, motion);
            // One splat per image: its center of gravity is where it stands.
            for position in [[0.2, 0.3], [0.7, 0.4], [0.5, 0.8]] {
                let k = &camera.intrinsics;
                let size = [f64::from(k.width_px), f64::from(k.height_px)];
                let at_px = glam::DVec2::new(position[0] * size[0], position[1] * size[1]);
                let ray = k.unproject(at_px).unwrap();
                let mean = camera.world_from_camera.transform(ray * 8.0).as_vec3();
                let splat = Splat {
                    scale_m: [0.05; 3],
                    ..Splat::at(mean.x, mean.y, mean.z)
                };
                let world = world_of(&[splat]);
                let image = &draw(&gpu, &world, std::slice::from_ref(&rolled), Rules::DEFAULT)[0];
                let truth = reference::render(&world, &rolled, &Rules::DEFAULT).to_image();
                let centers = [image, &truth].map(center);
                far_px.push((centers[0] - centers[1]).length());
            }
        }
    }
    far_px.sort_by(f64::total_cmp);
    let most = far_px[far_px.len() - 1];
    println!(
        "{} splats, at most {most:.4} px from their positions",
        far_px.len()
    );
    assert!(most < 0.1, "{most} px");
}

/// Center of gravity of an image's alpha, pixels.
fn center(image: &Image) -> glam::DVec2 {
    let mut sum = 0.0;
    let mut moment = glam::DVec2::ZERO;
    for (index, &alpha) in image.alpha.iter().enumerate() {
        let (column, row) = (index as u32 % image.width, index as u32 / image.width);
        moment += f64::from(alpha) * (glam::DVec2::new(column.into(), row.into()) + 0.5);
        sum += f64::from(alpha);
    }
    moment / sum
}

#[test]
fn a_sky_is_seen_along_the_rays_of_each_row() {
    let gpu = Validated::open();
    let world = SplatScene {
        sky_map: Some(Arc::new(noise(16, DMat3::IDENTITY))),
        ..world_of(&[Splat::at(0.0, 0.0, 3.0)])
    };
    for camera in cameras() {
        let turning = Motion {
            turn_rad_per_s: DVec3::new(1.0, -2.0, 0.5),
            ..Motion::REST
        };
        let rolled = rolling(&camera, ShutterDirection::BottomToTop, turning);
        let image = &draw(&gpu, &world, std::slice::from_ref(&rolled), Rules::DEFAULT)[0];
        let truth = reference::render(&world, &rolled, &Rules::DEFAULT).to_image();
        let db = psnr_db(image, &truth);
        assert!(db > 75.0, "{}: {db:.1} dB", camera.name);
    }
}

#[test]
fn splats_that_pass_the_near_plane_during_the_readout_are_drawn() {
    let gpu = Validated::open();
    // At the middle of the readout it is 5 cm behind the camera; at its start 40 cm before it.
    let splat = Splat {
        scale_m: [0.03; 3],
        ..Splat::at(0.05, -0.1, -0.05)
    };
    let camera = camera_at(DVec3::ZERO, 96, 64);
    let motion = Motion {
        velocity_mps: DVec3::Z * 30.0,
        ..Motion::REST
    };
    let world = world_of(&[splat]);
    let rolled = rolling(&camera, ShutterDirection::TopToBottom, motion);
    let truth = reference::render(&world, &rolled, &Rules::DEFAULT);
    let seen = |alphas: &mut dyn Iterator<Item = f64>| alphas.filter(|&alpha| alpha > 0.5).count();
    let in_truth = seen(&mut truth.alpha.iter().copied());
    let image = &draw(&gpu, &world, &[rolled, camera], Rules::DEFAULT);
    let drawn = image
        .iter()
        .map(|image| seen(&mut image.alpha.iter().map(|&a| f64::from(a))));
    let drawn: Vec<usize> = drawn.collect();
    assert!(in_truth > 20, "{in_truth} pixels in the definition");
    assert!(drawn[0] > in_truth / 2, "{} of {in_truth} pixels", drawn[0]);
    assert_eq!(drawn[1], 0, "a global shutter does not see it");
}

#[test]
fn cameras_that_turn_too_far_are_refused() {
    let gpu = Validated::open();
    let mut renderer = Renderer::new(&gpu, RenderOptions::default());
    let resident = renderer.upload(&background(10, 1)).unwrap();
    let camera = camera_at(DVec3::ZERO, 32, 32);
    for (turn, word) in [(100.0, "1.50 rad"), (f64::NAN, "NaN")] {
        let motion = Motion {
            turn_rad_per_s: DVec3::Y * turn,
            ..Motion::REST
        };
        let rolled = rolling(&camera, ShutterDirection::TopToBottom, motion);
        let refused = renderer
            .render(&resident, &[rolled])
            .unwrap_err()
            .to_string();
        assert!(
            refused.contains("camera test") && refused.contains(word),
            "{refused}"
        );
    }
}
