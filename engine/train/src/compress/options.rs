//! Options and errors of a compression.

use decouplegs_scene::codebook::{COLORS_MAX, SHAPES_MAX};
use decouplegs_scene::{Invalid, ShFrame, SplatCloud};

use super::FINAL_ITERATIONS;
use super::prune::{Prune, THRESHOLD};
use super::shape_space::ShapeSpace;
use super::vector_quantize::QuantizeOptions;

/// Options of the compression of an asset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CompressOptions {
    /// Pruning rule.
    pub prune: Prune,
    /// Entries of the color codebook, 1 to [`COLORS_MAX`].
    pub colors: usize,
    /// Entries of the shape codebook, 1 to [`SHAPES_MAX`].
    pub shapes: usize,
    /// Seed of all randomness.
    pub seed: u64,
    /// Frame of the asset's colors.
    pub sh_frame: ShFrame,
    /// Space in which distances between shapes are measured.
    pub shape_space: ShapeSpace,
    /// Weight of a DC coefficient against the others in the distance between colors, above 0. Less
    /// than 1, because splats keep what their DC terms are off by. A tenth gave the best images
    /// of a car and of a captured object; from a fiftieth to a quarter they differ by half a
    /// decibel.
    pub color_dc_weight: f32,
    /// Most mini-batches for each codebook.
    pub iterations_max: usize,
}

impl Default for CompressOptions {
    fn default() -> Self {
        Self {
            prune: Prune::Threshold(THRESHOLD),
            colors: COLORS_MAX,
            shapes: SHAPES_MAX,
            seed: 1,
            sh_frame: ShFrame::Canonical,
            shape_space: ShapeSpace::default(),
            color_dc_weight: 0.1,
            iterations_max: 5000,
        }
    }
}

impl CompressOptions {
    pub(super) fn check(&self) -> Result<(), CompressError> {
        let within = |what, value: usize, max: usize| {
            let fault = || {
                Err(CompressError::Option(format!(
                    "{what} is {value}; expected 1 to {max}"
                )))
            };
            if (1..=max).contains(&value) {
                Ok(())
            } else {
                fault()
            }
        };
        within("the number of colors", self.colors, COLORS_MAX)?;
        within("the number of shapes", self.shapes, SHAPES_MAX)?;
        let fault = match self.prune {
            Prune::Threshold(least) if !(0.0..=1.0).contains(&least) => {
                format!("the threshold is {least}; expected 0 to 1")
            }
            Prune::KeepRatio(ratio) if !(ratio > 0.0 && ratio <= 1.0) => {
                format!("the keep ratio is {ratio}; expected a share above 0, at most 1")
            }
            _ if !(self.color_dc_weight.is_finite() && self.color_dc_weight >= 1e-3) => {
                format!(
                    "the weight of DC is {}; expected at least 0.001",
                    self.color_dc_weight
                )
            }
            _ => return Ok(()),
        };
        Err(CompressError::Option(fault))
    }

    /// Training options of the codebook `stream`. Books share no random numbers.
    pub(super) fn book(&self, entries: usize, stream: u64) -> QuantizeOptions {
        QuantizeOptions {
            entries,
            iterations_max: self.iterations_max,
            final_iterations_max: FINAL_ITERATIONS,
            seed: self.seed.wrapping_mul(2).wrapping_add(stream),
        }
    }
}

/// Reason why a cloud cannot be compressed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CompressError {
    /// An option out of its range.
    #[error("{0}")]
    Option(String),
    /// The visibilities are not one for each splat.
    #[error("{found} visibilities were given for {expected} splats; expected one for each")]
    VisibilityCount {
        /// Number of splats.
        expected: usize,
        /// Number of visibilities.
        found: usize,
    },
    /// A visibility that is none.
    #[error("the visibility of splat {splat} is {value}; expected a finite number, at least 0")]
    Visibility {
        /// Index of the splat.
        splat: usize,
        /// Visibility as text, because NaN is not equal to itself.
        value: String,
    },
    /// No splats remain after pruning.
    #[error(
        "none of {splats} splats is left: {transparent} have an opacity below 1/255, {defects} cannot be drawn, {unseen} are seen in \
         no view; keep more of them (a lower threshold or a larger ratio), or look at the asset with `inspect`"
    )]
    NothingLeft {
        /// Splats that came in.
        splats: usize,
        /// Number of splats with a defect.
        defects: usize,
        /// Number of splats with an opacity below 1/255.
        transparent: usize,
        /// Number of splats with a visibility of zero.
        unseen: usize,
    },
    /// The result cannot be stored.
    #[error("the splats cannot be coded: {0}")]
    Unrepresentable(Invalid),
}

pub(super) fn check_visibility(
    cloud: &SplatCloud,
    visibility: &[f32],
) -> Result<(), CompressError> {
    if visibility.len() != cloud.len() {
        return Err(CompressError::VisibilityCount {
            expected: cloud.len(),
            found: visibility.len(),
        });
    }
    match visibility
        .iter()
        .position(|value| !(value.is_finite() && *value >= 0.0))
    {
        Some(splat) => Err(CompressError::Visibility {
            splat,
            value: visibility[splat].to_string(),
        }),
        None => Ok(()),
    }
}
