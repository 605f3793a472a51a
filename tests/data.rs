//! Public test files, which are not part of the project.

use std::path::{Path, PathBuf};

/// `relative` in the folder that `DECOUPLEGS_DATA` names (by default `../shared/data` beside the
/// checkout); where it is missing, says aloud that `test` was skipped and returns `None`.
pub fn file(test: &str, relative: &str) -> Option<PathBuf> {
    let named = std::env::var_os("DECOUPLEGS_DATA").map(PathBuf::from);
    // Packages lie at different depths of the checkout.
    let folders = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors();
    let mut beside = folders.map(|folder| folder.join("shared/data"));
    let folder = named.or_else(|| beside.find(|folder| folder.is_dir()));
    let folder = folder.unwrap_or_else(|| "../shared/data".into());
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
