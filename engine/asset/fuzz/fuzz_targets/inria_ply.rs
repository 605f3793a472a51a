//! Any bytes as a file: an error or a cloud.
#![no_main]

use decouplegs_asset::{SplatSummary, inria_ply};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    if let Ok(cloud) = inria_ply::decode(bytes) {
        // Every array is as long as the summary, which walks them all, takes it to be.
        assert_eq!(SplatSummary::new(&cloud).splats, cloud.len() as u64);
    }
});
