//! The queue of requests: each goes to the thread that draws on the device of its scene, which
//! gives each connection the same time. Images go back one by one, and files are read on threads
//! beside.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use decouplegs::gpu::Gpu;
use decouplegs::open_movable_scene;
use decouplegs::render::RenderOptions;
use decouplegs::scene::LidarSweep;
use tokio::sync::{oneshot, watch};
use tonic::Status;

use crate::devices::{Asked, Devices, Job, Message, ToRead, caught};
use crate::image_memory::Images;
use crate::metrics::Metrics;
use crate::options::Limits;
use crate::placement::{Placement, PlacementLimits};
use crate::read_ahead::ReadAhead;
use crate::render_request::RenderRequest;
use crate::render_worker::RenderWorker;
use crate::request_guard::connection_number;
use crate::scene_registry::SceneRegistry;
use crate::sweep_request::SweepRequest;

/// Least number of threads that read files, of which there is one for each device: one may wait for
/// a slow disk while another reads.
const READERS_MIN: usize = 2;

/// Asks for images and sweeps.
#[derive(Clone)]
pub struct RenderQueue {
    devices: Arc<Devices>,
}

impl RenderQueue {
    /// Starts the threads, which draw scenes of `registry` on `gpus` as `render` says: one for each
    /// device. What was read `ahead` is not read again.
    ///
    /// # Errors
    /// Returns an error if the operating system gives no threads.
    pub fn start(
        gpus: &[Gpu],
        render: RenderOptions,
        registry: Arc<SceneRegistry>,
        ahead: ReadAhead,
        limits: &Limits,
        metrics: Arc<Metrics>,
    ) -> Result<(Self, RenderThreads)> {
        let (inboxes, inbox): (Vec<_>, Vec<_>) = gpus.iter().map(|_| channel()).unzip();
        let (loads, to_load) = channel();
        let (to_load, ahead) = (Arc::new(Mutex::new(to_load)), Arc::new(ahead));
        for _ in 0..READERS_MIN.max(gpus.len()) {
            let (to_load, ahead) = (Arc::clone(&to_load), Arc::clone(&ahead));
            Builder::new()
                .name("read-scenes".into())
                .spawn(move || read_scenes(&to_load, &ahead))
                .context("no thread")?;
        }
        let placement_limits = PlacementLimits {
            scenes_max: limits.cache_size as usize,
            bytes_max: limits.cache_bytes,
            copies_max: limits.copies as usize,
        };
        metrics.with_devices(gpus.len());
        let devices = Arc::new(Devices {
            placement: Arc::new(Placement::new(gpus.len(), placement_limits)),
            inboxes,
            registry,
            metrics,
            lost: watch::channel(false).0,
            refusing: AtomicBool::new(false),
        });
        let mut threads = Vec::new();
        for (position, (gpu, inbox)) in gpus.iter().zip(inbox).enumerate() {
            let devices = Arc::clone(&devices);
            let mut worker = RenderWorker::new(
                position,
                gpu,
                render,
                limits,
                loads.clone(),
                devices.clone(),
            );
            let render = move || {
                let worked = caught("drawing", || worker.work(&inbox));
                if let Err(status) = worked {
                    tracing::error!(reason = status.message(), "a thread that draws ended");
                    devices.take_out(position);
                }
                worker.check_validation()
            };
            let thread = Builder::new().name("render".into()).spawn(render);
            threads.push(thread.context("no thread")?);
        }
        Ok((Self { devices }, RenderThreads(threads)))
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
        self.devices.metrics.queued(1);
        let gone = || Status::unavailable("the server is ending: ask another");
        let asked = Asked {
            connection: connection_number(),
            job,
            refused: Vec::new(),
            lost: 0,
            load: None,
        };
        if self.devices.send(asked).is_err() {
            self.devices.metrics.queued(-1);
            return Err(gone());
        }
        answered.await.map_err(|_| gone())?
    }

    /// Reads `scenes` into the caches of the devices.
    pub fn preload(&self, scenes: impl IntoIterator<Item = String>) {
        for scene in scenes {
            let bytes = || self.devices.registry.size_bytes(&scene);
            let placed = self.devices.placement.place(&scene, &[], bytes);
            if let Some(placed) = placed {
                self.devices.preload(&scene, &[placed.device]);
                self.devices.preload(&scene, &placed.copies);
            }
        }
    }

    /// Number of devices that `scene` is on.
    pub fn copies(&self, scene: &str) -> usize {
        self.devices.placement.copies(scene)
    }

    /// Scenes that all devices keep together at most.
    pub fn scenes_max(&self) -> u64 {
        self.devices.placement.scenes_max()
    }

    /// Ends the threads once what was asked before is done.
    pub fn stop(&self) {
        for inbox in &self.devices.inboxes {
            // It may have ended already.
            let _ = inbox.send(Message::Stop);
        }
    }

    /// Refuses all requests that wait or come from now on, with UNAVAILABLE.
    pub fn refuse_waiting(&self) {
        self.devices.refusing.store(true, Ordering::Relaxed);
    }

    /// Turns true when nothing will be drawn again: every device was lost, or its thread has ended.
    pub fn lost(&self) -> watch::Receiver<bool> {
        self.devices.lost.subscribe()
    }
}

/// The threads that draw.
pub struct RenderThreads(Vec<JoinHandle<Result<()>>>);

impl RenderThreads {
    /// Waits for their end. Fails with the first fault of any.
    pub fn join(self) -> Result<()> {
        let ends = self.0.into_iter().map(JoinHandle::join);
        let ends: Vec<_> = ends.collect();
        ends.into_iter()
            .try_for_each(|end| end.map_err(|_| anyhow!("a thread that draws panicked"))?)
    }
}

/// Reads scenes that are asked for, until nobody can ask. A reader that panics has failed to read
/// one scene.
fn read_scenes(to_load: &Mutex<Receiver<ToRead>>, ahead: &ReadAhead) {
    loop {
        // Locked only while it waits: the other reader waits for the lock then.
        let next = to_load
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .recv();
        let Ok(ToRead {
            scene: id,
            path,
            reader,
        }) = next
        else {
            return;
        };
        let since = Instant::now();
        let read = caught("reading the scene", || match ahead.take(&id) {
            Some(read) => Ok(read),
            None => open_movable_scene(&path),
        });
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
        let _ = reader.send(Message::Loaded(id, scene));
    }
}
