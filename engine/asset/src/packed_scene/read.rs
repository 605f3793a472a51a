//! A package back into a scene.

use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::read_bytes;
use crate::zip::Archive;
use crate::{AssetError, DecodeError, LoadedScene, SceneFile, write_atomically};

use super::{OURS, SCENE};

/// What users call it.
const NAME: &str = "USDZ package of decouplegs";
/// Entries of a package that are ours; scenes have as many assets.
const ENTRIES_MAX: usize = 100_000;

/// Whether `path` is called like a package.
pub(crate) fn is_package(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("usdz"))
}

/// Unpacks what is ours in the package at `path` into `folder`, which exists; the scene file in it.
///
/// Entries are stored, so that they take what the package takes, and none leads out of the folder.
///
/// # Errors
/// [`AssetError`] of the package, or of the file that could not be written.
pub fn unpack(path: &Path, folder: &Path) -> Result<PathBuf, AssetError> {
    let bytes = read_bytes(path)?;
    let decode_error = |source| AssetError::Decode { path: path.to_owned(), format: NAME, source };
    let archive = Archive::parse(&bytes).map_err(decode_error)?;
    if !archive.has(SCENE) {
        let told = format!("it has no '{SCENE}': packages of other programs hold no scene that is read here");
        return Err(decode_error(DecodeError::Unsupported(told)));
    }
    let names: Vec<&str> = archive.names().filter(|name| name.starts_with(OURS) && !name.ends_with('/')).collect();
    if names.len() > ENTRIES_MAX {
        let told = format!("it has {} entries; at most {ENTRIES_MAX} are read", names.len());
        return Err(decode_error(DecodeError::Malformed(told)));
    }
    for name in names {
        // Stored: `checked` compares the checksum and allocates nothing.
        archive.stored(name).map_err(decode_error)?;
        let content = archive.checked(name, bytes.len() as u64).map_err(decode_error)?;
        let to = folder.join(&name[OURS.len()..]);
        if let Some(parent) = to.parent() {
            std::fs::create_dir_all(parent).map_err(|source| AssetError::Write { path: parent.to_owned(), source })?;
        }
        write_atomically(&to, |file| file.write_all(&content))?;
    }
    Ok(folder.join(&SCENE[OURS.len()..]))
}

/// Opens the scene in the package at `path`, loaded as at `time_s`. It is unpacked into a temporary folder, which is gone afterwards.
///
/// # Errors
/// As [`unpack`] and [`SceneFile::load`]; a scene that names files outside of its package is refused.
pub fn open_packed_scene(path: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
    let folder = tempfile::tempdir().map_err(|source| AssetError::Write { path: std::env::temp_dir(), source })?;
    let scene = SceneFile::read(&unpack(path, folder.path())?)?;
    let transfer = scene.light.as_ref().and_then(|light| light.transfer.as_ref());
    let files = scene.agents.iter().map(|agent| &agent.asset).chain([&scene.background]).chain(transfer);
    for file in files {
        let is_inside = file.components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if !is_inside {
            let told = format!("its scene names '{}', which is not in the package", file.display());
            return Err(AssetError::Decode { path: path.to_owned(), format: NAME, source: DecodeError::Malformed(told) });
        }
    }
    scene.load(folder.path(), time_s)
}
