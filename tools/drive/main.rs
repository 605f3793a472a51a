//! The program `decouplegs-drive`: subcommands of `decouplegs` that know vehicles, roads and logs,
//! one file for each.
//!
//! It exits with 0 when the work is done, with 1 when it could not be done (one sentence on
//! standard error, then its causes), and with 2 when the command line makes no sense.
#![forbid(unsafe_code)]

mod calibrate_light;
mod drive;
mod edit;
mod episode_report;
mod export;
mod import;
mod lane_drawing;
mod lidar;
mod map;
mod open_loop;
mod pack;
mod realism;
mod register;
mod replay;
mod score;
mod seen;
mod sites;

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use decouplegs_cli::command_line::parse;
use decouplegs_cli::programs::{exit_code, print_warnings};
use decouplegs_cli::{
    arguments, background, device, outputs, page, plot, progress, thumbnail, views,
};

/// Drives, scores and exports episodes; moves agents, reads maps, sweeps LiDARs.
#[derive(Parser)]
#[command(name = "decouplegs", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Import(import::Arguments),
    Lidar(Box<lidar::Arguments>),
    Edit(edit::Arguments),
    Pack(pack::Arguments),
    Map(map::Arguments),
    Register(Box<register::Arguments>),
    CalibrateLight(calibrate_light::Arguments),
    Drive(Box<drive::Arguments>),
    Replay(replay::Arguments),
    OpenLoop(open_loop::Arguments),
    Realism(realism::Arguments),
    Score(score::Arguments),
    Export(export::Arguments),
}

fn main() -> ExitCode {
    print_warnings();
    exit_code(&match &parse::<Program>().command {
        Command::Import(arguments) => import::run(arguments),
        Command::Lidar(arguments) => lidar::run(arguments),
        Command::Edit(arguments) => edit::run(arguments),
        Command::Pack(arguments) => pack::run(arguments),
        Command::Map(arguments) => map::run(arguments),
        Command::Register(arguments) => register::run(arguments),
        Command::CalibrateLight(arguments) => calibrate_light::run(arguments),
        Command::Drive(arguments) => drive::run(arguments),
        Command::Replay(arguments) => replay::run(arguments),
        Command::OpenLoop(arguments) => open_loop::run(arguments),
        Command::Realism(arguments) => realism::run(arguments),
        Command::Score(arguments) => score::run(arguments),
        Command::Export(arguments) => export::run(arguments),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;
    use decouplegs_cli::programs;

    #[test]
    fn subcommands_are_those_that_decouplegs_lists() {
        let command = Program::command();
        command.clone().debug_assert();
        let own = command.get_subcommands().map(|own| {
            let about = own.get_about().map(ToString::to_string);
            (own.get_name().to_owned(), about.unwrap_or_default())
        });
        let listed = programs::DRIVE.commands.iter();
        let listed = listed.map(|&(name, about)| (name.to_owned(), about.to_owned()));
        assert_eq!(own.collect::<Vec<_>>(), listed.collect::<Vec<_>>());
    }
}
