//! Files and folders that a subcommand writes, checked before its work begins.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use decouplegs_asset::{TEMPORARY_PREFIX, check_writable};

/// Extensions of the files that the programs write. A new folder of such a name is a mistake.
const FILE_EXTENSIONS: [&str; 29] = [
    "bin",
    "bmp",
    "csv",
    "exr",
    "feather",
    "gif",
    "glb",
    "html",
    "jpeg",
    "jpg",
    "json",
    "log",
    "mcap",
    "mp4",
    "npy",
    "npz",
    "pcd",
    "ply",
    "png",
    "safetensors",
    "sog",
    "splat",
    "spz",
    "svg",
    "toml",
    "txt",
    "usdz",
    "webp",
    "xodr",
];

/// The option to replace what exists.
#[derive(clap::Args, Clone, Copy, Debug, Default)]
pub struct Force {
    /// Replace files that exist, and write into a folder that is not empty. The inputs are never
    /// replaced
    #[arg(long)]
    pub force: bool,
}

impl Force {
    /// Outputs of a subcommand that reads `inputs`.
    pub fn outputs(self, inputs: &[&Path]) -> Outputs {
        Outputs {
            force: self.force,
            inputs: inputs.iter().map(|input| input.to_path_buf()).collect(),
            files: vec![],
            folders: vec![],
        }
    }

    /// Checks all of `files`, which a subcommand that reads `inputs` writes.
    ///
    /// # Errors
    /// The first that [`Outputs::file`] finds.
    pub fn files<'a>(
        self,
        inputs: &[&Path],
        files: impl IntoIterator<Item = &'a PathBuf>,
    ) -> Result<()> {
        let mut outputs = self.outputs(inputs);
        files.into_iter().try_for_each(|file| outputs.file(file))
    }
}

/// Checks of outputs by one rule: an input is never replaced, nothing that exists is without
/// [`Force`], and no output takes the place of another one.
pub struct Outputs {
    force: bool,
    inputs: Vec<PathBuf>,
    /// Files that were checked, each in its real folder.
    files: Vec<PathBuf>,
    /// Folders that are made before the files in them are.
    folders: Vec<PathBuf>,
}

impl Outputs {
    /// Checks the file `path`, which is written as a whole. A device or a FIFO cannot be lost.
    ///
    /// # Errors
    /// A sentence if `path` is an input, a folder, taken, named for another output too, or cannot
    /// be written.
    pub fn file(&mut self, path: &Path) -> Result<()> {
        for input in &self.inputs {
            ensure!(
                !is_same(input, path),
                "{} is read and would be replaced by what is made of it: name another output",
                path.display()
            );
        }
        let is_taken = fs::symlink_metadata(path).is_ok() && (!path.exists() || path.is_file());
        ensure!(
            self.force || !is_taken,
            "{} exists already and is left as it is: name another file, or give --force to replace it",
            path.display()
        );
        let is_in_new_folder = self
            .folders
            .iter()
            .any(|folder| path.parent() == Some(folder.as_path()));
        if !is_in_new_folder || path.exists() {
            check_writable(path)?;
        }
        if !path.exists() || path.is_file() {
            let place = placed(path);
            ensure!(
                !self.files.contains(&place),
                "{} is named for two outputs: the second would replace the first; give each a name of its own",
                path.display()
            );
            self.files.push(place);
        }
        Ok(())
    }

    /// Checks the folder `path`, in which files are written. It need not exist.
    ///
    /// # Errors
    /// A sentence if `path` is a file, has the name of one, holds something or cannot be made.
    pub fn folder(&mut self, path: &Path) -> Result<()> {
        self.check_folder(
            path,
            "name a new folder, or give --force to replace files of the same names",
            self.force,
        )?;
        self.folders.push(path.to_owned());
        Ok(())
    }

    /// Checks the folder `path`, which appears as a whole: it must not exist, or be empty.
    ///
    /// # Errors
    /// A sentence as [`Outputs::folder`] gives, with or without [`Force`].
    pub fn whole_folder(&self, path: &Path) -> Result<()> {
        self.check_folder(path, "name a new folder", false)
    }

    fn check_folder(&self, path: &Path, advice: &str, force: bool) -> Result<()> {
        let metadata = fs::metadata(path);
        if metadata.is_err() && has_file_name(path) {
            bail!(
                "{} is the name of a file; expected the name of a folder, which the files are written into",
                path.display()
            );
        }
        if let Ok(metadata) = metadata {
            ensure!(
                metadata.is_dir(),
                "{} is a file; expected the name of a folder, which the files are written into",
                path.display()
            );
            let entries =
                fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))?;
            if let Some(first) = entries.flatten().next().filter(|_| !force) {
                bail!(
                    "{} exists already and is left as it is, with {} in it: {advice}",
                    path.display(),
                    first.file_name().to_string_lossy()
                );
            }
        }
        let folder = path.ancestors().find(|part| part.exists());
        let folder = folder.filter(|part| !part.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        check_writable(&folder.join(format!("{TEMPORARY_PREFIX}check")))
            .with_context(|| format!("{} cannot be made", path.display()))
    }
}

fn is_same(one: &Path, other: &Path) -> bool {
    let [one, other] = [one, other].map(Path::canonicalize);
    one.is_ok_and(|one| one.is_file() && other.is_ok_and(|other| one == other))
}

/// `path` in its real folder, so that one file has one name. Links in a folder that is made later
/// are not known.
fn placed(path: &Path) -> PathBuf {
    let folder = path
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let real = folder
        .canonicalize()
        .or_else(|_| std::path::absolute(folder));
    let folder = real.unwrap_or_else(|_| folder.to_owned());
    folder.join(path.file_name().unwrap_or_default())
}

fn has_file_name(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default().to_ascii_lowercase();
    FILE_EXTENSIONS.iter().any(|known| extension == *known)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(result: Result<()>, part: &str) {
        let said = format!("{:#}", result.unwrap_err());
        assert!(said.contains(part), "{said}");
    }

    #[test]
    fn nothing_is_replaced_unasked_and_no_input_ever() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        fs::write(at("in.ply"), "in").unwrap();
        fs::write(at("old.ply"), "old").unwrap();
        std::os::unix::fs::symlink("in.ply", at("link.ply")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("dangling.ply")).unwrap();
        let input = at("in.ply");
        let [mut plain, mut forced] = [false, true].map(|force| Force { force }.outputs(&[&input]));
        for outputs in [&mut plain, &mut forced] {
            refused(outputs.file(&at("in.ply")), "is read");
            refused(outputs.file(&at("link.ply")), "is read");
            refused(outputs.file(&at("none/a.ply")), "no folder");
            refused(outputs.file(directory.path()), "folder");
            outputs.file(&at("new.ply")).unwrap();
            refused(outputs.file(&at("./new.ply")), "two outputs");
            outputs.file(Path::new("/dev/null")).unwrap();
            outputs.file(Path::new("/dev/null")).unwrap();
        }
        for taken in ["old.ply", "dangling.ply"] {
            refused(plain.file(&at(taken)), "--force");
            forced.file(&at(taken)).unwrap();
        }
        assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 4);
    }

    #[test]
    fn folders_are_new_or_empty_and_have_no_name_of_a_file() {
        let directory = tempfile::tempdir().unwrap();
        let at = |name: &str| directory.path().join(name);
        fs::create_dir(at("empty")).unwrap();
        fs::create_dir(at("full")).unwrap();
        fs::write(at("full/front.png"), "old").unwrap();
        fs::write(at("file"), "old").unwrap();
        let [mut plain, mut forced] = [false, true].map(|force| Force { force }.outputs(&[]));
        for outputs in [&mut plain, &mut forced] {
            outputs.folder(&at("empty")).unwrap();
            outputs.folder(&at("new/deep")).unwrap();
            outputs.file(&at("new/deep/sheet.png")).unwrap();
            refused(outputs.folder(&at("file")), "is a file");
            refused(outputs.folder(&at("file/in")), "cannot be made");
            refused(outputs.folder(&at("out.PNG")), "name of a file");
            refused(outputs.whole_folder(&at("full")), "new folder");
        }
        refused(plain.folder(&at("full")), "front.png");
        forced.folder(&at("full")).unwrap();
        assert!(!at("new").exists() && !at("out.PNG").exists());
    }
}
