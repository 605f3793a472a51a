//! Scenes read from packages, of this program and of NuRec. Nothing is unpacked to the disk:
//! entries are read from the bytes of the package.

use std::borrow::Cow;
use std::cell::Cell;
use std::io::Write;
use std::path::{Path, PathBuf};

use crate::error::read_bytes;
use crate::maps::lane_json;
use crate::scene_file::SceneFiles;
use crate::scene_import::{BACKGROUND, ImportedScene, nurec};
use crate::sky_bundle::SkyBundle;
use crate::toml_text::text_of;
use crate::zip::Archive;
use crate::{
    AssetError, DecodeError, LoadedScene, PlacedSplats, SceneFile, SceneSky, write_atomically,
};
use decouplegs_scene::SplatCloud;
use glam::DVec3;

use super::packed_map::{MAP, read_packed_lanes};
use super::{OURS, SCENE};

/// Name of the format in messages.
pub(super) const NAME: &str = "USDZ package of decouplegs";

/// True if `path` is named like a package.
#[must_use]
pub fn is_package(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("usdz"))
}

/// Opens the scene in the package at `path`, loaded as at `time_s`. Only the entries that the scene
/// names are read.
///
/// # Errors
/// [`AssetError`] of the package, or of the entry at fault. A scene that names files outside of its
/// package is refused.
pub fn open_packed_scene(path: &Path, time_s: f64) -> Result<LoadedScene, AssetError> {
    let mut package = PackedScene::open(path)?;
    let background = match &mut package.content {
        Content::NuRec(scene) => Some(std::mem::take(&mut scene.background)),
        Content::Own(_) => None,
    };
    package.load_with(background, &package.file, time_s)
}

/// A package that is open: its scene file, and the files that it names.
pub struct PackedScene {
    path: PathBuf,
    content: Content,
    file: SceneFile,
}

/// Content of a package.
enum Content {
    /// One of this program: the bytes of the package, which hold the files.
    Own(Vec<u8>),
    /// One of NuRec, read.
    NuRec(Box<ImportedScene>),
}

impl PackedScene {
    /// Opens the package at `path`.
    ///
    /// # Errors
    /// [`AssetError`] of the package, or of its scene file.
    pub fn open(path: &Path) -> Result<Self, AssetError> {
        let bytes = read_bytes(path)?;
        let file = {
            let package = Package::new(path, &bytes)?;
            if !package.archive.has(SCENE) && nurec::is_package(&package.archive) {
                let scene = nurec::scene(&package.archive);
                let scene = scene.map_err(|source| AssetError::Decode {
                    path: path.to_owned(),
                    format: nurec::NAME,
                    source,
                })?;
                for note in &scene.notes {
                    log::warn!("{}: {note}", path.display());
                }
                let file = scene.scene_file();
                return Ok(Self {
                    path: path.to_owned(),
                    content: Content::NuRec(Box::new(scene)),
                    file,
                });
            }
            if !package.archive.has(SCENE) {
                let message = format!(
                    "it has neither '{SCENE}' nor a 'volume.nurec': it is no package of this program or of NuRec"
                );
                return Err(package.error(DecodeError::Unsupported(message)));
            }
            let text = package.bytes(Path::new(&SCENE[OURS.len()..]))?;
            let scene_error = |source| AssetError::Scene {
                path: path.join(SCENE),
                source,
            };
            text_of(&text)
                .and_then(SceneFile::parse)
                .map_err(scene_error)?
        };
        Ok(Self {
            path: path.to_owned(),
            content: Content::Own(bytes),
            file,
        })
    }

    /// The scene file.
    #[must_use]
    pub fn file(&self) -> &SceneFile {
        &self.file
    }

    /// `scene`, which names files of this package, loaded as at `time_s`.
    ///
    /// # Errors
    /// [`AssetError`] of the entry at fault.
    pub fn load(&self, scene: &SceneFile, time_s: f64) -> Result<LoadedScene, AssetError> {
        self.load_with(None, scene, time_s)
    }

    /// Loads like [`PackedScene::load`], with the `background` that was taken out of an import.
    fn load_with(
        &self,
        background: Option<SplatCloud>,
        scene: &SceneFile,
        time_s: f64,
    ) -> Result<LoadedScene, AssetError> {
        match &self.content {
            Content::Own(bytes) => scene.load_from(&Package::new(&self.path, bytes)?, time_s),
            Content::NuRec(imported) => {
                let files = Imported {
                    path: &self.path,
                    scene: imported,
                    background: Cell::new(background),
                };
                scene.load_from(&files, time_s)
            }
        }
    }

    /// Writes the scene with all of its files into `folder`, which exists: `scene.toml`, and the
    /// map of the package, `map.xodr` or `lanes.json`, if it has one.
    ///
    /// # Errors
    /// [`AssetError`] of the entry at fault, or of a file that cannot be written.
    pub fn write(&self, folder: &Path) -> Result<SceneFile, AssetError> {
        let bytes = match &self.content {
            Content::NuRec(scene) => {
                // Opened without its lanes, which most callers do not need.
                match read_packed_lanes(&self.path) {
                    Ok(None) => {}
                    Ok(Some(lanes)) => lane_json::write(&folder.join("lanes.json"), &lanes)?,
                    Err(error) => log::warn!("the map is left out: {error}"),
                }
                return scene.write(folder);
            }
            Content::Own(bytes) => bytes,
        };
        let package = Package::new(&self.path, bytes)?;
        if package.archive.has(MAP) {
            let map = package.archive.checked(MAP, package.file_bytes);
            let map = map.map_err(|source| package.error(source))?;
            write_atomically(&folder.join(MAP), |file| file.write_all(&map))?;
        }
        let names = package.archive.names();
        let (last, mut files): (Vec<&str>, Vec<&str>) = names
            .filter(|name| name.starts_with(OURS) && !name.ends_with('/'))
            .partition(|name| *name == SCENE);
        // A scene that is found is complete.
        files.extend(last);
        for name in files {
            let name = Path::new(&name[OURS.len()..]);
            let content = package.bytes(name)?;
            let path = folder.join(name);
            let parent = path.parent().unwrap_or(folder);
            std::fs::create_dir_all(parent).map_err(|source| AssetError::Write {
                path: parent.to_owned(),
                source,
            })?;
            write_atomically(&path, |file| file.write_all(&content))?;
        }
        Ok(self.file.clone())
    }

    /// The splats in `file`, a path as the scene file names it.
    ///
    /// # Errors
    /// [`AssetError`] of the entry.
    pub fn splats(&self, file: &Path) -> Result<SplatCloud, AssetError> {
        match &self.content {
            Content::Own(bytes) => Package::new(&self.path, bytes)?.splats(file),
            Content::NuRec(scene) => {
                let files = Imported {
                    path: &self.path,
                    scene,
                    background: Cell::new(None),
                };
                files.splats(file)
            }
        }
    }
}

/// The files of a scene that was imported, which are nowhere but in memory.
struct Imported<'a> {
    path: &'a Path,
    scene: &'a ImportedScene,
    /// The background if it was taken out of the scene. It is given once, without a copy: it can
    /// be half a gigabyte.
    background: Cell<Option<SplatCloud>>,
}

impl Imported<'_> {
    fn unknown(&self, file: &Path) -> AssetError {
        AssetError::Placement(format!(
            "{} is not in the package",
            self.path(file).display()
        ))
    }
}

impl SceneFiles for Imported<'_> {
    fn bytes(&self, file: &Path) -> Result<Cow<'_, [u8]>, AssetError> {
        let parameters = self.scene.lidar_parameters(file);
        parameters
            .map(|parameters| Cow::Borrowed(parameters.as_bytes()))
            .ok_or_else(|| self.unknown(file))
    }

    fn path(&self, file: &Path) -> PathBuf {
        self.path.join(file)
    }

    fn placed_splats(&self, file: &Path) -> Result<PlacedSplats, AssetError> {
        let taken = match file == Path::new(BACKGROUND) {
            true => self.background.take(),
            false => None,
        };
        let splats = taken.or_else(|| self.scene.splats(file).cloned());
        splats
            .map(PlacedSplats::from)
            .ok_or_else(|| self.unknown(file))
    }

    fn ground(&self, file: &Path) -> Result<Vec<DVec3>, AssetError> {
        if self.scene.ground.is_empty() {
            return Err(self.unknown(file));
        }
        Ok(self.scene.ground.clone())
    }

    fn sky(&self, sky: &SceneSky) -> Result<SkyBundle, AssetError> {
        let map = self.scene.sky.clone();
        map.map(SkyBundle::of_sky)
            .ok_or_else(|| self.unknown(&sky.file))
    }
}

/// The entries of a package as the files of its scene.
struct Package<'a> {
    path: &'a Path,
    archive: Archive<'a>,
    /// Size of the package.
    file_bytes: u64,
    /// Size of all entries read so far.
    read_bytes: Cell<u64>,
}

impl SceneFiles for Package<'_> {
    fn bytes(&self, file: &Path) -> Result<Cow<'_, [u8]>, AssetError> {
        self.entry(file).map_err(|source| self.error(source))
    }

    fn path(&self, file: &Path) -> PathBuf {
        self.path.join(OURS).join(file)
    }
}

impl<'a> Package<'a> {
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self, AssetError> {
        let archive = Archive::parse(bytes).map_err(|source| AssetError::Decode {
            path: path.to_owned(),
            format: NAME,
            source,
        })?;
        Ok(Self {
            path,
            archive,
            file_bytes: bytes.len() as u64,
            read_bytes: Cell::new(0),
        })
    }

    fn error(&self, source: DecodeError) -> AssetError {
        AssetError::Decode {
            path: self.path.to_owned(),
            format: NAME,
            source,
        }
    }

    fn entry(&self, file: &Path) -> Result<Cow<'_, [u8]>, DecodeError> {
        let is_inside = file
            .components()
            .all(|part| matches!(part, std::path::Component::Normal(_)));
        let Some(name) = file.to_str().filter(|_| is_inside) else {
            return Err(DecodeError::Malformed(format!(
                "its scene names '{}', which is not in the package",
                file.display()
            )));
        };
        let name = format!("{OURS}{name}");
        // Stored: `checked` compares the checksum and allocates nothing.
        let bytes = self.archive.stored(&name)?.len() as u64;
        self.read_bytes.set(self.read_bytes.get() + bytes);
        if self.read_bytes.get() > self.file_bytes {
            let message = "its entries overlap: together they are larger than the package. Pack the scene again";
            return Err(DecodeError::Malformed(message.into()));
        }
        self.archive.checked(&name, bytes)
    }
}
