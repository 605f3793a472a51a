//! The program `decouplegs-server`.
//!
//! It exits with 0 when it was told to stop, with 1 when it could not serve (one sentence on
//! standard error, then its causes), with 2 when the command line makes no sense, and with 130 when
//! it was told twice.
#![forbid(unsafe_code)]

use std::io::{IsTerminal, Write};
use std::process::ExitCode;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::{Parser, Subcommand};
use decouplegs::asset::write_atomically;
use decouplegs_cli::arguments::print;
use decouplegs_cli::command_line::parse;
use decouplegs_cli::programs::exit_code;
use decouplegs_server::bench::{self, BenchOptions};
use decouplegs_server::conform::{self, ConformOptions, Report};
use decouplegs_server::options::{LogForm, ServerOptions};
use decouplegs_server::running;
use tokio::signal::unix::{SignalKind, signal};
use tracing_subscriber::EnvFilter;

/// Exit code after a second signal: that of programs that Ctrl-C ended.
const EXIT_INTERRUPTED: i32 = 130;
/// Time for threads that read files to end after the server has ended.
const THREADS_PATIENCE: Duration = Duration::from_secs(1);

/// Serves images of scenes to closed-loop simulators, over gRPC.
#[derive(Parser)]
#[command(name = "decouplegs-server", version, propagate_version = true)]
struct Program {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Serve until SIGTERM or SIGINT
    #[command(name = "serve-grpc", visible_alias = "serve")]
    Serve(Box<ServerOptions>),
    /// Start a server in this process, request images over the loopback, and report latencies
    Bench(Box<BenchOptions>),
    Conform(Box<ConformOptions>),
}

fn main() -> ExitCode {
    let started = Instant::now();
    let done = match parse::<Program>().command {
        Command::Serve(options) => serve(&options),
        Command::Bench(options) => {
            log(LogForm::Text, "warn");
            let checked = options.force.files(&[], &options.json);
            checked.and_then(|()| bench::run(&options, started))
        }
        Command::Conform(options) => judge(&options),
    };
    exit_code(&done)
}

fn serve(options: &ServerOptions) -> Result<()> {
    log(options.log, options.log_level.name());
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .context("no threads")?;
    let served = runtime.block_on(async {
        // Until it answers, a signal ends it at once: nothing has begun.
        let running = running::start(options).await?;
        let (mut terminated, mut interrupted) = (
            signal(SignalKind::terminate())?,
            signal(SignalKind::interrupt())?,
        );
        let mut said = std::io::stdout().lock();
        writeln!(said, "listening on {}", running.address)?;
        if let Some(address) = running.metrics_address {
            writeln!(said, "metrics on http://{address}/metrics")?;
        }
        said.flush()?;
        drop(said);
        let message = async move {
            tokio::select! {
                _ = terminated.recv() => {}
                _ = interrupted.recv() => {}
            }
            tracing::info!(
                "told to stop: finishing what has begun; a second signal ends it at once"
            );
            tokio::spawn(async move {
                tokio::select! {
                    _ = terminated.recv() => {}
                    _ = interrupted.recv() => {}
                }
                std::process::exit(EXIT_INTERRUPTED);
            });
        };
        running.until(message).await
    });
    // Threads that still read a file may wait for it forever: a hung network drive.
    runtime.shutdown_timeout(THREADS_PATIENCE);
    served
}

fn judge(options: &ConformOptions) -> Result<()> {
    options.force.files(&[], &options.json)?;
    let mut printed = Ok(());
    let report = conform::run(options, &mut |check, outcome| {
        if printed.is_ok() {
            printed = print(&Report::line(check, outcome));
        }
    })?;
    printed?;
    print(&report.summary())?;
    if let Some(path) = &options.json {
        write_atomically(path, |file| writeln!(file, "{:#}", report.to_json()))?;
    }
    let failed = report.failed().len();
    if failed > 0 {
        bail!("{failed} checks failed");
    }
    Ok(())
}

/// Events go to standard error: those that `RUST_LOG` says, otherwise those of `level` and above.
fn log(form: LogForm, level: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(level));
    let events = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    match form {
        LogForm::Text => events.init(),
        LogForm::Json => events.json().init(),
    }
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
        for (name, about) in programs::SERVER.commands {
            let own = command.find_subcommand(name).expect(name);
            assert_eq!(
                own.get_about().map(ToString::to_string).as_deref(),
                Some(*about)
            );
        }
    }
}
