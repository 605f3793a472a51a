//! Bytes that were written once must mean the same for ever. The same files seed the fuzz targets.

use std::path::{Path, PathBuf};

use decouplegs_asset::{SceneFile, cameras};

use crate::sample;

fn seed(target: &str, name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/seeds").join(target).join(name)
}

#[test]
fn splat_files_of_every_version_read_as_ever() {
    for (name, fresh, read) in sample::files() {
        let target = if name.starts_with("spz") { "spz" } else { name };
        let frozen = std::fs::read(seed(target, name)).unwrap();
        // A compressor may change its bytes, but not what they mean.
        assert_eq!(read(&frozen).unwrap(), read(&fresh).unwrap(), "{name}");
    }
}

#[test]
fn text_files_read_as_ever() {
    let [inria, nerfstudio] = ["inria.json", "nerfstudio.json"].map(|name| std::fs::read(seed("cameras", name)).unwrap());
    assert_eq!(cameras::decode(&inria).unwrap()[0].name, "seq_00001");
    assert_eq!(cameras::decode(&nerfstudio).unwrap()[0].name, "images_frame_1");
    let scene = SceneFile::read(&seed("scene_file", "example.toml")).unwrap();
    assert_eq!((scene.rig.cameras.len(), scene.agents.len()), (2, 2));
}
