//! `decouplegs realism`: how far scenes are from what they were made of, and simulated traffic from
//! recorded traffic.

mod detections;
mod detector;
mod gap;
mod page;
mod photographs;
mod plans;
mod report;
mod road;
mod scan_points;
mod scene;
mod traffic;

use anyhow::Result;
use clap::Subcommand;

/// Measure how far a scene is from the recording that it was made of, or simulated traffic from
/// recorded traffic
#[derive(clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    Scene(Box<scene::Arguments>),
    Traffic(traffic::Arguments),
}

pub fn run(arguments: &Arguments) -> Result<()> {
    match &arguments.what {
        What::Scene(arguments) => scene::run(arguments),
        What::Traffic(arguments) => traffic::run(arguments),
    }
}
