//! Sky maps behind splats and calibrations of cameras, against the f64 definition.

use std::sync::Arc;

use decouplegs::asset::SkyKind;
use decouplegs::asset::sky_file;
use decouplegs::render::{ColorFormat, Image, Outputs, RenderOptions, Renderer, reference};
use decouplegs::scene::photometry::{ColorCurve, Response, Vignetting};
use decouplegs::scene::{Camera, Photometry, Pose, Rules, SkyMap, SplatScene};
use glam::{DMat3, DQuat, DVec3};

use super::hard_cases::crowd;
use super::{Splat, all_outputs, assert_exact, camera_at, draw, world_of};
use crate::device::Validated;
use crate::stages::Random;
use crate::stages::scenes::lens_rig;

/// A sky of random texels, also below 0 and above 1.
pub fn noise(face_texels: usize, world_from_sky: DMat3) -> SkyMap {
    let mut random = Random(face_texels as u64);
    let texels: Vec<[f32; 3]> = (0..6 * face_texels * face_texels)
        .map(|_| std::array::from_fn(|_| random.between(-0.2, 1.3)))
        .collect();
    SkyMap::new(face_texels, &texels, world_from_sky).unwrap()
}

/// A calibration with all stages; green has no exponent.
pub fn some_photometry(gamma: f64) -> Photometry {
    Photometry {
        exposure_ev: 0.4,
        curve: ColorCurve::Display,
        vignetting: Some(Vignetting {
            center_px: [[45.0, 30.0], [44.0, 31.0], [47.0, 28.0]],
            radius_px: [60.0, 60.0],
            rgb: [[-0.3, 0.05, 0.01], [-0.25, 0.0, -0.02], [-0.2, 0.0, 0.0]],
        }),
        balance: None,
        matrix: [
            [0.9, 0.1, -0.05, 0.02],
            [0.05, 1.05, 0.0, -0.01],
            [-0.1, 0.2, 0.8, 0.03],
        ],
        gamma: [gamma, 1.0, gamma],
        response: None,
    }
}

/// The calibration of a camera as PPISP has it: vignetting, balance and response.
pub fn ppisp_photometry() -> Photometry {
    Photometry {
        balance: Some([[1.05, -0.02, 0.01], [0.03, 0.96, 0.0], [0.04, -0.03, 1.0]]),
        response: Some(Response {
            toe: [1.2, 1.0, 0.9],
            shoulder: [1.1, 1.3, 1.0],
            gamma: [0.9, 0.7, 1.1],
            center: [0.4, 0.5, 0.6],
        }),
        matrix: Photometry::IDENTITY.matrix,
        gamma: [1.0; 3],
        ..some_photometry(1.0)
    }
}

/// Cameras that look along six axes and to a corner of the cube, 60 degrees wide.
fn around() -> Vec<Camera> {
    let towards = [
        DVec3::X,
        -DVec3::X,
        DVec3::Y,
        -DVec3::Y,
        DVec3::Z,
        -DVec3::Z,
        DVec3::new(1.0, -1.0, 1.0).normalize(),
    ];
    let camera = |(index, axis): (usize, DVec3)| {
        let center = DVec3::new(0.1, 0.2, -0.3);
        Camera {
            name: format!("towards {index}"),
            world_from_camera: Pose::new(DQuat::from_rotation_arc(DVec3::Z, axis), center),
            ..camera_at(center, 96, 64)
        }
    };
    towards.into_iter().enumerate().map(camera).collect()
}

fn world_under(sky: SkyMap) -> SplatScene {
    // Some half transparent, some opaque, some brighter than white.
    let mut splats = crowd(60);
    splats.iter_mut().step_by(3).for_each(|splat| {
        splat.rgb = [1.6, 0.4, 1.1];
        splat.opacity = 0.5;
    });
    SplatScene {
        sky: [9.0; 3],
        sky_map: Some(Arc::new(sky)),
        ..world_of(&splats)
    }
}

#[test]
fn skies_are_seen_in_every_direction_and_through_every_lens() {
    let turned = DMat3::from_axis_angle(DVec3::new(0.3, 0.8, -0.5).normalize(), 0.7);
    assert_exact(&world_under(noise(16, turned)), &around(), Rules::DEFAULT);
    let mut clamped = noise(5, DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0)));
    (clamped.clamps, clamped.clamps_splats) = (true, true);
    assert_exact(&world_under(clamped), &lens_rig(), Rules::INRIA);
    let faces = noise(3, turned).with_clamped_edges();
    assert_exact(&world_under(faces), &around(), Rules::DEFAULT);
}

/// Color of a splat of opacity one half before a sky: exact numbers, with and without clamping.
#[test]
fn splats_are_clamped_before_the_sky_is_added() {
    let gpu = Validated::open();
    let splat = Splat {
        scale_m: [50.0, 50.0, 1e-3],
        opacity: 0.5,
        rgb: [3.0, 1.0, 0.0],
        ..Splat::at(0.0, 0.0, 5.0)
    };
    for (clamps_splats, expected) in [(false, [1.9, 0.9, 0.4]), (true, [1.4, 0.9, 0.4])] {
        let mut sky = SkyMap::new(1, &[[0.8; 3]; 6], DMat3::IDENTITY).unwrap();
        sky.clamps_splats = clamps_splats;
        let world = SplatScene {
            sky_map: Some(Arc::new(sky)),
            ..world_of(&[splat])
        };
        let camera = camera_at(DVec3::ZERO, 9, 9);
        let truth = reference::render(&world, &camera, &Rules::DEFAULT).to_image();
        let image = &draw(&gpu, &world, &[camera], Rules::DEFAULT)[0];
        for found in [truth.rgb[40], image.rgb[40]] {
            for channel in 0..3 {
                assert!(
                    (found[channel] - expected[channel]).abs() < 1e-3,
                    "{found:?}"
                );
            }
        }
    }
}

/// Planes and alpha are those of the same world without a sky, to the last bit; a renderer draws
/// worlds with and without one by turns; bytes are the rounded color.
#[test]
fn only_color_changes_and_worlds_without_a_sky_are_what_they_were() {
    let gpu = Validated::open();
    let under = world_under(noise(8, DMat3::IDENTITY));
    let bare = SplatScene {
        sky_map: None,
        ..under.clone()
    };
    let cameras = [around(), lens_rig()].concat();
    let mut renderer = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let scenes = [&bare, &under, &bare].map(|world| renderer.upload(world).unwrap());
    let images = scenes.map(|scene| {
        renderer.render(&scene, &cameras).unwrap();
        renderer.read_images().unwrap()
    });
    let [before, with, after] = &images;
    assert!(before == after && before == &draw(&gpu, &bare, &cameras, Rules::DEFAULT));
    for (with, before) in with.iter().zip(before) {
        assert!(with.alpha == before.alpha && with.planes == before.planes);
        assert!(with.rgb != before.rgb);
    }
    let mut bytes = Renderer::new(
        &gpu,
        RenderOptions {
            outputs: Outputs {
                color: ColorFormat::U8,
                ..Outputs::default()
            },
            ..RenderOptions::default()
        },
    );
    let scene = bytes.upload(&under).unwrap();
    bytes.render(&scene, &cameras).unwrap();
    let off = |(rounded, exact): (&Image, &Image)| {
        let pairs = rounded
            .rgb
            .as_flattened()
            .iter()
            .zip(exact.rgb.as_flattened());
        pairs
            .map(|(rounded, exact)| (rounded - exact.clamp(0.0, 1.0)).abs())
            .fold(0.0, f32::max)
    };
    let rounded = bytes.read_images().unwrap();
    let worst = rounded.iter().zip(with).map(off);
    assert!(worst.fold(0.0, f32::max) <= 0.5001 / 255.0);
}

/// A lat-long image of the directions themselves: the sky of each pixel is its ray.
#[test]
fn a_lat_long_sky_shows_the_ray_of_each_pixel() {
    let (width, height) = (512u32, 256u32);
    let color = |x: u32, y: u32| {
        let azimuth = std::f64::consts::PI * (1.0 - 2.0 * (f64::from(x) + 0.5) / f64::from(width));
        let zenith = std::f64::consts::PI * (f64::from(y) + 0.5) / f64::from(height);
        let direction = DVec3::new(
            zenith.sin() * azimuth.cos(),
            zenith.sin() * azimuth.sin(),
            zenith.cos(),
        );
        image::Rgb((0.5 + 0.5 * direction).as_vec3().to_array())
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    image::Rgb32FImage::from_fn(width, height, color)
        .write_to(&mut bytes, image::ImageFormat::OpenExr)
        .unwrap();
    let sky = sky_file::decode(bytes.get_ref(), SkyKind::Equirect, DMat3::IDENTITY).unwrap();
    let world = SplatScene {
        sky_map: Some(Arc::new(sky)),
        ..SplatScene::default()
    };
    let gpu = Validated::open();
    let cameras = around();
    let images = draw(&gpu, &world, &cameras, Rules::DEFAULT);
    for (image, camera) in images.iter().zip(&cameras) {
        for pixel in (0..image.rgb.len()).step_by(37) {
            let (x, y) = (pixel as u32 % image.width, pixel as u32 / image.width);
            let center_px = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let ray = camera.intrinsics.unproject(center_px).unwrap();
            let truth = 0.5 + 0.5 * (camera.world_from_camera.rotation * ray);
            for (found, truth) in image.rgb[pixel].iter().zip(truth.to_array()) {
                assert!((f64::from(*found) - truth).abs() < 1.0 / 512.0);
            }
        }
    }
}

#[test]
fn calibrated_cameras_give_the_colors_of_the_definition() {
    let calibrated = |cameras: Vec<Camera>| -> Vec<Camera> {
        let gammas = [0.7, 1.0, 1.8].into_iter().cycle();
        let cameras = cameras.into_iter().zip(gammas);
        cameras
            .map(|(mut camera, gamma)| {
                camera.intrinsics.photometry = some_photometry(gamma);
                camera
            })
            .collect()
    };
    let turned = DMat3::from_rotation_x(0.5);
    let under = world_under(noise(6, turned));
    assert_exact(&under, &calibrated(around()), Rules::DEFAULT);
    let mut seen_by_ppisp = around();
    for camera in &mut seen_by_ppisp {
        camera.intrinsics.photometry = ppisp_photometry();
    }
    assert_exact(&under, &seen_by_ppisp, Rules::DEFAULT);
    let bare = SplatScene {
        sky_map: None,
        sky: [0.3, 0.5, 0.9],
        ..under
    };
    assert_exact(&bare, &calibrated(lens_rig()), Rules::INRIA);
}

/// A camera whose calibration changes nothing draws what it drew, beside one that has another.
#[test]
fn an_identity_beside_a_calibration_changes_no_bit() {
    let gpu = Validated::open();
    let world = SplatScene {
        sky: [0.3, 0.5, 0.9],
        ..world_of(&crowd(80))
    };
    let mut cameras = around();
    let plain = draw(&gpu, &world, &cameras, Rules::DEFAULT);
    cameras[2].intrinsics.photometry = some_photometry(0.8);
    let beside = draw(&gpu, &world, &cameras, Rules::DEFAULT);
    for (index, (plain, beside)) in plain.iter().zip(&beside).enumerate() {
        assert_eq!(plain == beside, index != 2, "{index}");
        assert!(plain.alpha == beside.alpha && plain.planes == beside.planes);
    }
}

/// The calibration of a scene is that of its cameras without one, in the images and in the
/// reference; a camera with its own keeps it.
#[test]
fn a_calibration_of_the_scene_serves_cameras_without_one() {
    let gpu = Validated::open();
    let bare = world_under(noise(6, DMat3::IDENTITY));
    let world = SplatScene {
        photometry: Photometry {
            vignetting: None,
            ..some_photometry(0.8)
        },
        ..bare.clone()
    };
    let mut cameras = around();
    cameras[1].intrinsics.photometry = some_photometry(1.8);
    let mut calibrated = cameras.clone();
    for camera in &mut calibrated {
        camera.intrinsics.photometry = world.photometry_of(&camera.intrinsics);
    }
    let found = draw(&gpu, &world, &cameras, Rules::DEFAULT);
    assert!(found == draw(&gpu, &bare, &calibrated, Rules::DEFAULT));
    let plain = draw(&gpu, &bare, &cameras, Rules::DEFAULT);
    for (index, (found, plain)) in found.iter().zip(&plain).enumerate() {
        assert_eq!(found == plain, index == 1, "{index}");
    }
    assert_exact(&world, &cameras, Rules::DEFAULT);
}
