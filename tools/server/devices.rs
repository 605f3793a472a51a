//! The devices that draw: requests on their way to the threads that own them.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::Sender;

use decouplegs::asset::LoadedScene;
use decouplegs::scene::LidarSweep;
use tokio::sync::{oneshot, watch};
use tonic::Status;

use crate::image_memory::Images;
use crate::metrics::Metrics;
use crate::placement::{Load, Placement};
use crate::render_request::RenderRequest;
use crate::scene_registry::SceneRegistry;
use crate::sweep_request::SweepRequest;

/// Message to a thread that draws.
pub enum Message {
    Draw(Asked),
    Loaded(String, Result<Box<LoadedScene>, Status>),
    Preload(String),
    Stop,
}

/// A scene to read: its id, its file, and the thread that it is for.
pub struct ToRead {
    pub scene: String,
    pub path: PathBuf,
    pub reader: Sender<Message>,
}

/// A request on its way to a device.
pub struct Asked {
    /// Number of the connection that it came by.
    pub connection: u64,
    pub job: Job,
    /// Devices that have no room for it.
    pub refused: Vec<usize>,
    /// Number of devices that were lost while they worked for it.
    pub lost: usize,
    /// Counts it as a load of the device.
    pub load: Option<Load>,
}

/// The devices that draw, and which scene is on which.
pub struct Devices {
    /// The threads that draw, one for each device.
    pub inboxes: Vec<Sender<Message>>,
    pub placement: Arc<Placement>,
    pub registry: Arc<SceneRegistry>,
    pub metrics: Arc<Metrics>,
    /// Turns true when nothing will be drawn again.
    pub lost: watch::Sender<bool>,
    /// True if queued requests are refused instead of rendered.
    pub refusing: AtomicBool,
}

impl Devices {
    /// Sends `asked` to the device that draws its scene.
    ///
    /// # Errors
    /// Gives it back if no device can draw it.
    pub fn send(&self, mut asked: Asked) -> Result<(), Asked> {
        let scene = asked.job.scene();
        loop {
            let bytes = || self.registry.size_bytes(&scene);
            let Some(placed) = self.placement.place(&scene, &asked.refused, bytes) else {
                return Err(asked);
            };
            self.preload(&scene, &placed.copies);
            let device = placed.device;
            asked.load = Some(placed.load);
            match self.inboxes[device].send(Message::Draw(asked)) {
                Ok(()) => return Ok(()),
                Err(unsent) => {
                    let Message::Draw(back) = unsent.0 else {
                        unreachable!("what comes back is what was sent")
                    };
                    asked = back;
                    // Its thread has ended.
                    asked.refused.push(device);
                }
            }
        }
    }

    /// Has `scene` loaded by `devices`.
    pub fn preload(&self, scene: &str, devices: &[usize]) {
        for &device in devices {
            // A thread that has ended needs no scenes.
            let _ = self.inboxes[device].send(Message::Preload(scene.to_owned()));
        }
    }

    /// Takes a device out for good. Where none is left, nothing will be drawn again.
    pub fn take_out(&self, device: usize) {
        if !self.placement.take_out(device) {
            self.lost.send_replace(true);
        }
    }

    /// The inbox of the thread that draws on `device`.
    pub fn inbox(&self, device: usize) -> Sender<Message> {
        self.inboxes[device].clone()
    }

    /// True if there are several, whether they draw or not.
    pub fn are_several(&self) -> bool {
        self.inboxes.len() > 1
    }

    /// True if queued requests are refused instead of rendered.
    pub fn is_refusing(&self) -> bool {
        self.refusing.load(Ordering::Relaxed)
    }
}

/// Work for one scene.
pub enum Job {
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
    pub fn scene(&self) -> String {
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
    pub fn is_closed(&self) -> bool {
        match self {
            Self::Images { answer, .. } => answer.is_closed(),
            Self::Sweep { answer, .. } => answer.is_closed(),
        }
    }
}

/// Runs `work`; a panic in it becomes INTERNAL.
pub fn caught<T>(what: &str, work: impl FnOnce() -> T) -> Result<T, Status> {
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
