//! How a world becomes pixels.
//!
//! [`Renderer`] draws on a GPU; [`reference`] is the f64 definition of the same picture, brute force on the CPU, and
//! [`metrics`] measures one against the other. `frame.rs` lists the stages of a frame in the order they run.
#![forbid(unsafe_code)]

mod error;
mod frame;
mod output;
mod renderer;
mod resident;

pub mod capacity;
pub mod layout;
pub mod metrics;
pub mod picture;
pub mod reference;
pub mod sh_codec;
pub mod stages;
pub mod twins;

pub use capacity::Capacity;
pub use error::RenderError;
pub use output::{ColourFormat, OutputBuffers, Outputs};
pub use picture::Picture;
pub use renderer::{FrameStatistics, RenderOptions, Renderer};
pub use resident::ResidentWorld;
