//! The program `decouplegs-lab`: benchmarks and experiments, as subcommands of `decouplegs`.
#![forbid(unsafe_code)]

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use decouplegs_benches::{ablate, bench, stress};
use decouplegs_cli::command_line::parse;
use decouplegs_cli::programs::{exit_code, print_warnings};

/// Measures speed, memory and error, and what each part of the system is worth.
#[derive(Parser)]
#[command(name = "decouplegs", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Bench(Box<bench::Arguments>),
    Stress(Box<stress::Arguments>),
    Ablate(Box<ablate::Arguments>),
}

fn main() -> ExitCode {
    print_warnings();
    exit_code(&match &parse::<Program>().command {
        Command::Bench(arguments) => bench::run(arguments),
        Command::Stress(arguments) => stress::run(arguments),
        Command::Ablate(arguments) => ablate::run(arguments),
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
        let listed = programs::LAB.commands.iter();
        let listed = listed.map(|&(name, about)| (name.to_owned(), about.to_owned()));
        assert_eq!(own.collect::<Vec<_>>(), listed.collect::<Vec<_>>());
    }
}
