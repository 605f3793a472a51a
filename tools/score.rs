//! `decouplegs score`: scores from logs.

use std::path::PathBuf;

use anyhow::Result;
use decouplegs::asset::read_episode_log;
use decouplegs::episode::Appearance;

use crate::arguments::print;
use crate::background::BackgroundArguments;
use crate::episode_report::{self, Scored};
use crate::progress;
use crate::sites::Sites;

/// Score episodes again from their logs, without rendering
#[derive(clap::Args)]
pub struct Arguments {
    /// Logs of episodes, as `drive` writes them
    #[arg(required = true, value_name = "LOG")]
    logs: Vec<PathBuf>,
    /// Compare with these logs of another run, episode by episode. Both runs need the same
    /// scenarios
    #[arg(long, value_name = "LOG", num_args = 1..)]
    against: Vec<PathBuf>,
    /// Write report.json and report.html, with --against comparison.json and comparison.html, to
    /// this folder too
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let scored = read(&arguments.logs)?;
    let out = arguments.out.as_deref();
    let text = match out {
        _ if !arguments.against.is_empty() => {
            episode_report::compare(&scored, &read(&arguments.against)?, out)?
        }
        Some(out) => episode_report::write(
            &scored,
            &Sites::new(None, BackgroundArguments::default(), Appearance::default()),
            out,
        )?,
        None => episode_report::text(&scored)?,
    };
    print(&text)
}

fn read(paths: &[PathBuf]) -> Result<Vec<Scored>> {
    let bar = progress::bar("logs", paths.len());
    let mut scored = Vec::with_capacity(paths.len());
    for path in paths {
        let images = episode_report::images_beside(path);
        scored.push(Scored::new(
            read_episode_log(path)?,
            path.clone(),
            images,
            None,
        )?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    scored.sort_by(|a, b| (a.level(), a.name()).cmp(&(b.level(), b.name())));
    Ok(scored)
}
