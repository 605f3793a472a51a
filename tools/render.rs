//! `decouplegs render`: one picture for each camera.

use std::collections::HashSet;
use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use decouplegs::gpu::{DeviceChoice, DeviceOptions, Gpu};
use decouplegs::render::picture::{Picture, PictureFormat, contact_sheet};
use decouplegs::render::{RenderOptions, Renderer, reference};
use decouplegs::scene::Camera;

use crate::arguments::write_picture;
use crate::progress;
use crate::scene_source::{Scene, SceneArguments};

/// Render a scene for every camera, one picture each, named by the camera
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Folder for the pictures; made if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How pictures are written
    #[arg(long, value_enum, default_value_t = Format::Png)]
    format: Format,
    /// Device to render on: an index, a part of its name or its UUID, as `devices` lists them
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
    /// Render with the f64 definition on the processor: exact and slow
    #[arg(long, conflicts_with = "device")]
    reference: bool,
    /// Write all pictures side by side to this PNG too
    #[arg(long, value_name = "FILE")]
    contact_sheet: Option<PathBuf>,
}

/// How a picture is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// 8 bits a channel, clamped; no alpha
    Png,
    /// float32 RGBA as blended
    Exr,
    /// float32 [height, width, 4]: RGB as blended, unclamped, and alpha
    Npy,
}

impl From<Format> for PictureFormat {
    fn from(format: Format) -> Self {
        match format {
            Format::Png => Self::Png,
            Format::Exr => Self::Exr,
            Format::Npy => Self::Npy,
        }
    }
}

/// Pictures in a row of a contact sheet: a rig's front row stands above its back row.
const SHEET_COLUMNS: u32 = 3;

pub fn run(arguments: &Arguments) -> Result<()> {
    let scene = Scene::open(&arguments.scene)?;
    check_names(&scene.cameras)?;
    let pictures = if arguments.reference { render_by_definition(&scene) } else { render_on_gpu(&scene, &arguments.device)? };

    fs::create_dir_all(&arguments.out).with_context(|| format!("{} cannot be made", arguments.out.display()))?;
    let format = PictureFormat::from(arguments.format);
    for (camera, picture) in scene.cameras.iter().zip(&pictures) {
        write_picture(&arguments.out.join(format!("{}.{}", camera.name, format.extension())), picture, format)?;
    }
    if let Some(path) = &arguments.contact_sheet {
        let sheet = contact_sheet(&pictures, SHEET_COLUMNS).context("there is no camera, so there is no picture")?;
        write_picture(path, &sheet, PictureFormat::Png)?;
    }
    Ok(())
}

/// The device of `choice`, said on standard error: which one made a picture matters to whoever looks at it later.
pub fn open_device(choice: &DeviceChoice) -> Result<Gpu> {
    let gpu = Gpu::open(&DeviceOptions { choice: choice.clone(), ..DeviceOptions::default() })?;
    eprintln!("on {}", gpu.info());
    Ok(gpu)
}

fn render_on_gpu(scene: &Scene, device: &DeviceChoice) -> Result<Vec<Picture>> {
    let gpu = open_device(device)?;
    let working = progress::spinner(format!("{} splats, {} cameras", scene.world.splats.len(), scene.cameras.len()));
    let mut renderer = Renderer::new(&gpu, RenderOptions { rules: scene.world.rules, ..RenderOptions::default() });
    let resident = renderer.upload(&scene.world)?;
    renderer.render(&resident, &scene.cameras)?;
    let pictures = renderer.read_pictures()?;
    working.finish_and_clear();
    Ok(pictures)
}

fn render_by_definition(scene: &Scene) -> Vec<Picture> {
    let bar = progress::bar("reference", scene.cameras.len());
    let render = |camera: &Camera| {
        let picture = reference::render(&scene.world, camera, &scene.world.rules).to_picture();
        bar.inc(1);
        picture
    };
    let pictures = scene.cameras.iter().map(render).collect();
    bar.finish_and_clear();
    pictures
}

/// Refuses names that would write outside the folder, or over another camera's picture.
fn check_names(cameras: &[Camera]) -> Result<()> {
    let mut taken = HashSet::new();
    for Camera { name, .. } in cameras {
        let plain = !name.is_empty() && !name.contains(['/', '\\', '\0']) && !name.starts_with('.');
        ensure!(plain, "the camera {name:?} cannot name a picture: use letters, digits, '-' and '_'");
        ensure!(taken.insert(name.to_lowercase()), "two cameras are called {name:?}: the second picture would replace the first");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::{Intrinsics, Pose};

    fn cameras(names: &[&str]) -> Vec<Camera> {
        let intrinsics = Intrinsics::from_horizontal_fov(2, 2, 1.0);
        names.iter().map(|&name| Camera { name: name.into(), intrinsics, world_from_camera: Pose::IDENTITY }).collect()
    }

    #[test]
    fn pictures_stay_in_their_folder_and_apart() {
        assert!(check_names(&cameras(&["front", "front left", "0001.v2"])).is_ok());
        for bad in ["", "..", "../front", "a/b", "a\\b", ".hidden"] {
            let error = check_names(&cameras(&["front", bad])).unwrap_err().to_string();
            assert!(error.contains(&format!("{bad:?}")), "{error}");
        }
        assert!(check_names(&cameras(&["front", "Front"])).unwrap_err().to_string().contains("replace"));
    }
}
