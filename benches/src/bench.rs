//! `decouplegs bench`: how long a frame takes, stage by stage, what memory it holds, and how wrong
//! it is.

mod kernels;
mod lidar;
mod report;
mod trace;
mod trial;

use std::borrow::Cow;
use std::io::Write;
use std::ops::Range;
use std::path::PathBuf;
use std::str::FromStr;
use std::time::Instant;

use anyhow::{Result, ensure};
use clap::ValueEnum;
use decouplegs::asset::write_atomically;
use decouplegs::gpu::{DeviceInfo, DeviceOptions, Gpu, KernelReport, KernelTrial, MemoryReport};
use decouplegs::render::metrics::{Difference, Flips};
use decouplegs::render::reference::{self, Window};
use decouplegs::render::rendered_image::Image;
use decouplegs::render::{
    ColorFormat, FrameStatistics, Outputs, Plane, PlaneMap, RenderOptions, Renderer,
};
use decouplegs::scene::{Intrinsics, Rules, SplatScene};
use decouplegs::{Session, World};

use crate::arguments::{Size, finite, pixels, plane_names, print};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;
use crate::scene_source::{DrawInput, SceneArguments};

/// Measure frames on a GPU: time per stage, memory by purpose, and error against the f64 reference
#[derive(clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    scene: SceneArguments,
    /// Number of timed frames
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Number of frames before them that are not timed
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(..=1_000_000))]
    warm_up: u32,
    /// Number of cameras to render in one submission, from the first (default: all)
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    cameras_used: Option<usize>,
    /// Storage format of color
    #[arg(long, value_enum, default_value_t = Color::Rgba8)]
    color: Color,
    /// Render these planes too: depth, instance
    #[arg(long, value_name = "PLANE,...", value_delimiter = ',', value_parser = plane_names())]
    planes: Vec<Plane>,
    /// Compute the background's depth keys in every frame instead of reusing them while a camera
    /// does not turn
    #[arg(long)]
    compute_keys: bool,
    /// Keep records and sorted lists of the background while the cameras stand (default: sort
    /// everything in every frame)
    #[arg(long)]
    keep_lists: bool,
    /// Render agents at the coarsest level of detail whose splats are at most this many pixels
    /// apart (default: always the finest)
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, value_parser = pixels)]
    level_pitch: Option<f64>,
    #[command(flatten)]
    background: BackgroundArguments,
    /// Time step between frames, in which the ego and the agents move, seconds (default: they stand
    /// still)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 0.0, value_parser = finite)]
    step: f64,
    /// Frames in which the ego, and with it every camera, stands while the agents go on, warm-up
    /// included; with no value, in all
    #[arg(long, value_name = "FROM..TO", num_args = 0..=1, default_missing_value = "0..", requires = "step")]
    ego_stands: Option<EgoStands>,
    /// Frames in flight: with 2, a frame is submitted before the previous one has finished
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    in_flight: u8,
    /// Run the agents' part of a frame on the main queue instead of the update queue
    #[arg(long)]
    serial: bool,
    /// Write a timeline of both queues and the host, for chrome://tracing or ui.perfetto.dev
    #[arg(long, value_name = "FILE")]
    trace: Option<PathBuf>,
    /// Write three frames of the timeline as an SVG image
    #[arg(long, value_name = "FILE.svg")]
    trace_image: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
    /// Size of the window in the middle of the first camera's image whose error is measured, in f32
    /// for any --color
    #[arg(
        long,
        value_name = "WxH",
        allow_hyphen_values = true,
        default_value = "160x90"
    )]
    error_window: Size,
    /// Measure the error in the whole images of N cameras too, evenly chosen from all: the f64
    /// reference takes seconds to minutes for each
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 0
    )]
    error_cameras: usize,
    /// Time sweeps of this LiDAR on the ego instead of frames: one of the scene, a model of the
    /// program, or a file
    #[arg(long, value_name = "NAME|FILE")]
    lidar: Option<String>,
    /// Measure the error in N beams of the sweep, evenly chosen from all: the f64 definition takes
    /// a second for a few
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 0,
        requires = "lidar"
    )]
    error_beams: usize,
    /// Print what the driver says of each kernel: registers, shared memory, and the workgroups that
    /// fit a multiprocessor of 48 KB of shared memory
    #[arg(long)]
    kernels: bool,
    /// Folder of SPIR-V files that replace kernels, and of `constants.txt`: frames with them are
    /// timed in turn with the program's own
    #[arg(long, value_name = "FOLDER", hide = true)]
    trial: Vec<trial::Trial>,
    /// Number of times that all trials are timed
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 2,
        hide = true
    )]
    trial_rounds: u32,
    /// Write all figures to this JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Frames in which the ego stands.
#[derive(Clone, Debug, PartialEq, Eq)]
struct EgoStands(Range<u32>);

impl EgoStands {
    /// Frames before `frame` in which the ego moved.
    fn frames_moved(&self, frame: u32) -> u32 {
        let Range { start, end } = self.0;
        match frame {
            moving if moving < start => moving,
            standing if standing < end => start,
            moving_again => start + (moving_again - end),
        }
    }
}

impl FromStr for EgoStands {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected =
            || format!("expected FROM..TO, for example 40..80, or FROM.., found '{text}'");
        let (from, to) = text.split_once("..").ok_or_else(expected)?;
        let from = from.parse().map_err(|_| expected())?;
        let to = match to {
            "" => u32::MAX,
            to => to.parse().map_err(|_| expected())?,
        };
        if from >= to {
            return Err(expected());
        }
        Ok(Self(from..to))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Color {
    /// 8 bits per channel, what a camera delivers
    Rgba8,
    /// 32 bits per channel, unclamped
    F32,
}

impl Arguments {
    fn options(&self, rules: Rules) -> RenderOptions {
        let mut options = RenderOptions {
            rules,
            outputs: self.outputs(),
            keep_keys: !self.compute_keys,
            keep_lists: self.keep_lists,
            level_pitch_px: self.level_pitch,
            frames_in_flight: usize::from(self.in_flight),
            overlap: !self.serial,
            ..RenderOptions::default()
        };
        self.background.apply_to(&mut options);
        options
    }

    /// The device, with the kernels of `trial` in the place of the program's.
    fn open(&self, trial: KernelTrial) -> Result<Gpu> {
        self.device.open_with(DeviceOptions {
            trial,
            reports_kernels: self.kernels || !self.trial.is_empty(),
            ..DeviceOptions::default()
        })
    }

    fn outputs(&self) -> Outputs {
        let color = match self.color {
            Color::Rgba8 => ColorFormat::U8,
            Color::F32 => ColorFormat::F32,
        };
        Outputs {
            color,
            planes: self.planes.iter().copied().collect(),
            ..Outputs::default()
        }
    }
}

/// Frames drawn once more after those that are timed, with every stage timed: stages that are timed
/// do not overlap, and a frame may take longer.
const FRAMES_BY_STAGE_MAX: u32 = 20;

/// Frames that were timed.
struct Timed {
    frames: Vec<FrameStatistics>,
    /// The last of them, drawn once more with every stage timed.
    by_stage: Vec<FrameStatistics>,
    /// Wall clock from the end of the frame before to the end of each.
    steps_ms: Vec<f64>,
    /// Device memory in use while the frames were drawn.
    memory: MemoryReport,
}

/// Results and their subject.
struct Measured {
    device: DeviceInfo,
    options: RenderOptions,
    step_s: f64,
    warm_up: u32,
    timed: Timed,
    window: Window,
    difference: Difference,
    images: Vec<ImageError>,
    /// Empty where they were not asked for.
    kernels: Vec<KernelReport>,
}

/// Error of a whole image.
struct ImageError {
    camera: String,
    difference: Difference,
    flips: Flips,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let written = [&arguments.json, &arguments.trace, &arguments.trace_image];
    arguments.force.files(&[], written.into_iter().flatten())?;
    let mut input = DrawInput::open(&arguments.scene)?;
    input.warn_of_shapes();
    let used = arguments.cameras_used.unwrap_or(input.cameras.len());
    ensure!(
        (1..=input.cameras.len()).contains(&used),
        "--cameras-used {used}: the scene has {} cameras",
        input.cameras.len()
    );
    input.cameras.truncate(used);
    ensure!(
        arguments.error_cameras <= used,
        "--error-cameras {}: {used} cameras are rendered",
        arguments.error_cameras
    );

    if let Some(name) = &arguments.lidar {
        return lidar::run(name, &input, arguments);
    }
    if !arguments.trial.is_empty() {
        let figures = trial::run(&input, arguments)?;
        return match &arguments.json {
            Some(path) => Ok(write_atomically(path, |file| {
                writeln!(file, "{figures:#}")
            })?),
            None => Ok(()),
        };
    }
    let gpu = arguments.open(KernelTrial::default())?;
    let timed = time_frames(&gpu, &input, arguments)?;
    if arguments.trace.is_some() || arguments.trace_image.is_some() {
        let trace = trace::chrome_trace(&timed.by_stage, gpu.clock()?);
        if let Some(path) = &arguments.trace {
            write_atomically(path, |file| writeln!(file, "{trace}"))?;
        }
        if let Some(path) = &arguments.trace_image {
            write_atomically(path, |file| file.write_all(trace::image(&trace).as_bytes()))?;
        }
    }
    let window = middle(&input.cameras[0].intrinsics, arguments.error_window);
    let mut comparison = Comparison::new(&gpu, &input, arguments)?;
    let (difference, _) = comparison.differences(0, window)?;
    let images = comparison.whole_images(arguments.error_cameras)?;
    drop(comparison);
    check_validation(&gpu)?;

    let (device, warm_up) = (gpu.info().clone(), arguments.warm_up);
    let (options, step_s) = (arguments.options(input.rules()), arguments.step);
    let measured = Measured {
        device,
        options,
        step_s,
        warm_up,
        timed,
        window,
        difference,
        images,
        kernels: gpu.kernel_reports(),
    };
    let mut figures = report::figures(&input, &measured);
    if arguments.kernels {
        figures["kernels"] = kernels::figures(&measured.kernels);
    }
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{figures:#}"))?;
    }
    print(&report::to_text(&figures))?;
    match arguments.kernels {
        true => print(&kernels::to_text(&figures["kernels"])),
        false => Ok(()),
    }
}

/// The frames after the warm-up, the wall clock from one to the next, and the memory that they
/// took; then the frames whose stages are timed.
fn time_frames(gpu: &Gpu, input: &DrawInput, arguments: &Arguments) -> Result<Timed> {
    let options = arguments.options(input.rules());
    let mut renderer = Renderer::new(gpu, options);
    let copying = progress::spinner("copying the scene to the device".into());
    let session = Session::on(gpu, &options.into());
    let mut world = World::new(&session.add_scene(&input.loaded)?);
    copying.finish_and_clear();
    let count = arguments.warm_up + arguments.frames;
    let by_stage_count = arguments.frames.min(FRAMES_BY_STAGE_MAX);
    let bar = progress::bar("frames", (count + by_stage_count) as usize);
    let mut draw = |renderer: &mut Renderer, range: Range<u32>| {
        let (mut frames, mut steps_ms) = (Vec::new(), Vec::new());
        let mut last = Instant::now();
        let ahead = usize::from(arguments.in_flight) - 1;
        let mut moments = range.clone();
        for place in 0..range.len() + ahead {
            if let Some(frame) = moments.next() {
                let later_s = f64::from(frame) * arguments.step;
                world.set_time(input.time_s + later_s);
                let moved = match &arguments.ego_stands {
                    Some(stands) => stands.frames_moved(frame),
                    None => frame,
                };
                let cameras = input.cameras_after(f64::from(moved) * arguments.step);
                world.lend(|splats| renderer.submit(splats, &cameras))?;
            }
            if place >= ahead {
                frames.push(renderer.finish()?);
                let now = Instant::now();
                let step = now - std::mem::replace(&mut last, now);
                steps_ms.push(step.as_secs_f64() * 1e3);
                bar.inc(1);
            }
        }
        anyhow::Ok((frames, steps_ms))
    };
    let (mut frames, mut steps_ms) = draw(&mut renderer, 0..count)?;
    frames.drain(..arguments.warm_up as usize);
    steps_ms.drain(..arguments.warm_up as usize);
    let memory = gpu.memory();
    renderer.time_stages(true);
    let (by_stage, _) = draw(&mut renderer, count - by_stage_count..count)?;
    bar.finish_and_clear();
    Ok(Timed {
        frames,
        by_stage,
        steps_ms,
        memory,
    })
}

/// The window of at most `size` in the middle of an image.
fn middle(image: &Intrinsics, size: Size) -> Window {
    let (width_px, height_px) = (
        size.width_px.min(image.width_px),
        size.height_px.min(image.height_px),
    );
    Window {
        left_px: (image.width_px - width_px) / 2,
        top_px: (image.height_px - height_px) / 2,
        width_px,
        height_px,
    }
}

/// Images that are rendered once more in f32, since 8 bits would hide their error, and the
/// reference's.
struct Comparison<'a> {
    renderer: Renderer,
    world: World,
    input: &'a DrawInput,
    splat_scene: SplatScene,
}

impl<'a> Comparison<'a> {
    fn new(gpu: &Gpu, input: &'a DrawInput, arguments: &Arguments) -> Result<Self> {
        let options = RenderOptions {
            outputs: Outputs::default(),
            ..arguments.options(input.rules())
        };
        let renderer = Renderer::new(gpu, options);
        let session = Session::on(gpu, &options.into());
        let mut world = World::new(&session.add_scene(&input.loaded)?);
        world.set_time(input.time_s);
        Ok(Self {
            renderer,
            world,
            input,
            splat_scene: input.splat_scene(),
        })
    }

    /// The error in `window` of the image of camera `index`.
    fn differences(&mut self, index: usize, window: Window) -> Result<(Difference, Flips)> {
        let Self {
            renderer,
            world,
            input,
            splat_scene,
        } = self;
        let camera = &input.cameras[index];
        let working = progress::spinner(format!("{} by the f64 definition", camera.name));
        let cameras = std::slice::from_ref(camera);
        world.lend(|splats| renderer.render(splats, cameras))?;
        let found = cut(&renderer.read_images()?[0], window);
        let world_at = |later_s: f64| match later_s {
            0.0 => Cow::Borrowed(splat_scene),
            _ => Cow::Owned(input.loaded.baked(input.time_s + later_s)),
        };
        let expected =
            reference::render_moving_window(&world_at, camera, &splat_scene.rules, window);
        let expected = expected.to_image();
        working.finish_and_clear();
        Ok((
            Difference::between(&found, &expected)?,
            Flips::between(&found, &expected)?,
        ))
    }

    /// The errors of the whole images of `count` cameras.
    fn whole_images(&mut self, count: usize) -> Result<Vec<ImageError>> {
        let mut errors = Vec::with_capacity(count);
        for place in 0..count {
            let index = place * self.input.cameras.len() / count;
            let camera = &self.input.cameras[index];
            let whole = Window::whole(&camera.intrinsics);
            let (difference, flips) = self.differences(index, whole)?;
            errors.push(ImageError {
                camera: camera.name.clone(),
                difference,
                flips,
            });
        }
        Ok(errors)
    }
}

/// The pixels of `image` in `window`, which lies inside it.
fn cut(image: &Image, window: Window) -> Image {
    let rows = window.top_px..window.top_px + window.height_px;
    let pixels = rows.flat_map(|row| {
        (window.left_px..window.left_px + window.width_px).map(move |column| (row, column))
    });
    let places: Vec<usize> = pixels
        .map(|(row, column)| row as usize * image.width as usize + column as usize)
        .collect();
    Image {
        width: window.width_px,
        height: window.height_px,
        rgb: places.iter().map(|&at| image.rgb[at]).collect(),
        alpha: places.iter().map(|&at| image.alpha[at]).collect(),
        planes: PlaneMap::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_lies_in_the_middle_and_cuts_its_own_pixels() {
        let image = Intrinsics::from_horizontal_fov(7, 5, 1.0);
        let window = middle(
            &image,
            Size {
                width_px: 3,
                height_px: 100,
            },
        );
        assert_eq!(
            window,
            Window {
                left_px: 2,
                top_px: 0,
                width_px: 3,
                height_px: 5
            }
        );
        let mut image = Image::filled(7, 5, [0.0; 3]);
        image
            .rgb
            .iter_mut()
            .enumerate()
            .for_each(|(at, rgb)| rgb[0] = at as f32);
        let offsets: Vec<f32> = cut(&image, window).rgb.iter().map(|rgb| rgb[0]).collect();
        assert_eq!(offsets[..4], [2.0, 3.0, 4.0, 9.0]);
    }

    #[test]
    fn an_ego_that_stands_goes_on_from_where_it_stood() {
        let stands: EgoStands = "2..5".parse().unwrap();
        let moved: Vec<u32> = (0..8).map(|frame| stands.frames_moved(frame)).collect();
        assert_eq!(moved, [0, 1, 2, 2, 2, 2, 3, 4]);
        let always: EgoStands = "0..".parse().unwrap();
        assert_eq!(always.frames_moved(99), 0);
        for text in ["", "3", "5..5", "6..5", "a..b"] {
            assert!(text.parse::<EgoStands>().unwrap_err().contains("FROM..TO"));
        }
    }
}
