//! Any bytes as an OpenSCENARIO file, which is also its own catalog.
#![no_main]

use decouplegs_logs::open_scenario;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(scenario) = open_scenario::decode(bytes, |_| Some(bytes.to_vec())) {
        assert!(scenario.entities.iter().all(|entity| entity.size.length_m >= 0.1));
    }
});
