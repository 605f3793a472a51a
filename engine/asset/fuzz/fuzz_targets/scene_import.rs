//! Any bytes as a checkpoint with actors, as the pickle of one, and as a PLY of several models: an
//! error, no scene or a scene.
#![no_main]

use decouplegs_asset::SplatSummary;
use decouplegs_asset::scene_import::{ImportOptions, decode_checkpoint, decode_ply};
use decouplegs_asset::zip::StoredZip;
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
    let options = ImportOptions::default();
    for read in [
        decode_checkpoint(bytes, &options),
        decode_checkpoint(&zipped(bytes), &options),
        decode_ply(bytes, &options),
    ] {
        let Ok(Some(scene)) = read else { continue };
        for splats in scene
            .actors
            .iter()
            .map(|actor| &actor.splats)
            .chain([&scene.background])
        {
            assert_eq!(SplatSummary::of(splats).splats, splats.len() as u64);
        }
    }
});
