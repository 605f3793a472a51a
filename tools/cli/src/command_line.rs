//! Command lines of the programs, and the words for mistakes in them.

use std::error::Error;
use std::ffi::OsString;
use std::num::{IntErrorKind, ParseFloatError, ParseIntError};

use clap::error::{ContextKind, ContextValue, ErrorKind};
use clap::{ArgMatches, Command, Parser};

/// Parses the command line of this process, or prints what is wrong with it and exits with 2.
#[must_use]
pub fn parse<P: Parser>() -> P {
    let matches = matches(P::command(), std::env::args_os());
    P::from_arg_matches(&matches).unwrap_or_else(|error| error.exit())
}

/// Parses `arguments` of `command`, or prints what is wrong with them and exits with 2.
#[must_use]
pub fn matches(command: Command, arguments: impl IntoIterator<Item = OsString>) -> ArgMatches {
    try_matches(command, arguments).unwrap_or_else(|error| error.exit())
}

fn try_matches<T: Into<OsString> + Clone>(
    command: Command,
    arguments: impl IntoIterator<Item = T>,
) -> Result<ArgMatches, clap::Error> {
    with_negative_numbers(command)
        .try_get_matches_from(arguments)
        .map_err(in_words)
}

/// Lets every option take a number below zero, so that its own parser refuses it with the range,
/// and not clap as an unknown option.
fn with_negative_numbers(command: Command) -> Command {
    let command = command.mut_args(|argument| {
        let takes_values = argument.get_long().is_some() && argument.get_action().takes_values();
        if takes_values && !argument.is_allow_hyphen_values_set() {
            argument.allow_negative_numbers(true)
        } else {
            argument
        }
    });
    command.mut_subcommands(with_negative_numbers)
}

/// `error`, with what is expected instead of the standard library's words for texts that are no
/// numbers.
fn in_words(error: clap::Error) -> clap::Error {
    let is_float = |cause: &(dyn Error + 'static)| cause.is::<ParseFloatError>();
    let expected = error.source().and_then(|cause| {
        let whole = cause.downcast_ref::<ParseIntError>();
        let whole = whole.map(|cause| expected_for(cause.kind()));
        whole.or(is_float(cause).then_some("a number"))
    });
    let context = |kind| match error.get(kind) {
        Some(ContextValue::String(text)) => Some(text),
        _ => None,
    };
    let found = context(ContextKind::InvalidArg).zip(context(ContextKind::InvalidValue));
    let (Some(expected), Some((option, value))) = (expected, found) else {
        return error;
    };
    let sentence = format!(
        "invalid value '{value}' for '{option}': expected {expected}, found {value:?}\n\n\
         For more information, try '--help'.\n"
    );
    clap::Error::raw(ErrorKind::ValueValidation, sentence)
}

/// Number that is expected where a whole one was refused as `kind`.
fn expected_for(kind: &IntErrorKind) -> &'static str {
    match kind {
        IntErrorKind::PosOverflow => "a smaller whole number",
        IntErrorKind::NegOverflow | IntErrorKind::Zero => "a whole number above 0",
        _ => "a whole number, 0 or above",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::num::NonZeroUsize;

    #[derive(Parser)]
    struct Nested {
        #[command(subcommand)]
        command: Draw,
    }

    #[derive(clap::Subcommand)]
    enum Draw {
        Draw {
            #[arg(long)]
            seed: Option<u64>,
            #[arg(long, value_parser = clap::value_parser!(u16).range(1..=9))]
            port: Option<u16>,
            #[arg(long)]
            cells: Option<NonZeroUsize>,
            #[arg(long)]
            gain: Option<f64>,
            #[arg(long)]
            force: bool,
        },
    }

    fn said(words: &[&str]) -> String {
        let line = [&["program", "draw"], words].concat();
        let error = try_matches(<Nested as clap::CommandFactory>::command(), line).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    }

    #[test]
    fn what_is_no_number_is_told_what_is_expected() {
        for (words, expected) in [
            (
                ["--seed", "x"],
                "expected a whole number, 0 or above, found \"x\"",
            ),
            (
                ["--seed", "-5"],
                "expected a whole number, 0 or above, found \"-5\"",
            ),
            (
                ["--seed", ""],
                "for '--seed <SEED>': expected a whole number",
            ),
            (
                ["--seed", "99999999999999999999"],
                "expected a smaller whole number",
            ),
            (["--cells", "0"], "expected a whole number above 0"),
            (
                ["--gain", "much"],
                "invalid value 'much' for '--gain <GAIN>': expected a number",
            ),
            (["--port", "-1"], "-1 is not in 1..=9"),
            (["--port", "x"], "expected a whole number"),
        ] {
            let said = said(&words);
            assert!(said.contains(expected), "{said}");
            assert!(said.ends_with("try '--help'.\n"), "{said}");
        }
    }

    #[test]
    fn other_mistakes_and_numbers_below_zero_are_as_they_were() {
        assert!(said(&["--force", "-1"]).contains("unexpected argument '-1'"));
        assert!(said(&["--sed", "1"]).contains("'--seed'"));
        let line = ["program", "draw", "--gain", "-1.5", "--seed", "7"];
        let matches = try_matches(<Nested as clap::CommandFactory>::command(), line).unwrap();
        let Draw::Draw {
            seed,
            port,
            cells,
            gain,
            force,
        } = <Nested as clap::FromArgMatches>::from_arg_matches(&matches)
            .unwrap()
            .command;
        assert_eq!((seed, gain, force), (Some(7), Some(-1.5), false));
        assert_eq!((port, cells), (None, None));
    }
}
