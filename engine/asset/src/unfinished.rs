//! Output folders that are complete or absent, and what killed programs left of theirs.

use std::fs::{self, File, Permissions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use rustix::fs::{FlockOperation, flock};
use tempfile::TempDir;

use crate::atomic::{directory_of, sync_directory_of};
use crate::{AssetError, TEMPORARY_PREFIX};

/// File that marks an unfinished folder as one of ours, and is locked by who writes it.
const MARK: &str = ".unfinished";

/// A folder that is written under a temporary name beside its own, which it gets when it is whole.
/// Dropped before that, it is removed.
#[derive(Debug)]
pub struct UnfinishedFolder {
    part: TempDir,
    out: PathBuf,
    /// Locked as long as the folder is written, however the program ends.
    _mark: File,
}

impl UnfinishedFolder {
    /// Makes the temporary folder for `out`, in the same folder, which is made if it does not
    /// exist. Those that killed programs have left there are removed; those that are written by a
    /// program that runs are locked, and stay.
    ///
    /// # Errors
    /// [`AssetError::Write`] where `out` names no folder or the folder cannot be made.
    pub fn begin(out: &Path) -> Result<Self, AssetError> {
        Self::begun(out).map_err(|source| AssetError::Write {
            path: out.to_owned(),
            source,
        })
    }

    fn begun(out: &Path) -> io::Result<Self> {
        let name = out
            .file_name()
            .ok_or_else(|| io::Error::other("it is no name of a folder"))?;
        let parent = directory_of(out);
        fs::create_dir_all(parent)?;
        sweep(parent);
        let prefix = format!("{TEMPORARY_PREFIX}{}-", name.to_string_lossy());
        let mut builder = tempfile::Builder::new();
        builder.prefix(&prefix);
        // Folders of this kind are private by default; a result is not.
        builder.permissions(<Permissions as std::os::unix::fs::PermissionsExt>::from_mode(0o777));
        loop {
            let part = builder.tempdir_in(parent)?;
            let mut mark = File::create_new(part.path().join(MARK))?;
            // Another program may sweep between the two calls.
            if flock(&mark, FlockOperation::NonBlockingLockExclusive).is_ok()
                && part.path().join(MARK).exists()
            {
                writeln!(mark, "{}", std::process::id())?;
                return Ok(Self {
                    part,
                    out: out.to_owned(),
                    _mark: mark,
                });
            }
        }
    }

    /// The folder, under its temporary name.
    #[must_use]
    pub fn path(&self) -> &Path {
        self.part.path()
    }

    /// Gives the folder its name. An empty folder of that name is replaced.
    ///
    /// # Errors
    /// [`AssetError::Write`] where something else has the name: the folder is removed then.
    pub fn finish(self) -> Result<(), AssetError> {
        let named = fs::remove_file(self.part.path().join(MARK))
            .and_then(|()| fs::rename(self.part.path(), &self.out));
        match named {
            Ok(()) => {
                // It has another name now.
                let _ = self.part.keep();
                sync_directory_of(&self.out);
                Ok(())
            }
            Err(source) => Err(AssetError::Write {
                path: self.out,
                source,
            }),
        }
    }
}

/// Removes the unfinished folders in `parent` that no running program writes to. Folders that
/// cannot be removed are left there.
fn sweep(parent: &Path) {
    for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
        let is_ours = entry
            .file_name()
            .to_string_lossy()
            .starts_with(TEMPORARY_PREFIX)
            && entry.file_type().is_ok_and(|kind| kind.is_dir());
        if !is_ours {
            continue;
        }
        let Ok(mark) = File::open(entry.path().join(MARK)) else {
            continue;
        };
        if flock(&mark, FlockOperation::NonBlockingLockExclusive).is_ok() {
            let _ = fs::remove_dir_all(entry.path());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_folder_is_whole_or_absent() {
        let root = tempfile::tempdir().unwrap();
        let out = root.path().join("made/set");
        let unfinished = UnfinishedFolder::begin(&out).unwrap();
        fs::write(unfinished.path().join("a"), b"a").unwrap();
        assert!(!out.exists());
        unfinished.finish().unwrap();
        assert_eq!(names(&out), ["a"]);
        // What fails leaves nothing, and what is there stays.
        let unfinished = UnfinishedFolder::begin(&out).unwrap();
        fs::write(unfinished.path().join("b"), b"b").unwrap();
        assert!(unfinished.finish().is_err());
        drop(UnfinishedFolder::begin(&out).unwrap());
        assert_eq!(names(&out), ["a"]);
        assert_eq!(names(&root.path().join("made")), ["set"]);
        assert!(UnfinishedFolder::begin(Path::new("/")).is_err());
    }

    #[test]
    fn what_a_killed_program_left_is_swept_and_nothing_else() {
        let root = tempfile::tempdir().unwrap();
        let at = |name: &str| root.path().join(name);
        // A folder of a user, an unfinished one of a killed program, and a link to another place.
        fs::create_dir_all(at(".writing-poems")).unwrap();
        fs::create_dir_all(at(".writing-killed-a1b2c3/images")).unwrap();
        fs::write(at(".writing-killed-a1b2c3").join(MARK), b"1\n").unwrap();
        fs::create_dir_all(at("elsewhere")).unwrap();
        fs::write(at("elsewhere").join(MARK), b"1\n").unwrap();
        std::os::unix::fs::symlink("elsewhere", at(".writing-link")).unwrap();
        // Two that are written, of one name.
        let [first, second] = [0, 1].map(|_| UnfinishedFolder::begin(&at("set")).unwrap());
        assert!(first.path().exists() && second.path().exists());
        assert!(!at(".writing-killed-a1b2c3").exists());
        assert!(at(".writing-poems").exists() && at("elsewhere").join(MARK).exists());
        first.finish().unwrap();
        drop(second);
        assert_eq!(
            names(root.path()),
            [".writing-link", ".writing-poems", "elsewhere", "set"]
        );
    }
}
