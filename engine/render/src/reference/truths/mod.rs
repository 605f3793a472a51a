//! Properties of the reference itself, against closed forms that were derived by hand.

mod blending;
mod lenses;
mod limits;
mod projection;

use decouplegs_scene::{Camera, Intrinsics, Motion, Pose, Rules, SplatCloud, SplatScene, sh};

use super::Image64;
use super::project::{Projected64, View};

/// A splat of one color; `rgb` is what it shows.
struct Plain {
    mean: [f32; 3],
    scales: [f32; 3],
    opacity: f32,
    rgb: [f32; 3],
}

impl Plain {
    fn ball(mean: [f32; 3], scale: f32, opacity: f32, rgb: [f32; 3]) -> Self {
        Self {
            mean,
            scales: [scale; 3],
            opacity,
            rgb,
        }
    }
}

fn world_of(plain: &[Plain]) -> SplatScene {
    SplatScene::from_splats(SplatCloud {
        means: plain.iter().map(|splat| splat.mean).collect(),
        scales: plain.iter().map(|splat| splat.scales).collect(),
        rotations: vec![[1.0, 0.0, 0.0, 0.0]; plain.len()],
        opacities: plain.iter().map(|splat| splat.opacity).collect(),
        sh_degree: 0,
        sh_dc: plain
            .iter()
            .map(|splat| {
                splat
                    .rgb
                    .map(|value| ((f64::from(value) - 0.5) / sh::Y0) as f32)
            })
            .collect(),
        sh_rest: vec![],
    })
}

/// Camera at the world's zero, looking along +z with x right and y down; an odd size puts a pixel's
/// center on the axis.
fn camera(size_px: u32) -> Camera {
    Camera {
        name: "front".into(),
        intrinsics: Intrinsics::centered([size_px; 2], 100.0),
        world_from_camera: Pose::IDENTITY,
        motion: Motion::REST,
    }
}

fn middle(image: &Image64) -> usize {
    (image.width * image.height / 2) as usize
}

fn projected(splat_scene: &SplatScene, camera: &Camera, rules: &Rules) -> Option<Projected64> {
    View::new(splat_scene.origin, camera, rules).project(&splat_scene.splats, 0)
}

fn largest_difference(a: &Image64, b: &Image64) -> f64 {
    let channels = |image: &Image64| image.rgb.iter().flatten().copied().collect::<Vec<_>>();
    channels(a)
        .iter()
        .zip(channels(b))
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max)
}

const WHITE: [f32; 3] = [1.0; 3];
const RED: [f32; 3] = [1.0, 0.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];
