//! `decouplegs export`: an episode as a data set of detectors, rendered again from its log, or as a
//! scene.

mod coco;
mod kitti;
mod mcap;
mod nuscenes;
mod plans;
mod scene;
mod sensed;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use decouplegs::asset::{UnfinishedFolder, write_atomically};
use decouplegs::episode::{Appearance, Moments, Site, camera_named, chosen_lidars};
use decouplegs::logs::read_episode_log;
use decouplegs::planner::{Cameras, PlannerChoice, Timeouts};
use decouplegs::scene::episode::{DrawnBy, Episode};
use decouplegs::scene::{Camera, Rig, RigCamera, RigLidar, RoadUser, Sensor};
use decouplegs::session::Scene;
use decouplegs_cli::png_bytes;

use self::sensed::{LabeledImage, Renderers, Sensed};
use crate::arguments::{Size, print, transfer_in};
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::progress;

/// Write an episode as a data set: images, LiDAR sweeps and boxes of all road users, at each step;
/// or as a scene
///
/// Images are rendered again from the log. Those that the log has hashes of are compared with them:
/// where one differs nothing is written, and the exit code is 1
#[derive(clap::Args)]
pub struct Arguments {
    /// Log of an episode, as 'decouplegs drive' writes it
    log: PathBuf,
    /// Format of the data set
    #[arg(long = "as", value_name = "FORMAT", value_enum)]
    format: Format,
    /// Folder to write; it must not exist, or be empty
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Cameras, by name [default: those whose images the planner got, otherwise all]
    #[arg(long, value_name = "NAME,...", value_delimiter = ',')]
    cameras: Vec<String>,
    /// Size of the images [default: that of the log, otherwise the cameras' own]
    #[arg(long, value_name = "WxH", allow_hyphen_values = true)]
    size: Option<Size>,
    /// LiDAR: one of the scene, or a model (see `lidar --help`) on the roof of the ego
    #[arg(long, value_name = "NAME|FILE")]
    lidar: Option<String>,
    /// Write the data set even if images differ from the log
    #[arg(long)]
    unchecked: bool,
    /// Folder that the scenario's files are relative to [default: the log's]
    #[arg(long, value_name = "DIR")]
    base: Option<PathBuf>,
    /// Planner whose plans are written with `--as plans`, one that needs no sensors: lane-follow or
    /// constant-velocity
    #[arg(long, value_name = "PLANNER", default_value = "lane-follow")]
    planner: PlannerChoice,
    /// Ego whose sensors are written, by its name, where the log has several [default: the first]
    #[arg(long, value_name = "EGO")]
    ego: Option<String>,
    /// Light transfer for the cars, as given to the run
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    #[command(flatten)]
    device: DeviceArguments,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Format {
    /// nuScenes v1.0: tables, samples every 0.5 s, sweeps between
    Nuscenes,
    /// KITTI object detection of one camera: images, labels, calibration and points
    Kitti,
    /// COCO: boxes and masks in annotations.json, panoptic segmentation in panoptic.json
    Coco,
    /// ROS 2 messages in episode.mcap: images, camera_info, points, transforms, boxes as markers,
    /// odometry, plans, infractions, and score, time to collision and other quantities over time
    Mcap,
    /// A scene: the place with all road users on their ways, the ego's way with its cameras, and
    /// the lanes. Nothing is rendered. `view`, `render`, `drive --scene` and `pack` take it
    Scene,
    /// Plans of --planner at each step, with motion and guidance of the ego, in plans.jsonl: for
    /// planners that learn from it. Nothing is rendered
    Plans,
}

/// Writer of a data set.
trait DataSet {
    /// Adds what the sensors saw at a step.
    fn add(&mut self, sensed: &Sensed) -> Result<()>;

    /// Writes the rest. Words on what was written.
    fn finish(self: Box<Self>) -> Result<String>;
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let out = &arguments.out;
    Force::default().outputs(&[]).whole_folder(out)?;
    let episode = read_episode_log(&arguments.log)?;
    let episode = match &arguments.ego {
        Some(name) => episode.with_first_named(name)?,
        None => episode,
    };
    let base = arguments.base.as_deref().or(arguments.log.parent());
    if arguments.format == Format::Plans {
        return write_plans(arguments, &episode, base.unwrap_or(Path::new("")));
    }
    let appearance = Appearance {
        transfer: transfer_in(arguments.light.as_deref())?,
        only_cars: episode.head.scenario.has_only_cars(),
    };
    let gpu = arguments.device.open()?;
    let opening = progress::spinner(format!("opening the place of {}", arguments.log.display()));
    let place = &episode.head.scenario.place;
    let site = Site::open(place, base.unwrap_or(Path::new("")), Some(&appearance));
    let site = Arc::new(site.context("the place of the log is not usable")?);
    let part = UnfinishedFolder::begin(out)?;
    let said = if arguments.format == Format::Scene {
        let files = (base.unwrap_or(Path::new("")), arguments.light.as_deref());
        let said = scene::write(&gpu, &episode, &site, files, part.path())?;
        opening.finish_and_clear();
        said
    } else {
        let rig = rig_of(arguments, &episode, &site.loaded.rig)?;
        let mut renderers = Renderers::new(&gpu, &site)?;
        let moments = moments_of(&episode, &site, renderers.scene())?;
        opening.finish_and_clear();
        write(
            arguments,
            &episode,
            &rig,
            &mut renderers,
            &moments,
            part.path(),
        )?
    };
    part.finish()?;
    print(&format!("{}: {said}\n", out.display()))?;
    check_validation(&gpu)
}

/// Writes the plans of a planner along `episode`, whose files are relative to `base`.
fn write_plans(arguments: &Arguments, episode: &Episode, base: &Path) -> Result<()> {
    let planner = arguments.planner.open(Timeouts::default())?;
    let sees = planner.sees();
    ensure!(
        sees.cameras == Cameras::None && !sees.lidars,
        "{} needs images or sweeps, and plans are written without: `open-loop` shows it images along a log",
        arguments.planner
    );
    let site = Site::open(&episode.head.scenario.place, base, None);
    let site = Arc::new(site.context("the place of the log is not usable")?);
    let part = UnfinishedFolder::begin(&arguments.out)?;
    let said = plans::write(episode, &site, planner, part.path())?;
    part.finish()?;
    print(&format!("{}: {said}\n", arguments.out.display()))
}

/// The moments of `episode` in `site`, whose copy on a device is `scene`.
///
/// # Errors
/// Returns an error where vehicles move otherwise than in the log.
fn moments_of(episode: &Episode, site: &Arc<Site>, scene: &Arc<Scene>) -> Result<Moments> {
    let moments = Moments::from_episode(episode, site, scene)?;
    if let Some(time_s) = moments.departs_s() {
        bail!(
            "from {time_s:.1} s on vehicles move differently than in the log: its place or the program has changed"
        );
    }
    Ok(moments)
}

fn write(
    arguments: &Arguments,
    episode: &Episode,
    rig: &Rig,
    renderers: &mut Renderers,
    moments: &Moments,
    folder: &Path,
) -> Result<String> {
    let mut data_set: Box<dyn DataSet> = match arguments.format {
        Format::Nuscenes => Box::new(nuscenes::Tables::new(folder, episode, rig)?),
        Format::Kitti => Box::new(kitti::Folders::new(folder, rig)?),
        Format::Coco => Box::new(coco::Annotations::new(folder)?),
        Format::Mcap => Box::new(mcap::Messages::new(folder, episode, moments, rig)?),
        Format::Scene | Format::Plans => bail!("scenes and plans have no images"),
    };
    let begun = moments.as_slice().iter().filter(|m| m.step.is_some());
    let bar = progress::bar("steps", episode.steps.len());
    let (mut compared, mut different) = (0, Vec::new());
    for moment in begun {
        let sensed = renderers.sense(episode, rig, moment)?;
        for (camera, same) in sensed.compared(episode) {
            compared += 1;
            if !same {
                different.push(format!("{camera} at {:.1} s", moment.time_s));
            }
        }
        data_set.add(&sensed)?;
        bar.inc(1);
    }
    bar.finish_and_clear();
    ensure!(
        different.is_empty() || arguments.unchecked,
        "{} of {compared} images are not those of the log, the first {}: it was rendered on another device or of other files. --unchecked writes the data set all the same",
        different.len(),
        different[0]
    );
    let said = data_set.finish()?;
    let same = compared - different.len();
    Ok(match compared {
        0 => format!("{said}; the log has no images of this size to compare with"),
        _ => format!("{said}; {same} of {compared} images have the bits of the log"),
    })
}

/// Cameras and the LiDAR that are exported.
fn rig_of(arguments: &Arguments, episode: &Episode, all: &Rig) -> Result<Rig> {
    let head = &episode.head;
    let names = match arguments.cameras.is_empty() {
        true => &head.planner.cameras,
        false => &arguments.cameras,
    };
    let mut cameras: Vec<RigCamera> = Vec::new();
    for name in names {
        cameras.push(camera_named(all, name)?.clone());
    }
    if names.is_empty() {
        cameras = all.cameras().cloned().collect();
    }
    let logged = head.drawn_by.clone().filter(|by| by.width_px > 0);
    let drawn_by = logged.map(|by| DrawnBy {
        width_px: arguments.size.map_or(by.width_px, |size| size.width_px),
        height_px: arguments.size.map_or(by.height_px, |size| size.height_px),
        ..by
    });
    for camera in &mut cameras {
        let k = &mut camera.intrinsics;
        *k = match (&drawn_by, arguments.size) {
            (Some(by), _) => by.intrinsics(k),
            (None, Some(size)) => k.resized(size.width_px, size.height_px),
            (None, None) => *k,
        };
    }
    let names: Vec<String> = arguments.lidar.iter().cloned().collect();
    let lidars: Vec<RigLidar> = chosen_lidars(all, false, &names)?;
    let mut rig = Rig::from_iter(cameras);
    rig.sensors.extend(lidars.into_iter().map(Sensor::Lidar));
    Ok(rig)
}

/// Kinds of road users, from 1 in data sets that count them.
fn category_number(kind: RoadUser) -> usize {
    RoadUser::ALL
        .iter()
        .position(|one| *one == kind)
        .unwrap_or(0)
        + 1
}

/// Writes `image` as PNG, without loss.
fn write_png(path: &Path, image: &LabeledImage) -> Result<()> {
    write_rgba(path, &image.rgba, &image.camera)
}

/// Writes an image of `camera`, 8-bit RGBA, as PNG.
fn write_rgba(path: &Path, rgba: &[u8], camera: &Camera) -> Result<()> {
    let k = &camera.intrinsics;
    let bytes = png_bytes::encode(rgba, [k.width_px, k.height_px]);
    let bytes = bytes.map_err(anyhow::Error::msg)?;
    Ok(write_atomically(path, |file| file.write_all(&bytes))?)
}
