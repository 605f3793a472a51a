//! Maps as files: of a format of their own, or in a package.

use std::path::Path;

use decouplegs_scene::LaneMap;

use crate::AssetError;
use crate::error::read_bytes;
use crate::maps::{self, MapFormat};
use crate::packed_scene::{is_package, packed_map};

/// Reads the lanes of a map. Its format is found from its content; the map of a package (.usdz) is
/// read too.
///
/// # Errors
/// [`AssetError::Read`], [`AssetError::Unrecognized`] or [`AssetError::Decode`].
pub fn read_map(path: &Path) -> Result<LaneMap, AssetError> {
    let bytes = read_bytes(path)?;
    if is_package(path) {
        return packed_map::decode(&bytes).map_err(|source| AssetError::Decode {
            path: path.to_owned(),
            format: "package",
            source,
        });
    }
    let format = MapFormat::detect(&bytes).map_err(|found| AssetError::Unrecognized {
        path: path.to_owned(),
        found: found.into(),
        expected: "a map: OpenDRIVE (.xodr), Lanelet2 (.osm), Argoverse 2 or lane JSON, CommonRoad XML, or a package with a map (.usdz)",
    })?;
    maps::decode(&bytes, format).map_err(|source| AssetError::Decode {
        path: path.to_owned(),
        format: format.name(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_name_the_file_and_what_is_expected() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("a.xodr");
        assert!(read_map(&path).unwrap_err().to_string().contains("a.xodr"));
        std::fs::write(&path, "[]").unwrap();
        let error = read_map(&path).unwrap_err().to_string();
        assert!(
            error.contains("a.xodr") && error.contains("OpenDRIVE (.xodr)"),
            "{error}"
        );
        std::fs::write(&path, "<OpenDRIVE/>").unwrap();
        let error = read_map(&path).unwrap_err().to_string();
        assert!(
            error.contains("not a readable OpenDRIVE file") && error.contains("no lane"),
            "{error}"
        );
    }
}
