//! `decouplegs bench`: how long a frame takes, stage by stage, what memory it holds, and how wrong it is.

use std::io::Write;
use std::path::PathBuf;

use anyhow::{Result, ensure};
use decouplegs::asset::write_atomically;
use decouplegs::gpu::DeviceChoice;
use decouplegs::render::metrics::Difference;
use decouplegs::render::picture::Picture;
use decouplegs::render::reference::{self, Window};
use decouplegs::render::{FrameStatistics, RenderOptions, Renderer, ResidentWorld};
use decouplegs::scene::{Camera, Intrinsics};
use serde_json::{Value, json};

use crate::arguments::{Size, print};
use crate::progress;
use crate::render::open_device;
use crate::scene_source::{Scene, SceneArguments};

/// Time frames on a GPU, stage by stage, with memory by purpose and the error against the f64 definition
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Frames that are timed
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    frames: u32,
    /// Frames before them that are not
    #[arg(long, default_value_t = 10)]
    warm_up: u32,
    /// Draw the first so many cameras, in one submission (default: all)
    #[arg(long, value_name = "N")]
    cameras_used: Option<usize>,
    /// Device to render on: an index, a part of its name or its UUID, as `devices` lists them
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    device: DeviceChoice,
    /// Middle of the first camera's picture whose error is measured
    #[arg(long, value_name = "WxH", default_value = "160x90")]
    error_window: Size,
    /// Write all figures to this file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut scene = Scene::open(&arguments.scene)?;
    let used = arguments.cameras_used.unwrap_or(scene.cameras.len());
    ensure!((1..=scene.cameras.len()).contains(&used), "--cameras-used {used}: the scene has {} cameras", scene.cameras.len());
    scene.cameras.truncate(used);

    let gpu = open_device(&arguments.device)?;
    let mut renderer = Renderer::new(&gpu, RenderOptions { rules: scene.world.rules, ..RenderOptions::default() });
    let resident = renderer.upload(&scene.world)?;
    let frames = time_frames(&mut renderer, &resident, &scene.cameras, arguments)?;
    let window = middle(&scene.cameras[0].intrinsics, arguments.error_window);
    let difference = error_in_window(&scene, &renderer.read_pictures()?[0], window)?;

    let report = report(&scene, &renderer, &frames, window, &difference);
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{report:#}"))?;
    }
    print(&to_text(&report))
}

fn time_frames(
    renderer: &mut Renderer,
    resident: &ResidentWorld,
    cameras: &[Camera],
    arguments: &Arguments,
) -> Result<Vec<FrameStatistics>> {
    let bar = progress::bar("frames", (arguments.warm_up + arguments.frames) as usize);
    for _ in 0..arguments.warm_up {
        renderer.render(resident, cameras)?;
        bar.inc(1);
    }
    let mut frames = Vec::new();
    for _ in 0..arguments.frames {
        frames.push(renderer.render(resident, cameras)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok(frames)
}

/// The window of at most `size` in the middle of an image.
fn middle(image: &Intrinsics, size: Size) -> Window {
    let (width_px, height_px) = (size.width_px.min(image.width_px), size.height_px.min(image.height_px));
    Window { left_px: (image.width_px - width_px) / 2, top_px: (image.height_px - height_px) / 2, width_px, height_px }
}

fn error_in_window(scene: &Scene, picture: &Picture, window: Window) -> Result<Difference> {
    let working = progress::spinner("the same pixels by the f64 definition".into());
    let expected = reference::render_window(&scene.world, &scene.cameras[0], &scene.world.rules, window).to_picture();
    working.finish_and_clear();
    Ok(Difference::between(&cut(picture, window), &expected)?)
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

fn report(scene: &Scene, renderer: &Renderer, frames: &[FrameStatistics], window: Window, difference: &Difference) -> Value {
    let last = frames.last().expect("at least one frame was timed");
    let gpu = renderer.gpu();
    let milliseconds = |of: &dyn Fn(&FrameStatistics) -> f64| spread(frames.iter().map(of).collect());
    let wall_ms = milliseconds(&|frame| frame.wall_time.as_secs_f64() * 1e3);
    let rig_steps_per_s = 1e3 / wall_ms["median"].as_f64().unwrap_or(f64::NAN);
    let stages: Vec<Value> = (0..last.stages.len())
        .map(|at| json!({ "name": last.stages[at].name, "gpu_ms": milliseconds(&|frame| frame.stages[at].duration_ns as f64 / 1e6) }))
        .collect();
    let memory = gpu.memory();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": gpu.info().name,
        "driver": gpu.info().driver,
        "splats": scene.world.splats.len(),
        "sh_degree": scene.world.splats.sh_degree,
        "cameras": scene.cameras.len(),
        "width_px": scene.cameras[0].intrinsics.width_px,
        "height_px": scene.cameras[0].intrinsics.height_px,
        "frames": frames.len(),
        "frames_redrawn": frames.iter().filter(|frame| frame.redrawn > 0).count(),
        "frame_gpu_ms": milliseconds(&|frame| frame.gpu_time.as_secs_f64() * 1e3),
        "frame_wall_ms": wall_ms,
        "record_ms": milliseconds(&|frame| frame.record_time.as_secs_f64() * 1e3),
        "rig_steps_per_s": rig_steps_per_s,
        "images_per_s": rig_steps_per_s * scene.cameras.len() as f64,
        "stages": stages,
        "needs": last.needs,
        "capacity": last.capacity,
        "memory_bytes": { "total": memory.total_bytes, "by_purpose": memory.bytes_by_purpose },
        "error": {
            "camera": scene.cameras[0].name,
            "window_px": [window.left_px, window.top_px, window.width_px, window.height_px],
            "difference": difference,
        },
    })
}

/// Median, 99th percentile (the value that 99 of 100 do not exceed) and the extremes of at least one value.
fn spread(mut values: Vec<f64>) -> Value {
    values.sort_by(f64::total_cmp);
    let count = values.len();
    let median = 0.5 * (values[(count - 1) / 2] + values[count / 2]);
    let p99 = values[(count * 99).div_ceil(100) - 1];
    json!({ "median": median, "p99": p99, "min": values[0], "max": values[count - 1] })
}

fn to_text(report: &Value) -> String {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let mebibytes = |value: &Value| number(value) / f64::from(1 << 20);
    let text = |value: &Value| value.as_str().unwrap_or_default().to_owned();
    let row =
        |name: &str, times: &Value| format!("  {name:<16} {:>9.3} {:>9.3}\n", number(&times["median"]), number(&times["p99"]));
    let mut lines = format!(
        "{} ({})\n{} splats of degree {}, {} cameras, the first of {}x{}, {} frames\n\n  {:<16} {:>9} {:>9}\n",
        text(&report["device"]),
        text(&report["driver"]),
        report["splats"],
        report["sh_degree"],
        report["cameras"],
        report["width_px"],
        report["height_px"],
        report["frames"],
        "ms",
        "median",
        "p99",
    );
    for stage in report["stages"].as_array().into_iter().flatten() {
        lines.push_str(&row(&text(&stage["name"]), &stage["gpu_ms"]));
    }
    lines.push_str(&row("frame, GPU", &report["frame_gpu_ms"]));
    lines.push_str(&row("frame, wall", &report["frame_wall_ms"]));
    let (images, steps) = (number(&report["images_per_s"]), number(&report["rig_steps_per_s"]));
    lines.push_str(&format!("\n  {images:.1} images/s, {steps:.1} rig steps/s\n"));
    let by_purpose = report["memory_bytes"]["by_purpose"].as_object().into_iter().flatten();
    let purposes: Vec<String> = by_purpose.map(|(purpose, bytes)| format!("{purpose} {:.1}", mebibytes(bytes))).collect();
    lines.push_str(&format!("  {:.1} MiB: {}\n", mebibytes(&report["memory_bytes"]["total"]), purposes.join(", ")));
    let error = &report["error"]["difference"];
    let psnr = error["psnr_db"].as_f64().map_or("no error".to_owned(), |psnr| format!("PSNR {psnr:.2} dB"));
    lines.push_str(&format!(
        "  against f64, in the middle of {}: {psnr}, max {:.6}\n",
        text(&report["error"]["camera"]),
        number(&error["max_abs"])
    ));
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_of_the_sorted_values() {
        assert_eq!(spread(vec![5.0]), json!({ "median": 5.0, "p99": 5.0, "min": 5.0, "max": 5.0 }));
        let hundred: Vec<f64> = (0..100).rev().map(f64::from).collect();
        assert_eq!(spread(hundred), json!({ "median": 49.5, "p99": 98.0, "min": 0.0, "max": 99.0 }));
    }

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
