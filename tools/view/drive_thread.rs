//! The thread that drives live episodes on: planners see images and think, and commands do not wait
//! for them.

use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;

use decouplegs::episode::LiveEpisode;
use decouplegs::explain::explain;

/// Live episode that is lent to the thread for a step.
pub struct Lent {
    /// Source that it belongs to.
    pub source: usize,
    /// Number that tells it from episodes that began anew.
    pub number: u64,
    /// The episode.
    pub live: Box<LiveEpisode>,
}

/// Episode that comes back.
pub struct Driven {
    /// The episode that was lent.
    pub lent: Lent,
    /// True if there is one more step; a sentence if the device failed.
    pub result: Result<bool, String>,
}

/// The thread that drives.
pub struct DriveThread {
    works: Sender<Lent>,
    thread: JoinHandle<()>,
}

impl DriveThread {
    /// Starts the thread, which hands over what was driven by `tell`, until that is false.
    ///
    /// # Errors
    /// Returns an error if the system has no thread.
    pub fn start(tell: impl Fn(Driven) -> bool + Send + 'static) -> std::io::Result<Self> {
        let (works, inbox) = channel::<Lent>();
        let drive = move || {
            for mut lent in inbox {
                let stepped = lent.live.step();
                let result = stepped.map(|step| step.is_some());
                let result = result.map_err(|error| explain(&error));
                if !tell(Driven { lent, result }) {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("driving".into());
        Ok(Self {
            works,
            thread: thread.spawn(drive)?,
        })
    }

    /// Hands over an episode for one step.
    pub fn give(&self, lent: Lent) {
        let _ = self.works.send(lent);
    }

    /// Waits for the steps that were begun.
    ///
    /// # Panics
    /// Panics if the thread has.
    pub fn end(self) {
        drop(self.works);
        if let Err(cause) = self.thread.join() {
            std::panic::resume_unwind(cause);
        }
    }
}
