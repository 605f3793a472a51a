//! The program `decouplegs-view`: the viewer, as a subcommand of `decouplegs`.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use decouplegs_cli::command_line::parse;
use decouplegs_cli::programs::{exit_code, print_warnings};
use decouplegs_view as view;

/// Shows scenes and episodes in the browser.
#[derive(Parser)]
#[command(name = "decouplegs", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    View(Box<view::Arguments>),
}

fn main() -> ExitCode {
    print_warnings();
    let Command::View(arguments) = parse::<Program>().command;
    exit_code(&view::run(&arguments))
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
        let listed = programs::VIEW.commands.iter();
        let listed = listed.map(|&(name, about)| (name.to_owned(), about.to_owned()));
        assert_eq!(own.collect::<Vec<_>>(), listed.collect::<Vec<_>>());
    }
}
