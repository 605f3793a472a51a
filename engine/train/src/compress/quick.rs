//! Compression while a person waits: every splat that images show, with small codebooks.

use decouplegs_scene::codebook::{COLORS_MAX, SHAPES_MAX};
use decouplegs_scene::{CodedCloud, SplatCloud};

use super::{CompressError, CompressOptions, Prune, compress, prune};

/// Mini-batches for the codebooks.
const ITERATIONS_MAX: usize = 16;
/// Splats for each entry of the codebooks, where the books could hold more. With fewer, making the
/// books takes as long as using them.
const SPLATS_PER_ENTRY: usize = 16;
const ALL: Prune = Prune::KeepRatio(1.0);

/// Compresses `cloud`, an asset in its own frame, with all splats that images show, in seconds.
///
/// # Errors
/// Returns the errors of [`compress`].
pub fn compress_quickly(cloud: &SplatCloud) -> Result<CodedCloud, CompressError> {
    let entries = |max: usize| (cloud.len() / SPLATS_PER_ENTRY).clamp(64, max);
    let options = CompressOptions {
        prune: ALL,
        colors: entries(COLORS_MAX),
        shapes: entries(SHAPES_MAX),
        iterations_max: ITERATIONS_MAX,
        ..CompressOptions::default()
    };
    Ok(compress(cloud, &vec![1.0; cloud.len()], &options, &|_| {})?.cloud)
}

/// Length, width and height that [`compress_quickly`] gives to `cloud`, meters. None if no splat is
/// left.
#[must_use]
pub fn quick_dims_m(cloud: &SplatCloud) -> Option<[f32; 3]> {
    let kept = prune(cloud, &vec![1.0; cloud.len()], ALL);
    kept.least_importance?;
    let bounds = cloud.select(&kept.splats).bounds();
    Some(std::array::from_fn(|axis| {
        bounds.max[axis] - bounds.min[axis]
    }))
}
