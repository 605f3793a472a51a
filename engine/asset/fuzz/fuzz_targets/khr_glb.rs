//! Any bytes as a file, and as the JSON of one: an error or a cloud.
#![no_main]

use decouplegs_asset::{SplatSummary, khr_glb};
use libfuzzer_sys::fuzz_target;

/// Numbers that accessors may point to.
const BINARY: [u8; 256] = [0x3f; 256];

fuzz_target!(|bytes: &[u8]| {
    let mut wrapped = b"glTF".to_vec();
    let length = 12 + 8 + bytes.len() + 8 + BINARY.len();
    wrapped.extend(
        [2, length as u32, bytes.len() as u32]
            .into_iter()
            .flat_map(u32::to_le_bytes),
    );
    wrapped.extend_from_slice(b"JSON");
    wrapped.extend_from_slice(bytes);
    wrapped.extend_from_slice(&(BINARY.len() as u32).to_le_bytes());
    wrapped.extend_from_slice(b"BIN\0");
    wrapped.extend_from_slice(&BINARY);
    for file in [bytes, &wrapped] {
        if let Ok(cloud) = khr_glb::decode(file) {
            assert_eq!(SplatSummary::new(&cloud).splats, cloud.len() as u64);
        }
    }
});
