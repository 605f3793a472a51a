//! Codes splats with codebooks.

use decouplegs_scene::shape::PrincipalAxes;
use decouplegs_scene::{Bounds, CodedSplat, SplatCloud, SplatCodes, sh};
use rayon::prelude::*;

use super::shape_space::{LOG2_SIZE_MAX, ShapeSpace, size_of};
use super::vector_quantize::{SearchBook, Vectors};
use super::{CompressOptions, color_space};

/// Numbers of a shape vector.
pub(super) const SHAPE_DIMENSION: usize = 6;

/// The vectors of the shapes of `cloud`. Where splats keep no size of their own, `unit_m` counts as
/// 1.
pub(super) fn shape_vectors(cloud: &SplatCloud, space: ShapeSpace, unit_m: f64) -> Vec<f32> {
    let vector = |splat: usize| {
        let axes = PrincipalAxes {
            scales: cloud.scales[splat],
            rotation: cloud.rotations[splat],
        };
        space.vector(
            &axes,
            if space.keeps_size() {
                size_of(&axes.scales)
            } else {
                unit_m
            },
        )
    };
    let vectors: Vec<[f32; SHAPE_DIMENSION]> =
        (0..cloud.len()).into_par_iter().map(vector).collect();
    vectors.into_flattened()
}

/// The sizes that a byte stands for.
#[derive(Clone, Copy, Debug)]
pub(super) struct SizeScale {
    pub log2_min: f32,
    pub log2_step: f32,
}

impl SizeScale {
    /// Scale from the smallest to the largest splat of `levels`, or the one size `unit_m` where
    /// splats keep none.
    pub(super) fn for_levels(levels: &[SplatCloud], space: ShapeSpace, unit_m: f64) -> Self {
        if !space.keeps_size() {
            return Self {
                log2_min: (unit_m.log2() as f32).clamp(-LOG2_SIZE_MAX, LOG2_SIZE_MAX),
                log2_step: 0.0,
            };
        }
        let sizes = levels
            .iter()
            .flat_map(|level| &level.scales)
            .map(|scales| size_of(scales).log2() as f32);
        let (min, max) = sizes.fold((f32::MAX, f32::MIN), |(min, max), size| {
            (min.min(size), max.max(size))
        });
        Self {
            log2_min: min,
            log2_step: (max - min) / 255.0,
        }
    }

    fn code(&self, size: f64) -> u8 {
        if self.log2_step > 0.0 {
            ((size.log2() as f32 - self.log2_min) / self.log2_step).round() as u8
        } else {
            0
        }
    }
}

/// All that splats are coded with.
pub(super) struct Books<'a> {
    pub options: &'a CompressOptions,
    pub bounds: Bounds,
    pub unit_m: f64,
    pub sizes: SizeScale,
    /// Shape entries as vectors, for the search.
    pub shape_vectors: &'a [f32],
    /// Color entries as vectors, for the search.
    pub color_vectors: &'a [f32],
    /// Color entries as they are stored.
    pub colors: &'a [[f32; 3]],
    pub dc_residual_step: [f32; 3],
}

impl Books<'_> {
    /// The splats of one level, in their order.
    pub(super) fn encode(&self, cloud: &SplatCloud) -> Vec<CodedSplat> {
        let coefficients = sh::coefficient_count(cloud.sh_degree);
        let shapes = nearest(
            &shape_vectors(cloud, self.options.shape_space, self.unit_m),
            self.shape_vectors,
            SHAPE_DIMENSION,
        );
        let vectors = color_space::vectors(cloud, self.options.color_dc_weight);
        let colors = nearest(&vectors, self.color_vectors, 3 * coefficients);
        let splat = |splat: usize| {
            let entry = &self.colors[usize::from(colors[splat]) * coefficients];
            let residual = color_space::residual(&cloud.sh_dc[splat], entry);
            let codes = SplatCodes {
                position: self.position(&cloud.means[splat]),
                // Never a visible splat below what a pixel shows.
                opacity: (cloud.opacities[splat] * 255.0).round().clamp(1.0, 255.0) as u8,
                size: self.sizes.code(size_of(&cloud.scales[splat])),
                shape: shapes[splat],
                color: colors[splat],
                dc_residual: color_space::residual_codes(&residual, &self.dc_residual_step),
            };
            CodedSplat::from(codes)
        };
        (0..cloud.len()).into_par_iter().map(splat).collect()
    }

    fn position(&self, mean: &[f32; 3]) -> [u16; 3] {
        std::array::from_fn(|axis| {
            let (min, max) = (
                f64::from(self.bounds.min[axis]),
                f64::from(self.bounds.max[axis]),
            );
            let share = if max > min {
                (f64::from(mean[axis]) - min) / (max - min)
            } else {
                0.0
            };
            (share * 65_535.0).round() as u16
        })
    }
}

/// The nearest of `entries` to each of `vectors`.
fn nearest(vectors: &[f32], entries: &[f32], dimension: usize) -> Vec<u16> {
    let book = SearchBook::new(Vectors {
        values: entries,
        dimension,
    });
    let found = book.nearest_of_all(Vectors {
        values: vectors,
        dimension,
    });
    found.iter().map(|nearest| nearest.entry as u16).collect()
}
