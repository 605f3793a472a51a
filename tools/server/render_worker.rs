//! A thread that draws: it owns a device and the scenes on it. Where the device is lost or full,
//! and there are others, its requests go to them.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasher, RandomState};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender};
use std::time::Instant;

use anyhow::{Result, ensure};
use decouplegs::asset::LoadedScene;
use decouplegs::gpu::{Gpu, GpuError};
use decouplegs::render::RenderOptions;
use decouplegs::scene::release;
use decouplegs::session::{Session, SessionError, SessionOptions};
use tokio::sync::oneshot;
use tonic::Status;

use crate::cache::Cache;
use crate::devices::{Asked, Devices, Job, Message, ToRead, caught};
use crate::fair_queue::FairQueue;
use crate::image_memory::ImageMemory;
use crate::log_limit::LogLimit;
use crate::names::no_scene;
use crate::options::Limits;
use crate::request_renderer::{Drawn, RequestRenderer, is_lost, status_of};

/// Unknown objects that are warned of, once each. Only hashes of their names are kept.
const WARNED_MAX: usize = 1000;

/// Devices that one request may lose.
const LOST_MAX: usize = 2;

/// Reason why a request was not drawn.
struct Failed {
    status: Status,
    /// Fault of the device, which another one need not have.
    fault: Option<Fault>,
}

/// Fault of a device that another one need not have.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Fault {
    Lost,
    Full,
}

impl From<Status> for Failed {
    fn from(status: Status) -> Self {
        Self {
            status,
            fault: None,
        }
    }
}

impl From<&SessionError> for Failed {
    fn from(error: &SessionError) -> Self {
        let is_full = || error.gpu().is_some_and(GpuError::is_full);
        let fault = match is_lost(error) {
            true => Some(Fault::Lost),
            false => is_full().then_some(Fault::Full),
        };
        Self {
            status: status_of(error),
            fault,
        }
    }
}

/// State of the render thread.
pub struct RenderWorker {
    /// Position of the device.
    position: usize,
    /// True if the device was lost.
    is_out: bool,
    session: Session,
    scenes: Cache<RequestRenderer>,
    /// Jobs for scenes that are there, by connection.
    queue: FairQueue<Asked>,
    /// Jobs for scenes that are being read.
    waiting: HashMap<String, Vec<Asked>>,
    loads: Sender<ToRead>,
    memory: Arc<ImageMemory>,
    /// Hashes of scenes and objects.
    warned: HashSet<u64>,
    hashes: RandomState,
    /// Limit on lines about scenes and frames that failed: a client can repeat the request.
    failures: LogLimit,
    devices: Arc<Devices>,
}

impl RenderWorker {
    /// Work on `gpu`, the device at `position`, with nothing on it yet.
    pub fn new(
        position: usize,
        gpu: &Gpu,
        render: RenderOptions,
        limits: &Limits,
        loads: Sender<ToRead>,
        devices: Arc<Devices>,
    ) -> Self {
        let options = SessionOptions {
            render,
            ..SessionOptions::default()
        };
        Self {
            position,
            is_out: false,
            session: Session::on(gpu, &options),
            scenes: Cache::new(limits.cache_size as usize, limits.cache_bytes),
            queue: FairQueue::default(),
            waiting: HashMap::new(),
            loads,
            memory: Arc::default(),
            warned: HashSet::new(),
            hashes: RandomState::new(),
            failures: LogLimit::default(),
            devices,
        }
    }

    /// Draws what comes until it is told to stop.
    pub fn work(&mut self, inbox: &Receiver<Message>) {
        let mut is_ending = false;
        loop {
            // What has come is known before the next job is chosen.
            let message = match self.queue.is_empty() && !is_ending {
                true => inbox.recv().ok(),
                false => inbox.try_recv().ok(),
            };
            match message {
                Some(Message::Draw(asked)) => self.queue.push(asked.connection, asked),
                Some(Message::Loaded(id, scene)) => self.loaded(&id, scene),
                Some(Message::Preload(id)) => self.load(&id),
                Some(Message::Stop) => is_ending = true,
                None => match self.queue.pop() {
                    Some((_, asked)) => self.serve(asked),
                    None => return,
                },
            }
            self.say_cached();
        }
    }

    /// Works on a job, and counts the time of its connection.
    fn serve(&mut self, asked: Asked) {
        let (connection, since) = (asked.connection, Instant::now());
        self.draw_or_wait(asked);
        self.queue.took(connection, since.elapsed());
    }

    fn say_cached(&self) {
        let (scenes, bytes) = (self.scenes.names(), self.scenes.bytes());
        self.devices.metrics.cached(self.position, scenes, bytes);
    }

    /// Fails with what the validation layers reported, if they were on (`DECOUPLEGS_VALIDATION=1`)
    /// and had something to say.
    pub fn check_validation(&self) -> Result<()> {
        let messages = self.session.gpu().take_validation_messages();
        ensure!(
            messages.is_empty(),
            "the Vulkan validation layers reported {} faults, the first: {}",
            messages.len(),
            messages[0]
        );
        Ok(())
    }

    fn draw_or_wait(&mut self, asked: Asked) {
        let id = asked.job.scene();
        let status = if self.devices.is_refusing() {
            Status::unavailable("the server is ending: ask another")
        } else if self.devices.registry.path(&id).is_none() {
            no_scene(&id)
        } else if self.is_out {
            let lost = Status::unavailable("the device was lost that draws the scene: ask again");
            return self.pass_on(asked, lost);
        } else if self.scenes.get(&id).is_some() {
            return self.draw(&id, asked);
        } else {
            self.load(&id);
            return self.waiting.entry(id).or_default().push(asked);
        };
        self.refuse(asked.job, status);
    }

    /// Has `id` read, unless it is there or on its way.
    fn load(&mut self, id: &str) {
        let Some(path) = self.devices.registry.path(id).filter(|_| !self.is_out) else {
            return;
        };
        if self.scenes.get(id).is_none() && !self.waiting.contains_key(id) {
            self.waiting.insert(id.to_owned(), Vec::new());
            // The reader lives as long as this sender.
            let _ = self.loads.send(ToRead {
                scene: id.to_owned(),
                path: path.to_owned(),
                reader: self.devices.inbox(self.position),
            });
        }
    }

    fn loaded(&mut self, id: &str, scene: Result<Box<LoadedScene>, Status>) {
        // None of a device that was lost: they went to others.
        let waiting = self.waiting.remove(id).unwrap_or_default();
        if self.is_out {
            return;
        }
        let staged = scene.map_err(Failed::from).and_then(|scene| {
            let staged = caught("preparing the scene", || self.request_renderer(id, &scene));
            release(scene);
            staged.map_err(Failed::from).flatten()
        });
        if let Err(failed) = staged {
            if let Some(suppressed) = self.failures.admit() {
                tracing::error!(
                    scene = id,
                    reason = failed.status.message(),
                    suppressed,
                    "a scene cannot be served"
                );
            }
            self.devices.placement.left(self.position, id);
            if failed.fault == Some(Fault::Lost) {
                self.leave();
            }
            for asked in waiting {
                self.fail(asked, &failed);
            }
            return;
        }
        // The first of each connection at once: before the scene has to leave for another one.
        let mut served = HashSet::new();
        for asked in waiting {
            match served.insert(asked.connection) {
                true => self.serve(asked),
                false => self.queue.push(asked.connection, asked),
            }
        }
    }

    /// Answers a request that was not drawn, or passes it on where the fault is one of the device.
    fn fail(&mut self, mut asked: Asked, failed: &Failed) {
        match failed.fault {
            Some(Fault::Lost) => {
                self.leave();
                asked.lost += 1;
                // It may be what devices are lost by.
                if asked.lost >= LOST_MAX {
                    return self.refuse(asked.job, failed.status.clone());
                }
            }
            Some(Fault::Full) => asked.refused.push(self.position),
            None => return self.refuse(asked.job, failed.status.clone()),
        }
        // None of its own device, which is out or was just added to those that refused it.
        self.pass_on(asked, failed.status.clone());
    }

    /// Passes a request on to another device; answers with `status` if there is none.
    fn pass_on(&mut self, asked: Asked, status: Status) {
        if let Err(asked) = self.devices.send(asked) {
            self.refuse(asked.job, status);
        }
    }

    /// Gives up the device, which was lost: its scenes and requests go to others.
    fn leave(&mut self) {
        if self.is_out {
            return;
        }
        self.is_out = true;
        self.devices.take_out(self.position);
        let gone = self.scenes.clear();
        if self.devices.are_several() {
            tracing::error!(
                device = self.position,
                name = %self.session.gpu().info(),
                scenes = ?gone,
                "a device is lost, and draws no more: others draw its scenes"
            );
        }
        let waiting: Vec<Asked> = self.waiting.drain().flat_map(|(_, asked)| asked).collect();
        for asked in waiting {
            self.draw_or_wait(asked);
        }
    }

    /// Puts `scene` on the device, in the place of others if need be.
    fn request_renderer(&mut self, id: &str, scene: &LoadedScene) -> Result<(), Failed> {
        let most = self.scenes.bytes_max();
        let estimate = scene.splat_scene.splats.len() as u64
            * bytes_a_splat(scene.splat_scene.splats.sh_degree);
        while let Some((other, _)) = self.scenes.make_room(estimate.min(most)) {
            self.say_left(&other);
        }
        let (before, since) = (self.session.gpu().memory().total_bytes, Instant::now());
        let request_renderer =
            RequestRenderer::new(&self.session, scene).map_err(|error| Failed::from(&error))?;
        let bytes = self
            .session
            .gpu()
            .memory()
            .total_bytes
            .saturating_sub(before);
        if bytes > most {
            let reason = format!(
                "scene {id:?} takes {bytes} bytes of the device; the cache has {most} (--cache-bytes)"
            );
            return Err(Status::resource_exhausted(reason).into());
        }
        let (splats, agents, seconds) = (
            scene.splat_scene.splats.len(),
            scene.agents.len(),
            since.elapsed().as_secs_f64(),
        );
        tracing::info!(
            scene = id,
            splats,
            agents,
            bytes,
            seconds,
            "a scene is on the device"
        );
        self.scenes.insert(id.to_owned(), request_renderer, bytes);
        self.resize(id, bytes);
        Ok(())
    }

    fn draw(&mut self, id: &str, asked: Asked) {
        if asked.job.is_closed() {
            return self.devices.metrics.queued(-1);
        }
        let Asked {
            connection,
            job,
            refused,
            lost,
            load,
        } = asked;
        let (job, failed) = match job {
            Job::Images { views, answer } => {
                let mut images = self.memory.take();
                let count = views.iter().map(Vec::len).sum();
                let drawn = self.on_scene(id, count, |scene| {
                    let drawn = scene.draw(&views, &mut images.bytes)?;
                    Ok(((), drawn))
                });
                match drawn {
                    Ok(()) => return self.answer(answer, Ok(images)),
                    Err(failed) => (Job::Images { views, answer }, failed),
                }
            }
            Job::Sweep { request, answer } => {
                match self.on_scene(id, 0, |scene| scene.sweep(&request)) {
                    Ok(sweep) => return self.answer(answer, Ok(sweep)),
                    Err(failed) => (Job::Sweep { request, answer }, failed),
                }
            }
        };
        let asked = Asked {
            connection,
            job,
            refused,
            lost,
            load,
        };
        self.fail(asked, &failed);
    }

    /// Result of `work` on the scene `id`, which draws `images` images.
    fn on_scene<T>(
        &mut self,
        id: &str,
        images: usize,
        work: impl FnOnce(&mut RequestRenderer) -> Result<(T, Drawn), SessionError>,
    ) -> Result<T, Failed> {
        let (before, held) = (
            self.session.gpu().memory().total_bytes,
            self.scenes.bytes_of(id),
        );
        let Some(request_renderer) = self.scenes.get(id) else {
            let left = format!("scene {id:?} left the cache: ask again");
            return Err(Status::unavailable(left).into());
        };
        let since = Instant::now();
        match caught("drawing", || work(request_renderer)) {
            Ok(Ok((done, drawn))) => {
                tracing::debug!(
                    scene = id,
                    images,
                    seconds = since.elapsed().as_secs_f64(),
                    "a frame was drawn"
                );
                let unknown = drawn.unknown.len();
                self.devices.metrics.drew(self.position, images, unknown);
                self.warn_of(id, drawn.unknown);
                let grown =
                    i128::from(self.session.gpu().memory().total_bytes) - i128::from(before);
                self.resize(
                    id,
                    u64::try_from((i128::from(held) + grown).max(0)).unwrap_or(u64::MAX),
                );
                Ok(done)
            }
            // What the panic left of the scene is not drawn again.
            Err(status) => {
                self.scenes.remove(id);
                self.devices.placement.left(self.position, id);
                if let Some(suppressed) = self.failures.admit() {
                    tracing::error!(
                        scene = id,
                        reason = status.message(),
                        suppressed,
                        "a frame was not drawn"
                    );
                }
                Err(status.into())
            }
            Ok(Err(error)) => {
                if let Some(suppressed) = self.failures.admit() {
                    tracing::error!(scene = id, %error, suppressed, "a frame was not drawn");
                }
                Err(Failed::from(&error))
            }
        }
    }

    fn resize(&mut self, id: &str, bytes: u64) {
        for (other, _) in self.scenes.resize(id, bytes) {
            self.say_left(&other);
        }
        self.devices.placement.holds(self.position, id, bytes);
    }

    fn say_left(&self, id: &str) {
        tracing::info!(scene = id, "a scene leaves the cache");
        self.devices.placement.left(self.position, id);
    }

    fn warn_of(&mut self, id: &str, unknown: Vec<String>) {
        for track in unknown {
            if self.warned.len() < WARNED_MAX
                && self.warned.insert(self.hashes.hash_one((id, &track)))
            {
                tracing::warn!(
                    scene = id,
                    track,
                    "an object that the scene does not have is not drawn"
                );
                if self.warned.len() == WARNED_MAX {
                    tracing::warn!(
                        "further unknown objects are not reported: see decouplegs_unknown_objects_total"
                    );
                }
            }
        }
    }

    fn refuse(&self, job: Job, status: Status) {
        match job {
            Job::Images { answer, .. } => self.answer(answer, Err(status)),
            Job::Sweep { answer, .. } => self.answer(answer, Err(status)),
        }
    }

    fn answer<T>(&self, answer: oneshot::Sender<Result<T, Status>>, result: Result<T, Status>) {
        self.devices.metrics.queued(-1);
        // A client may read the metrics as soon as it has the answer.
        self.say_cached();
        // The client may have gone.
        let _ = answer.send(result);
    }
}

/// About what a splat of a background takes on the device.
fn bytes_a_splat(sh_degree: u8) -> u64 {
    let coefficients = (u64::from(sh_degree) + 1).pow(2);
    48 + 6 * coefficients
}
