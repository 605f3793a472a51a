//! Compression of agents: from splats to a [`CodedCloud`], offline.
//!
//! Splats that matter little are pruned by [`importance`], the shapes and the colors of the others
//! become entries of two codebooks ([`vector_quantize`]), and coarser levels of detail are made of
//! the same entries ([`levels`]). Everything random follows from one seed; the result is the same
//! on any number of threads.

mod color_space;
mod encode;
mod importance;
pub mod levels;
mod options;
mod prune;
mod quick;
mod report;
mod shape_space;
#[cfg(test)]
mod tests;
mod vector_quantize;

pub use importance::importance;
pub use options::{CompressError, CompressOptions};
pub use prune::{Kept, Prune, THRESHOLD, prune};
pub use quick::{compress_quickly, quick_dims_m};
pub use report::{BookReport, CompressionReport, PartBytes};
pub use shape_space::ShapeSpace;
pub use vector_quantize::{
    Nearest, QuantizeOptions, Quantized, SearchBook, Vectors, vector_quantize,
};

use decouplegs_scene::{CodedCloud, SplatCloud, sh};

use encode::{Books, SHAPE_DIMENSION, SizeScale, shape_vectors};

/// Iterations over all splats that finish a codebook: beyond, an image gains less than 0.05 dB.
const FINAL_ITERATIONS: usize = 8;

/// Progress report of a compression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// Splats are weighed and pruned, then merged into levels.
    Pruning,
    /// The codebook of shapes is made; iterations done.
    Shapes(usize),
    /// The codebook of colors is made; iterations done.
    Colors(usize),
    /// Splats are coded.
    Coding,
}

/// Result of a compression.
#[derive(Clone, Debug, PartialEq)]
pub struct Compressed {
    /// The asset.
    pub cloud: CodedCloud,
    /// Statistics of the compression.
    pub report: CompressionReport,
    /// Index in the input of each splat of the finest level, in the asset's order. Pruned splats
    /// are absent.
    pub kept: Vec<u32>,
}

/// `cloud`, an asset in its own frame, coded.
///
/// `visibility` is, for each splat, the mean over views all around the asset of its blending
/// weights, summed over pixels. `dims_m` of the result is the box of the kept means; nothing is
/// added for what splats reach beyond it.
///
/// # Errors
/// Returns an error if the options make no sense, `visibility` does not fit the cloud, no splat is
/// left, or the cloud's extent is beyond f32.
pub fn compress(
    cloud: &SplatCloud,
    visibility: &[f32],
    options: &CompressOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<Compressed, CompressError> {
    options.check()?;
    options::check_visibility(cloud, visibility)?;
    progress(Progress::Pruning);
    let kept = prune(cloud, &importance(cloud, visibility), options.prune);
    let Some(least_importance) = kept.least_importance else {
        return Err(CompressError::NothingLeft {
            splats: cloud.len(),
            defects: kept.defects,
            transparent: kept.transparent,
            unseen: visibility.iter().filter(|&&value| value == 0.0).count(),
        });
    };
    let levels = Levels::new(cloud, visibility, &kept.splats);
    let weights = book_weights(&levels.visibility);
    let (coded, [shapes, colors]) = code(&levels.clouds, &weights, options, progress)?;
    let report = CompressionReport {
        splats: cloud.len(),
        kept: kept.splats.len(),
        defects: kept.defects,
        transparent: kept.transparent,
        least_importance,
        shape_space: options.shape_space,
        shapes,
        colors,
        bytes: PartBytes::new(&coded),
    };
    Ok(Compressed {
        cloud: coded,
        report,
        kept: levels.order,
    })
}

/// All levels, each in spatial order, which the renderer's culling by runs of splats needs.
struct Levels {
    clouds: Vec<SplatCloud>,
    /// Visibility of the splats of the finest level.
    visibility: Vec<f32>,
    /// Index in the input of each splat of the finest level.
    order: Vec<u32>,
}

impl Levels {
    fn new(cloud: &SplatCloud, visibility: &[f32], kept: &[u32]) -> Self {
        let order: Vec<u32> = cloud
            .select(kept)
            .spatial_order()
            .iter()
            .map(|&index| kept[index as usize])
            .collect();
        let visibility: Vec<f32> = order
            .iter()
            .map(|&splat| visibility[splat as usize])
            .collect();
        let mut clouds = vec![cloud.select(&order)];
        let coarser = levels::coarser_levels(&clouds[0], &visibility);
        clouds.extend(coarser.iter().map(SplatCloud::in_spatial_order));
        Self {
            clouds,
            visibility,
            order,
        }
    }
}

/// Weights of splats in codebook training: the root of their visibility, and a small share for
/// splats that no view showed.
fn book_weights(visibility: &[f32]) -> Vec<f32> {
    let mean = visibility
        .iter()
        .map(|&value| f64::from(value))
        .sum::<f64>()
        / visibility.len() as f64;
    if mean <= 0.0 {
        return vec![1.0; visibility.len()];
    }
    visibility
        .iter()
        .map(|&value| (f64::from(value) / mean + 1e-3).sqrt() as f32)
        .collect()
}

/// The coded asset of `levels` (the finest first), whose finest splats count by `weights`, and how
/// its two books were made.
fn code(
    levels: &[SplatCloud],
    weights: &[f32],
    options: &CompressOptions,
    progress: &(dyn Fn(Progress) + Sync),
) -> Result<(CodedCloud, [BookReport; 2]), CompressError> {
    let finest = &levels[0];
    let bounds = finest.bounds();
    let unit_m = finest
        .scales
        .iter()
        .map(shape_space::size_of)
        .fold(0.0, f64::max);
    let shape_values = shape_vectors(finest, options.shape_space, unit_m);
    let shape_book = vector_quantize(
        Vectors {
            values: &shape_values,
            dimension: SHAPE_DIMENSION,
        },
        weights,
        &options.book(options.shapes, 0),
        &|done| progress(Progress::Shapes(done)),
    );
    let color_values = color_space::vectors(finest, options.color_dc_weight);
    let color_book = vector_quantize(
        Vectors {
            values: &color_values,
            dimension: 3 * sh::coefficient_count(finest.sh_degree),
        },
        weights,
        &options.book(options.colors, 1),
        &|done| progress(Progress::Colors(done)),
    );
    progress(Progress::Coding);
    let colors = color_space::entries(
        &color_book.entries,
        finest.sh_degree,
        options.color_dc_weight,
    );
    let sizes = SizeScale::for_levels(levels, options.shape_space, unit_m);
    let books = Books {
        options,
        bounds,
        unit_m,
        sizes,
        shape_vectors: &shape_book.entries,
        color_vectors: &color_book.entries,
        colors: &colors,
        dc_residual_step: residual_steps(finest, &color_book, &colors, weights),
    };
    let coded = CodedCloud {
        bounds,
        log2_size_min: sizes.log2_min,
        log2_size_step: sizes.log2_step,
        dc_residual_step: books.dc_residual_step,
        splats: levels
            .iter()
            .flat_map(|level| books.encode(level))
            .collect(),
        levels: levels.iter().map(SplatCloud::len).collect(),
        shapes: shape_book
            .entries
            .chunks_exact(SHAPE_DIMENSION)
            .map(|entry| options.shape_space.factor(entry))
            .collect(),
        sh_degree: finest.sh_degree,
        sh_frame: options.sh_frame,
        dims_m: std::array::from_fn(|axis| bounds.max[axis] - bounds.min[axis]),
        colors,
    };
    coded.check().map_err(CompressError::Unrepresentable)?;
    Ok((
        coded,
        [
            book_report(shape_book, SHAPE_DIMENSION),
            book_report(color_book, color_values.len() / finest.len()),
        ],
    ))
}

fn residual_steps(
    finest: &SplatCloud,
    book: &Quantized,
    colors: &[[f32; 3]],
    weights: &[f32],
) -> [f32; 3] {
    let coefficients = sh::coefficient_count(finest.sh_degree);
    let entries = book
        .assignment
        .iter()
        .map(|&entry| &colors[usize::from(entry) * coefficients]);
    let residuals: Vec<[f32; 3]> = finest
        .sh_dc
        .iter()
        .zip(entries)
        .map(|(dc, entry)| color_space::residual(dc, entry))
        .collect();
    color_space::residual_steps(&residuals, weights)
}

fn book_report(book: Quantized, dimension: usize) -> BookReport {
    let Quantized {
        entries,
        distortion,
        batches,
        reseeded,
        ..
    } = book;
    BookReport {
        entries: entries.len() / dimension,
        distortion,
        batches,
        reseeded,
    }
}
