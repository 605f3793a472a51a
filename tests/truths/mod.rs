//! Properties of any image that were derived by hand, without the f64 reference and without a twin.
//!
//! The definition's own truths stand in `engine/render/src/reference/truths.rs`; these hold the GPU
//! to the same mathematics.

mod agents;
mod light;
mod one_splat;
mod order;
mod properties;
mod rules;

use decouplegs::render::{Image, RenderOptions, Renderer};
use decouplegs::scene::{
    Camera, Intrinsics, Lens, Motion, Photometry, Pose, Rules, Shutter, SplatScene,
};

use crate::device::Validated;
use crate::frames::{Splat, all_outputs, world_of};

/// Rounding of f32 through projection, exponential and a few blends, on colors up to 1. A flipped
/// decision at 1/255 is a hundred times as much.
const ROUNDING: f32 = 4e-5;

const WHITE: [f32; 3] = [1.0; 3];
const RED: [f32; 3] = [1.0, 0.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 1.0];

/// Camera at the world's zero, looking along +z, `size_px` pixels square with a focal length of 100
/// pixels: an odd size puts a pixel's center on the axis.
fn square_camera(size_px: u32) -> Camera {
    let center_px = 0.5 * f64::from(size_px);
    Camera {
        name: "square".into(),
        intrinsics: Intrinsics {
            width_px: size_px,
            height_px: size_px,
            fx_px: 100.0,
            fy_px: 100.0,
            cx_px: center_px,
            cy_px: center_px,
            lens: Lens::Pinhole,
            photometry: Photometry::IDENTITY,
            windshield: None,
            shutter: Shutter::GLOBAL,
        },
        world_from_camera: Pose::IDENTITY,
        motion: Motion::REST,
    }
}

/// A splat that covers the image evenly: so wide and flat that its fall-off is below rounding.
fn sheet(z_m: f32, opacity: f32, rgb: [f32; 3]) -> Splat {
    Splat {
        scale_m: [1e4, 1e4, 1e-6],
        opacity,
        rgb,
        ..Splat::at(0.0, 0.0, z_m)
    }
}

/// One device and one renderer for many small worlds.
struct Easel {
    renderer: Renderer,
    /// Dropped last, because it fails the test if the layers had something to say.
    gpu: Validated,
}

impl Easel {
    fn new(rules: Rules) -> Self {
        let gpu = Validated::open();
        let renderer = Renderer::new(
            &gpu,
            RenderOptions {
                rules,
                outputs: all_outputs(),
                ..RenderOptions::default()
            },
        );
        Self { renderer, gpu }
    }

    fn draw(&mut self, world: &SplatScene, camera: &Camera) -> Image {
        let resident = self
            .renderer
            .upload(world)
            .unwrap_or_else(|error| panic!("{}: {error}", self.gpu.info()));
        self.renderer
            .render(&resident, std::slice::from_ref(camera))
            .unwrap();
        self.renderer.read_images().unwrap().remove(0)
    }
}

/// The middle pixel of what `splats` look like under `rules`: RGB and alpha.
fn middle_of(splats: &[Splat], rules: Rules) -> ([f32; 3], f32) {
    let image = Easel::new(rules).draw(&world_of(splats), &square_camera(9));
    (image.rgb[40], image.alpha[40])
}

/// The largest difference of a color channel or an alpha.
fn worst_difference(a: &Image, b: &Image) -> f32 {
    assert_eq!((a.width, a.height), (b.width, b.height));
    let values = |image: &Image| {
        image
            .rgb
            .iter()
            .flatten()
            .chain(&image.alpha)
            .copied()
            .collect::<Vec<_>>()
    };
    values(a)
        .iter()
        .zip(values(b))
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f32::max)
}
