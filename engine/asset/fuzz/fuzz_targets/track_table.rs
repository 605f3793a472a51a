//! Any bytes as a table of tracks, CSV and JSON: an error, or tracks that hold together.
#![no_main]

use decouplegs_asset::tracks::table;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    for read in [table::decode_csv, table::decode_json] {
        let Ok(tracks) = read(bytes) else { continue };
        assert!(!tracks.is_empty() && tracks.iter().all(|track| track.check().is_ok()));
    }
});
