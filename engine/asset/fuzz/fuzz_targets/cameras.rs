//! Any bytes as a camera file: an error, or cameras that can be used as they are.
#![no_main]

use std::collections::HashSet;

use decouplegs_asset::cameras;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    // A COLMAP model is two files: the first byte says where the second begins, and which form they
    // have.
    if let [head, rest @ ..] = bytes {
        let (lenses, images) = rest.split_at(rest.len() * usize::from(head >> 1) / 128);
        let _ = cameras::decode_colmap(lenses, images, head & 1 == 1);
    }
    let Ok(cameras) = cameras::decode(bytes, None) else {
        return;
    };
    let mut names = HashSet::new();
    for camera in &cameras {
        assert!(camera.intrinsics.check().is_ok());
        assert!((camera.world_from_camera.rotation.length() - 1.0).abs() < 1e-9);
        assert!(
            !camera.name.is_empty()
                && !camera.name.contains(['/', '\\', '\0'])
                && !camera.name.starts_with('.')
        );
        assert!(names.insert(&camera.name));
    }
});
