//! Any bytes as a file of obstacles.
#![no_main]

use decouplegs_asset::obstacle_file;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(obstacles) = obstacle_file::decode(bytes) {
        assert!(obstacles.iter().all(|one| one.center_m.is_finite() && one.length_m >= 0.0));
    }
});
