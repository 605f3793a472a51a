//! AlpaSim's gRPC contracts: messages that the render server and its clients share, and drivers of
//! AlpaSim as planners of the closed loop.
//!
//! | module | content |
//! |---|---|
//! | `proto/`, [`wire`], [`codec`] | the messages of the public contracts, and how they are read without trusting their counts |
//! | [`poses`], [`camera_spec`] | poses, lenses and shutters in messages |
//! | [`encoding`] | images as PNG, JPEG or planes, on threads of their own |
//! | [`egodriver`] | the client of driving policies: a planner |
//! | [`planner_name`] | planners by the names that the command line gives them |
#![forbid(unsafe_code)]

pub mod camera_spec;
pub mod codec;
pub mod egodriver;
pub mod encoding;
pub mod planner_name;
pub mod poses;
pub mod wire;
