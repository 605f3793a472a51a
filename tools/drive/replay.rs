//! `decouplegs replay`: an episode driven again from its log.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Result, bail, ensure};
use decouplegs::drive::score::EpisodeScore;
use decouplegs::episode::{
    Appearance, EgosObserver, EgosRenderer, EpisodeObserver, ObservationRenderer, Replayed, Site,
    camera_named, chosen_lidars, replay, replay_egos,
};
use decouplegs::logs::read_episode_log;
use decouplegs::scene::episode::{DrawnBy, Episode, EpisodeHead, EpisodeStep};
use decouplegs::scene::{Rig, Sensor};

use crate::arguments::{print, transfer_in};
use crate::background::BackgroundArguments;
use crate::device::{DeviceArguments, check_validation};
use crate::drive::{ImageWriter, Images};
use crate::progress;
use crate::sites::Sites;

/// Repeat the plans of a log and compare: the motion of all vehicles and the score to the last bit,
/// images by their hashes. Exits with 1 if something differs
#[derive(clap::Args)]
pub struct Arguments {
    /// Log of an episode, as `drive` writes it
    log: PathBuf,
    /// Folder that the scenario's files are relative to (default: the log's)
    #[arg(long, value_name = "DIR")]
    base: Option<PathBuf>,
    /// Render nothing: compare motion and score only
    #[arg(long)]
    no_render: bool,
    /// Light transfer for the cars, as given to the run
    #[arg(long, value_name = "FILE")]
    light: Option<PathBuf>,
    /// Write the images to this folder
    #[arg(long, value_name = "DIR", conflicts_with = "no_render")]
    images: Option<PathBuf>,
    #[command(flatten)]
    background: BackgroundArguments,
    #[command(flatten)]
    device: DeviceArguments,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let episode = read_episode_log(&arguments.log)?;
    let base = arguments
        .base
        .as_deref()
        .or(arguments.log.parent())
        .unwrap_or(Path::new(""));
    let working = progress::spinner(format!("replaying {}", arguments.log.display()));
    let (replayed, device) = match (drawn_by(&episode), arguments.no_render) {
        (Some(drawn_by), false) => drawn(arguments, &episode, drawn_by, base)?,
        _ => {
            let site = Arc::new(Site::open(&episode.head.scenario.place, base, None)?);
            let replayed = match episode.others.as_slice() {
                [] => replay(&episode, &site, None, &mut ())?,
                _ => replay_egos(&episode, &site, None, &mut ())?,
            };
            (replayed, None)
        }
    };
    working.finish_and_clear();
    report(&episode, &replayed, device.as_deref())
}

/// Drawn as the log was: its cameras, their size, its rendering interval.
fn drawn(
    arguments: &Arguments,
    episode: &Episode,
    drawn_by: &DrawnBy,
    base: &Path,
) -> Result<(Replayed, Option<String>)> {
    let gpu = arguments.device.open()?;
    let scenario = &episode.head.scenario;
    let appearance = Appearance {
        transfer: transfer_in(arguments.light.as_deref())?,
        only_cars: scenario.has_only_cars(),
    };
    let sites = Sites::new(std::slice::from_ref(&gpu), arguments.background, appearance);
    let ready = sites.get(&scenario.place, base)?;
    let (session, scene) = (&sites.sessions()[0], &sites.scene(&ready, 0)?);
    let site = &ready.site;
    if !episode.others.is_empty() {
        let rigs = episode.egos().map(|ego| rig_of(site, ego, drawn_by));
        let rigs: Vec<Rig> = rigs.collect::<Result<_>>()?;
        let batch = session.batch_renderer();
        let mut renderer = EgosRenderer::new(batch, scene, rigs, drawn_by.every);
        let mut keeper = EgosKeeper::new(arguments, episode);
        let replayed = replay_egos(episode, site, Some(&mut renderer), &mut keeper)?;
        check_validation(&gpu)?;
        keeper.error.map_or(Ok(()), Err)?;
        return Ok((replayed, Some(gpu.info().to_string())));
    }
    let rig = rig_of(site, episode, drawn_by)?;
    let mut renderer =
        ObservationRenderer::new(session.batch_renderer(), scene, rig, drawn_by.every);
    let mut keeper = ImageKeeper {
        image_writer: ImageWriter::new(
            arguments.images.clone().unwrap_or_default(),
            keeps(arguments),
        ),
        error: None,
    };
    let replayed = replay(episode, site, Some(&mut renderer), &mut keeper)?;
    check_validation(&gpu)?;
    keeper.error.map_or(Ok(()), Err)?;
    Ok((replayed, renderer.drawn_by().map(|by| by.device)))
}

/// Renderer of the first ego whose sensors were drawn.
fn drawn_by(episode: &Episode) -> Option<&DrawnBy> {
    episode.egos().find_map(|ego| ego.head.drawn_by.as_ref())
}

/// Images that are kept.
fn keeps(arguments: &Arguments) -> Images {
    match arguments.images {
        Some(_) => Images::All,
        None => Images::None,
    }
}

/// Sensors with which the log of an ego was drawn.
fn rig_of(site: &Site, episode: &Episode, drawn_by: &DrawnBy) -> Result<Rig> {
    let mut cameras = Vec::new();
    for name in &episode.head.planner.cameras {
        let mut camera = camera_named(&site.loaded.rig, name)?.clone();
        camera.intrinsics = drawn_by.intrinsics(&camera.intrinsics);
        cameras.push(camera);
    }
    let lidars = chosen_lidars(&site.loaded.rig, false, &episode.head.planner.lidars)?;
    let mut rig = Rig::from_iter(cameras);
    rig.sensors.extend(lidars.into_iter().map(Sensor::Lidar));
    Ok(rig)
}

/// Keeps the images of several egos, each in a folder of its name.
struct EgosKeeper {
    writers: Vec<ImageWriter>,
    error: Option<anyhow::Error>,
}

impl EgosKeeper {
    fn new(arguments: &Arguments, episode: &Episode) -> Self {
        let keeps = keeps(arguments);
        let root = arguments.images.clone().unwrap_or_default();
        let names = episode.egos().map(|ego| &ego.head.scenario.egos.own.name);
        Self {
            writers: names
                .map(|name| ImageWriter::new(root.join(name), keeps))
                .collect(),
            error: None,
        }
    }
}

impl EgosObserver for EgosKeeper {
    fn step(
        &mut self,
        ego: usize,
        step: &EpisodeStep,
        readings: &[decouplegs::planner::Reading],
    ) -> Result<(), decouplegs::episode::EpisodeError> {
        if let Err(error) = self.writers[ego].add(step.step, readings) {
            self.error.get_or_insert(error);
        }
        Ok(())
    }
}

/// Keeps images and nothing else.
struct ImageKeeper {
    image_writer: ImageWriter,
    error: Option<anyhow::Error>,
}

impl EpisodeObserver for ImageKeeper {
    fn uses_readings(&self) -> bool {
        self.image_writer.keeps_images()
    }

    fn begin(
        &mut self,
        _: &EpisodeHead,
        _: &decouplegs::scene::episode::EpisodeTick,
    ) -> Result<(), decouplegs::episode::EpisodeError> {
        Ok(())
    }

    fn step(
        &mut self,
        step: &EpisodeStep,
        readings: &[decouplegs::planner::Reading],
    ) -> Result<(), decouplegs::episode::EpisodeError> {
        if let Err(error) = self.image_writer.add(step.step, readings) {
            self.error.get_or_insert(error);
        }
        Ok(())
    }
}

fn report(episode: &Episode, replayed: &Replayed, device: Option<&str>) -> Result<()> {
    if let Some(difference) = &replayed.moved_differently {
        bail!("the replay is another episode: {difference}");
    }
    for (before, after) in episode.egos().zip(replayed.episode.egos()) {
        let (before, after) = (EpisodeScore::new(before), EpisodeScore::new(after));
        ensure!(
            before == after,
            "the same motion was scored differently: {before:?} in the log, {after:?} now"
        );
    }
    let steps = episode.egos().map(|ego| ego.steps.len()).max();
    let steps = steps.unwrap_or(0);
    print(&format!(
        "{steps} steps: all vehicles move as in the log, to the last bit; the score is the same\n"
    ))?;
    let Some(device) = device else { return Ok(()) };
    let logged_on = drawn_by(episode).map_or("", |by| by.device.as_str());
    let Replayed {
        readings,
        readings_different,
        ..
    } = replayed;
    // Sweeps of LiDARs are readings too.
    let has_lidars = |ego: &Episode| !ego.head.planner.lidars.is_empty();
    let what = match episode.egos().any(has_lidars) {
        false => "images",
        true => "images and sweeps",
    };
    if *readings_different == 0 {
        return print(&format!("{readings} {what}: the same, to the last bit\n"));
    }
    if logged_on == device {
        bail!(
            "{readings_different} of {readings} {what} are not those of the log, on the same device: {device}"
        );
    }
    print(&format!(
        "{readings_different} of {readings} {what} have other bits: they were drawn on {logged_on}, now on {device}, and devices round \
         differently\n"
    ))
}
