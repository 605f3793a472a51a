//! Public test files, which are not part of the project.

use std::path::PathBuf;

/// `relative` in the folder that `DECOUPLEGS_DATA` names (by default `../shared/data` beside the
/// checkout); where it is missing, says aloud that `test` was skipped and returns `None`.
pub fn file(test: &str, relative: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("DECOUPLEGS_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data"),
        PathBuf::from,
    );
    let path = folder.join(relative);
    if path.is_file() {
        return Some(path);
    }
    println!(
        "SKIPPED {test}: {} is not there; set DECOUPLEGS_DATA to the folder of test files",
        path.display()
    );
    None
}
