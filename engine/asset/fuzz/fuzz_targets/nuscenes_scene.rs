//! Any bytes as all tables of nuScenes, which are lines of the input.
#![no_main]

use decouplegs_asset::nuscenes::{Tables, decode};
use decouplegs_asset::tracks::nuscenes as annotated;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut lines = bytes.splitn(9, |byte| *byte == b'\n');
    let mut next = || lines.next().unwrap_or_default();
    let annotated = annotated::Tables {
        scenes: next(),
        samples: next(),
        instances: next(),
        categories: next(),
        annotations: next(),
    };
    let tables = Tables {
        annotated,
        readings: next(),
        ego_poses: next(),
        calibrated: next(),
        sensors: next(),
    };
    if let Ok(scene) = decode(&tables, None) {
        assert!(!scene.cameras.is_empty());
        for camera in &scene.cameras {
            assert!(camera.intrinsics.check().is_ok() && !camera.images.is_empty());
        }
        assert!(scene.tracks.iter().all(|track| track.check().is_ok()));
    }
});
