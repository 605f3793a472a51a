//! Why a frame could not be drawn.

use decouplegs_gpu::GpuError;

/// Why a world could not be uploaded or a frame not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The device refused, ran out of memory or was lost.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A camera that cannot make a picture, or too many of them.
    #[error("{0}")]
    View(String),
    /// The lists kept outgrowing their buffers.
    #[error("the frame was drawn {attempts} times and still needed more room than it had: {needs}")]
    Unsettled {
        /// How often.
        attempts: u32,
        /// What the last one needed.
        needs: String,
    },
    /// A list that may not be cut and that software cannot blend in one run.
    #[error(
        "a macro tile's list holds {longest} splats, which an exclusive early stop does not let be cut, and lavapipe blends at most \
         {max} in one run: use the default rules, a larger picture or a GPU"
    )]
    ListTooLong {
        /// Entries of the longest list.
        longest: u32,
        /// How many can be blended.
        max: u32,
    },
    /// A world of more splats than an index can name.
    #[error("the world has {splats} splats; a frame addresses at most {max}")]
    TooManySplats {
        /// How many it has.
        splats: usize,
        /// How many can be addressed.
        max: usize,
    },
}
