//! Counts how many OpenSCENARIO files below a folder become scenarios, and how many of their events
//! are driven: `cargo run -p decouplegs-sim --example count_open_scenarios -- DIR [--why]`.
//!
//! Prints a line for each file, with `--why` also what is lost of it, then sums. Files without a
//! storyboard are left out. An event counts as driven if each of its actions is; events of the ego,
//! and those that do nothing which is shown here (lamps, pedals), are not counted.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use decouplegs_scene::explain::explain;
use decouplegs_sim::scenario_import::import_open_scenario;

fn main() -> ExitCode {
    let Some(folder) = std::env::args_os().nth(1) else {
        eprintln!("expected a folder with .xosc files");
        return ExitCode::from(2);
    };
    let says_why = std::env::args_os().any(|argument| argument == "--why");
    let mut files = Vec::new();
    find(Path::new(&folder), &mut files);
    files.sort();
    let (mut scenarios, mut read, mut mostly) = (0, 0, 0);
    let (mut events, mut driven, mut unseen) = (0, 0, 0);
    for file in files {
        let is_scenario =
            std::fs::read_to_string(&file).is_ok_and(|text| text.contains("<Storyboard"));
        if !is_scenario {
            continue;
        }
        scenarios += 1;
        match import_open_scenario(&file, None) {
            Ok(imported) => {
                read += 1;
                events += imported.events;
                driven += imported.events_driven;
                unseen += imported.events_unseen;
                let most = 5 * imported.events_driven >= 4 * imported.events;
                mostly += usize::from(most);
                println!(
                    "{}: {} of {} events",
                    file.display(),
                    imported.events_driven,
                    imported.events
                );
                if says_why && imported.events_driven < imported.events {
                    for sentence in &imported.skipped {
                        println!("    {sentence}");
                    }
                }
            }
            Err(error) => println!(
                "{}: refused: {}",
                file.display(),
                explain(&error).trim_end().replace('\n', "; ")
            ),
        }
    }
    println!(
        "{read} of {scenarios} files are read; {driven} of {events} events of others are driven; {mostly} files \
         with 80 % of them or more; {unseen} events of others do nothing that is shown here"
    );
    ExitCode::SUCCESS
}

fn find(folder: &Path, files: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            find(&path, files);
        } else if path
            .extension()
            .is_some_and(|extension| extension == "xosc")
        {
            files.push(path);
        }
    }
}
