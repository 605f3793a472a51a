//! Files of a scene: those of a folder, of a package, or of an import.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use decouplegs_scene::SplatCloud;
use glam::DVec3;

use super::SceneSky;
use crate::read::placed_splats_of;
use crate::sky_bundle::SkyBundle;
use crate::{AssetError, PlacedSplats, ground_file, read_bytes, read_placed_splats, sky_file};

/// The files that a scene names.
pub(crate) trait SceneFiles {
    /// The content of `file`, a path as the scene file names it.
    fn bytes(&self, file: &Path) -> Result<Cow<'_, [u8]>, AssetError>;

    /// The place of `file`, for messages.
    fn path(&self, file: &Path) -> PathBuf;

    /// The splats in `file`.
    fn placed_splats(&self, file: &Path) -> Result<PlacedSplats, AssetError> {
        placed_splats_of(&self.bytes(file)?, &self.path(file))
    }

    /// The sky of the scene.
    fn sky(&self, sky: &SceneSky) -> Result<SkyBundle, AssetError> {
        let decoded = sky_file::decode_sky(&self.bytes(&sky.file)?, sky);
        decoded.map_err(|source| AssetError::Decode {
            path: self.path(&sky.file),
            format: "sky",
            source,
        })
    }

    /// Points of the ground in `file`, about the origin of the scene.
    fn ground(&self, file: &Path) -> Result<Vec<DVec3>, AssetError> {
        ground_file::decode(&self.bytes(file)?).map_err(|source| AssetError::Decode {
            path: self.path(file),
            format: ground_file::NAME,
            source,
        })
    }

    /// The splats of an asset in `file`.
    fn splats(&self, file: &Path) -> Result<SplatCloud, AssetError> {
        Ok(self.placed_splats(file)?.cloud)
    }
}

/// Files relative to a folder.
pub(super) struct Folder<'a>(pub(super) &'a Path);

impl SceneFiles for Folder<'_> {
    fn bytes(&self, file: &Path) -> Result<Cow<'_, [u8]>, AssetError> {
        read_bytes(&self.path(file)).map(Cow::Owned)
    }

    fn path(&self, file: &Path) -> PathBuf {
        self.0.join(file)
    }

    // A SOG may be a folder.
    fn placed_splats(&self, file: &Path) -> Result<PlacedSplats, AssetError> {
        read_placed_splats(&self.path(file))
    }
}
