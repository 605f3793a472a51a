//! The demo scene, for a viewer that was given no other.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use decouplegs::synth::street::{Street, StreetOptions};
use decouplegs_cli::progress;
use decouplegs_cli::street_files::{Cars, Content, write_street};

/// Scene that `make demo` makes, from the folder of the sources.
const DEMO: &str = "out/demo/street/scene.toml";

/// The demo scene: the file that `make demo` makes, or one of the same content beside the caches
/// of this user, which is made if it is absent.
pub fn demo() -> Result<PathBuf> {
    let made = PathBuf::from(DEMO);
    if made.exists() {
        return Ok(made);
    }
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    let caches = variable("XDG_CACHE_HOME").map(PathBuf::from);
    let caches = caches.or_else(|| Some(PathBuf::from(variable("HOME")?).join(".cache")));
    let folder = caches.context("there is neither HOME nor XDG_CACHE_HOME: name a scene")?;
    let scene = folder.join("decouplegs/demo/scene.toml");
    if !scene.exists() {
        let working = progress::spinner(format!("making the demo scene {}", scene.display()));
        let mut street = Street::generate(&StreetOptions {
            background: 400_000,
            agents: 8,
            agent_splats: 8_000,
            sh_degree: 1,
            seed: 7,
            ..StreetOptions::default()
        });
        for camera in street.rig.cameras_mut() {
            camera.intrinsics = camera.intrinsics.resized(800, 450);
        }
        let out = scene.parent().unwrap_or(Path::new(""));
        let content = Content {
            cars: Cars::Compressed,
            baked: false,
            shadows: false,
            by_normals: false,
        };
        write_street(&street, out, content)?;
        working.finish_and_clear();
    }
    Ok(scene)
}
