//! `decouplegs drive`: episodes in closed loop.

mod difficulty;
mod egos;
mod episode_queue;
mod folder;
mod generated;
mod image_writer;
mod jobs;
mod overlays;
mod run_devices;
mod tracks;
mod workers;

use std::ffi::OsStr;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Result, bail, ensure};
use clap::ValueEnum;
use decouplegs::episode::Appearance;
use decouplegs::logs::scenario_file;
use decouplegs::planner::agents::{AgentDriver, AgentDriverChoice};
use decouplegs::planner::{Cameras, Planner, Timeouts};
use decouplegs::scene::episode::EpisodeEnd;
use decouplegs::scene::{Drivers, Level};
use serde_json::json;

use self::egos::EgoPlanner;
use self::folder::RunFolder;
pub use self::image_writer::{ImageWriter, Images};
use self::run_devices::RunDevices;
pub use self::tracks::is_commonroad;
use self::workers::Run;
use crate::arguments::{Size, print, seconds_within, transfer_in};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, DevicesArguments, check_validation};
use crate::episode_report::{self, Scored};
use crate::sites::Sites;
use decouplegs_alpasim::egodriver::DriverOptions;
use decouplegs_alpasim::planner_name::PlannerName;
use decouplegs_cli::video;

/// Traffic lights of generated scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum TrafficLights {
    On,
    Off,
}

/// Source of the parameters of drivers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DriversName {
    Kinds,
    Drawn,
}

impl From<DriversName> for Drivers {
    fn from(name: DriversName) -> Self {
        match name {
            DriversName::Kinds => Self::Kinds,
            DriversName::Drawn => Self::Drawn,
        }
    }
}

/// Road users of generated scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RoadUsers {
    Cars,
    Mixed,
}

/// Drive episodes in closed loop: render the cameras, ask the planner, move the ego, let traffic
/// react. Finished episodes stay in --out; the same command resumes a stopped run
#[derive(clap::Args)]
#[command(group = clap::ArgGroup::new("what").required(true).multiple(true)
    .args(["scenarios", "level", "follow_recording", "tracks"]))]
pub struct Arguments {
    /// Scenarios (.toml), OpenSCENARIO files (.xosc), or scenarios of HUGSIM (.yaml, in --scene) to
    /// drive, one episode each
    #[arg(value_name = "SCENARIO")]
    scenarios: Vec<PathBuf>,
    /// Generate scenarios of these levels: easy, medium, hard, extreme or all
    #[arg(long, value_name = "LEVEL", value_delimiter = ',', value_parser = levels, conflicts_with = "scenarios")]
    level: Vec<LevelName>,
    /// Drive the way on which --scene was recorded, pose by pose and as fast, whatever the planner
    /// plans: an open loop, whose log `open-loop` compares images along
    #[arg(long, requires = "scene", conflicts_with_all = ["level", "scenarios"])]
    follow_recording: bool,
    #[command(flatten)]
    tracks: tracks::TrackArguments,
    /// Planner: constant-velocity, lane-follow, lane-follow-cautious, lane-follow-brisk, vision,
    /// learned, learned:FILE, replay:LOG, exec:COMMAND, unix:SOCKET, or egodriver://HOST:PORT, a
    /// driver of AlpaSim
    #[arg(long, value_name = "PLANNER")]
    planner: PlannerName,
    /// Planner of one of the egos of a scenario, by the name of the ego. May be repeated. Egos
    /// without one are driven by the planner that the scenario names for them, or by --planner
    #[arg(long, value_name = "EGO=PLANNER")]
    ego_planner: Vec<EgoPlanner>,
    /// Generate scenarios with N egos, 2 to 8: cars of the traffic become egos, and keep their
    /// names
    #[arg(long, value_name = "N", allow_negative_numbers = true, requires = "level", value_parser = clap::value_parser!(u8).range(2..=8))]
    egos: Option<u8>,
    /// Program that drives the vehicles of the traffic in place of the driver model, all of them in
    /// one process: exec:COMMAND, unix:SOCKET, or onnx:MODEL, a network. Those that it leaves out
    /// are driven by the model
    #[arg(long, value_name = "DRIVER")]
    agents: Option<AgentDriverChoice>,
    /// Number of episodes per level
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    episodes: u32,
    /// Seed of the generated scenarios
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// Folder of the run; created if it does not exist
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Traffic lights of generated scenarios: those that the map has, or none
    #[arg(long, value_name = "on|off", value_enum, default_value_t = TrafficLights::On, hide_possible_values = true)]
    traffic_lights: TrafficLights,
    /// Take the number of vehicles of generated scenarios from this level
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    density: Option<Level>,
    /// Take drivers, injected behaviors and pedestrians from this level
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    surprise: Option<Level>,
    /// Take the time limit from this level
    #[arg(long, value_name = "LEVEL", value_parser = level)]
    time_budget: Option<Level>,
    /// Generate only scenarios that can be won: `lane-follow`, which knows everything, comes to the
    /// end of the route without a fault and with a tenth of the time to spare. Others are replaced
    #[arg(long)]
    winnable: bool,
    /// Road users of generated scenarios: cars, or also trucks, buses, cyclists and pedestrians
    #[arg(long, value_name = "cars|mixed", value_enum, default_value_t = RoadUsers::Cars, hide_possible_values = true)]
    road_users: RoadUsers,
    /// Parameters of drivers: kinds, four types with one set each; or drawn, own ones for each
    /// driver, with free speeds by class of road where the map tells no limit [default: what the
    /// scenario file says, kinds for others]
    #[arg(
        long,
        value_name = "kinds|drawn",
        value_enum,
        hide_possible_values = true
    )]
    drivers: Option<DriversName>,
    #[command(flatten)]
    place: jobs::PlaceArguments,
    /// Time from one plan to the next [default: that of the scenario, 0.1 for a driver of AlpaSim]
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, value_parser = step)]
    step: Option<f64>,
    /// Render every N-th step, or `off` for none
    #[arg(long, value_name = "N|off", default_value = "1")]
    render: Every,
    /// Size of the images
    #[arg(
        long,
        value_name = "WxH",
        allow_hyphen_values = true,
        default_value = "320x180"
    )]
    size: Size,
    /// Render all cameras of the rig for a planner that requests none, instead of the front one
    #[arg(long)]
    all_cameras: bool,
    /// LiDAR to trace at every rendered step: one of the scene, or a model (see `lidar --help`) on
    /// the roof of the ego. May be repeated. Planners that request LiDARs get those of the scene
    /// too
    #[arg(long, value_name = "NAME|FILE")]
    lidar: Vec<String>,
    /// Light transfer for the cars of a synthetic place, written by `calibrate-light`
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    /// Number of parallel workers, on each of --devices. One device gains little beyond two
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    workers: u32,
    /// Images to keep
    #[arg(long, value_enum, default_value_t = Images::Key)]
    images: Images,
    /// Write a video per camera and episode with ffmpeg; keeps all images
    #[arg(long)]
    video: bool,
    /// Draw the plan, boxes of road users, speed, time to collision, scores and infractions into
    /// the videos. Images that are kept have none of it
    #[arg(long, requires = "video")]
    overlays: bool,
    /// Time limit for an answer of an external planner: a later answer ends its episode. Also for a
    /// driver of --agents: a later answer ends the run
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 10.0, value_parser = seconds)]
    planner_timeout: f64,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
    #[command(flatten)]
    devices: DevicesArguments,
    #[command(flatten)]
    driver: DriverOptions,
}

fn seconds(text: &str) -> Result<f64, String> {
    seconds_within(text, &(0.001..=86_400.0))
}

fn step(text: &str) -> Result<f64, String> {
    seconds_within(
        text,
        &(scenario_file::STEP_S_MIN..=scenario_file::STEP_S_MAX),
    )
}

fn level(text: &str) -> Result<Level, String> {
    let expected = || "expected easy, medium, hard or extreme".to_owned();
    Level::by_name(text).ok_or_else(expected)
}

/// `all` or a level.
#[derive(Clone, Copy, Debug)]
struct LevelName(Option<Level>);

fn levels(text: &str) -> Result<LevelName, String> {
    match (text, Level::by_name(text)) {
        ("all", _) => Ok(LevelName(None)),
        (_, Some(level)) => Ok(LevelName(Some(level))),
        _ => Err("expected easy, medium, hard, extreme or all".into()),
    }
}

/// Rendering interval in steps; 0: never.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Every(u32);

impl std::str::FromStr for Every {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let every = if text == "off" {
            Some(0)
        } else {
            text.parse().ok().filter(|every| *every > 0)
        };
        every
            .map(Self)
            .ok_or_else(|| format!("expected a number from 1 on, or off, found {text:?}"))
    }
}

impl Arguments {
    fn levels(&self) -> Vec<Level> {
        let mut levels: Vec<Level> = self
            .level
            .iter()
            .flat_map(|name| name.0.map_or(Level::ALL.to_vec(), |level| vec![level]))
            .collect();
        levels.sort_unstable();
        levels.dedup();
        levels
    }

    /// Settings that must be the same when a run is resumed.
    fn settings(&self) -> serde_json::Value {
        let mut settings = json!({
            "planner": self.planner.to_string(),
            "seed": self.seed,
            "place": self.place.to_json(),
            "render": self.render.0,
            "size": [self.size.width_px, self.size.height_px],
            "all_cameras": self.all_cameras,
            "lidar": self.lidar,
            "traffic_lights": self.traffic_lights == TrafficLights::On,
            "density": self.density.map(Level::name),
            "surprise": self.surprise.map(Level::name),
            "time_budget": self.time_budget.map(Level::name),
            "road_users": if self.road_users == RoadUsers::Mixed { "mixed" } else { "cars" },
            "light": self.light.as_ref().map(|light| light.display().to_string()),
        });
        if self.follow_recording {
            settings["follow_recording"] = true.into();
        }
        if self.winnable {
            settings["winnable"] = true.into();
        }
        if let Some(egos) = self.egos {
            settings["egos"] = egos.into();
        }
        if !self.ego_planner.is_empty() {
            let planners = self.ego_planner.iter();
            let planners = planners.map(|named| format!("{}={}", named.ego, named.planner));
            settings["ego_planner"] = planners.collect::<Vec<String>>().into();
        }
        if let Some(tracks) = self.tracks.to_json() {
            settings["tracks"] = tracks;
        }
        if let Some(step_s) = self.step_s() {
            settings["step"] = step_s.into();
        }
        if let Some(drivers) = self.drivers {
            settings["drivers"] = Drivers::from(drivers).name().into();
        }
        if let Some(agents) = &self.agents {
            settings["agents"] = agents.to_string().into();
        }
        if self.planner.is_driver() {
            settings["driver"] = self.driver.to_json();
        }
        settings
    }

    /// Time from one plan to the next, seconds; `None` for that of the scenario.
    fn step_s(&self) -> Option<f64> {
        self.step.or(self.planner.step_s())
    }

    fn timeouts(&self) -> Timeouts {
        Timeouts {
            answer: Duration::from_secs_f64(self.planner_timeout),
            ..Timeouts::default()
        }
    }

    fn planner(&self) -> Result<Box<dyn Planner>> {
        self.planner.open(self.timeouts(), &self.driver)
    }

    /// The program that drives agents, if one is named.
    fn agents(&self) -> Result<Option<Box<dyn AgentDriver>>> {
        let choice = self.agents.as_ref();
        let opened = choice.map(|choice| choice.open(self.timeouts()));
        Ok(opened.transpose()?)
    }

    fn keeps(&self) -> Images {
        if self.video { Images::All } else { self.images }
    }
}

/// Threads that workers share for the work of the host, at most. Their pieces of work are small:
/// with 64 threads, to wake and to end them takes longer than the work
/// (`engine/guides/your-cluster.md`).
const THREADS_MAX: usize = 16;

/// Number of threads to make on a machine of `cores`; `None` where that is not changed.
fn threads_of(cores: usize, named: Option<&OsStr>) -> Option<usize> {
    (named.is_none() && cores > THREADS_MAX).then_some(THREADS_MAX)
}

/// Bounds the threads of the host, unless `RAYON_NUM_THREADS` says how many there are.
fn bound_threads() {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let named = std::env::var_os("RAYON_NUM_THREADS");
    if let Some(threads) = threads_of(cores, named.as_deref()) {
        // Threads that are there already stay as they are.
        let _ = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build_global();
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
    bound_threads();
    if arguments.video {
        ensure!(
            arguments.render.0 > 0,
            "--video needs images, and --render off draws none"
        );
        ensure!(
            video::has_ffmpeg(),
            "--video needs ffmpeg, which is not installed: install it, or keep the images with --images all"
        );
    }
    // Before the first episode: a planner that cannot be had is no episode's failure.
    ensure!(
        arguments.render.0 > 0 || arguments.lidar.is_empty(),
        "--lidar traces sweeps, and --render off draws nothing"
    );
    ensure!(
        arguments.render.0 > 0 || !arguments.devices.are_named(),
        "--devices names what draws, and --render off draws nothing"
    );
    let planner = arguments.planner()?;
    ensure!(
        arguments.render.0 > 0 || planner.sees().cameras == Cameras::None && !planner.sees().lidars,
        "{} drives by what it sees, and --render off draws nothing",
        arguments.planner
    );
    drop(planner);
    drop(arguments.agents()?);
    let folder = RunFolder::open(&arguments.out, &arguments.settings())?;
    let listed = jobs::list(arguments, &folder);
    let checked = listed.and_then(|jobs| egos::check(arguments, &jobs).map(|()| jobs));
    let jobs = match checked {
        Ok(jobs) => jobs,
        Err(error) => {
            folder.forget();
            return Err(error);
        }
    };
    let devices = opened(arguments)?;
    let appearance = Appearance {
        transfer: transfer_in(arguments.light.as_deref())?,
        only_cars: jobs.iter().all(|job| job.scenario.has_only_cars()),
    };
    let sites = Sites::new(devices.gpus(), arguments.background, appearance);
    let run = Run::new(arguments, &folder, &sites, &devices, &jobs);
    let mut scored = run.all()?;
    scored.sort_by(|a, b| (a.level(), a.name()).cmp(&(b.level(), b.name())));
    let device_use = devices.report();
    let text = episode_report::write(&scored, &sites, device_use.as_ref(), &arguments.out)?;
    print(&text)?;
    if scored.iter().all(|scored| scored.times.is_none()) {
        print("nothing was left to drive: all episodes were in the folder already\n")?;
    }
    let lost = jobs.iter().filter_map(|job| job.lost.as_ref());
    for sentence in lost {
        print(&format!("{sentence}\n"))?;
    }
    devices.gpus().iter().try_for_each(check_validation)?;
    // A planner that drove nothing at all is a fault of the run, not of an episode.
    let reason = |scored: &Scored| match &scored.end {
        EpisodeEnd::Planner { reason } => Some(reason.clone()),
        _ => None,
    };
    let reasons: Vec<String> = scored.iter().map_while(reason).collect();
    if let (Some(first), true) = (reasons.first(), reasons.len() == scored.len()) {
        bail!(
            "the planner failed in all {} episodes: {first}",
            scored.len()
        );
    }
    Ok(())
}

/// The devices that draw: those of --devices, or that of --device; none where nothing is drawn.
fn opened(arguments: &Arguments) -> Result<RunDevices> {
    if arguments.render.0 == 0 {
        return RunDevices::new(Vec::new(), None);
    }
    match arguments.devices.open()? {
        Some(gpus) => RunDevices::new(gpus, Some(&arguments.out)),
        None => RunDevices::new(vec![arguments.device.open()?], None),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn threads_are_bounded_unless_they_are_named() {
        assert_eq!(threads_of(64, None), Some(16));
        assert_eq!(threads_of(16, None), None);
        assert_eq!(threads_of(64, Some(OsStr::new("64"))), None);
    }
}
