//! How much of each splat is seen from all around.

use anyhow::{Context, Result};
use decouplegs::gpu::Gpu;
use decouplegs::render::{Outputs, RenderError, RenderOptions, Renderer, ResidentWorld};
use decouplegs::scene::{Camera, Intrinsics, SplatCloud, World};

use crate::arguments::warn;
use crate::progress;

/// Cameras of one submission: the weights of all its pixels are counted in one 32-bit sum.
const CAMERAS_AT_ONCE: usize = 4;

/// Largest side of a view, pixels.
pub const VIEW_PX_MAX: u32 = 4096;

/// For each splat the mean over `cameras` of its blending weights, summed over pixels. Where the device cannot draw so many
/// splats on so few pixels, the pictures are drawn at twice the size and so on, and the weights are of pixels as asked for.
pub fn visibility(gpu: &Gpu, cloud: &SplatCloud, cameras: &[Camera]) -> Result<Vec<f32>> {
    let outputs = Outputs { contributions: true, ..Outputs::default() };
    let mut renderer = Renderer::new(gpu, RenderOptions { outputs, sh_degree_max: 0, ..RenderOptions::default() });
    let order = cloud.spatial_order();
    let resident = renderer.upload(&World::of(cloud.select(&order)))?;
    let mut finer = 1;
    loop {
        let resized: Vec<Camera> = cameras.iter().map(|camera| finer_camera(camera, finer)).collect();
        let side_px = resized.iter().map(|camera| camera.intrinsics.width_px).max().unwrap_or(0);
        match mean_contributions(&mut renderer, &resident, &resized) {
            Err(RenderError::ListTooLong { .. }) if 2 * side_px <= VIEW_PX_MAX => {
                finer *= 2;
                warn(&format!("too many splats on too few pixels for this device: trying views of {} pixels", 2 * side_px));
            }
            Err(error) => return Err(error).context("the visibility of the splats cannot be measured"),
            Ok(ordered) => {
                let pixels_of_one = (finer * finer) as f32;
                let mut weights = vec![0.0; cloud.len()];
                order.iter().zip(ordered).for_each(|(&splat, weight)| weights[splat as usize] = weight / pixels_of_one);
                return Ok(weights);
            }
        }
    }
}

/// The view of `camera` on `finer` times as many pixels a side.
fn finer_camera(camera: &Camera, finer: u32) -> Camera {
    let Intrinsics { width_px, height_px, .. } = camera.intrinsics;
    Camera { intrinsics: camera.intrinsics.resized(width_px * finer, height_px * finer), ..camera.clone() }
}

/// For each splat of `world` the mean over `cameras` of its contributions.
fn mean_contributions(renderer: &mut Renderer, world: &ResidentWorld, cameras: &[Camera]) -> Result<Vec<f32>, RenderError> {
    let bar = progress::bar("visibility", cameras.len());
    let mut sums = vec![0.0f64; world.splats];
    for run in cameras.chunks(CAMERAS_AT_ONCE) {
        renderer.render(world, run)?;
        sums.iter_mut().zip(renderer.read_contributions()?).for_each(|(sum, weight)| *sum += f64::from(weight));
        bar.inc(run.len() as u64);
    }
    bar.finish_and_clear();
    Ok(sums.into_iter().map(|sum| (sum / cameras.len() as f64) as f32).collect())
}
