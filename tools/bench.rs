//! `decouplegs bench`: how long a frame takes, stage by stage, what memory it holds, and how wrong it is.

mod report;

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use clap::ValueEnum;
use decouplegs::asset::write_atomically;
use decouplegs::gpu::{DeviceInfo, Gpu, MemoryReport};
use decouplegs::render::metrics::Difference;
use decouplegs::render::picture::Picture;
use decouplegs::render::reference::{self, Window};
use decouplegs::render::{ColourFormat, FrameStatistics, Outputs, RenderOptions, Renderer};
use decouplegs::scene::Intrinsics;

use crate::arguments::{Size, print};
use crate::device::{DeviceArguments, check_validation};
use crate::progress;
use crate::scene_source::{Scene, SceneArguments};

/// Time frames on a GPU, stage by stage, with memory by purpose and the error against the f64 definition
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Frames that are timed
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Frames before them that are not
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    warm_up: u32,
    /// Draw the first so many cameras, in one submission (default: all)
    #[arg(long, value_name = "N")]
    cameras_used: Option<usize>,
    /// How colour is stored
    #[arg(long, value_enum, default_value_t = Colour::Rgba8)]
    colour: Colour,
    /// Draw the expected depth too
    #[arg(long)]
    depth: bool,
    /// Draw the instance ids too
    #[arg(long)]
    instance: bool,
    #[command(flatten)]
    device: DeviceArguments,
    /// Middle of the first camera's picture whose error is measured, in f32 whatever --colour says
    #[arg(long, value_name = "WxH", default_value = "160x90")]
    error_window: Size,
    /// Write all figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Colour {
    /// 8 bits a channel, what a camera delivers
    Rgba8,
    /// 32 bits a channel, unclamped
    F32,
}

impl Arguments {
    fn outputs(&self) -> Outputs {
        let colour = match self.colour {
            Colour::Rgba8 => ColourFormat::U8,
            Colour::F32 => ColourFormat::F32,
        };
        Outputs { colour, depth: self.depth, instance: self.instance, contributions: false }
    }
}

/// What was measured, and of what.
struct Measured {
    device: DeviceInfo,
    outputs: Outputs,
    warm_up: u32,
    frames: Vec<FrameStatistics>,
    /// While the frames were drawn.
    memory: MemoryReport,
    window: Window,
    difference: Difference,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut scene = Scene::open(&arguments.scene)?;
    let used = arguments.cameras_used.unwrap_or(scene.cameras.len());
    ensure!((1..=scene.cameras.len()).contains(&used), "--cameras-used {used}: the scene has {} cameras", scene.cameras.len());
    scene.cameras.truncate(used);

    let gpu = arguments.device.open()?;
    let (frames, memory) = time_frames(&gpu, &scene, arguments)?;
    let window = middle(&scene.cameras[0].intrinsics, arguments.error_window);
    let difference = error_in_window(&gpu, &scene, window)?;
    check_validation(&gpu)?;

    let (device, warm_up) = (gpu.info().clone(), arguments.warm_up);
    let measured = Measured { device, outputs: arguments.outputs(), warm_up, frames, memory, window, difference };
    let figures = report::figures(&scene, &measured);
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{figures:#}"))?;
    }
    print(&report::to_text(&figures))
}

/// The frames after the warm-up, and the memory that they took.
fn time_frames(gpu: &Gpu, scene: &Scene, arguments: &Arguments) -> Result<(Vec<FrameStatistics>, MemoryReport)> {
    let options = RenderOptions { rules: scene.world.rules, outputs: arguments.outputs(), ..RenderOptions::default() };
    let mut renderer = Renderer::new(gpu, options);
    let resident = renderer.upload(&scene.world)?;
    let bar = progress::bar("frames", arguments.warm_up as usize + arguments.frames as usize);
    let mut frames = Vec::new();
    for frame in 0..arguments.warm_up + arguments.frames {
        let statistics = renderer.render(&resident, &scene.cameras)?;
        if frame >= arguments.warm_up {
            frames.push(statistics);
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok((frames, gpu.memory()))
}

/// The window of at most `size` in the middle of an image.
fn middle(image: &Intrinsics, size: Size) -> Window {
    let (width_px, height_px) = (size.width_px.min(image.width_px), size.height_px.min(image.height_px));
    Window { left_px: (image.width_px - width_px) / 2, top_px: (image.height_px - height_px) / 2, width_px, height_px }
}

/// How far the first camera's picture, drawn once more in f32, is from the definition: 8 bits would hide it.
fn error_in_window(gpu: &Gpu, scene: &Scene, window: Window) -> Result<Difference> {
    let working = progress::spinner("the middle of a picture by the f64 definition".into());
    let camera = &scene.cameras[0];
    let mut renderer = Renderer::new(gpu, RenderOptions { rules: scene.world.rules, ..RenderOptions::default() });
    let resident = renderer.upload(&scene.world)?;
    renderer.render(&resident, std::slice::from_ref(camera))?;
    let found = cut(&renderer.read_pictures()?[0], window);
    let expected = reference::render_window(&scene.world, camera, &scene.world.rules, window).to_picture();
    working.finish_and_clear();
    Ok(Difference::between(&found, &expected)?)
}

/// The pixels of `picture` in `window`, which lies inside it.
fn cut(picture: &Picture, window: Window) -> Picture {
    let rows = window.top_px..window.top_px + window.height_px;
    let pixels = rows.flat_map(|row| (window.left_px..window.left_px + window.width_px).map(move |column| (row, column)));
    let places: Vec<usize> = pixels.map(|(row, column)| row as usize * picture.width as usize + column as usize).collect();
    Picture {
        width: window.width_px,
        height: window.height_px,
        rgb: places.iter().map(|&at| picture.rgb[at]).collect(),
        alpha: places.iter().map(|&at| picture.alpha[at]).collect(),
        depth: None,
        instance: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_lies_in_the_middle_and_cuts_its_own_pixels() {
        let image = Intrinsics::from_horizontal_fov(7, 5, 1.0);
        let window = middle(&image, Size { width_px: 3, height_px: 100 });
        assert_eq!(window, Window { left_px: 2, top_px: 0, width_px: 3, height_px: 5 });
        let mut picture = Picture::filled(7, 5, [0.0; 3]);
        picture.rgb.iter_mut().enumerate().for_each(|(at, rgb)| rgb[0] = at as f32);
        let firsts: Vec<f32> = cut(&picture, window).rgb.iter().map(|rgb| rgb[0]).collect();
        assert_eq!(firsts[..4], [2.0, 3.0, 4.0, 9.0]);
    }
}
