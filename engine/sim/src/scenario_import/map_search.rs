//! Search for a map whose path counts from another folder than that of its scenario.

use std::path::{Component, Path, PathBuf};

/// Folders above a scenario that are searched.
const FOLDERS_MAX: usize = 6;
/// Parts at the end of a map's path that are tried.
const PARTS_MAX: usize = 8;

/// The file at the longest end of the path `map` below a folder above `scenario`, or below a folder
/// `xodr` there; of several, in the nearest folder. `None` if there is none.
pub(super) fn above(scenario: &Path, map: &Path) -> Option<PathBuf> {
    let own = std::fs::canonicalize(scenario).ok()?;
    // What comes after the last `..` counts; the folder of the scenario was tried before.
    let mut parts: Vec<&std::ffi::OsStr> = Vec::new();
    for component in map.components() {
        match component {
            Component::Normal(part) => parts.push(part),
            Component::ParentDir | Component::RootDir | Component::Prefix(_) => parts.clear(),
            Component::CurDir => {}
        }
    }
    let first = parts.len().saturating_sub(PARTS_MAX);
    let ends = (first..parts.len()).map(|at| parts[at..].iter().collect::<PathBuf>());
    let ends: Vec<PathBuf> = ends.collect();
    let mut tried = ends.iter().flat_map(|end| {
        let folders = own.ancestors().skip(1).take(FOLDERS_MAX);
        folders.flat_map(move |folder| [folder.join(end), folder.join("xodr").join(end)])
    });
    tried.find(|file| file.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_map_is_found_by_the_longest_end_of_its_path_in_the_nearest_folder() {
        let root = tempfile::tempdir().unwrap();
        let root = std::fs::canonicalize(root.path()).unwrap();
        for folder in ["a/xosc", "a/xodr", "maps/deep"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
        }
        let scenario = root.join("a/xosc/s.xosc");
        for file in ["a/xosc/s.xosc", "a/xodr/m.xodr", "maps/deep/m.xodr"] {
            std::fs::write(root.join(file), "").unwrap();
        }
        let found = |map: &str| above(&scenario, Path::new(map));
        let (near, deep) = (root.join("a/xodr/m.xodr"), root.join("maps/deep/m.xodr"));
        assert_eq!(found("a/xosc/../../maps/deep/m.xodr"), Some(deep));
        assert_eq!(found("c:/some/where/m.xodr"), Some(near.clone()));
        assert_eq!(found("/else/where/m.xodr"), Some(near));
        assert_eq!(found("/else/where/n.xodr"), None);
        assert_eq!(found("../.."), None);
    }
}
