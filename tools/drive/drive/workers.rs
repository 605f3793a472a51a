//! The workers of a run, which take episodes from one queue: some on each device.

use std::fs;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, ensure};
use decouplegs::asset::{AssetError, UnfinishedFolder};
use decouplegs::episode::{
    self, Driven, EgosRenderer, ObservationRenderer, chosen, chosen_lidars, drive_among,
};
use decouplegs::logs::read_episode_log;
use decouplegs::planner::agents::AgentDriver;
use decouplegs::planner::{Cameras, Planner};
use decouplegs::scene::Sensor;
use decouplegs::scene::episode::Episode;
use decouplegs::scene::scenario::Place;
use decouplegs_cli::video;
use indicatif::ProgressBar;

use super::Arguments;
use super::egos::{EgosDrive, Pool, has_several};
use super::episode_queue::EpisodeQueue;
use super::folder::RunFolder;
use super::image_writer::{EpisodeImages, ImageWriter};
use super::jobs::Job;
use super::overlays::Overlays;
use super::run_devices::{RunDevices, is_device_fault};
use crate::arguments::warn;
use crate::episode_report::Scored;
use crate::progress;
use crate::seen::SeenWatch;
use crate::sites::Sites;

/// State shared by workers.
pub struct Run<'a> {
    arguments: &'a Arguments,
    folder: &'a RunFolder,
    sites: &'a Sites,
    devices: &'a RunDevices,
    jobs: &'a [Job],
    queue: EpisodeQueue,
    scored: Mutex<Vec<Scored>>,
    /// The last fault of a device.
    fault: Mutex<Option<anyhow::Error>>,
    bar: ProgressBar,
}

impl<'a> Run<'a> {
    /// A run of `jobs`, with nothing driven yet.
    pub fn new(
        arguments: &'a Arguments,
        folder: &'a RunFolder,
        sites: &'a Sites,
        devices: &'a RunDevices,
        jobs: &'a [Job],
    ) -> Self {
        Self {
            arguments,
            folder,
            sites,
            devices,
            jobs,
            queue: EpisodeQueue::new(jobs.len()),
            scored: Mutex::new(Vec::with_capacity(jobs.len())),
            fault: Mutex::default(),
            bar: progress::bar("episodes", jobs.len()),
        }
    }

    /// Every episode, those that were finished before as they are. Their order is that in which
    /// workers ended.
    pub fn all(self) -> Result<Vec<Scored>> {
        let devices = self.devices.gpus().len();
        // Without a device nothing is drawn.
        let positions: Vec<Option<usize>> = match devices {
            0 => vec![None],
            _ => (0..devices).map(Some).collect(),
        };
        let workers = (0..self.arguments.workers).flat_map(|_| positions.iter().copied());
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let run = &self;
            let workers: Vec<_> = workers
                .map(|position| scope.spawn(move || run.work(position)))
                .collect();
            scope.spawn(|| self.prepare_places(&done));
            let mut ends = workers.into_iter();
            let end = ends.try_for_each(|worker| worker.join().expect("a worker does not panic"));
            done.store(true, Ordering::Relaxed);
            end
        })?;
        self.bar.finish_and_clear();
        if let Some(fault) = unlocked(self.fault).filter(|_| self.queue.waiting() > 0) {
            let (left, all) = (self.queue.waiting(), self.jobs.len());
            return Err(fault.context(format!(
                "no device is left that draws: {} of {all} episodes are in {}, and the same command drives the other {left}",
                all - left,
                self.arguments.out.display()
            )));
        }
        Ok(unlocked(self.scored))
    }

    /// Drives episodes on the device at `position` until none is left, or the device cannot go on.
    fn work(&self, position: Option<usize>) -> Result<()> {
        let mut worker = Worker {
            run: self,
            position,
            planner: None,
            agents: None,
            renderer: None,
            pool: Pool::default(),
        };
        let is_out = || position.is_some_and(|position| self.devices.is_out(position));
        while !is_out()
            && let Some(index) = self.queue.take()
        {
            if is_out() {
                // Another worker of the device met the fault while this one waited.
                self.queue.put_back(index);
                break;
            }
            let job = &self.jobs[index];
            let name = &job.scenario.name;
            let not_driven = || format!("episode {name} was not driven");
            match (worker.job(job), position) {
                (Ok(done), _) => {
                    locked(&self.scored).extend(done);
                    self.queue.finish();
                }
                (Err(error), Some(position)) if is_device_fault(&error) => {
                    let noted = self.devices.take_out(position, name, &error);
                    *locked(&self.fault) = Some(error.context(not_driven()));
                    // The line of the fault comes before that of the worker who drives it.
                    self.queue.put_back(index);
                    return noted.inspect_err(|_| self.queue.stop());
                }
                (Err(error), _) => {
                    self.queue.stop();
                    return Err(error.context(not_driven()));
                }
            }
            self.bar.inc(1);
        }
        Ok(())
    }
}

fn locked<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex
        .lock()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

fn unlocked<T>(mutex: Mutex<T>) -> T {
    mutex
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// Time between looks at how far the workers are.
const PREPARE_EVERY: Duration = Duration::from_millis(20);

impl Run<'_> {
    /// Makes the places of the jobs, each when the first episode at the place before it has begun:
    /// one place ahead of the workers, who would wait for it otherwise. Ends when `done` is set.
    fn prepare_places(&self, done: &AtomicBool) {
        let is_driven = |job: &Job| !self.folder.log(&job.scenario.name).exists();
        let mut places: Vec<(usize, &Job)> = Vec::new();
        for (index, job) in self
            .jobs
            .iter()
            .enumerate()
            .filter(|(_, job)| is_driven(job))
        {
            let same = |(_, other): &(usize, &Job)| {
                other.scenario.place == job.scenario.place && other.directory == job.directory
            };
            if !places.iter().any(same) {
                places.push((index, job));
            }
        }
        for pair in places.windows(2) {
            let ((before, _), (_, job)) = (pair[0], pair[1]);
            while self.queue.begun() <= before {
                if done.load(Ordering::Relaxed) {
                    return;
                }
                std::thread::sleep(PREPARE_EVERY);
            }
            if done.load(Ordering::Relaxed) {
                return;
            }
            // A place that cannot be had is the fault of its episodes, which ask for it again.
            let Ok(ready) = self.sites.get(&job.scenario.place, &job.directory) else {
                continue;
            };
            for position in 0..self.devices.gpus().len() {
                if !self.devices.is_out(position) {
                    let _ = self.sites.scene(&ready, position);
                }
            }
        }
    }
}

/// One of the threads that drive.
struct Worker<'a> {
    run: &'a Run<'a>,
    /// The device's position; none where nothing is drawn.
    position: Option<usize>,
    planner: Option<Box<dyn Planner>>,
    /// Program that drives agents, where one is named.
    agents: Option<Box<dyn AgentDriver>>,
    renderer: Option<ObservationRenderer>,
    /// Planners of episodes with several egos.
    pool: Pool,
}

impl Worker<'_> {
    /// The episode of `job`, for each of its egos.
    fn job(&mut self, job: &Job) -> Result<Vec<Scored>> {
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
                    return Scored::egos(episode, &path, &self.run.folder.images(name), None);
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
        let driven = match has_several(&job.scenario) {
            true => self.drive_egos(job)?,
            false => self.drive(job)?,
        };
        let images = self.run.folder.images(name);
        if self.run.arguments.video {
            for ego in driven.episode.egos() {
                let folder = match driven.episode.others.as_slice() {
                    [] => images.clone(),
                    _ => images.join(&ego.head.scenario.egos.own.name),
                };
                self.videos(ego, &folder, job)?;
            }
        }
        Scored::egos(driven.episode, &path, &images, Some(&driven.times))
    }

    /// Drives an episode of several egos.
    fn drive_egos(&mut self, job: &Job) -> Result<Driven> {
        let run = self.run;
        let ready = run.sites.get(&job.scenario.place, &job.directory)?;
        if self.agents.is_none() {
            self.agents = run.arguments.agents()?;
        }
        let agents = self.agents.as_deref_mut();
        let agents = agents.map(|agents| agents as &mut dyn AgentDriver);
        let name = &job.scenario.name;
        let scene = self.position.map(|position| {
            let scene = run.sites.scene(&ready, position)?;
            anyhow::Ok((&run.sites.sessions()[position], scene))
        });
        let every = run.arguments.render.0;
        let renderer = scene.transpose()?.map(|(session, scene)| {
            move |rigs| EgosRenderer::new(session.batch_renderer(), &scene, rigs, every)
        });
        let drive = EgosDrive {
            arguments: run.arguments,
            site: &ready.site,
            log: run.folder.log(name),
            images: run.folder.images(name),
        };
        run.devices.begin();
        let since = Instant::now();
        let driven = drive.drive(&job.scenario, &mut self.pool, agents, renderer)?;
        if let Some(position) = self.position {
            run.devices.drove(position, name, since.elapsed())?;
        }
        Ok(driven)
    }

    fn drive(&mut self, job: &Job) -> Result<Driven> {
        let run = self.run;
        let ready = run.sites.get(&job.scenario.place, &job.directory)?;
        let planner = match &mut self.planner {
            Some(planner) => planner,
            none => none.insert(run.arguments.planner()?),
        };
        if self.agents.is_none() {
            self.agents = run.arguments.agents()?;
        }
        let agents = self.agents.as_deref_mut();
        // Drivers of agents live as long as their worker.
        let agents = agents.map(|agents| agents as &mut dyn AgentDriver);
        let name = &job.scenario.name;
        let image_writer = ImageWriter::new(run.folder.images(name), run.arguments.keeps());
        let log = run.folder.log(name);
        // Synthetic places look right from everywhere.
        let is_captured = matches!(job.scenario.place, Place::Scene { .. });
        let seen = is_captured.then(|| SeenWatch::new(ready.site.view_support().cloned(), &log));
        let mut images = EpisodeImages::new(log, image_writer, seen);
        let drawn_on = self.position.map(|position| {
            let scene = run.sites.scene(&ready, position)?;
            anyhow::Ok((position, scene))
        });
        let drawn_on = drawn_on.transpose()?;
        run.devices.begin();
        let since = Instant::now();
        let driven = match &drawn_on {
            Some((position, scene)) => {
                let session = &run.sites.sessions()[*position];
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
                let driven = drive_among(
                    &job.scenario,
                    &ready.site,
                    Some(&mut renderer),
                    (planner.as_mut(), agents),
                    &mut images,
                )?;
                self.renderer = Some(renderer);
                run.devices
                    .drove(*position, &job.scenario.name, since.elapsed())?;
                driven
            }
            None => drive_among(
                &job.scenario,
                &ready.site,
                None,
                (planner.as_mut(), agents),
                &mut images,
            )?,
        };
        images.image_error.map_or(Ok(driven), Err)
    }

    /// Films of the cameras of an ego, whose images are in `folder`.
    fn videos(&self, episode: &Episode, folder: &Path, job: &Job) -> Result<()> {
        let arguments = &self.run.arguments;
        let per_second = 1.0 / (f64::from(arguments.render.0) * episode.head.scenario.step_s);
        let cameras = &episode.head.planner.cameras;
        let encode = |frames: &Path, camera: &str| {
            let video = folder.join(format!("{camera}.mp4"));
            video::encode(frames, camera, per_second, &video)
        };
        let Some(position) = self.position.filter(|_| arguments.overlays) else {
            return cameras.iter().try_for_each(|camera| encode(folder, camera));
        };
        let ready = self.run.sites.get(&job.scenario.place, &job.directory)?;
        let scene = self.run.sites.scene(&ready, position)?;
        let overlays = Overlays::new(episode, &ready.site, &scene)?;
        for camera in cameras {
            let frames = UnfinishedFolder::begin(&folder.join(format!("{camera}.overlays")))?;
            overlays.draw_all(folder, camera, frames.path())?;
            encode(frames.path(), camera)?;
        }
        Ok(())
    }
}
