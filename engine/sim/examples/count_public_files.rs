//! Counts what becomes of public maps and scenarios, which are listed by repository, commit and
//! path in `public_files.txt`: `cargo run -p decouplegs-sim --example count_public_files -- DIR
//! [--why]`.
//!
//! `DIR` has a folder for each repository that is at hand, `OWNER/NAME`, with its files as of the
//! commit. Prints a table: how many files are listed, at hand and read, how many of the maps
//! traffic can drive on, and how many events of others than the ego are driven; with `--why` also
//! the reason for each file that is refused.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use decouplegs_asset::read_map;
use decouplegs_drive::RoadGraph;
use decouplegs_scene::explain::explain;
use decouplegs_sim::scenario_import::import_open_scenario;

/// Repositories with their commits, each before its paths.
const LIST: &str = include_str!("public_files.txt");

/// Counts of one repository and kind of file.
#[derive(Default)]
struct Counts {
    repository: String,
    kind: String,
    listed: usize,
    at_hand: usize,
    read: usize,
    drivable: usize,
    events: usize,
    driven: usize,
}

fn main() -> ExitCode {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("expected a folder with the repositories, OWNER/NAME");
        return ExitCode::from(2);
    };
    let says_why = std::env::args_os().any(|argument| argument == "--why");
    let mut table: Vec<Counts> = Vec::new();
    let mut repository = "";
    for line in LIST.lines() {
        if let Some(head) = line.strip_prefix("# ") {
            repository = head.split_once(' ').map_or(head, |(name, _)| name);
            continue;
        }
        let kind = line.rsplit_once('.').map_or("", |(_, kind)| kind);
        let is_own = |row: &Counts| row.repository == repository && row.kind == kind;
        let found = table.iter().position(is_own);
        let at = found.unwrap_or_else(|| {
            table.push(Counts {
                repository: repository.into(),
                kind: kind.into(),
                ..Counts::default()
            });
            table.len() - 1
        });
        if let Err(reason) = table[at].add(&folder.join(repository).join(line))
            && says_why
        {
            println!("{repository}/{line}: {reason}");
        }
    }
    println!("repository, kind: listed, at hand, read, drivable maps, events of others driven");
    for row in &table {
        println!(
            "{}, {}: {}, {}, {}, {}, {} of {}",
            row.repository,
            row.kind,
            row.listed,
            row.at_hand,
            row.read,
            row.drivable,
            row.driven,
            row.events
        );
    }
    let sum = |of: fn(&Counts) -> usize| table.iter().map(of).sum::<usize>();
    println!(
        "{} of {} files at hand are read; {} are listed",
        sum(|row| row.read),
        sum(|row| row.at_hand),
        sum(|row| row.listed)
    );
    ExitCode::SUCCESS
}

impl Counts {
    /// Adds a file.
    ///
    /// # Errors
    /// A sentence if it is refused.
    fn add(&mut self, path: &Path) -> Result<(), String> {
        self.listed += 1;
        if !path.is_file() {
            return Ok(());
        }
        self.at_hand += 1;
        if self.kind == "xosc" {
            let read = import_open_scenario(path, None).map_err(|error| sentence(&error))?;
            self.events += read.events;
            self.driven += read.events_driven;
        } else {
            let map = read_map(path).map_err(|error| sentence(&error))?;
            self.drivable += usize::from(RoadGraph::new(&map).is_ok());
        }
        self.read += 1;
        Ok(())
    }
}

fn sentence(error: &(dyn std::error::Error + 'static)) -> String {
    explain(error).trim_end().replace('\n', "; ")
}
