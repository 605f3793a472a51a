//! Any bytes as a CommonRoad scenario: its lanes and its tracks, each an error or what holds
//! together.
#![no_main]

use decouplegs_asset::{maps, tracks};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(map) = maps::commonroad::decode(bytes) {
        assert!(!map.lanes.is_empty() && map.check().is_ok());
        let written = maps::lane_json::encode(&map).expect("a map that was read can be written");
        assert_eq!(
            maps::lane_json::decode(&written).expect("what was written can be read"),
            map
        );
    }
    if let Ok(tracks) = tracks::commonroad::decode(bytes) {
        assert!(!tracks.is_empty() && tracks.iter().all(|track| track.check().is_ok()));
    }
});
