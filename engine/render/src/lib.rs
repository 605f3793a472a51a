//! Renderer: from splats to pixels.
//!
//! [`Renderer`] draws on a GPU; [`mod@reference`] is the f64 definition of the same image, brute
//! force on the CPU, and [`metrics`] measures one against the other. `frame.rs` lists the stages of
//! a frame in the order they run.
#![forbid(unsafe_code)]

mod agents;
mod asset_pool;
mod contributions;
mod error;
mod frame;
mod frame_buffers;
mod images;
mod interfaces;
mod kept_lists;
mod kernels;
mod keys;
pub mod lidar;
mod options;
mod output;
mod plane;
mod range_allocator;
mod renderer;
mod resident_splats;
mod slot;
mod statistics;
mod submitted;

pub mod capacity;
pub mod layout;
pub mod metrics;
pub mod reference;
pub mod sh_codec;
pub mod stages;
pub mod storage;
pub mod twins;

pub use agents::{Agent, FrameAgents, FrameSplats};
pub use asset_pool::{AssetId, AssetPool, PoolBuffers, SHAPE_WORDS, stored_shape};
pub use capacity::Capacity;
pub use error::RenderError;
pub use images::image_bytes::{ImageBytes, lower_half_opacity};
pub use images::image_hash::hash_bytes;
pub use images::rendered_image::Image;
pub use images::taken::TakenImages;
pub use images::{image_hash, post_processing, rendered_image};
pub use kept_lists::ListSource;
pub use keys::KeySource;
pub use lidar::{LidarOptions, LidarRenderer, LidarView, TracedSweep};
pub use options::{FrameStatistics, QueueTrace, RenderOptions};
pub use output::{ColorFormat, OutputBuffers, Outputs};
pub use plane::{Plane, PlaneMap, PlaneType, PlaneValues, Planes};
pub use renderer::Renderer;
pub use resident_splats::ResidentSplats;
pub use storage::Storage;
