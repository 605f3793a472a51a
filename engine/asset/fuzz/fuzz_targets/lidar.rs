//! Any bytes as the model of a LiDAR.
#![no_main]

use decouplegs_asset::lidar_file;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(model) = lidar_file::decode(bytes) {
        assert!(model.check().is_ok());
        assert!(model.cells().beams.len() >= model.beams().len());
        assert!(model.beams().iter().all(|beam| beam.direction.is_finite()));
    }
});
