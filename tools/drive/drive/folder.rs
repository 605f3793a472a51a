//! The folder of a run: what is finished stays, and what is not is driven again.
//!
//! `run.json` says with what the run was begun, `scenarios/` holds what is driven, `logs/` what
//! happened. A log under its own name is whole: it is renamed when its last line is in, so that a
//! run can be stopped at any moment and loses what is under way.

use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use decouplegs::asset::{TEMPORARY_PREFIX, write_atomically};
use decouplegs_cli::outputs::Force;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde_json::Value;

/// Name of the file that is locked while a run goes on. It holds the number of the process.
const LOCK: &str = "run.lock";

pub struct RunFolder {
    root: PathBuf,
    /// True where no run was in it before.
    is_new: bool,
    /// Locked until the run ends, however it ends.
    _lock: File,
}

impl RunFolder {
    /// The folder at `root`, made if it does not exist, for a run with `settings`.
    pub fn open(root: &Path, settings: &Value) -> Result<Self> {
        // The files of a run that is there stay, and others beside them.
        Force { force: true }.outputs(&[]).folder(root)?;
        let is_new = !root.join("scenarios").exists() && !root.join("run.json").exists();
        for part in ["scenarios", "logs"] {
            let part = root.join(part);
            fs::create_dir_all(&part)
                .with_context(|| format!("{} cannot be made", part.display()))?;
        }
        let folder = Self {
            root: root.to_owned(),
            is_new,
            _lock: locked(root)?,
        };
        sweep(&[root.to_owned(), root.join("scenarios"), root.join("logs")]);
        let path = folder.root.join("run.json");
        match fs::read(&path) {
            Ok(bytes) => {
                let begun: Value = serde_json::from_slice(&bytes).with_context(|| {
                    format!("{} is no JSON: remove it to begin again", path.display())
                })?;
                check_same(&path, &begun, settings)?;
            }
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                write_atomically(&path, |file| writeln!(file, "{settings:#}"))?;
            }
            Err(error) => {
                return Err(error).with_context(|| format!("{} cannot be read", path.display()));
            }
        }
        Ok(folder)
    }

    /// Removes the files of a run that could not begin, so that it keeps nobody from another one.
    /// Files that the folder had before stay.
    pub fn forget(self) {
        if !self.is_new {
            return;
        }
        // What stays does no harm.
        let _ = fs::remove_dir_all(self.root.join("scenarios"));
        let _ = fs::remove_dir(self.root.join("logs"));
        let _ = fs::remove_file(self.difficulty());
        let _ = fs::remove_file(self.root.join("run.json"));
        let _ = fs::remove_file(self.root.join(LOCK));
        let _ = fs::remove_dir(&self.root);
    }

    pub fn scenario(&self, name: &str) -> PathBuf {
        self.root.join("scenarios").join(format!("{name}.toml"))
    }

    /// Difficulty of the scenarios, as it was measured.
    pub fn difficulty(&self) -> PathBuf {
        self.root.join("difficulty.json")
    }

    pub fn log(&self, name: &str) -> PathBuf {
        self.root.join("logs").join(format!("{name}.log"))
    }

    /// The folder of an episode's images.
    pub fn images(&self, name: &str) -> PathBuf {
        self.root.join("images").join(name)
    }
}

/// The lock of the run in `root`. Two runs in one folder would write the same logs.
fn locked(root: &Path) -> Result<File> {
    let path = root.join(LOCK);
    let open = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path);
    let mut file = open.with_context(|| format!("{} cannot be opened", path.display()))?;
    match flock(&file, FlockOperation::NonBlockingLockExclusive) {
        Ok(()) => {}
        Err(Errno::WOULDBLOCK) => {
            let mut holder = String::new();
            // Only for the message.
            let _ = file.read_to_string(&mut holder);
            bail!(
                "{} is in use by another run (process {}): wait for its end, or name another folder with --out",
                root.display(),
                holder.trim()
            );
        }
        Err(error) => {
            return Err(error).with_context(|| format!("{} cannot be locked", path.display()));
        }
    }
    file.set_len(0)
        .and_then(|()| writeln!(file, "{}", std::process::id()))
        .with_context(|| format!("{} cannot be written", path.display()))?;
    Ok(file)
}

/// Removes what killed runs have left in `folders`: temporary files of half a second, by their
/// names.
fn sweep(folders: &[PathBuf]) {
    let entries = folders
        .iter()
        .filter_map(|folder| fs::read_dir(folder).ok())
        .flatten()
        .flatten();
    for entry in entries.filter(|entry| {
        entry
            .file_name()
            .to_string_lossy()
            .starts_with(TEMPORARY_PREFIX)
    }) {
        // One that stays does no harm.
        let _ = fs::remove_file(entry.path());
    }
}

/// Refuses to add episodes to those of another run: their scores would be mixed.
fn check_same(path: &Path, begun: &Value, settings: &Value) -> Result<()> {
    if let Some((key, was, wanted)) = first_difference("", begun, settings) {
        bail!(
            "{} holds a run with {key} = {was}, and this one has {wanted}: give the same options to go on with it, or another \
             folder with --out",
            path.parent().unwrap_or(path).display()
        );
    }
    Ok(())
}

/// The first value of `wanted` that `begun` does not have, with its key, such as `place.scene`, and
/// what `begun` has there.
fn first_difference<'a>(
    key: &str,
    begun: &'a Value,
    wanted: &'a Value,
) -> Option<(String, &'a Value, &'a Value)> {
    let (Some(_), Some(fields)) = (begun.as_object(), wanted.as_object()) else {
        return (begun != wanted).then(|| (key.to_owned(), begun, wanted));
    };
    let dot = if key.is_empty() { "" } else { "." };
    let found = fields.iter().find_map(|(name, wanted)| {
        let was = begun.get(name).unwrap_or(&Value::Null);
        first_difference(&format!("{key}{dot}{name}"), was, wanted)
    });
    // The run may have been begun with more settings, but none with more parts.
    let differs = !key.is_empty() && begun != wanted;
    found.or_else(|| differs.then(|| (key.to_owned(), begun, wanted)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_run_goes_on_with_the_same_settings_and_no_others() {
        let root = tempfile::tempdir().unwrap();
        let settings = json!({ "planner": "lane-follow", "seed": 1 });
        RunFolder::open(root.path(), &settings).unwrap();
        fs::write(root.path().join("logs/.writing-abc123"), "litter").unwrap();
        let run = RunFolder::open(root.path(), &settings).unwrap();
        assert_eq!(
            fs::read_dir(root.path().join("logs")).unwrap().count(),
            0,
            "litter of a killed run is removed"
        );
        let second = RunFolder::open(root.path(), &settings)
            .err()
            .unwrap()
            .to_string();
        assert!(
            second.contains("in use") && second.contains(&std::process::id().to_string()),
            "{second}"
        );
        drop(run);
        let other = RunFolder::open(root.path(), &json!({ "planner": "vision", "seed": 1 }))
            .err()
            .unwrap()
            .to_string();
        assert!(
            other.contains("planner = \"lane-follow\"") && other.contains("\"vision\""),
            "{other}"
        );
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let root = tempfile::tempdir().unwrap();
        let taken = root.path().join("taken");
        fs::write(&taken, "a file").unwrap();
        let refused = RunFolder::open(&taken, &json!({}))
            .err()
            .unwrap()
            .to_string();
        assert!(refused.contains("taken is a file"), "{refused}");
    }

    #[test]
    fn a_setting_in_a_setting_is_named_alone() {
        let root = tempfile::tempdir().unwrap();
        let place = |scene: Value| json!({ "place": { "map": null, "scene": scene } });
        drop(RunFolder::open(root.path(), &place(Value::Null)).unwrap());
        let other = RunFolder::open(root.path(), &place(json!("street")));
        let other = other.err().unwrap().to_string();
        assert!(
            other.contains("with place.scene = null, and this one has \"street\":"),
            "{other}"
        );
        let fewer = RunFolder::open(root.path(), &json!({ "place": { "map": null } }));
        let fewer = fewer.err().unwrap().to_string();
        assert!(fewer.contains("with place = {"), "{fewer}");
    }

    #[test]
    fn a_run_that_could_not_begin_leaves_nothing() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        let run = RunFolder::open(&at("new"), &json!({ "seed": 1 })).unwrap();
        fs::write(run.scenario("easy_0000"), "").unwrap();
        run.forget();
        assert!(!at("new").exists());
        fs::create_dir(at("mine")).unwrap();
        fs::write(at("mine/notes.txt"), "").unwrap();
        RunFolder::open(&at("mine"), &json!({})).unwrap().forget();
        assert_eq!(fs::read_dir(at("mine")).unwrap().count(), 1);
        drop(RunFolder::open(&at("old"), &json!({})).unwrap());
        RunFolder::open(&at("old"), &json!({})).unwrap().forget();
        assert!(at("old/run.json").exists() && at("old/scenarios").exists());
        fs::remove_dir(at("old/scenarios")).unwrap();
        RunFolder::open(&at("old"), &json!({})).unwrap().forget();
        assert!(at("old/run.json").exists());
    }
}
