//! Any bytes as a coded asset: an error, or splats that can be drawn and are written as they were
//! read.
#![no_main]

use decouplegs_asset::coded_asset;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(asset) = coded_asset::decode(bytes) else {
        return;
    };
    let decoded = asset.cloud.decoded(0);
    assert!((0..decoded.len()).all(|splat| decoded.defect_of(splat).is_none()));
    let written = coded_asset::encode(&asset).expect("an asset that was read can be written");
    assert_eq!(
        coded_asset::decode(&written).expect("what was written can be read"),
        asset
    );
});
