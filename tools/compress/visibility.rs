//! How much of each splat is seen from all around.

use anyhow::{Context, Result};
use decouplegs::gpu::Gpu;
use decouplegs::render::{Outputs, RenderOptions, Renderer};
use decouplegs::scene::{Camera, SplatCloud, World};

use crate::progress;

/// Cameras of one submission: the weights of all its pixels are counted in one 32-bit sum.
const CAMERAS_AT_ONCE: usize = 4;

/// For each splat the mean over `cameras` of its blending weights, summed over pixels.
pub fn visibility(gpu: &Gpu, cloud: &SplatCloud, cameras: &[Camera]) -> Result<Vec<f32>> {
    let outputs = Outputs { contributions: true, ..Outputs::default() };
    let mut renderer = Renderer::new(gpu, RenderOptions { outputs, sh_degree_max: 0, ..RenderOptions::default() });
    let order = cloud.spatial_order();
    let resident = renderer.upload(&World::of(cloud.select(&order)))?;
    let bar = progress::bar("visibility", cameras.len());
    let mut sums = vec![0.0f64; cloud.len()];
    for cameras in cameras.chunks(CAMERAS_AT_ONCE) {
        renderer.render(&resident, cameras).context("the visibility of the splats cannot be measured")?;
        for (&splat, weight) in order.iter().zip(renderer.read_contributions()?) {
            sums[splat as usize] += f64::from(weight);
        }
        bar.inc(cameras.len() as u64);
    }
    bar.finish_and_clear();
    Ok(sums.into_iter().map(|sum| (sum / cameras.len() as f64) as f32).collect())
}
