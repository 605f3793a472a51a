//! Images through lenses that are no pinhole.

use std::sync::Arc;

use decouplegs::render::metrics::Difference;
use decouplegs::render::{
    Agent, AssetPool, FrameAgents, FrameSplats, RenderOptions, Renderer, reference,
};
use decouplegs::scene::lens::{Fisheye, OpenCv, Windshield, WindshieldDirection};
use decouplegs::scene::{
    AgentPlacement, Camera, Intrinsics, Lens, Pose, Rules, ShFrame, SplatScene,
};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::{DMat3, DVec2, DVec3};

use super::agents::{background, camera_towards, coded_car};
use super::hard_cases::crowd;
use super::sky::noise;
use super::{ERROR_MAX, PSNR_MIN_DB, Splat, all_outputs, assert_exact, camera_at, draw, world_of};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

/// The lenses of the stages' rig, all where the first of its cameras stands.
fn cameras() -> Vec<Camera> {
    let rig = lens_rig();
    let pose = rig[0].world_from_camera;
    rig.into_iter()
        .map(|camera| Camera {
            world_from_camera: pose,
            ..camera
        })
        .collect()
}

#[test]
fn a_crowd_through_every_lens() {
    let mut splats = crowd(400);
    // Beside and behind, and so near that points of the transform lie behind the camera.
    splats.extend(crowd(200).into_iter().map(|splat| Splat {
        mean_m: [splat.mean_m[0] * 4.0, splat.mean_m[1], 0.5],
        ..splat
    }));
    splats.extend(crowd(100).into_iter().map(|splat| Splat {
        mean_m: splat.mean_m.map(|x| -x),
        ..splat
    }));
    splats.extend((0..20).map(|i| Splat {
        scale_m: [0.5; 3],
        opacity: 0.1,
        ..Splat::at(0.1 * i as f32 - 1.0, 0.2, 0.05 * i as f32)
    }));
    assert_exact(&world_of(&splats), &cameras(), Rules::DEFAULT);
    assert_exact(
        &world_of(&splats),
        &cameras(),
        Rules {
            antialias: true,
            ..Rules::INRIA
        },
    );
}

/// Cameras behind a windshield: a pinhole, a distorted one and a fisheye.
fn behind_a_windshield() -> Vec<Camera> {
    let mut windshield = Windshield::straight();
    windshield.horizontal[0] = [0.003, 1.01, -0.004, 0.005, 0.0, -0.002];
    windshield.horizontal[1][1] = 0.006;
    windshield.vertical[0][2] = 0.008;
    windshield.vertical[1][0] = 0.985;
    let directions = [WindshieldDirection::Forward, WindshieldDirection::Backward];
    let behind = |(camera, direction): (Camera, WindshieldDirection)| Camera {
        intrinsics: Intrinsics {
            windshield: Some(Windshield {
                direction,
                ..windshield
            }),
            ..camera.intrinsics
        },
        ..camera
    };
    let cameras = cameras().into_iter().take(3);
    cameras
        .zip(directions.into_iter().cycle())
        .map(behind)
        .collect()
}

#[test]
fn a_crowd_through_a_windshield() {
    let world = world_of(&crowd(400));
    let (plain, cameras) = (cameras(), behind_a_windshield());
    assert_exact(&world, &cameras, Rules::DEFAULT);
    // The windshield moves what is seen by more than the error.
    let gpu = Validated::open();
    let plain: Vec<Camera> = plain.into_iter().take(3).collect();
    let [bent, straight] =
        [&cameras, &plain].map(|cameras| draw(&gpu, &world, cameras, Rules::DEFAULT));
    for (bent, straight) in bent.iter().zip(&straight) {
        assert!(Difference::between(bent, straight).unwrap().psnr_db < 40.0);
    }
}

#[test]
fn a_sky_through_a_windshield() {
    let world = SplatScene {
        sky_map: Some(Arc::new(noise(8, DMat3::IDENTITY))),
        ..world_of(&crowd(40))
    };
    assert_exact(&world, &behind_a_windshield(), Rules::DEFAULT);
}

#[test]
fn huge_and_thin_splats_through_every_lens() {
    let mut splats = crowd(60);
    for (i, splat) in splats.iter_mut().enumerate() {
        let length_m = 10f32.powi(i as i32 % 4);
        splat.scale_m = [
            [length_m, 1e-4, 1e-4],
            [length_m, length_m, 1e-5],
            [length_m; 3],
        ][i % 3];
        splat.opacity = 0.15;
    }
    assert_exact(&world_of(&splats), &cameras(), Rules::DEFAULT);
}

#[test]
fn a_street_with_agents_through_a_fisheye_and_an_f_theta_lens() {
    let street = Street::generate(&StreetOptions {
        background: 40_000,
        agents: 4,
        agent_splats: 2000,
        sh_degree: 1,
        ..StreetOptions::default()
    });
    let mut world = SplatScene {
        sky: street.sky,
        ..SplatScene::from_splats(street.background.clone())
    };
    for agent in &street.agents {
        world
            .bake_agent(&street.assets[agent.asset], agent)
            .unwrap();
    }
    let poses = street.rig.at(&street.ego[0].1);
    let cameras: Vec<Camera> = lens_rig()
        .into_iter()
        .skip(1)
        .zip(poses)
        .map(|(lens, camera)| Camera {
            intrinsics: lens.intrinsics.resized(240, 156),
            ..camera
        })
        .collect();
    assert_exact(&world, &cameras, Rules::DEFAULT);
}

#[test]
fn agents_through_lenses_are_the_decoded_splats_placed_in_the_world() {
    let gpu = Validated::open();
    let world = background(2000, 1);
    let car = coded_car(700, 2);
    let position = |x: f64, y: f64| Pose::from_yaw(0.3 * x, DVec3::new(x, y, 0.0));
    // The third one is beside the cameras, more than 45 degrees off, and the last behind.
    let poses = [
        position(8.0, 1.0),
        position(11.0, -3.0),
        position(4.0, 5.5),
        position(-20.0, 0.0),
    ];
    let ahead =
        camera_towards("ahead", DVec3::ZERO, DVec3::new(10.0, 0.0, 0.2), (4, 4)).world_from_camera;
    let cameras: Vec<Camera> = lens_rig()
        .into_iter()
        .map(|camera| Camera {
            world_from_camera: ahead,
            ..camera
        })
        .collect();
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    let mut pool = AssetPool::new(&gpu).unwrap();
    let asset = pool.add(&car).unwrap();
    let agents: Vec<Agent> = poses
        .iter()
        .zip(1..)
        .map(|(&pose, instance)| Agent::new(asset, pose, instance))
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
    let mut truth = world.clone();
    for (i, &world_from_agent) in poses.iter().enumerate() {
        let placement = AgentPlacement {
            name: format!("{i}"),
            asset: 0,
            world_from_agent,
            sh_frame: ShFrame::Canonical,
        };
        truth.bake_agent(&car.decoded(0), &placement).unwrap();
    }
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
    }
}

#[test]
fn a_lens_without_distortion_is_the_pinhole() {
    let gpu = Validated::open();
    let small: Vec<Splat> = crowd(3000)
        .into_iter()
        .map(|splat| Splat {
            scale_m: splat
                .scale_m
                .map(|scale| scale.min(0.004 * splat.mean_m[2])),
            ..splat
        })
        .collect();
    let world = world_of(&small);
    let plain = camera_at(DVec3::ZERO, 320, 200);
    let with = |lens: Lens| {
        let mut camera = plain.clone();
        camera.intrinsics.lens = lens;
        draw(&gpu, &world, &[camera], Rules::DEFAULT).remove(0)
    };
    let pinhole = with(Lens::Pinhole);
    assert!(
        with(Lens::OpenCv(OpenCv::default())) == pinhole,
        "no coefficient, and other bits"
    );
    // The least distortion takes the unscented transform instead of the linear one: where splats
    // are small, these agree.
    let least = with(Lens::OpenCv(OpenCv {
        radial: [1e-12, 0.0, 0.0, 0.0, 0.0, 0.0],
        ..OpenCv::default()
    }));
    let difference = Difference::between(&least, &pinhole).unwrap();
    println!(
        "{:.1} dB, max {:.5}",
        difference.psnr_db, difference.max_abs
    );
    assert!(difference.psnr_db > 60.0, "{difference:?}");
}

#[test]
fn a_pinhole_beside_a_lens_is_drawn_as_it_is_alone() {
    let gpu = Validated::open();
    let world = world_of(&crowd(1500));
    let all = cameras();
    let together = draw(&gpu, &world, &all, Rules::DEFAULT);
    let alone = draw(&gpu, &world, &all[..1], Rules::DEFAULT);
    let difference = Difference::between(&together[0], &alone[0]).unwrap();
    assert!(difference.psnr_db >= 110.0, "{difference:?}");
    // Lenses come and go with the frames of one renderer.
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(&world).unwrap();
    for (cameras, expected) in [
        (&all[..1], &alone),
        (&all[..], &together),
        (&all[..1], &alone),
        (&all[..], &together),
    ] {
        renderer.render(&resident, cameras).unwrap();
        assert!(
            renderer.read_images().unwrap() == *expected,
            "a frame remembers the lenses of another"
        );
    }
}

#[test]
fn a_marker_lands_on_its_pixel() {
    let gpu = Validated::open();
    for camera in cameras().into_iter().skip(1) {
        for pixel in [
            DVec2::new(207.0, 131.2),
            DVec2::new(110.4, 60.3),
            DVec2::new(300.7, 180.6),
            DVec2::new(150.1, 210.9),
        ] {
            let ray = camera.intrinsics.unproject(pixel).unwrap();
            let mean_m = (camera.world_from_camera.transform(ray * 9.0))
                .as_vec3()
                .to_array();
            let world = world_of(&[Splat {
                mean_m,
                scale_m: [0.02; 3],
                ..Splat::at(0.0, 0.0, 0.0)
            }]);
            let image = draw(&gpu, &world, std::slice::from_ref(&camera), Rules::DEFAULT).remove(0);
            let (mut weight, mut position) = (0.0, DVec2::ZERO);
            for (index, &alpha) in image.alpha.iter().enumerate() {
                let (column, row) = (index as u32 % image.width, index as u32 / image.width);
                weight += f64::from(alpha);
                position +=
                    f64::from(alpha) * DVec2::new(f64::from(column) + 0.5, f64::from(row) + 0.5);
            }
            assert!(
                (position / weight - pixel).length() < 0.1,
                "{}: {} instead of {pixel}",
                camera.name,
                position / weight
            );
        }
    }
}

#[test]
fn lenses_that_make_no_image_are_refused_by_name() {
    let gpu = Validated::open();
    let mut renderer = Renderer::new(&gpu, RenderOptions::default());
    let resident = renderer.upload(&world_of(&crowd(10))).unwrap();
    for (lens, part) in [
        (
            Lens::Fisheye(Fisheye {
                radial: [f64::NAN, 0.0, 0.0, 0.0],
                ..Fisheye::default()
            }),
            "NaN",
        ),
        (
            Lens::Fisheye(Fisheye {
                radial: [-1.0, 0.0, 0.0, 0.0],
                ..Fisheye::default()
            }),
            "turns over",
        ),
        (
            Lens::OpenCv(OpenCv {
                radial: [-90.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                ..OpenCv::default()
            }),
            "folds",
        ),
    ] {
        let mut camera = camera_at(DVec3::ZERO, 64, 48);
        camera.intrinsics.lens = lens;
        let fault = renderer
            .render(&resident, &[camera])
            .unwrap_err()
            .to_string();
        assert!(
            fault.contains("camera test") && fault.contains(part),
            "{fault}"
        );
    }
}
