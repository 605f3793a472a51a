//! Subcommands that are programs of their own: found beside this one, otherwise on the path.

use std::convert::Infallible;
use std::env;
use std::ffi::OsString;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};
use decouplegs_cli::programs::{PROGRAMS, Program};

/// Program beside this one that `arguments` ask for, and its subcommand: `decouplegs view`, or
/// `decouplegs help view`.
pub fn asked_for(arguments: &[OsString]) -> Option<(&'static Program, &'static str)> {
    let named = arguments.get(1)?;
    let named = match named == "help" {
        true => arguments.get(2)?,
        false => named,
    };
    PROGRAMS.iter().find_map(|program| {
        let names = program.commands.iter().map(|&(name, _)| name);
        Some((*program, names.into_iter().find(|name| named == name)?))
    })
}

/// Becomes `program`, with the same arguments, name, streams and process: its help names
/// `decouplegs`, and signals and exit codes are its own.
///
/// # Errors
/// Returns an error if the program is absent or cannot be started.
pub fn run(program: &Program, command: &str, arguments: &[OsString]) -> Result<()> {
    let beside = env::current_exe().ok();
    let beside = beside.as_deref().and_then(Path::parent);
    let path = env::var_os("PATH").unwrap_or_default();
    // A relative folder on the path may be anyone's.
    let on_path = env::split_paths(&path).filter(|folder| folder.is_absolute());
    let mut folders = beside.map(Path::to_owned).into_iter().chain(on_path);
    let file = folders.find_map(|folder| executable(folder.join(program.name)));
    let file = file.with_context(|| {
        let beside = beside.unwrap_or(Path::new("its own folder")).display();
        let (name, folder) = (program.name, program.folder);
        format!(
            "'decouplegs {command}' is part of the program {name}, which is neither in {beside} nor on PATH: \
             install it from the sources, with 'make install' or 'cargo install --path {folder}'"
        )
    })?;
    let mut next = Command::new(&file);
    if let Some((name, rest)) = arguments.split_first() {
        next.arg0(name).args(rest);
    }
    // Returns only where it fails.
    Err::<Infallible, _>(next.exec())
        .with_context(|| format!("{} cannot be started", file.display()))?;
    Ok(())
}

fn executable(file: PathBuf) -> Option<PathBuf> {
    let metadata = file.metadata().ok()?;
    (metadata.is_file() && metadata.permissions().mode() & 0o111 != 0).then_some(file)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn asked(line: &[&str]) -> Option<&'static str> {
        let line: Vec<OsString> = line.iter().map(OsString::from).collect();
        Some(asked_for(&line)?.0.name)
    }

    #[test]
    fn only_the_subcommand_asks_for_a_program() {
        assert_eq!(
            asked(&["decouplegs", "view", "--help"]),
            Some("decouplegs-view")
        );
        assert_eq!(
            asked(&["decouplegs", "help", "drive"]),
            Some("decouplegs-drive")
        );
        for own in [
            &["decouplegs"] as &[&str],
            &["decouplegs", "help"],
            &["decouplegs", "--help", "view"],
            &["decouplegs", "render", "view"],
            &["decouplegs", "viewer"],
        ] {
            assert_eq!(asked(own), None, "{own:?}");
        }
    }
}
