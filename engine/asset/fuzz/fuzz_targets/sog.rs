//! Any bytes as a bundle, and as the description in one: an error or a cloud.
#![no_main]

use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{SplatSummary, sog};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut zip = StoredZip::new(Vec::new());
    zip.add("meta.json", bytes).expect("a name like any other");
    let wrapped = zip.finish().expect("a Vec takes every write");
    for file in [bytes, &wrapped] {
        if let Ok(cloud) = sog::decode(file) {
            assert_eq!(SplatSummary::new(&cloud).splats, cloud.len() as u64);
        }
    }
});
