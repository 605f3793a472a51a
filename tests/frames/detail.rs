//! Levels of detail of the background: the device draws the cut that the host computes, and what
//! that costs in error.

use decouplegs::render::metrics::Difference;
use decouplegs::render::{
    FrameSplats, Image, LidarOptions, LidarRenderer, RenderOptions, Renderer, ResidentSplats,
    Storage,
};
use decouplegs::scene::lidar::ReturnMode;
use decouplegs::scene::{Camera, DetailLevels, Motion, Pose, Rules, SplatScene};
use decouplegs::synth::street::{Street, StreetOptions};
use glam::{DQuat, DVec3};

use super::lidar::{lidar_at, models};
use super::{all_outputs, camera_at, draw};
use crate::device::Validated;
use crate::stages::scenes::lens_rig;

/// A street in spatial order, without traffic.
fn street(splats: usize) -> (SplatScene, Vec<Camera>) {
    let street = Street::generate(&StreetOptions {
        seed: 4,
        background: splats,
        agents: 0,
        sh_degree: 1,
        ..StreetOptions::default()
    });
    let cloud = street.background.in_spatial_order();
    let world = SplatScene {
        sky: street.sky,
        ..SplatScene::from_splats(cloud)
    };
    (world, street.rig.at(&street.ego[0].1))
}

/// The camera with images of another size.
fn sized(camera: &Camera, width_px: u32, height_px: u32) -> Camera {
    let mut sized = camera.clone();
    sized.intrinsics = camera.intrinsics.resized(width_px, height_px);
    sized
}

/// Images of the renderer, and the number of visible splats.
fn draw_at(
    gpu: &Validated,
    world: &SplatScene,
    cameras: &[Camera],
    (pitch_px, storage): (Option<f64>, Storage),
) -> (Vec<Image>, u32) {
    let options = RenderOptions {
        outputs: all_outputs(),
        background_pitch_px: pitch_px,
        storage,
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(gpu, options);
    let resident = renderer.upload(world).unwrap();
    let statistics = renderer.render(&resident, cameras).unwrap();
    (renderer.read_images().unwrap(), statistics.required.records)
}

/// The world that a camera is shown, cut by the host.
fn cut(world: &SplatScene, levels: &DetailLevels, camera: &Camera, pitch_px: f32) -> SplatScene {
    let k = &camera.intrinsics;
    let center = camera.world_from_camera.translation.as_vec3();
    let splats = levels.cut(center, k.fx_px.max(k.fy_px) as f32, pitch_px);
    SplatScene {
        splats: levels.splats.select(&splats),
        ..world.clone()
    }
}

#[test]
fn each_camera_is_shown_the_cut_that_the_host_computes() {
    let gpu = Validated::open();
    let (world, rig) = street(60_000);
    let levels = DetailLevels::build(&world.splats, &[]);
    let mut cameras: Vec<Camera> = rig.iter().take(2).map(|c| sized(c, 200, 120)).collect();
    // A lens, and a camera far above the street.
    cameras.push(Camera {
        world_from_camera: cameras[0].world_from_camera,
        ..lens_rig().remove(2)
    });
    let down = Pose::new(
        DQuat::from_rotation_x(std::f64::consts::PI),
        DVec3::new(0.0, 0.0, 200.0),
    );
    cameras.push(Camera {
        world_from_camera: down,
        ..camera_at(DVec3::ZERO, 160, 120)
    });
    let mut drawn = vec![];
    for pitch_px in [1.0, 4.0, 20.0] {
        let at = (Some(f64::from(pitch_px)), Storage::Exact);
        let (images, records) = draw_at(&gpu, &world, &cameras, at);
        drawn.push(records);
        for (image, camera) in images.iter().zip(&cameras) {
            let seen = cut(&world, &levels, camera, pitch_px);
            let expected = draw(&gpu, &seen, std::slice::from_ref(camera), Rules::DEFAULT);
            let difference = Difference::between(image, &expected[0]).unwrap();
            println!(
                "{} at {pitch_px} px: {} splats, {:.1} dB",
                camera.name,
                seen.splats.len(),
                difference.psnr_db
            );
            assert!(difference.max_abs < 1e-5, "{}: {difference:?}", camera.name);
        }
        // And another cut shows.
        let other = cut(&world, &levels, &cameras[3], 2.0 * pitch_px);
        let other = draw(&gpu, &other, &cameras[3..], Rules::DEFAULT);
        assert!(Difference::between(&images[3], &other[0]).unwrap().max_abs > 1e-4);
    }
    assert!(drawn[0] > drawn[1] && drawn[1] > drawn[2], "{drawn:?}");
}

#[test]
fn levels_cost_nothing_when_off_and_change_nothing_at_zero_pixels() {
    let gpu = Validated::open();
    let (mut world, rig) = street(20_000);
    world.instance_from_splat = (0..world.splats.len()).map(|s| (s / 5000) as u16).collect();
    let cameras: Vec<Camera> = rig.iter().take(2).map(|c| sized(c, 160, 96)).collect();
    for storage in Storage::ALL {
        let [(off, _), (zero, _), (coarse, _)] = [None, Some(0.0), Some(8.0)]
            .map(|pitch_px| draw_at(&gpu, &world, &cameras, (pitch_px, storage)));
        assert_eq!(off, zero);
        assert_ne!(off, coarse);
    }
}

#[test]
fn a_street_is_near_its_finest_level_where_splats_are_a_pixel_apart() {
    let gpu = Validated::open();
    let (world, rig) = street(300_000);
    let cameras = [sized(&rig[0], 320, 180)];
    let (exact, all) = draw_at(&gpu, &world, &cameras, (None, Storage::Exact));
    for (pitch_px, least_db, most_share) in [(1.0, 70.0, 1.0), (2.0, 46.0, 0.85), (3.0, 42.0, 0.65)]
    {
        let (images, records) = draw_at(&gpu, &world, &cameras, (Some(pitch_px), Storage::Exact));
        let difference = Difference::between(&images[0], &exact[0]).unwrap();
        let share = f64::from(records) / f64::from(all);
        println!(
            "{pitch_px} px: {share:.2} of {all} splats, {:.1} dB",
            difference.psnr_db
        );
        assert!(
            difference.psnr_db >= least_db && share <= most_share,
            "{pitch_px} px: {share:.2} of the splats, {difference:?}"
        );
    }
}

#[test]
fn lidars_meet_the_finest_level() {
    let gpu = Validated::open();
    let (world, rig) = street(20_000);
    let center = rig[0].world_from_camera.translation;
    let scenes = [
        ResidentSplats::upload(&gpu, &world, Storage::Exact).unwrap(),
        ResidentSplats::upload_with_levels(&gpu, &world, Storage::Exact).unwrap(),
    ];
    let (_, model) = models().remove(0);
    let lidar = lidar_at(model, center, Motion::REST);
    let [plain, with_levels] = scenes.map(|scene| {
        let mut renderer = LidarRenderer::new(&gpu, LidarOptions::default());
        let traced = renderer.trace(FrameSplats::from(&scene), &lidar, ReturnMode::Strongest);
        traced.unwrap().states
    });
    assert!(plain.iter().any(|state| state.transmittance < 0.5));
    assert_eq!(plain, with_levels);
}
