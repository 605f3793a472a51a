//! Maps and tracks as their users meet them: analytic roads, real files, broken files.

mod formats;
mod hostile;
mod open_drive;
mod real;

use std::path::{Path, PathBuf};

use decouplegs_scene::{Lane, LaneMap};

/// A file of the test data, or nothing and a line that says so where there is none.
fn data(name: &str) -> Option<PathBuf> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("DECOUPLEGS_DATA").map_or_else(default, PathBuf::from).join(name);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {} is not there; set DECOUPLEGS_DATA to the folder of test data", path.display());
    None
}

/// The bytes of a file that seeds the fuzz targets.
fn seed(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The lane of an id.
fn lane<'a>(map: &'a LaneMap, id: &str) -> &'a Lane {
    map.lanes.iter().find(|lane| lane.id == id).unwrap_or_else(|| panic!("no lane {id}"))
}

/// The ids of lanes by their places.
fn ids(map: &LaneMap, places: &[usize]) -> Vec<String> {
    places.iter().map(|&at| map.lanes[at].id.clone()).collect()
}
