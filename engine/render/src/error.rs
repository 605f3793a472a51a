//! Errors of rendering.

use decouplegs_gpu::GpuError;
use decouplegs_scene::Invalid;

/// Reason why a world could not be uploaded or a frame could not be rendered.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The device refused, ran out of memory or was lost.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// A camera that cannot make an image, or too many of them.
    #[error("{0}")]
    View(Invalid),
    /// A LiDAR that cannot make a sweep.
    #[error("LiDAR {name}: {reason}")]
    Lidar {
        /// Name in the rig.
        name: String,
        /// Reason of the refusal.
        reason: Invalid,
    },
    /// An asset that cannot be drawn.
    #[error("the asset cannot be drawn: {0}")]
    Asset(Invalid),
    /// An agent that names an asset which was removed, or is another pool's.
    #[error(
        "an agent shows an asset that the pool does not hold: it was removed, or added to another pool"
    )]
    NoSuchAsset,
    /// An agent that stands nowhere.
    #[error("agent with instance {instance}: its pose {pose} is not finite")]
    AgentPose {
        /// Instance id.
        instance: u16,
        /// Pose that was found.
        pose: String,
    },
    /// An agent whose motion cannot be projected.
    #[error("agent with instance {instance}: {reason}")]
    AgentMotion {
        /// Instance id.
        instance: u16,
        /// Reason of the refusal.
        reason: Invalid,
    },
    /// An agent in a light that is no light.
    #[error(
        "agent with instance {instance}: the light it is put in has numbers that are not finite"
    )]
    AgentLight {
        /// Instance id.
        instance: u16,
    },
    /// A shadow that lies nowhere.
    #[error("shadow {index}: {reason}")]
    Shadow {
        /// Index among the scene's agents.
        index: usize,
        /// Reason that its values make no sense.
        reason: Invalid,
    },
    /// A frame too many.
    #[error("{max} frames are in flight, as many as may be: finish one first")]
    TooManyInFlight {
        /// Largest number allowed.
        max: usize,
    },
    /// Number of held images beyond the limit.
    #[error(
        "the images of {max} frames are held, as many as may be: drop some, or allow more (taken_max)"
    )]
    TooManyTaken {
        /// Largest number allowed.
        max: usize,
    },
    /// No frame to wait for.
    #[error("no frame is in flight: submit one first")]
    NothingInFlight,
    /// The lists kept outgrowing their buffers.
    #[error(
        "the frame was drawn {attempts} times and still needed more room than it had: {required}"
    )]
    Unsettled {
        /// Number of attempts.
        attempts: u32,
        /// Counts that the last one required.
        required: String,
    },
    /// A world of more splats than an index can name.
    #[error("the world has {splats} splats; a frame addresses at most {max}")]
    TooManySplats {
        /// Number of splats.
        splats: usize,
        /// Number of splats that can be addressed.
        max: usize,
    },
}
