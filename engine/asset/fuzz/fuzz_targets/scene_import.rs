//! Any bytes as a checkpoint with actors, as the pickle of one, as the metadata of a HUGSIM folder,
//! and as a PLY of several models: an error, no scene or a scene.
#![no_main]

use decouplegs_asset::SplatSummary;
use decouplegs_asset::scene_import::{
    HugsimFiles, ImportOptions, decode_checkpoint, decode_hugsim, decode_ply,
};
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

const HUGSIM_SCENE: &[u8] = include_bytes!("../seeds/scene_import/hugsim/scene.pth");
const HUGSIM_ACTOR: &[u8] = include_bytes!("../seeds/scene_import/hugsim/dynamic_3.pth");

fuzz_target!(|bytes: &[u8]| {
    let options = ImportOptions::default();
    let hugsim = HugsimFiles {
        scene: HUGSIM_SCENE,
        metadata: Some(bytes),
        actors: &[("3".to_owned(), HUGSIM_ACTOR.to_vec())],
    };
    for read in [
        decode_hugsim(&hugsim, &options)
            .map(Some)
            .map_err(|fault| fault.error),
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
            assert_eq!(SplatSummary::new(splats).splats, splats.len() as u64);
        }
    }
});
