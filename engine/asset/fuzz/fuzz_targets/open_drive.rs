//! Any bytes as an OpenDRIVE file: an error, or a map that survives being written and read.
#![no_main]

use decouplegs_asset::maps::{lane_json, open_drive};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(map) = open_drive::decode(bytes) else {
        return;
    };
    assert!(!map.lanes.is_empty() && map.check().is_ok());
    let written = lane_json::encode(&map).expect("a map that was read can be written");
    assert_eq!(
        lane_json::decode(&written).expect("what was written can be read"),
        map
    );
});
