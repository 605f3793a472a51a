//! How a world moves: where the ground is, how tracks are registered to lanes.
//!
//! Plain mathematics over [`decouplegs_scene`]; nothing here reads a file or knows a GPU. Units are metres, seconds and radians.
#![forbid(unsafe_code)]
