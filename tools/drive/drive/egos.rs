//! Episodes of several egos: a planner for each, one log, and a folder of images for each.

use std::collections::HashMap;
use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Result, bail, ensure};
use decouplegs::episode::{
    Driven, EgosObserver, EgosRenderer, EpisodeError, Site, cameras_of, chosen, chosen_lidars,
    drive_egos,
};
use decouplegs::logs::EpisodeLog;
use decouplegs::planner::agents::AgentDriver;
use decouplegs::planner::{Cameras, Planner, Reading};
use decouplegs::scene::episode::{Episode, EpisodeEnd, EpisodeStep};
use decouplegs::scene::{EgoIdentity, Rig, Scenario, Sensor};
use decouplegs_alpasim::egodriver::SensorLens;
use decouplegs_alpasim::planner_name::PlannerName;

use super::Arguments;
use super::image_writer::ImageWriter;
use super::jobs::Job;

/// Planner of an ego, by the name of the ego.
#[derive(Clone, Debug)]
pub struct EgoPlanner {
    pub ego: String,
    pub planner: PlannerName,
}

impl FromStr for EgoPlanner {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (ego, planner) = text
            .split_once('=')
            .ok_or_else(|| format!("expected EGO=PLANNER, found {text:?}"))?;
        Ok(Self {
            ego: ego.to_owned(),
            planner: planner.parse()?,
        })
    }
}

/// True if the egos of `scenario` are driven by more than the planner of the run.
pub fn has_several(scenario: &Scenario) -> bool {
    !scenario.egos.others.is_empty() || scenario.egos.own.planner.is_some()
}

/// Checks that every ego that `arguments` name is in one of `jobs`, and that several egos can be
/// driven as they say.
pub fn check(arguments: &Arguments, jobs: &[Job]) -> Result<()> {
    let several = jobs.iter().find(|job| has_several(&job.scenario));
    if let Some(job) = several {
        let name = &job.scenario.name;
        ensure!(
            !arguments.overlays,
            "--overlays draws into the videos of one ego, and {name} has its own planners or several egos: leave it out"
        );
        ensure!(
            arguments.driver.driver_lens == SensorLens::Own,
            "--driver-lens f-theta draws for one ego, and {name} has its own planners or several egos: leave it out"
        );
    }
    let names = || {
        jobs.iter().flat_map(|job| {
            let egos = 0..job.scenario.egos.count();
            egos.map(|ego| job.scenario.ego_identity(ego).name.as_str())
        })
    };
    for EgoPlanner { ego, .. } in &arguments.ego_planner {
        if !names().any(|name| name == ego) {
            let mut there: Vec<&str> = names().collect();
            there.sort_unstable();
            there.dedup();
            bail!(
                "--ego-planner {ego}=...: no scenario has an ego of this name; there are {}",
                there.join(", ")
            );
        }
    }
    Ok(())
}

/// Name of the planner of an ego: that of the command line, else that of the scenario, else that of
/// the run.
fn name_for(arguments: &Arguments, identity: &EgoIdentity) -> Result<PlannerName> {
    let mut named = arguments.ego_planner.iter();
    let named = named.rfind(|named| named.ego == identity.name);
    match (named, &identity.planner) {
        (Some(named), _) => Ok(named.planner.clone()),
        (None, Some(name)) => name.parse().map_err(anyhow::Error::msg),
        (None, None) => Ok(arguments.planner.clone()),
    }
}

/// Planners that a worker has opened and that drive no episode now, by their names.
#[derive(Default)]
pub struct Pool(HashMap<String, Vec<Box<dyn Planner>>>);

impl Pool {
    /// A planner for each ego of `scenario`, with its name.
    fn take(
        &mut self,
        arguments: &Arguments,
        scenario: &Scenario,
    ) -> Result<Vec<(String, Box<dyn Planner>)>> {
        let egos = 0..scenario.egos.count();
        egos.map(|ego| {
            let name = name_for(arguments, scenario.ego_identity(ego))?;
            let waiting = self.0.get_mut(&name.to_string()).and_then(Vec::pop);
            let planner = match waiting {
                Some(planner) => planner,
                None => name.open(arguments.timeouts(), &arguments.driver)?,
            };
            Ok((name.to_string(), planner))
        })
        .collect()
    }

    fn put_back(&mut self, planners: Vec<(String, Box<dyn Planner>)>) {
        for (name, planner) in planners {
            self.0.entry(name).or_default().push(planner);
        }
    }
}

/// Sensors of the rig of the place that `planner` gets.
fn rig_for(arguments: &Arguments, all: &Rig, planner: &dyn Planner) -> Result<Rig> {
    let at_least = match arguments.all_cameras {
        true => Cameras::All,
        false => Cameras::Front,
    };
    let size_px = [arguments.size.width_px, arguments.size.height_px];
    let mut rig = chosen(all, &cameras_of(planner, at_least), Some(size_px))?;
    let lidars = chosen_lidars(all, planner.sees().lidars, &arguments.lidar)?;
    ensure!(
        !(planner.sees().lidars && lidars.is_empty()),
        "the planner {} wants sweeps, and the scene has no LiDARs: add a [[lidar]] to the scene file, or name a model with --lidar",
        planner.name()
    );
    rig.sensors.extend(lidars.into_iter().map(Sensor::Lidar));
    Ok(rig)
}

/// Drive of an episode of several egos.
pub struct EgosDrive<'a> {
    pub arguments: &'a Arguments,
    pub site: &'a std::sync::Arc<Site>,
    pub log: PathBuf,
    /// Folder of the images of the episode, which has a folder for each ego.
    pub images: PathBuf,
}

impl EgosDrive<'_> {
    /// Drives `scenario`. `renderer` makes one for the rigs of the egos, where something is drawn.
    pub fn drive(
        self,
        scenario: &Scenario,
        pool: &mut Pool,
        agents: Option<&mut dyn AgentDriver>,
        renderer: Option<impl FnOnce(Vec<Rig>) -> EgosRenderer>,
    ) -> Result<Driven> {
        let arguments = self.arguments;
        let mut taken = pool.take(arguments, scenario)?;
        for (name, planner) in &taken {
            let sees = planner.sees();
            ensure!(
                renderer.is_some() || sees.cameras == Cameras::None && !sees.lidars,
                "{name} drives by what it sees, and --render off draws nothing"
            );
        }
        let all = &self.site.loaded.rig;
        let rigs = taken
            .iter()
            .map(|(_, planner)| rig_for(arguments, all, &**planner));
        let mut renderer = match renderer {
            Some(renderer) => Some(renderer(rigs.collect::<Result<_>>()?)),
            None => None,
        };
        let writer = |ego: usize| {
            let folder = self.images.join(&scenario.ego_identity(ego).name);
            ImageWriter::new(folder, arguments.keeps())
        };
        let mut kept = EgosImages {
            path: self.log,
            log: None,
            writers: (0..scenario.egos.count()).map(writer).collect(),
            image_error: None,
        };
        let planners = taken.iter_mut();
        let planners = planners.map(|(_, planner)| &mut **planner as &mut dyn Planner);
        let mut planners: Vec<&mut dyn Planner> = planners.collect();
        let drivers = (planners.as_mut_slice(), agents);
        let driven = drive_egos(scenario, self.site, renderer.as_mut(), drivers, &mut kept)?;
        kept.close()?;
        pool.put_back(taken);
        Ok(driven)
    }
}

/// Keeps what happens: one log, and the images of each ego.
struct EgosImages {
    path: PathBuf,
    log: Option<EpisodeLog>,
    writers: Vec<ImageWriter>,
    /// Error of writing an image. The log has priority, so it is reported after the episode.
    image_error: Option<anyhow::Error>,
}

impl EgosImages {
    /// Finishes the log, and tells of an image that could not be written.
    fn close(mut self) -> Result<()> {
        if let Some(log) = self.log.take() {
            log.close()?;
        }
        self.image_error.map_or(Ok(()), Err)
    }
}

impl EgosObserver for EgosImages {
    fn begin(&mut self, episode: &Episode) -> Result<(), EpisodeError> {
        self.log = Some(EpisodeLog::create_for(&self.path, episode)?);
        Ok(())
    }

    fn step(
        &mut self,
        ego: usize,
        step: &EpisodeStep,
        readings: &[Reading],
    ) -> Result<(), EpisodeError> {
        if let Some(log) = &mut self.log {
            log.append_for(ego, step)?;
        }
        if let Err(error) = self.writers[ego].add(step.step, readings) {
            self.image_error.get_or_insert(error);
        }
        Ok(())
    }

    fn end(&mut self, ego: usize, end: &EpisodeEnd) -> Result<(), EpisodeError> {
        if let Err(error) = self.writers[ego].close() {
            self.image_error.get_or_insert(error);
        }
        if let Some(log) = &mut self.log {
            log.end_for(ego, end)?;
        }
        Ok(())
    }
}
