//! `decouplegs score`: scores from logs.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Result;
use decouplegs::asset::write_atomically;
use decouplegs::episode::Appearance;
use decouplegs::logs::read_episode_log;

use crate::arguments::print;
use crate::background::BackgroundArguments;
use crate::episode_report::{self, HdScores, Hugsim, Scored};
use crate::outputs::Force;
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
    /// Print the HD-Score of HUGSIM too; with --out, write hugsim.json
    #[arg(long, value_name = "VERSION", value_enum, conflicts_with = "against")]
    hugsim: Option<Hugsim>,
    /// Write report.json and report.html, with --against comparison.json and comparison.html, to
    /// this folder too
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Checks the files that are to be written.
fn check_outputs(arguments: &Arguments) -> Result<()> {
    let Some(out) = arguments.out.as_ref().filter(|out| out.is_dir()) else {
        return Ok(());
    };
    let name = match arguments.against.is_empty() {
        true => "report",
        false => "comparison",
    };
    let mut written = vec![format!("{name}.json"), format!("{name}.html")];
    written.extend(arguments.hugsim.map(|_| "hugsim.json".to_owned()));
    let written: Vec<PathBuf> = written.iter().map(|name| out.join(name)).collect();
    arguments.force.files(&[], &written)
}

pub fn run(arguments: &Arguments) -> Result<()> {
    check_outputs(arguments)?;
    let scored = read(&arguments.logs)?;
    let out = arguments.out.as_deref();
    let sites = Sites::new(&[], BackgroundArguments::default(), Appearance::default());
    let text = match out {
        _ if !arguments.against.is_empty() => {
            episode_report::compare(&scored, &read(&arguments.against)?, out)?
        }
        Some(out) => episode_report::write(&scored, &sites, None, out)?,
        None => episode_report::text(&scored)?,
    };
    print(&text)?;
    if let Some(version) = arguments.hugsim {
        let scores = HdScores::from_scored(&scored, version, &sites)?;
        if let Some(out) = out {
            let report = scores.to_json(&scored);
            write_atomically(&out.join("hugsim.json"), |file| {
                writeln!(file, "{report:#}")
            })?;
        }
        print(&scores.text(&scored))?;
    }
    Ok(())
}

fn read(paths: &[PathBuf]) -> Result<Vec<Scored>> {
    let bar = progress::bar("logs", paths.len());
    let mut scored = Vec::with_capacity(paths.len());
    for path in paths {
        let images = episode_report::images_beside(path);
        scored.extend(Scored::egos(read_episode_log(path)?, path, &images, None)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    scored.sort_by(|a, b| (a.level(), a.name()).cmp(&(b.level(), b.name())));
    Ok(scored)
}
