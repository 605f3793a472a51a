//! A cloud that came from any PLY, as SPZ: refused, or read back with the same count and degree.
#![no_main]

use decouplegs_asset::{inria_ply, spz};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    let Ok(cloud) = inria_ply::decode(bytes) else {
        return;
    };
    let Ok(packed) = spz::encode(&cloud) else {
        return;
    };
    let back = spz::decode(&packed).expect("what was written can be read");
    assert_eq!((back.len(), back.sh_degree), (cloud.len(), cloud.sh_degree));
    assert!((0..back.len()).all(|splat| back.defect_of(splat).is_none()));
});
