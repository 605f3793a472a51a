//! The thread that draws: it owns the device and the scenes on it. Requests come by a queue, images
//! go back one by one, and files are read on a thread beside it.

use std::collections::{HashMap, HashSet};
use std::hash::{BuildHasher, RandomState};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use anyhow::{Context, Result, ensure};
use decouplegs::asset::LoadedScene;
use decouplegs::gpu::Gpu;
use decouplegs::open_movable_scene;
use decouplegs::render::RenderOptions;
use decouplegs::scene::LidarSweep;
use decouplegs::session::{Session, SessionError, SessionOptions};
use tokio::sync::{oneshot, watch};
use tonic::Status;

use crate::cache::Cache;
use crate::image_memory::{ImageMemory, Images};
use crate::log_limit::LogLimit;
use crate::metrics::Metrics;
use crate::names::no_scene;
use crate::options::Limits;
use crate::render_request::RenderRequest;
use crate::scene_registry::SceneRegistry;
use crate::scene_renderer::{Drawn, SceneRenderer, is_lost, status_of};
use crate::sweep_request::SweepRequest;

/// Unknown objects that are warned of, once each. Only hashes of their names are kept.
const WARNED_MAX: usize = 1000;
/// Threads that read files. One may wait for a slow disk while another reads.
const READERS: usize = 2;

/// Asks for images and sweeps.
#[derive(Clone)]
pub struct RenderQueue {
    messages: Sender<Message>,
    metrics: Arc<Metrics>,
    /// Turns true when nothing will be drawn again.
    lost: watch::Receiver<bool>,
    /// True if queued requests are refused instead of rendered.
    refusing: Arc<AtomicBool>,
}

enum Message {
    Draw(Job),
    Loaded(String, Result<Box<LoadedScene>, Status>),
    Preload(Vec<String>),
    Stop,
}

/// Work for one scene.
enum Job {
    /// Requests by view: those of one view see the same objects.
    Images {
        views: Vec<Vec<RenderRequest>>,
        answer: oneshot::Sender<Result<Images, Status>>,
    },
    /// One sweep of a LiDAR.
    Sweep {
        request: Box<SweepRequest>,
        answer: oneshot::Sender<Result<LidarSweep, Status>>,
    },
}

impl Job {
    /// Id of the scene.
    fn scene(&self) -> String {
        let of_images = |views: &[Vec<RenderRequest>]| {
            let first = views.iter().flatten().next();
            first.map_or_else(String::new, |request| request.scene.clone())
        };
        match self {
            Self::Images { views, .. } => of_images(views),
            Self::Sweep { request, .. } => request.scene.clone(),
        }
    }

    /// True if the client has gone, or the deadline has passed.
    fn is_closed(&self) -> bool {
        match self {
            Self::Images { answer, .. } => answer.is_closed(),
            Self::Sweep { answer, .. } => answer.is_closed(),
        }
    }
}

impl RenderQueue {
    /// Starts the threads, which draw scenes of `registry` on `gpu` as `render` says.
    ///
    /// # Errors
    /// Returns an error if the operating system gives no threads.
    pub fn start(
        gpu: Gpu,
        render: RenderOptions,
        registry: Arc<SceneRegistry>,
        limits: &Limits,
        metrics: Arc<Metrics>,
    ) -> Result<(Self, JoinHandle<Result<()>>)> {
        let (messages, inbox) = channel();
        let (loads, to_load) = channel();
        let to_load = Arc::new(Mutex::new(to_load));
        for _ in 0..READERS {
            let (to_load, loaded) = (Arc::clone(&to_load), messages.clone());
            Builder::new()
                .name("read-scenes".into())
                .spawn(move || read_scenes(&to_load, &loaded))
                .context("no thread")?;
        }
        let (lost_sender, lost) = watch::channel(false);
        let refusing = Arc::new(AtomicBool::new(false));
        let options = SessionOptions {
            render,
            ..SessionOptions::default()
        };
        let mut worker = RenderWorker {
            session: Session::on(&gpu, &options),
            registry,
            scenes: Cache::new(limits.cache_size as usize, limits.cache_bytes),
            waiting: HashMap::new(),
            loads,
            memory: Arc::default(),
            warned: HashSet::new(),
            hashes: RandomState::new(),
            failures: LogLimit::default(),
            metrics: Arc::clone(&metrics),
            lost: lost_sender.clone(),
            refusing: Arc::clone(&refusing),
        };
        let render = move || {
            let worked = caught("drawing", || worker.work(&inbox));
            if let Err(status) = worked {
                tracing::error!(reason = status.message(), "the thread that draws ended");
                lost_sender.send_replace(true);
            }
            worker.check_validation()
        };
        let thread = Builder::new()
            .name("render".into())
            .spawn(render)
            .context("no thread")?;
        Ok((
            Self {
                messages,
                metrics,
                lost,
                refusing,
            },
            thread,
        ))
    }

    /// Images of the requests of `views`, which are all of one scene, drawn in one submission.
    /// Requests of one view see the same objects.
    ///
    /// # Errors
    /// NOT_FOUND for unknown scenes, and what reading or drawing meets.
    pub async fn draw(&self, views: Vec<Vec<RenderRequest>>) -> Result<Images, Status> {
        let (answer, answered) = oneshot::channel();
        self.answered(Job::Images { views, answer }, answered).await
    }

    /// The sweep that `request` asks for.
    ///
    /// # Errors
    /// Returns the errors of [`RenderQueue::draw`].
    pub async fn sweep(&self, request: SweepRequest) -> Result<LidarSweep, Status> {
        let (answer, answered) = oneshot::channel();
        let request = Box::new(request);
        self.answered(Job::Sweep { request, answer }, answered)
            .await
    }

    /// Sends `job` and waits for its answer.
    async fn answered<T>(
        &self,
        job: Job,
        answered: oneshot::Receiver<Result<T, Status>>,
    ) -> Result<T, Status> {
        self.metrics.queued(1);
        let gone = || Status::unavailable("the server is ending: ask another");
        match self.messages.send(Message::Draw(job)) {
            Ok(()) => answered.await.map_err(|_| gone())?,
            Err(_) => Err(gone()),
        }
    }

    /// Reads `scenes` into the cache.
    pub fn preload(&self, scenes: Vec<String>) {
        // A queue that has ended needs no scenes.
        let _ = self.messages.send(Message::Preload(scenes));
    }

    /// Ends the threads once what was asked before is done.
    pub fn stop(&self) {
        // It may have ended already.
        let _ = self.messages.send(Message::Stop);
    }

    /// Refuses all requests that wait or come from now on, with UNAVAILABLE.
    pub fn refuse_waiting(&self) {
        self.refusing.store(true, Ordering::Relaxed);
    }

    /// Turns true when nothing will be drawn again: the device was lost, or the thread that draws
    /// has ended.
    pub fn lost(&self) -> watch::Receiver<bool> {
        self.lost.clone()
    }
}

/// Reads scenes that are asked for, until nobody can ask. A reader that panics has failed to read
/// one scene.
fn read_scenes(to_load: &Mutex<Receiver<(String, PathBuf)>>, loaded: &Sender<Message>) {
    loop {
        // Locked only while it waits: the other reader waits for the lock then.
        let next = to_load
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .recv();
        let Ok((id, path)) = next else { return };
        let since = Instant::now();
        let read = caught("reading the scene", || open_movable_scene(&path));
        let read = read.and_then(|scene| {
            scene.map_err(|error| Status::failed_precondition(error.to_string()))
        });
        let (seconds, is_good) = (since.elapsed().as_secs_f64(), read.is_ok());
        tracing::info!(scene = id, seconds, is_good, "a scene was read");
        if let Ok((_, assets @ 1..)) = read {
            tracing::warn!(
                scene = id,
                assets,
                "plain splat files of agents were compressed: `decouplegs compress` does it once"
            );
        }
        let scene = read.map(|(scene, _)| Box::new(scene));
        // No one to tell: the queue has ended.
        let _ = loaded.send(Message::Loaded(id, scene));
    }
}

/// Runs `work`; a panic in it becomes INTERNAL.
fn caught<T>(what: &str, work: impl FnOnce() -> T) -> Result<T, Status> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        let text = panic
            .downcast_ref::<&str>()
            .copied()
            .or_else(|| panic.downcast_ref::<String>().map(String::as_str));
        let text: String = text
            .unwrap_or("without a message")
            .chars()
            .take(200)
            .collect();
        Status::internal(format!(
            "{what} panicked, which is a fault of this server: {text}"
        ))
    })
}

/// State of the render thread.
struct RenderWorker {
    session: Session,
    registry: Arc<SceneRegistry>,
    scenes: Cache<SceneRenderer>,
    /// Jobs for scenes that are being read.
    waiting: HashMap<String, Vec<Job>>,
    loads: Sender<(String, PathBuf)>,
    memory: Arc<ImageMemory>,
    /// Hashes of scenes and objects.
    warned: HashSet<u64>,
    hashes: RandomState,
    /// Limit on lines about scenes and frames that failed: a client can repeat the request.
    failures: LogLimit,
    metrics: Arc<Metrics>,
    lost: watch::Sender<bool>,
    refusing: Arc<AtomicBool>,
}

impl RenderWorker {
    fn work(&mut self, inbox: &Receiver<Message>) {
        for message in inbox {
            match message {
                Message::Draw(job) => self.draw_or_wait(job),
                Message::Loaded(id, scene) => self.loaded(&id, scene),
                Message::Preload(ids) => ids.iter().for_each(|id| self.load(id)),
                Message::Stop => return,
            }
            self.metrics
                .cached(self.scenes.names(), self.scenes.bytes());
        }
    }

    /// Fails with what the validation layers reported, if they were on (`DECOUPLEGS_VALIDATION=1`)
    /// and had something to say.
    fn check_validation(&self) -> Result<()> {
        let messages = self.session.gpu().take_validation_messages();
        ensure!(
            messages.is_empty(),
            "the Vulkan validation layers reported {} faults, the first: {}",
            messages.len(),
            messages[0]
        );
        Ok(())
    }

    fn draw_or_wait(&mut self, job: Job) {
        let id = job.scene();
        if self.refusing.load(Ordering::Relaxed) {
            return self.refuse(
                job,
                Status::unavailable("the server is ending: ask another"),
            );
        }
        if self.registry.path(&id).is_none() {
            return self.refuse(job, no_scene(&id));
        }
        if self.scenes.get(&id).is_some() {
            self.draw(&id, job);
        } else {
            self.load(&id);
            self.waiting.entry(id).or_default().push(job);
        }
    }

    /// Has `id` read, unless it is there or on its way.
    fn load(&mut self, id: &str) {
        let Some(path) = self.registry.path(id) else {
            return;
        };
        if self.scenes.get(id).is_none() && !self.waiting.contains_key(id) {
            self.waiting.insert(id.to_owned(), Vec::new());
            // The reader lives as long as this sender.
            let _ = self.loads.send((id.to_owned(), path.to_owned()));
        }
    }

    fn loaded(&mut self, id: &str, scene: Result<Box<LoadedScene>, Status>) {
        let jobs = self.waiting.remove(id).unwrap_or_default();
        let staged = scene.and_then(|scene| {
            caught("preparing the scene", || self.scene_renderer(id, &scene)).flatten()
        });
        if let Err(status) = staged {
            if let Some(suppressed) = self.failures.admit() {
                tracing::error!(
                    scene = id,
                    reason = status.message(),
                    suppressed,
                    "a scene cannot be served"
                );
            }
            jobs.into_iter()
                .for_each(|job| self.refuse(job, status.clone()));
            return;
        }
        // As they came, and refused if the server is ending meanwhile.
        jobs.into_iter().for_each(|job| self.draw_or_wait(job));
    }

    /// Puts `scene` on the device, in the place of others if need be.
    fn scene_renderer(&mut self, id: &str, scene: &LoadedScene) -> Result<(), Status> {
        let most = self.scenes.bytes_max();
        let estimate = scene.splat_scene.splats.len() as u64
            * bytes_a_splat(scene.splat_scene.splats.sh_degree);
        while let Some((other, _)) = self.scenes.make_room(estimate.min(most)) {
            tracing::info!(scene = other, "a scene leaves the cache");
        }
        let (before, since) = (self.session.gpu().memory().total_bytes, Instant::now());
        let scene_renderer =
            SceneRenderer::new(&self.session, scene).map_err(|error| status_of(&error))?;
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
            return Err(Status::resource_exhausted(reason));
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
        self.scenes.insert(id.to_owned(), scene_renderer, bytes);
        self.resize(id, bytes);
        Ok(())
    }

    fn draw(&mut self, id: &str, job: Job) {
        if job.is_closed() {
            return self.metrics.queued(-1);
        }
        match job {
            Job::Images { views, answer } => {
                let mut images = self.memory.take();
                let count = views.iter().map(Vec::len).sum();
                let drawn = self.on_scene(id, count, |scene| {
                    let drawn = scene.draw(&views, &mut images.bytes)?;
                    Ok(((), drawn))
                });
                self.answer(answer, drawn.map(|()| images));
            }
            Job::Sweep { request, answer } => {
                let swept = self.on_scene(id, 0, |scene| scene.sweep(&request));
                self.answer(answer, swept);
            }
        }
    }

    /// Result of `work` on the scene `id`, which draws `images` images.
    fn on_scene<T>(
        &mut self,
        id: &str,
        images: usize,
        work: impl FnOnce(&mut SceneRenderer) -> Result<(T, Drawn), SessionError>,
    ) -> Result<T, Status> {
        let (before, held) = (
            self.session.gpu().memory().total_bytes,
            self.scenes.bytes_of(id),
        );
        let Some(scene_renderer) = self.scenes.get(id) else {
            return Err(Status::unavailable(format!(
                "scene {id:?} left the cache: ask again"
            )));
        };
        let since = Instant::now();
        match caught("drawing", || work(scene_renderer)) {
            Ok(Ok((done, drawn))) => {
                tracing::debug!(
                    scene = id,
                    images,
                    seconds = since.elapsed().as_secs_f64(),
                    "a frame was drawn"
                );
                self.metrics.drew(images, drawn.unknown.len());
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
                if let Some(suppressed) = self.failures.admit() {
                    tracing::error!(
                        scene = id,
                        reason = status.message(),
                        suppressed,
                        "a frame was not drawn"
                    );
                }
                Err(status)
            }
            Ok(Err(error)) => {
                if let Some(suppressed) = self.failures.admit() {
                    tracing::error!(scene = id, %error, suppressed, "a frame was not drawn");
                }
                if is_lost(&error) {
                    self.lost.send_replace(true);
                }
                Err(status_of(&error))
            }
        }
    }

    fn resize(&mut self, id: &str, bytes: u64) {
        for (other, _) in self.scenes.resize(id, bytes) {
            tracing::info!(scene = other, "a scene leaves the cache");
        }
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
        self.metrics.queued(-1);
        // A client may read the metrics as soon as it has the answer.
        self.metrics
            .cached(self.scenes.names(), self.scenes.bytes());
        // The client may have gone.
        let _ = answer.send(result);
    }
}

/// About what a splat of a background takes on the device.
fn bytes_a_splat(sh_degree: u8) -> u64 {
    let coefficients = (u64::from(sh_degree) + 1).pow(2);
    48 + 6 * coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_answer() {
        assert_eq!(caught("reading", || 7).unwrap(), 7);
        let status = caught("reading", || -> u8 { panic!("entry {} is odd", 3) }).unwrap_err();
        assert_eq!(status.code(), tonic::Code::Internal);
        assert!(
            status.message().contains("reading panicked")
                && status.message().contains("entry 3 is odd"),
            "{status}"
        );
    }
}
