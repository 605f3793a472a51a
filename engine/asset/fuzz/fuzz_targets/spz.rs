//! Any bytes as a file, plain or, so that checksums are no wall, as the inside of a gzip stream.
#![no_main]

use std::io::Write;

use decouplegs_asset::{SplatSummary, spz};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let mut gzip = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    gzip.write_all(bytes).expect("a Vec takes every write");
    let wrapped = gzip.finish().expect("a Vec takes every write");
    for file in [bytes, &wrapped] {
        if let Ok(cloud) = spz::decode(file) {
            assert_eq!(SplatSummary::new(&cloud).splats, cloud.len() as u64);
        }
    }
});
