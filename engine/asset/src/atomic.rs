//! Output files that are complete or absent.

use std::fs::{File, Metadata, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::os::fd::AsRawFd;
use std::path::{Path, PathBuf};

use rustix::fs::{AtFlags, CWD, Mode, OFlags, linkat};

use crate::AssetError;

/// Start of the names of temporary files.
pub const TEMPORARY_PREFIX: &str = ".writing-";
/// Bytes that are collected before they are handed to the operating system.
const BUFFER_BYTES: usize = 1 << 20;
/// Symbolic links that are followed one after the other, as many as Linux follows.
const LINKS_MAX: usize = 40;

/// Writes `path` through `fill` so that no reader ever sees half of it.
///
/// The bytes go to a file without a name in the same directory (with a temporary name where the
/// file system has no such files), are forced to the disk and renamed over `path`. If `fill` or the
/// disk fails, nothing is left behind and the old file stays.
///
/// A symbolic link is followed, and a file that was there keeps its permissions. A device or FIFO
/// is written to directly: it cannot be replaced.
///
/// # Errors
/// [`AssetError::Write`] with the failure of `fill` or of the operating system.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<(), AssetError> {
    write(path, fill).map_err(|source| AssetError::Write {
        path: path.to_owned(),
        source,
    })
}

/// Files that one which is written may replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replaces {
    /// Nothing: a name that is taken, also by a link that leads nowhere, is an error.
    Nothing,
    /// Whatever is there but a folder. A link is replaced itself.
    Anything,
}

/// Writes `path` as [`write_atomically`] does, and follows no link: the file is in the folder of
/// `path` afterwards. For names that a client gives, and folders that others may write.
///
/// # Errors
/// [`AssetError::Write`] with the failure of `fill` or of the operating system, or where
/// [`Replaces::Nothing`] is asked for and the name is taken.
pub fn write_in_folder(
    path: &Path,
    replaces: Replaces,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> Result<(), AssetError> {
    let there = std::fs::symlink_metadata(path).ok();
    let written = match (there, replaces) {
        (Some(_), Replaces::Nothing) => Err(name_is_taken()),
        (there, _) => {
            let kept = there.filter(Metadata::is_file);
            write_at(path, kept.as_ref(), replaces, fill)
        }
    };
    written.map_err(|source| AssetError::Write {
        path: path.to_owned(),
        source,
    })
}

fn name_is_taken() -> io::Error {
    io::Error::other("something of that name exists already, and is left as it is: choose another")
}

/// Checks that [`write_atomically`] could write `path` now: before work that takes long, not after
/// it.
///
/// # Errors
/// [`AssetError::Write`]: no such folder, no permission, a read-only file system.
pub fn check_writable(path: &Path) -> Result<(), AssetError> {
    let check = || {
        let there = std::fs::metadata(path).ok();
        if there.as_ref().is_some_and(Metadata::is_dir) {
            return Err(io::Error::other(
                "it is a folder; expected the name of a file",
            ));
        }
        if there.is_some_and(|there| !there.is_file()) {
            return OpenOptions::new().write(true).open(path).map(drop);
        }
        let file = followed(path)?;
        // Gone as soon as it is made.
        temporary_in(directory_of(&file)).map(drop)
    };
    check().map_err(|source| AssetError::Write {
        path: path.to_owned(),
        source,
    })
}

fn write(
    path: &Path,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    let there = std::fs::metadata(path).ok();
    if there
        .as_ref()
        .is_some_and(|there| !there.is_file() && !there.is_dir())
    {
        return fill_file(&mut OpenOptions::new().write(true).open(path)?, fill);
    }
    write_at(&followed(path)?, there.as_ref(), Replaces::Anything, fill)
}

/// Writes the file at `path`, whose last part is no link that is to be followed, with the
/// permissions of the file `there`.
fn write_at(
    path: &Path,
    there: Option<&Metadata>,
    replaces: Replaces,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    let directory = directory_of(path);
    let unnamed = rustix::fs::open(
        directory,
        OFlags::TMPFILE | OFlags::WRONLY | OFlags::CLOEXEC,
        Mode::from_raw_mode(0o666),
    );
    match unnamed {
        Ok(unnamed) => {
            let mut file = File::from(unnamed);
            fill_file(&mut file, fill)?;
            finish(&file, there)?;
            give_name(&file, path, replaces)?;
        }
        // Whatever is wrong with the directory, the next call tells it too.
        Err(_) => {
            let mut temporary = temporary_in(directory)?;
            fill_file(temporary.as_file_mut(), fill)?;
            finish(temporary.as_file(), there)?;
            let named = match replaces {
                Replaces::Anything => temporary.persist(path),
                Replaces::Nothing => temporary.persist_noclobber(path),
            };
            named.map_err(|error| error.error)?;
        }
    }
    sync_directory_of(path);
    Ok(())
}

fn fill_file(
    file: &mut File,
    fill: impl FnOnce(&mut BufWriter<&mut File>) -> io::Result<()>,
) -> io::Result<()> {
    let mut buffered = BufWriter::with_capacity(BUFFER_BYTES, file);
    fill(&mut buffered)?;
    buffered.flush()
}

/// Gives `file` the permissions of the file that it replaces, and forces it to the disk.
fn finish(file: &File, replaced: Option<&Metadata>) -> io::Result<()> {
    if let Some(replaced) = replaced {
        file.set_permissions(replaced.permissions())?;
    }
    file.sync_all()
}

/// Links `file`, which has no name, to `path`, over any file there that it may replace. Only the
/// last two steps leave a file behind if the program is killed between them.
fn give_name(file: &File, path: &Path, replaces: Replaces) -> io::Result<()> {
    let unnamed = format!("/proc/self/fd/{}", file.as_raw_fd());
    let link = |name: &Path| linkat(CWD, unnamed.as_str(), CWD, name, AtFlags::SYMLINK_FOLLOW);
    match link(path) {
        Err(rustix::io::Errno::EXIST) if replaces == Replaces::Nothing => Err(name_is_taken()),
        Err(rustix::io::Errno::EXIST) => {
            let temporary = temporary_name().make_in(directory_of(path), |name| Ok(link(name)?))?;
            temporary
                .into_temp_path()
                .persist(path)
                .map_err(|error| error.error)
        }
        other => Ok(other?),
    }
}

/// A new temporary file in `folder`, as readable as any file the user creates. Errors do not
/// contain its random name.
fn temporary_in(folder: &Path) -> io::Result<tempfile::NamedTempFile> {
    if !folder.is_dir() {
        let folder = folder.display();
        return Err(io::Error::other(format!(
            "there is no folder {folder}; make it first"
        )));
    }
    let mut reason = None;
    let made = temporary_name().make_in(folder, |name| {
        let mut options = OpenOptions::new();
        let opened = options.read(true).write(true).create_new(true).open(name);
        opened.inspect_err(|error| reason = error.raw_os_error())
    });
    made.map_err(|error| reason.map_or(error, io::Error::from_raw_os_error))
}

fn temporary_name() -> tempfile::Builder<'static, 'static> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(TEMPORARY_PREFIX);
    builder
}

/// `path` with its symbolic links followed, as far as its last part is one. What it leads to need
/// not exist.
fn followed(path: &Path) -> io::Result<PathBuf> {
    let mut path = path.to_owned();
    for _ in 0..LINKS_MAX {
        match std::fs::read_link(&path) {
            Ok(target) => path = directory_of(&path).join(target),
            Err(_) => return Ok(path),
        }
    }
    Err(io::Error::other(
        "too many symbolic links, one behind the other",
    ))
}

/// The directory that `path` is in.
pub(crate) fn directory_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Makes a rename to `path` survive a power cut; systems that cannot sync a directory have no such
/// guarantee to give.
pub fn sync_directory_of(path: &Path) {
    if let Ok(directory) = File::open(directory_of(path)) {
        let _ = directory.sync_all();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_do_not_contain_the_name_of_a_temporary_file() {
        let directory = tempfile::tempdir().unwrap();
        let missing = directory.path().join("none/a.txt");
        let checked = check_writable(&missing).unwrap_err().to_string();
        let written = write_atomically(&missing, |file| file.write_all(b"a"));
        assert_eq!(written.unwrap_err().to_string(), checked);
        assert!(checked.contains("there is no folder"), "{checked}");
        // A folder that takes no files, not even those of root.
        let taken = write_atomically(Path::new("/proc/a.txt"), |_| Ok(()));
        let taken = taken.unwrap_err().to_string();
        assert!(!taken.contains(TEMPORARY_PREFIX), "{taken}");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_litter() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        write_atomically(&path, |file| file.write_all(b"first")).unwrap();
        let error = write_atomically(&path, |file| {
            file.write_all(b"second, cut")?;
            Err(io::Error::other("disk on fire"))
        })
        .unwrap_err();
        assert!(
            error.to_string().contains("a.txt") && error.to_string().contains("disk on fire"),
            "{error}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), b"first");
        assert_eq!(std::fs::read_dir(directory.path()).unwrap().count(), 1);
        write_atomically(&path, |file| file.write_all(b"third")).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"third");
    }

    #[test]
    fn links_are_followed_and_permissions_stay() {
        use std::fs::Permissions;
        use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::create_dir(at("far")).unwrap();
        symlink("far/file", at("link")).unwrap();
        symlink("link", at("link_to_link")).unwrap();
        write_atomically(&at("link_to_link"), |file| file.write_all(b"first")).unwrap();
        assert_eq!(std::fs::read(at("far/file")).unwrap(), b"first");
        std::fs::set_permissions(at("far/file"), Permissions::from_mode(0o600)).unwrap();
        write_atomically(&at("link"), |file| file.write_all(b"second")).unwrap();
        assert_eq!(std::fs::read(at("far/file")).unwrap(), b"second");
        assert_eq!(std::fs::metadata(at("link")).unwrap().mode() & 0o777, 0o600);
        assert!(std::fs::symlink_metadata(at("link")).unwrap().is_symlink());
        assert_eq!(
            std::fs::read_dir(at("far")).unwrap().count(),
            1,
            "no litter"
        );
        symlink("round", at("round")).unwrap();
        assert!(
            write_atomically(&at("round"), |_| Ok(()))
                .unwrap_err()
                .to_string()
                .contains("round")
        );
    }

    #[test]
    fn a_name_in_a_folder_leads_nowhere_else() {
        use std::os::unix::fs::symlink;
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        std::fs::create_dir_all(at("in")).unwrap();
        let write = |name: &str, replaces| {
            write_in_folder(&at(name), replaces, |file| file.write_all(b"new"))
                .map_err(|error| error.to_string())
        };
        symlink("../elsewhere", at("in/dangling")).unwrap();
        std::fs::write(at("in/taken"), b"old").unwrap();
        for name in ["in/dangling", "in/taken", "in"] {
            let refused = write(name, Replaces::Nothing).unwrap_err();
            assert!(refused.contains("choose another"), "{name}: {refused}");
        }
        assert_eq!(std::fs::read(at("in/taken")).unwrap(), b"old");
        write("in/fresh", Replaces::Nothing).unwrap();
        // A link that was put there meanwhile is replaced, and nothing is written through it.
        write("in/dangling", Replaces::Anything).unwrap();
        write("in/taken", Replaces::Anything).unwrap();
        assert!(write("in", Replaces::Anything).is_err());
        for name in ["in/dangling", "in/taken", "in/fresh"] {
            assert!(std::fs::symlink_metadata(at(name)).unwrap().is_file());
            assert_eq!(std::fs::read(at(name)).unwrap(), b"new");
        }
        assert!(!at("elsewhere").exists());
        assert_eq!(std::fs::read_dir(at("in")).unwrap().count(), 3, "no litter");
    }

    #[test]
    fn devices_and_fifos_are_written_to_and_stay_what_they_are() {
        use std::os::unix::fs::FileTypeExt;
        write_atomically(Path::new("/dev/null"), |file| file.write_all(b"nothing")).unwrap();
        assert!(
            std::fs::metadata("/dev/null")
                .unwrap()
                .file_type()
                .is_char_device()
        );
        let directory = tempfile::tempdir().unwrap();
        let fifo = directory.path().join("fifo");
        rustix::fs::mknodat(
            CWD,
            &fifo,
            rustix::fs::FileType::Fifo,
            Mode::RUSR | Mode::WUSR,
            0,
        )
        .unwrap();
        let reader = std::thread::spawn({
            let fifo = fifo.clone();
            move || std::fs::read(fifo).unwrap()
        });
        write_atomically(&fifo, |file| file.write_all(b"through")).unwrap();
        assert_eq!(reader.join().unwrap(), b"through");
        assert!(std::fs::metadata(&fifo).unwrap().file_type().is_fifo());
    }

    #[test]
    fn a_place_that_cannot_be_written_is_told_beforehand() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.txt");
        check_writable(&path).unwrap();
        assert_eq!(
            std::fs::read_dir(directory.path()).unwrap().count(),
            0,
            "nothing is left behind"
        );
        for (wrong, part) in [
            (directory.path().to_owned(), "folder"),
            (path.join("b"), "a.txt/b"),
            ("/proc/a".into(), "/proc/a"),
        ] {
            let message = check_writable(&wrong).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
        std::fs::write(&path, "kept").unwrap();
        check_writable(&path).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"kept");
    }

    #[test]
    fn a_missing_directory_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let error = write_atomically(&directory.path().join("none/b.txt"), |_| Ok(())).unwrap_err();
        assert!(error.to_string().contains("none/b.txt"), "{error}");
    }
}
