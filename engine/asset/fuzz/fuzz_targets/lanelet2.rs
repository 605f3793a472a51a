//! Any bytes as a Lanelet2 map: an error, or a map that survives being written and read.
#![no_main]

use decouplegs_asset::maps::{lane_json, lanelet2};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(map) = lanelet2::decode(bytes) else {
        return;
    };
    assert!(!map.lanes.is_empty() && map.check().is_ok());
    let written = lane_json::encode(&map).expect("a map that was read can be written");
    assert_eq!(
        lane_json::decode(&written).expect("what was written can be read"),
        map
    );
});
