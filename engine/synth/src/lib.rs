//! Procedural scenes: a synthetic street with cars, the roads of a map as splats, and environment
//! probes. Everything follows from a seed.
#![forbid(unsafe_code)]

pub mod probes;
pub mod roads;
pub mod street;
