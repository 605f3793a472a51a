//! Benchmarks and experiments: the subcommands `bench`, `stress` and `ablate` of the program
//! `decouplegs`. Their figures are in `benches/README.md`.
//!
//! | module | content |
//! |---|---|
//! | `bench` | frame times of a scene, with memory and error |
//! | `stress` | throughput and memory over the number of agents, against uncompressed copies |
//! | `ablate` | the parts of relighting and compression, each left out in turn |
#![forbid(unsafe_code)]

#[doc(hidden)]
pub mod ablate;
#[doc(hidden)]
pub mod bench;
mod spread;
mod stage_times;
#[doc(hidden)]
pub mod stress;

use decouplegs_cli::{
    arguments, background, device, image_quality, outputs, page, plot, progress, scene_source,
    thumbnail, views, visibility,
};
