//! Libraries of drivers, which stay loaded once they were.
//!
//! The loader unloads a driver with its last instance. NVIDIA's leaves destructors with each thread
//! that called it: one that ends later would jump to where the driver was.

use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

/// Shared libraries that the process has loaded, by path; none where the system does not tell.
pub(crate) fn loaded() -> BTreeSet<PathBuf> {
    let maps = fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let mapped = maps
        .lines()
        .filter_map(|line| line.find('/').map(|at| PathBuf::from(&line[at..])));
    mapped.filter(|path| is_library(path)).collect()
}

fn is_library(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| name.ends_with(".so") || name.contains(".so."))
}

/// Keeps what was loaded since `before` until the process ends.
#[cfg(target_os = "linux")]
pub(crate) fn keep_since(before: &BTreeSet<PathBuf>) {
    use libloading::os::unix::{Library, RTLD_NOW};

    /// The library is found only if it is loaded.
    const RTLD_NOLOAD: i32 = 0x4;
    /// The library is never unloaded.
    const RTLD_NODELETE: i32 = 0x1000;

    for path in loaded().difference(before) {
        // SAFETY: nothing is loaded, so nothing of the library runs. One that was replaced on the
        // disk is not found, and is as before.
        let _ = unsafe { Library::open(Some(path), RTLD_NOW | RTLD_NOLOAD | RTLD_NODELETE) };
    }
}

/// Nothing: other systems were not seen to need it.
#[cfg(not(target_os = "linux"))]
pub(crate) fn keep_since(_before: &BTreeSet<PathBuf>) {}
