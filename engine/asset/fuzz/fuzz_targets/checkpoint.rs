//! Any bytes as a checkpoint, and as the pickle of one: an error or a cloud, and nothing is ever
//! run.
#![no_main]

use decouplegs_asset::zip::StoredZip;
use decouplegs_asset::{SplatSummary, checkpoint};
use libfuzzer_sys::fuzz_target;

/// A checkpoint of this pickle, with one storage.
fn zipped(pickle: &[u8]) -> Vec<u8> {
    let mut zip = StoredZip::new(Vec::new());
    zip.add("a/data.pkl", pickle)
        .expect("a name like any other");
    zip.add("a/data/0", &[0x3f; 256])
        .expect("a name like any other");
    zip.finish().expect("a Vec takes every write")
}

fuzz_target!(|bytes: &[u8]| {
    for file in [bytes, &zipped(bytes)] {
        if let Ok(cloud) = checkpoint::decode(file) {
            assert_eq!(SplatSummary::new(&cloud).splats, cloud.len() as u64);
        }
    }
});
