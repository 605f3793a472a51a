//! Public test files, which are not part of the project.

use std::path::{Path, PathBuf};

/// A file of the test data, or nothing and a line that says so where there is none.
pub fn data(name: &str) -> Option<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("DECOUPLEGS_DATA")
        .map_or_else(default, PathBuf::from)
        .join(name);
    if path.exists() {
        return Some(path);
    }
    println!(
        "skipped: {} is not there; set DECOUPLEGS_DATA to the folder of test data",
        path.display()
    );
    None
}
