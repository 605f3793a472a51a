//! Any text as a scene file: an error, or a scene that survives being written and read.
#![no_main]

use decouplegs_asset::SceneFile;
use libfuzzer_sys::fuzz_target;

fuzz_target!(|text: &str| {
    let Ok(scene) = SceneFile::parse(text) else {
        return;
    };
    let written = scene
        .to_toml()
        .expect("a scene that was read can be written");
    assert_eq!(
        SceneFile::parse(&written).expect("what was written can be read"),
        scene
    );
});
