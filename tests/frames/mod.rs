//! Frames on the GPU against the f64 definition.

mod agents;
mod detail;
mod determinism;
mod editing;
mod faults;
mod fog;
mod geometry;
mod growth;
mod hard_cases;
mod in_flight;
mod kept_lists;
mod keys;
mod least_response;
mod lenses;
pub mod lidar;
mod light;
mod light_on_demand;
mod needles;
mod one_file;
mod outputs;
mod presence;
mod rig_devices;
mod rolling_shutter;
mod scenes;
pub mod sky;
mod storage;
mod views_of_one_world;
pub mod worlds;

pub use agents::background;

use decouplegs::render::metrics::Difference;
use decouplegs::render::{Image, Outputs, Planes, RenderOptions, Renderer, reference};
use decouplegs::scene::{Camera, Intrinsics, Motion, Pose, Rules, SplatCloud, SplatScene};
use glam::{DQuat, DVec3};

use crate::device::Validated;

/// Least PSNR of exact mode at equal rules (one flipped 1/255 decision moves a pixel by up to
/// 0.004).
pub const PSNR_MIN_DB: f64 = 95.0;
pub const ERROR_MAX: f64 = 0.01;

/// A splat to be put into a small world.
#[derive(Clone, Copy, Debug)]
pub struct Splat {
    pub mean_m: [f32; 3],
    pub scale_m: [f32; 3],
    pub rotation: [f32; 4],
    pub opacity: f32,
    pub rgb: [f32; 3],
}

impl Splat {
    /// A gray ball of 10 cm.
    pub fn at(x: f32, y: f32, z: f32) -> Self {
        Self {
            mean_m: [x, y, z],
            scale_m: [0.1; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: 0.8,
            rgb: [0.6, 0.5, 0.4],
        }
    }
}

/// A world of degree 0. Its camera frame is the world's: x right, y down, z forward.
pub fn world_of(splats: &[Splat]) -> SplatScene {
    SplatScene::from_splats(SplatCloud {
        means: splats.iter().map(|s| s.mean_m).collect(),
        scales: splats.iter().map(|s| s.scale_m).collect(),
        rotations: splats.iter().map(|s| s.rotation).collect(),
        opacities: splats.iter().map(|s| s.opacity).collect(),
        sh_degree: 0,
        sh_dc: splats
            .iter()
            .map(|s| s.rgb.map(|c| (c - 0.5) / 0.282_094_8))
            .collect(),
        sh_rest: vec![],
    })
}

/// A camera at `center` that looks along +z of the world, 60 degrees wide.
pub fn camera_at(center: DVec3, width_px: u32, height_px: u32) -> Camera {
    let intrinsics = Intrinsics::from_horizontal_fov(width_px, height_px, 60f64.to_radians());
    Camera {
        name: "test".into(),
        intrinsics,
        world_from_camera: Pose::new(DQuat::IDENTITY, center),
        motion: Motion::REST,
    }
}

/// Color in f32, and all planes that are blended together with it.
pub fn all_outputs() -> Outputs {
    Outputs {
        planes: Planes::BESIDE_COLOR,
        ..Outputs::default()
    }
}

/// Images from the GPU.
pub fn draw(gpu: &Validated, world: &SplatScene, cameras: &[Camera], rules: Rules) -> Vec<Image> {
    let mut renderer = Renderer::new(
        gpu,
        RenderOptions {
            rules,
            outputs: all_outputs(),
            ..RenderOptions::default()
        },
    );
    let resident = renderer.upload(world).unwrap();
    renderer.render(&resident, cameras).unwrap();
    renderer.read_images().unwrap()
}

/// The difference of the GPU's image from the definition, per camera.
pub fn differences(
    gpu: &Validated,
    world: &SplatScene,
    cameras: &[Camera],
    rules: Rules,
) -> Vec<Difference> {
    draw(gpu, world, cameras, rules)
        .iter()
        .zip(cameras)
        .map(|(image, camera)| {
            Difference::between(image, &reference::render(world, camera, &rules).to_image())
                .unwrap()
        })
        .collect()
}

/// Draws on the GPU and by definition, and holds them to what exact mode promises.
pub fn assert_exact(world: &SplatScene, cameras: &[Camera], rules: Rules) {
    let gpu = Validated::open();
    for (difference, camera) in differences(&gpu, world, cameras, rules).iter().zip(cameras) {
        println!(
            "{} {}: {:.1} dB, max {:.5}",
            gpu.info().name,
            camera.name,
            difference.psnr_db,
            difference.max_abs
        );
        assert!(
            difference.psnr_db >= PSNR_MIN_DB && difference.max_abs <= ERROR_MAX,
            "{}: {:.2} dB and {:.5} at most, against {PSNR_MIN_DB} and {ERROR_MAX}",
            camera.name,
            difference.psnr_db,
            difference.max_abs
        );
    }
}
