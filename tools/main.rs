//! The command line program `decouplegs`: one file for each subcommand.
//!
//! It exits with 0 when the work is done, with 1 when it could not be done (one sentence on
//! standard error, then its causes), and with 2 when the command line makes no sense.
#![forbid(unsafe_code)]

mod calibrate_light;
mod compare;
mod compress;
mod conform;
mod convert;
mod decompress;
mod devices;
mod drive;
mod edit;
mod episode_report;
mod export;
mod inspect;
mod lane_drawing;
mod lidar;
mod map;
mod open_loop;
mod pack;
mod register;
mod render;
mod replay;
mod score;
mod sites;
mod synth;

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use decouplegs::explain::explain;
use decouplegs_benches::{ablate, bench, stress};
use decouplegs_cli::{
    arguments, background, device, image_quality, page, plot, progress, scene_source, thumbnail,
    views, visibility,
};
use decouplegs_view as view;

/// Renders 3D Gaussian scenes for driving simulation on any Vulkan 1.3 device.
#[derive(Parser)]
#[command(name = "decouplegs", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Render(render::Arguments),
    Lidar(Box<lidar::Arguments>),
    Inspect(inspect::Arguments),
    Map(map::Arguments),
    Register(Box<register::Arguments>),
    Convert(convert::Arguments),
    Decompress(decompress::Arguments),
    Compress(compress::Arguments),
    Compare(compare::Arguments),
    Synth(synth::Arguments),
    CalibrateLight(calibrate_light::Arguments),
    Bench(bench::Arguments),
    Stress(Box<stress::Arguments>),
    Ablate(Box<ablate::Arguments>),
    Edit(edit::Arguments),
    Pack(pack::Arguments),
    Drive(Box<drive::Arguments>),
    Replay(replay::Arguments),
    OpenLoop(open_loop::Arguments),
    Score(score::Arguments),
    Conform(conform::Arguments),
    Export(export::Arguments),
    View(Box<view::Arguments>),
    Devices(devices::Arguments),
}

fn main() -> ExitCode {
    let done = match &Program::parse().command {
        Command::Render(arguments) => render::run(arguments),
        Command::Lidar(arguments) => lidar::run(arguments),
        Command::Inspect(arguments) => inspect::run(arguments),
        Command::Map(arguments) => map::run(arguments),
        Command::Register(arguments) => register::run(arguments),
        Command::Convert(arguments) => convert::run(arguments),
        Command::Decompress(arguments) => decompress::run(arguments),
        Command::Compress(arguments) => compress::run(arguments),
        Command::Compare(arguments) => compare::run(arguments),
        Command::Synth(arguments) => synth::run(arguments),
        Command::CalibrateLight(arguments) => calibrate_light::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Stress(arguments) => stress::run(arguments),
        Command::Ablate(arguments) => ablate::run(arguments),
        Command::Edit(arguments) => edit::run(arguments),
        Command::Pack(arguments) => pack::run(arguments),
        Command::Drive(arguments) => drive::run(arguments),
        Command::Replay(arguments) => replay::run(arguments),
        Command::OpenLoop(arguments) => open_loop::run(arguments),
        Command::Score(arguments) => score::run(arguments),
        Command::Conform(arguments) => conform::run(arguments),
        Command::Export(arguments) => export::run(arguments),
        Command::View(arguments) => view::run(arguments, synth::demo),
        Command::Devices(arguments) => devices::run(arguments),
    };
    match done {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            // Where standard error is full or closed, there is nobody to tell.
            let _ = std::io::stderr().write_all(explain(error.as_ref()).as_bytes());
            ExitCode::FAILURE
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        use clap::CommandFactory;
        Program::command().debug_assert();
    }
}
