//! Any bytes as the tables of nuScenes, which are lines of the input.
#![no_main]

use decouplegs_asset::tracks::nuscenes::{Tables, decode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut lines = bytes.splitn(5, |byte| *byte == b'\n');
    let mut next = || lines.next().unwrap_or_default();
    let tables = Tables {
        scenes: next(),
        samples: next(),
        instances: next(),
        categories: next(),
        annotations: next(),
    };
    if let Ok(tracks) = decode(&tables, None) {
        assert!(!tracks.is_empty() && tracks.iter().all(|track| track.check().is_ok()));
    }
});
