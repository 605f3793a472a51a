//! Maps and tracks as their users meet them: analytic roads, real files, broken files.

#[path = "../files/data.rs"]
mod data;
mod field;
mod formats;
mod hostile;
mod open_drive;
mod real;
mod written;

use std::path::Path;

use decouplegs_scene::{Lane, LaneMap};

/// The bytes of a file that seeds the fuzz targets.
fn seed(name: &str) -> Vec<u8> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("fuzz/seeds")
        .join(name);
    std::fs::read(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The lane of an id.
fn lane<'a>(map: &'a LaneMap, id: &str) -> &'a Lane {
    map.lanes
        .iter()
        .find(|lane| lane.id == id)
        .unwrap_or_else(|| panic!("no lane {id}"))
}

/// The ids of lanes by their places.
fn ids(map: &LaneMap, places: &[usize]) -> Vec<String> {
    places.iter().map(|&at| map.lanes[at].id.clone()).collect()
}
