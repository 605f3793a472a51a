//! Any bytes as a camera file: an error, or cameras that can be used as they are.
#![no_main]

use std::collections::HashSet;

use decouplegs_asset::cameras;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(cameras) = cameras::decode(bytes) else { return };
    let mut names = HashSet::new();
    for camera in &cameras {
        assert!(camera.intrinsics.check().is_ok());
        assert!((camera.world_from_camera.rotation.length() - 1.0).abs() < 1e-9);
        assert!(!camera.name.is_empty() && !camera.name.contains(['/', '\\', '\0']) && !camera.name.starts_with('.'));
        assert!(names.insert(&camera.name));
    }
});
