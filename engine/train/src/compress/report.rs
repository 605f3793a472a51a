//! Statistics of a compression.

use decouplegs_scene::{CodedCloud, CodedSplat};
use serde::Serialize;

use super::shape_space::ShapeSpace;

/// Counts of splats, codebook errors and sizes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompressionReport {
    /// Splats that came in.
    pub splats: usize,
    /// Splats of the finest level.
    pub kept: usize,
    /// Splats dropped because they cannot be drawn.
    pub defects: usize,
    /// Splats dropped because no pixel shows their opacity.
    pub transparent: usize,
    /// The least importance that was kept.
    pub least_importance: f32,
    /// The space of the shape codebook.
    pub shape_space: ShapeSpace,
    /// Training of the shape codebook.
    pub shapes: BookReport,
    /// Training of the color codebook.
    pub colors: BookReport,
    /// Bytes of the parts, without the container's header.
    pub bytes: PartBytes,
}

/// Training of one codebook.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BookReport {
    /// Number of entries.
    pub entries: usize,
    /// Weighted mean squared distance by iteration.
    pub distortion: Vec<f64>,
    /// Number of entries from mini-batches; the others are over all splats.
    pub batches: usize,
    /// Entries that began again because nothing used them.
    pub reseeded: usize,
}

/// Bytes of each part of an asset as it is stored: colors as f16, shapes as f32.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PartBytes {
    /// Splats of each level of detail.
    pub levels: Vec<usize>,
    /// The shape codebook.
    pub shapes: usize,
    /// The color codebook.
    pub colors: usize,
}

impl PartBytes {
    pub(super) fn new(cloud: &CodedCloud) -> Self {
        Self {
            levels: cloud
                .levels
                .iter()
                .map(|level| level * size_of::<CodedSplat>())
                .collect(),
            shapes: size_of_val(cloud.shapes.as_slice()),
            // Two bytes a number instead of four.
            colors: size_of_val(cloud.colors.as_slice()) / 2,
        }
    }

    /// All of them.
    #[must_use]
    pub fn total(&self) -> usize {
        self.levels.iter().sum::<usize>() + self.shapes + self.colors
    }
}

impl CompressionReport {
    /// Stored bytes per input splat.
    #[must_use]
    pub fn bytes_per_splat(&self) -> f64 {
        self.bytes.total() as f64 / self.splats as f64
    }
}
