//! The command line program `decouplegs`: one file for each subcommand of splats and images. Other
//! subcommands are programs of their own, which it runs (`programs`).
//!
//! It exits with 0 when the work is done, with 1 when it could not be done (one sentence on
//! standard error, then its causes), and with 2 when the command line makes no sense.
#![forbid(unsafe_code)]

mod compare;
mod compress;
mod convert;
mod decompress;
mod devices;
mod inspect;
mod programs;
mod render;
mod synth;
mod transform;

use std::env;
use std::ffi::OsString;
use std::process::ExitCode;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use decouplegs_cli::programs::{exit_code, print_warnings};
use decouplegs_cli::{
    arguments, background, camera_path, device, image_quality, outputs, page, plot, progress,
    scene_source, street_files, views, visibility,
};

/// Renders 3D Gaussian scenes for driving simulation on any Vulkan 1.3 device.
#[derive(Parser)]
#[command(name = "decouplegs", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Render(Box<render::Arguments>),
    Inspect(inspect::Arguments),
    Convert(convert::Arguments),
    Transform(transform::Arguments),
    Decompress(decompress::Arguments),
    Compress(compress::Arguments),
    Compare(compare::Arguments),
    Synth(synth::Arguments),
    Devices(devices::Arguments),
}

/// The whole command line, with the subcommands of other programs.
fn command_line() -> clap::Command {
    let listed =
        |&(name, about): &(&'static str, &'static str)| clap::Command::new(name).about(about);
    let others = decouplegs_cli::programs::PROGRAMS
        .iter()
        .flat_map(|program| program.commands.iter().map(listed));
    Program::command().subcommands(others)
}

fn main() -> ExitCode {
    let arguments: Vec<OsString> = env::args_os().collect();
    if let Some((program, command)) = programs::asked_for(&arguments) {
        return exit_code(&programs::run(program, command, &arguments));
    }
    print_warnings();
    let matches = decouplegs_cli::command_line::matches(command_line(), arguments);
    let program = Program::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    exit_code(&match &program.command {
        Command::Render(arguments) => render::run(arguments),
        Command::Inspect(arguments) => inspect::run(arguments),
        Command::Convert(arguments) => convert::run(arguments),
        Command::Transform(arguments) => transform::run(arguments),
        Command::Decompress(arguments) => decompress::run(arguments),
        Command::Compress(arguments) => compress::run(arguments),
        Command::Compare(arguments) => compare::run(arguments),
        Command::Synth(arguments) => synth::run(arguments),
        Command::Devices(arguments) => devices::run(arguments),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        command_line().debug_assert();
    }
}
