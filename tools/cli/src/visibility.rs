//! Visibility of each splat from all around.

use anyhow::{Context, Result};
use decouplegs_gpu::Gpu;
use decouplegs_render::{Outputs, RenderError, RenderOptions, Renderer, ResidentSplats};
use decouplegs_scene::{Camera, SplatCloud, SplatScene};

use crate::progress;

/// Cameras of one submission: the weights of all its pixels are counted in one 32-bit sum.
const CAMERAS_AT_ONCE: usize = 4;

/// Few lists of so small views are longer. Segments behind the first are blended twice where
/// weights are counted.
const SEGMENT_PAIRS: u32 = 8192;

/// Largest side of a view, pixels.
pub const VIEW_PX_MAX: u32 = 4096;

/// For each splat the mean over `cameras` of its blending weights, summed over pixels.
pub fn visibility(gpu: &Gpu, cloud: &SplatCloud, cameras: &[Camera]) -> Result<Vec<f32>> {
    let outputs = Outputs {
        contributions: true,
        ..Outputs::default()
    };
    let options = RenderOptions {
        outputs,
        sh_degree_max: 0,
        segment_pairs: SEGMENT_PAIRS,
        ..RenderOptions::default()
    };
    let mut renderer = Renderer::new(gpu, options);
    let order = cloud.spatial_order();
    let resident = renderer.upload(&SplatScene::from_splats(cloud.select(&order)))?;
    let ordered = mean_contributions(&mut renderer, &resident, cameras)
        .context("the visibility of the splats cannot be measured")?;
    let mut weights = vec![0.0; cloud.len()];
    order
        .iter()
        .zip(ordered)
        .for_each(|(&splat, weight)| weights[splat as usize] = weight);
    Ok(weights)
}

/// For each splat of `background` the mean over `cameras` of its contributions.
fn mean_contributions(
    renderer: &mut Renderer,
    background: &ResidentSplats,
    cameras: &[Camera],
) -> Result<Vec<f32>, RenderError> {
    let bar = progress::bar("visibility", cameras.len());
    let mut sums = vec![0.0f64; background.splats];
    for run in cameras.chunks(CAMERAS_AT_ONCE) {
        renderer.render(background, run)?;
        sums.iter_mut()
            .zip(renderer.read_contributions()?)
            .for_each(|(sum, weight)| *sum += f64::from(weight));
        bar.inc(run.len() as u64);
    }
    bar.finish_and_clear();
    Ok(sums
        .into_iter()
        .map(|sum| (sum / cameras.len() as f64) as f32)
        .collect())
}
