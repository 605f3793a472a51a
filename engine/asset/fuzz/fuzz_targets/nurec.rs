//! Packages of NuRec whose volume, rig or tracks are any bytes: an error, or a scene whose parts
//! agree. The first byte says which; a volume's bytes are what its gzip holds.
#![no_main]

use std::io::Write;

use decouplegs_asset::scene_import::decode_nurec;
use decouplegs_asset::zip::StoredZip;
use flate2::{Compression, write::GzEncoder};
use libfuzzer_sys::fuzz_target;

/// {"nre_data": {"state_dict": {}}}
const EMPTY: &[u8] = b"\x81\xa8nre_data\x81\xaastate_dict\x80";

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut zipped = GzEncoder::new(Vec::new(), Compression::fast());
    zipped.write_all(bytes).unwrap();
    zipped.finish().unwrap()
}

fuzz_target!(|bytes: &[u8]| {
    let Some((kind, content)) = bytes.split_first() else {
        return;
    };
    let mut package = Vec::new();
    let mut zip = StoredZip::new(&mut package);
    let (name, content) = match kind % 4 {
        0 => ("volume.nurec", gzip(content)),
        1 => ("rig_trajectories.json", content.to_vec()),
        2 => ("sequence_tracks.json", content.to_vec()),
        _ => ("datasource_summary.json", content.to_vec()),
    };
    zip.add(name, &content).unwrap();
    if name != "volume.nurec" {
        zip.add("volume.nurec", &gzip(EMPTY)).unwrap();
    }
    zip.finish().unwrap();
    if let Ok(Some(scene)) = decode_nurec(&package) {
        let splats = &scene.background;
        assert_eq!(splats.means.len(), splats.opacities.len());
        assert_eq!(splats.sh_rest.len(), splats.len() * splats.rest_stride());
        assert!(scene.actors.iter().all(|actor| !actor.splats.is_empty()));
    }
});
