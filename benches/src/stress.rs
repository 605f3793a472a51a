//! `decouplegs stress`: how frames, memory and error go with the number of agents, for several ways
//! to draw them.

mod charts;
pub mod drive_schedule;
mod fidelity;
pub mod figures;
mod fit;
mod measure;
mod mode;
mod page;
mod prune;
mod report;
mod tables;
mod workload;

use std::io::Write;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Result, ensure};
use decouplegs::asset::{CameraOptions, read_cameras, write_atomically};
use decouplegs::gpu::Gpu;
use decouplegs::render::Image;
use serde_json::{Value, json};

use crate::arguments::{Size, finite, print};
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;
use drive_schedule::DriveSchedule;
use figures::Point;
use measure::TestRig;
use mode::{Agents, Mode};
use report::{Report, Thumbnails};
use workload::{StreetWish, Workload};

/// Measure frame time, memory and error against the number of moving agents, for several modes of
/// rendering
///
/// The ego drives through a scene file or a generated street, with more and more agents around it,
/// once for each mode. Every mode's frames are timed, its memory is counted, and its images are
/// compared with those of vanilla. A table is printed; --report writes a page with plots, and says
/// there how to read them.
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
pub struct Arguments {
    /// A scene (.toml) with agents, plain or compressed
    #[arg(group = "what")]
    scene: Option<PathBuf>,
    /// Generate a street with the requested number of agents, and compress its cars
    #[arg(long, group = "what")]
    synth: bool,
    #[command(flatten)]
    street: StreetArguments,
    /// Numbers of agents to measure, always the first ones of the scene
    #[arg(
        long,
        value_name = "N,...",
        value_delimiter = ',',
        default_value = "0,1,2,5,10,20,30,40,50"
    )]
    agents: Vec<usize>,
    /// Fixed cameras: INRIA cameras.json or nerfstudio transforms.json (default: the ego's
    /// rig, which drives)
    #[arg(long, value_name = "FILE")]
    cameras: Option<PathBuf>,
    /// Number of cameras to render in one submission, from the first (default: all)
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    cameras_used: Option<usize>,
    /// Render every image at this size, with its field of view (default: the camera's own)
    #[arg(long, value_name = "WxH", allow_hyphen_values = true)]
    size: Option<Size>,
    /// Number of timed frames
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 120, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Least number of frames before them that are not timed
    ///
    /// They are the first frames of the drive backwards, so that the timed ones begin at --time in
    /// any case. A GPU warms up for at least 0.5 s, until its clocks have risen, and by the whole
    /// drive where that has at most 240 frames. A software device draws exactly N.
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    warm_up: u32,
    /// Time from one frame to the next, in which the ego and the agents drive on, seconds
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 0.1, value_parser = seconds)]
    step: f64,
    /// Time of the first timed frame, seconds (default: the start of the ego's trajectory)
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = finite)]
    time: Option<f64>,
    /// Modes of rendering; all but vanilla are compared with it
    ///
    /// vanilla: uncompressed copies of the agents, depth keys computed in every frame
    /// prune=SHARE: vanilla with a share of all splats kept (0.34)
    /// decoupled: compressed agents that drive, depth keys of the background kept while a camera
    ///   does not turn
    /// decoupled-serial: the same without overlap, 1 frame in flight instead of 2
    /// compact: decoupled, the background in compact storage
    /// far=PX: decoupled, the background with fewer splats where they lie at most so far apart (2)
    /// lod=PX: decoupled, agents at the coarsest level whose splats are at most so far apart (0.7)
    /// sh0, sh1, sh2: decoupled, colors evaluated to that degree
    /// keep=SHARE: decoupled, assets compressed with a share of their splats kept
    /// colors=N: decoupled, assets compressed with N colors and half as many shapes
    #[arg(long, verbatim_doc_comment, value_name = "MODE,...", value_delimiter = ',', default_value = mode::DEFAULT_MODES)]
    modes: Vec<Mode>,
    /// Number of moments at which images are compared with vanilla's
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 3, value_parser = clap::value_parser!(u32).range(0..=1000))]
    samples: u32,
    /// Limit of device memory, such as 2GiB or 500MiB; a mode that needs more is reported as out of
    /// memory
    #[arg(long, value_name = "BYTES", allow_negative_numbers = true)]
    memory_limit: Option<ByteSize>,
    /// Views all around an asset from which its splats' visibility is measured, where it is to be
    /// compressed
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    views: u32,
    #[command(flatten)]
    device: DeviceArguments,
    /// Write all figures to this JSON file
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write an HTML page with plots, tables and images to this file
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// The street of `--synth`.
#[derive(clap::Args)]
struct StreetArguments {
    /// Splats of the street without its traffic
    #[arg(
        long,
        value_name = "N",
        default_value_t = 200_000,
        conflicts_with = "scene"
    )]
    background: usize,
    /// Splats of each car
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 10_000, conflicts_with = "scene", value_parser = at_least_one)]
    agent_splats: usize,
    /// Distinct cars
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 12, conflicts_with = "scene", value_parser = at_least_one)]
    assets: usize,
    /// Degree of the spherical harmonics
    #[arg(long, value_name = "DEGREE", allow_negative_numbers = true, default_value_t = 3, conflicts_with = "scene",
        value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: u8,
    /// Seed of all randomness, the codebooks of compressed assets too
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
}

/// A number of bytes, with or without a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ByteSize(u64);

impl FromStr for ByteSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let digits = text.trim_end_matches(|c: char| c.is_ascii_alphabetic());
        let unit = match &text[digits.len()..] {
            "" | "B" => Some(1.0),
            "KiB" => Some(1024.0),
            "MiB" => Some(1048576.0),
            "GiB" => Some(1073741824.0),
            "kB" => Some(1e3),
            "MB" => Some(1e6),
            "GB" => Some(1e9),
            _ => None,
        };
        let bytes = unit.and_then(|unit| Some(digits.trim().parse::<f64>().ok()? * unit));
        let fits = bytes.filter(|bytes| (1.0..1e18).contains(bytes));
        fits.map(|bytes| Self(bytes as u64))
            .ok_or_else(|| format!("expected bytes such as 2GiB, 500MB or 1048576, found {text:?}"))
    }
}

fn at_least_one(text: &str) -> Result<usize, String> {
    text.parse()
        .ok()
        .filter(|&count| count >= 1)
        .ok_or_else(|| format!("expected a number of at least 1, found {text:?}"))
}

fn seconds(text: &str) -> Result<f64, String> {
    finite(text).and_then(|value| {
        if value >= 0.0 {
            Ok(value)
        } else {
            Err(format!("expected seconds of at least 0, found {text:?}"))
        }
    })
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let written = [&arguments.json, &arguments.report];
    arguments.force.files(&[], written.into_iter().flatten())?;
    let mut counts = arguments.agents.clone();
    counts.sort_unstable();
    counts.dedup();
    let modes = without_repetition(&arguments.modes);
    let mut workload = open(arguments, counts.last().copied().unwrap_or(0))?;
    let most = counts.last().copied().unwrap_or(0);
    ensure!(
        most <= workload.agents(),
        "--agents {most}: the scene has {} agents",
        workload.agents()
    );
    let schedule = schedule(arguments, &mut workload)?;

    let gpu = arguments.device.open()?;
    for mode in &modes {
        if let Agents::Coded(coding) = mode.agents {
            workload.code(&gpu, coding, arguments.views, arguments.street.seed)?;
        }
    }
    let conditions = conditions(arguments, &gpu, &workload, &schedule);
    let mut stand = TestRig::new(
        &gpu,
        workload,
        &schedule,
        arguments.memory_limit.map(|limit| limit.0),
    );
    let (points, thumbnails) = measure_all(&mut stand, &modes, &counts)?;
    check_validation(&gpu)?;

    let report = Report {
        conditions,
        modes,
        counts,
        points,
        thumbnails,
    };
    if let Some(path) = &arguments.json {
        write_atomically(path, |file| writeln!(file, "{:#}", report.to_json()))?;
    }
    if let Some(path) = &arguments.report {
        let page = page::page(&report)?;
        write_atomically(path, |file| file.write_all(page.as_bytes()))?;
    }
    print(&report.to_text())
}

fn without_repetition(asked: &[Mode]) -> Vec<Mode> {
    let mut modes: Vec<Mode> = Vec::new();
    for mode in asked {
        if !modes.contains(mode) {
            modes.push(mode.clone());
        }
    }
    modes
}

fn open(arguments: &Arguments, agents: usize) -> Result<Workload> {
    let StreetArguments {
        background,
        agent_splats,
        assets,
        degree,
        seed,
    } = arguments.street;
    match &arguments.scene {
        Some(path) => Workload::open(path),
        None => Workload::street(&StreetWish {
            background,
            agents,
            agent_splats,
            assets,
            sh_degree: degree,
            seed,
        }),
    }
}

/// The drive, for which the scene's cameras get the size that was asked for.
fn schedule(arguments: &Arguments, workload: &mut Workload) -> Result<DriveSchedule> {
    let scene = workload.background_mut();
    let mut standing = arguments
        .cameras
        .as_deref()
        .map(|path| read_cameras(path, &CameraOptions::default()))
        .transpose()?;
    if let Some(Size {
        width_px,
        height_px,
    }) = arguments.size
    {
        let rig = scene.rig.cameras_mut().map(|camera| &mut camera.intrinsics);
        let fixed = standing
            .iter_mut()
            .flatten()
            .map(|camera| &mut camera.intrinsics);
        rig.chain(fixed)
            .for_each(|intrinsics| *intrinsics = intrinsics.resized(width_px, height_px));
    }
    let there = match &standing {
        Some(standing) => standing.len(),
        None => scene.rig.cameras().count(),
    };
    ensure!(
        there > 0,
        "the scene has no cameras of its own: name some with --cameras FILE (INRIA or nerfstudio)"
    );
    let cameras_used = arguments.cameras_used.unwrap_or(there);
    ensure!(
        (1..=there).contains(&cameras_used),
        "--cameras-used {cameras_used}: there are {there} cameras"
    );
    Ok(DriveSchedule {
        start_s: arguments.time.unwrap_or(scene.ego.start_s()),
        step_s: arguments.step,
        warm_up: arguments.warm_up,
        frames: arguments.frames,
        samples: arguments.samples,
        cameras_used,
        standing,
    })
}

/// Conditions of the measurement, for later readers.
fn conditions(
    arguments: &Arguments,
    gpu: &Gpu,
    workload: &Workload,
    schedule: &DriveSchedule,
) -> Value {
    let scene = workload.background();
    let cameras = schedule.cameras(scene, schedule.start_s);
    let names: Vec<&str> = cameras.iter().map(|camera| camera.name.as_str()).collect();
    let warm_up = schedule.warm_up_on(gpu.info().kind);
    let assets = workload.asset_splats().into_iter();
    let assets: Vec<Value> =
        assets.map(|(name, splats, coded)| json!({ "name": name, "splats": splats, "coded_splats": coded })).collect();
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": gpu.info().name,
        "driver": gpu.info().driver,
        "device_memory_bytes": gpu.info().device_memory_bytes,
        "two_queues": gpu.has_update_queue(),
        "source": workload.source(),
        "background_splats": scene.splat_scene.splats.len(),
        "sh_degree": scene.splat_scene.splats.sh_degree,
        "rules": format!("{:?}", scene.splat_scene.rules),
        "assets": assets,
        "originals_known": workload.has_originals(),
        "compression": { "views": arguments.views, "seed": arguments.street.seed },
        "cameras": cameras.len(),
        "camera_names": names,
        "width_px": cameras[0].intrinsics.width_px,
        "height_px": cameras[0].intrinsics.height_px,
        "start_s": schedule.start_s,
        "step_s": schedule.step_s,
        "warm_up": warm_up.turn.len(),
        "warm_up_least_s": warm_up.least.as_secs_f64(),
        "frames": schedule.frames,
        "samples_s": schedule.sample_frames().into_iter().map(|frame| schedule.time_s(frame)).collect::<Vec<_>>(),
        "memory_limit_bytes": arguments.memory_limit.map(|limit| limit.0),
    })
}

/// Every mode with every number of agents, and one view of the last that vanilla and decoupled were
/// both drawn with.
fn measure_all(
    stand: &mut TestRig<'_>,
    modes: &[Mode],
    counts: &[usize],
) -> Result<(Vec<Point>, Option<Thumbnails>)> {
    let bar = progress::bar("stress", counts.len() * (modes.len() + 1));
    let (mut points, mut thumbnails) = (Vec::new(), None);
    for &agents in counts {
        bar.set_message(format!("{agents} agents: the images to compare with"));
        let vanilla = stand.vanilla_images(agents)?;
        bar.inc(1);
        for mode in modes {
            bar.set_message(format!("{agents} agents: {}", mode.name));
            let (outcome, images) = stand.measure(mode, agents, vanilla.as_deref())?;
            if mode.is_decoupled() {
                thumbnails =
                    view_of(stand.schedule, agents, vanilla.as_deref(), &images).or(thumbnails);
            }
            points.push(Point {
                mode: mode.clone(),
                agents,
                unique_assets: stand.workload.unique_assets(agents),
                outcome,
            });
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    Ok((points, thumbnails))
}

/// The first camera at the middle one of the sampled moments.
fn view_of(
    schedule: &DriveSchedule,
    agents: usize,
    vanilla: Option<&[Image]>,
    decoupled: &[Image],
) -> Option<Thumbnails> {
    let samples = schedule.sample_frames();
    let middle = samples.len() / 2;
    let place = middle * schedule.cameras_used;
    Some(Thumbnails {
        agents,
        time_s: schedule.time_s(*samples.get(middle)?),
        vanilla: vanilla?.get(place)?.clone(),
        decoupled: decoupled.get(place)?.clone(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_read_with_their_unit() {
        let read = |text: &str| text.parse::<ByteSize>().map(|size| size.0);
        assert_eq!(read("2GiB"), Ok(2 << 30));
        assert_eq!(read("1.5kB"), Ok(1500));
        assert_eq!(read("1048576"), Ok(1 << 20));
        for nonsense in ["", "GiB", "-1MB", "2 gigabytes", "NaN", "0", "1e30GB"] {
            assert!(read(nonsense).unwrap_err().contains("2GiB"), "{nonsense}");
        }
    }
}
