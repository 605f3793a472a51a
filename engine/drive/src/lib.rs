//! How a world moves: where the ground is, how tracks are registered to lanes.
//!
//! Plain mathematics over [`decouplegs_scene`]; nothing here reads a file or knows a GPU. Units are metres, seconds and radians.
#![forbid(unsafe_code)]

pub mod alignment;
pub mod ground;
pub mod lane_index;
pub mod planar;
pub mod polyline;
pub mod register;

pub use ground::{Ground, GroundHeight, GroundOptions};
pub use lane_index::{LaneIndex, LanePoint};
pub use planar::PlanarTransform;
pub use polyline::{Foot, Polyline};
pub use register::{Outcome, RegisterError, RegisterOptions, RegisteredTrack, Registration, register};
