//! `decouplegs drive`: episodes in closed loop.

mod folder;
mod image_writer;
mod jobs;

use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail, ensure};
use clap::ValueEnum;
use decouplegs::asset::AssetError;
use decouplegs::episode::{
    self, Appearance, Driven, ObservationRenderer, chosen, chosen_lidars, drive,
};
use decouplegs::logs::{read_episode_log, scenario_file};
use decouplegs::planner::{Cameras, Planner, Timeouts};
use decouplegs::scene::episode::{Episode, EpisodeEnd};
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Level, Sensor};
use indicatif::ProgressBar;
use serde_json::json;

use self::folder::RunFolder;
use self::image_writer::EpisodeImages;
pub use self::image_writer::{ImageWriter, Images};
use self::jobs::Job;
use crate::arguments::{Size, print, seconds_within, transfer_in, warn};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
use crate::episode_report::{self, Scored};
use crate::progress;
use crate::seen::SeenWatch;
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

/// Road users of generated scenarios.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum RoadUsers {
    Cars,
    Mixed,
}

/// Drive episodes in closed loop: render the cameras, ask the planner, move the ego, let traffic
/// react. Finished episodes stay in --out; the same command resumes a stopped run
#[derive(clap::Args)]
pub struct Arguments {
    /// Scenarios (.toml) or OpenSCENARIO files (.xosc) to drive, one episode each
    #[arg(required_unless_present_any = ["level", "follow_recording"], value_name = "SCENARIO")]
    scenarios: Vec<PathBuf>,
    /// Generate scenarios of these levels: easy, medium, hard, extreme or all
    #[arg(long, value_name = "LEVEL", value_delimiter = ',', value_parser = levels, conflicts_with = "scenarios")]
    level: Vec<LevelName>,
    /// Drive the way on which --scene was recorded, pose by pose and as fast, whatever the planner
    /// plans: an open loop, whose log `open-loop` compares images along
    #[arg(long, requires = "scene", conflicts_with_all = ["level", "scenarios"])]
    follow_recording: bool,
    /// Planner: constant-velocity, lane-follow, vision, replay:LOG, exec:COMMAND, unix:SOCKET, or
    /// egodriver://HOST:PORT, a driver of AlpaSim
    #[arg(long, value_name = "PLANNER")]
    planner: PlannerName,
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
    /// Road users of generated scenarios: cars, or also trucks, buses, cyclists and pedestrians
    #[arg(long, value_name = "cars|mixed", value_enum, default_value_t = RoadUsers::Cars, hide_possible_values = true)]
    road_users: RoadUsers,
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
    /// Number of parallel workers. One device gains little beyond two
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=256))]
    workers: u32,
    /// Images to keep
    #[arg(long, value_enum, default_value_t = Images::Key)]
    images: Images,
    /// Write a video per camera and episode with ffmpeg; keeps all images
    #[arg(long)]
    video: bool,
    /// Time limit for an answer of an external planner: a later answer ends its episode
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 10.0, value_parser = seconds)]
    planner_timeout: f64,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
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
        if let Some(step_s) = self.step_s() {
            settings["step"] = step_s.into();
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

    fn planner(&self) -> Result<Box<dyn Planner>> {
        let patience = Timeouts {
            answer: Duration::from_secs_f64(self.planner_timeout),
            ..Timeouts::default()
        };
        self.planner.open(patience, &self.driver)
    }

    fn keeps(&self) -> Images {
        if self.video { Images::All } else { self.images }
    }
}

pub fn run(arguments: &Arguments) -> Result<()> {
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
    let planner = arguments.planner()?;
    ensure!(
        arguments.render.0 > 0 || planner.sees().cameras == Cameras::None && !planner.sees().lidars,
        "{} drives by what it sees, and --render off draws nothing",
        arguments.planner
    );
    drop(planner);
    let folder = RunFolder::open(&arguments.out, &arguments.settings())?;
    let jobs = jobs::list(arguments, &folder)?;
    let gpu = (arguments.render.0 > 0)
        .then(|| arguments.device.open())
        .transpose()?;
    let appearance = Appearance {
        transfer: transfer_in(arguments.light.as_deref())?,
        only_cars: jobs.iter().all(|job| job.scenario.has_only_cars()),
    };
    let sites = Sites::new(gpu.as_ref(), arguments.background, appearance);
    let run = Run {
        arguments,
        folder: &folder,
        sites: &sites,
        bar: progress::bar("episodes", jobs.len()),
    };
    let mut scored = run.all(&jobs)?;
    run.bar.finish_and_clear();
    scored.sort_by(|a, b| (a.level(), a.name()).cmp(&(b.level(), b.name())));
    let text = episode_report::write(&scored, &sites, &arguments.out)?;
    print(&text)?;
    if scored.iter().all(|scored| scored.times.is_none()) {
        print("nothing was left to drive: all episodes were in the folder already\n")?;
    }
    let lost = jobs.iter().filter_map(|job| job.lost.as_ref());
    for sentence in lost {
        print(&format!("{sentence}\n"))?;
    }
    gpu.as_ref().map_or(Ok(()), check_validation)?;
    // A planner that drove nothing at all is a fault of the run, not of an episode.
    let reason = |scored: &Scored| match &scored.episode.end {
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

/// State shared by workers.
struct Run<'a> {
    arguments: &'a Arguments,
    folder: &'a RunFolder,
    sites: &'a Sites,
    bar: ProgressBar,
}

impl Run<'_> {
    /// Every episode, those that were finished before as they are.
    fn all(&self, jobs: &[Job]) -> Result<Vec<Scored>> {
        let (next, failed) = (AtomicUsize::new(0), AtomicBool::new(false));
        let scored = Mutex::new(Vec::with_capacity(jobs.len()));
        let work = || -> Result<()> {
            let mut worker = Worker {
                run: self,
                planner: None,
                renderer: None,
            };
            while !failed.load(Ordering::Relaxed) {
                let Some(job) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) else {
                    break;
                };
                let done = worker
                    .job(job)
                    .with_context(|| format!("episode {} was not driven", job.scenario.name));
                match done {
                    Ok(done) => scored
                        .lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner)
                        .push(done),
                    Err(error) => {
                        failed.store(true, Ordering::Relaxed);
                        return Err(error);
                    }
                }
                self.bar.inc(1);
            }
            Ok(())
        };
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.arguments.workers)
                .map(|_| scope.spawn(work))
                .collect();
            scope.spawn(|| self.prepare_places(jobs, &next, &done));
            let mut ends = workers.into_iter();
            let end = ends.try_for_each(|worker| worker.join().expect("a worker does not panic"));
            done.store(true, Ordering::Relaxed);
            end
        })?;
        Ok(scored
            .into_inner()
            .unwrap_or_else(std::sync::PoisonError::into_inner))
    }
}

/// Time between looks at how far the workers are.
const PREPARE_EVERY: Duration = Duration::from_millis(20);

impl Run<'_> {
    /// Makes the places of `jobs`, each when the first episode at the place before it has begun:
    /// one place ahead of the workers, who would wait for it otherwise. `next` is the job that a
    /// worker takes next. Ends when `done` is set.
    fn prepare_places(&self, jobs: &[Job], next: &AtomicUsize, done: &AtomicBool) {
        let is_driven = |job: &Job| !self.folder.log(&job.scenario.name).exists();
        let mut places: Vec<(usize, &Job)> = Vec::new();
        for (index, job) in jobs.iter().enumerate().filter(|(_, job)| is_driven(job)) {
            let same = |(_, other): &(usize, &Job)| {
                other.scenario.place == job.scenario.place && other.directory == job.directory
            };
            if !places.iter().any(same) {
                places.push((index, job));
            }
        }
        for pair in places.windows(2) {
            let ((before, _), (_, job)) = (pair[0], pair[1]);
            while next.load(Ordering::Relaxed) <= before {
                if done.load(Ordering::Relaxed) {
                    return;
                }
                std::thread::sleep(PREPARE_EVERY);
            }
            if done.load(Ordering::Relaxed) {
                return;
            }
            // A place that cannot be had is the fault of its episodes, which ask for it again.
            let _ = self.sites.get(&job.scenario.place, &job.directory);
        }
    }
}

/// One of the threads that drive.
struct Worker<'a> {
    run: &'a Run<'a>,
    planner: Option<Box<dyn Planner>>,
    renderer: Option<ObservationRenderer>,
}

impl Worker<'_> {
    fn job(&mut self, job: &Job) -> Result<Scored> {
        let name = &job.scenario.name;
        let path = self.run.folder.log(name);
        if path.exists() {
            match read_episode_log(&path) {
                Ok(episode) => {
                    ensure!(
                        episode.head.scenario == job.scenario,
                        "{} is of another scenario of the same name: remove it, or name another folder with --out",
                        path.display()
                    );
                    return Scored::new(episode, path, self.run.folder.images(name), None);
                }
                // Kept under another name, and driven again.
                Err(error @ AssetError::Decode { .. }) => {
                    let damaged = path.with_extension("log.damaged");
                    fs::rename(&path, &damaged)
                        .with_context(|| format!("{} cannot be renamed", path.display()))?;
                    warn(&format!(
                        "{error}: it is kept as {}, and the episode is driven again",
                        damaged.display()
                    ));
                }
                Err(error) => return Err(error.into()),
            }
        }
        let driven = self.drive(job)?;
        if self.run.arguments.video {
            self.videos(&driven.episode)?;
        }
        Scored::new(
            driven.episode,
            path,
            self.run.folder.images(name),
            Some(driven.times),
        )
    }

    fn drive(&mut self, job: &Job) -> Result<Driven> {
        let run = self.run;
        let ready = run.sites.get(&job.scenario.place, &job.directory)?;
        let planner = match &mut self.planner {
            Some(planner) => planner,
            none => none.insert(run.arguments.planner()?),
        };
        let name = &job.scenario.name;
        let image_writer = ImageWriter::new(run.folder.images(name), run.arguments.keeps());
        let log = run.folder.log(name);
        // Synthetic places look right from everywhere.
        let is_captured = matches!(job.scenario.place, Place::Scene { .. });
        let seen = is_captured.then(|| SeenWatch::new(ready.site.view_support().cloned(), &log));
        let mut images = EpisodeImages::new(log, image_writer, seen);
        let driven = match (run.sites.session(), &ready.scene) {
            (Some(session), Some(scene)) => {
                let at_least = if run.arguments.all_cameras {
                    Cameras::All
                } else {
                    Cameras::Front
                };
                let size = run.arguments.size;
                let all = &ready.site.loaded.rig;
                let mut rig = chosen(
                    all,
                    &episode::cameras_of(planner.as_ref(), at_least),
                    Some([size.width_px, size.height_px]),
                )?;
                let lidars = chosen_lidars(all, planner.sees().lidars, &run.arguments.lidar)?;
                ensure!(
                    !(planner.sees().lidars && lidars.is_empty()),
                    "the planner wants sweeps, and the scene has no LiDARs: add a [[lidar]] to the scene file, or name a model with --lidar"
                );
                rig.sensors.extend(lidars.into_iter().map(Sensor::Lidar));
                let every = run.arguments.render.0;
                let mut renderer = match self.renderer.take() {
                    Some(renderer) => renderer.restarted(scene, rig, every),
                    None => ObservationRenderer::new(session.batch_renderer(), scene, rig, every),
                };
                let (name, options) = (&run.arguments.planner, &run.arguments.driver);
                renderer = name.fit(renderer, options)?;
                let driven = drive(
                    &job.scenario,
                    &ready.site,
                    Some(&mut renderer),
                    planner.as_mut(),
                    &mut images,
                )?;
                self.renderer = Some(renderer);
                driven
            }
            _ => drive(
                &job.scenario,
                &ready.site,
                None,
                planner.as_mut(),
                &mut images,
            )?,
        };
        images.image_error.map_or(Ok(driven), Err)
    }

    fn videos(&self, episode: &Episode) -> Result<()> {
        let name = &episode.head.scenario.name;
        let folder = self.run.folder.images(name);
        let every = f64::from(self.run.arguments.render.0);
        for camera in &episode.head.planner.cameras {
            let video = self.run.folder.images(name).join(format!("{camera}.mp4"));
            video::encode(
                &folder,
                camera,
                1.0 / (every * episode.head.scenario.step_s),
                &video,
            )?;
        }
        Ok(())
    }
}
