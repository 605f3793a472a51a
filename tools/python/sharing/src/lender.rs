//! Borrowed images: their owners, and their return.

use std::collections::HashMap;
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::{Exported, Interop, InteropError, Stream};

/// A buffer of the renderer that can be shared. Clones share the memory.
pub trait Shared: Send + Sync {
    /// Id that no other buffer that is alive has.
    fn id(&self) -> usize;

    /// Number of owners, this handle included.
    fn holders(&self) -> usize;

    /// Exports its memory as a new descriptor.
    ///
    /// # Errors
    /// Returns an error if the driver cannot.
    fn export(&self) -> Result<Exported, InteropError>;
}

/// A buffer that was imported. The mapping goes before the buffer: fields are dropped in order.
struct Import<M> {
    memory: Arc<M>,
    buffer: Box<dyn Shared>,
}

/// Lends the images `P` of one renderer.
pub struct Lender<I: Interop, P: Send> {
    interop: Arc<I>,
    timeline: I::Timeline,
    /// Imports by [`Shared::id`]. A renderer draws into the same few buffers again and again, and
    /// importing one takes far longer than handing it out.
    imports: Mutex<HashMap<usize, Import<I::Memory>>>,
    returned: Mutex<Vec<Returned<I, P>>>,
}

/// Images that no consumer holds any more, and the work on the device that still reads them.
struct Returned<I: Interop, P> {
    images: P,
    events: Vec<I::Event>,
    /// Reason why their release cannot be observed.
    lost: Option<InteropError>,
}

/// The images of one frame, lent. They go back when this and all that was handed out of it are
/// dropped, and the device is done.
pub struct Loan<I: Interop, P: Send> {
    lender: Arc<Lender<I, P>>,
    /// Value of the timeline when the images are complete.
    drawn: u64,
    /// `None` only while it is dropped.
    images: Option<P>,
    ends: Mutex<(Vec<I::Event>, Option<InteropError>)>,
}

/// Images in the hands of a consumer that reads them on one stream. Dropped when the consumer has
/// submitted all that reads them.
pub struct Handed<I: Interop, P: Send> {
    loan: Arc<Loan<I, P>>,
    stream: Stream,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<I: Interop, P: Send> Lender<I, P> {
    /// A lender of images that are drawn when `timeline` says so.
    ///
    /// # Errors
    /// Returns an error if the timeline cannot be imported.
    pub fn new(interop: Arc<I>, timeline: OwnedFd) -> Result<Arc<Self>, InteropError> {
        let timeline = interop.import_timeline(timeline)?;
        Ok(Arc::new(Self {
            interop,
            timeline,
            imports: Mutex::default(),
            returned: Mutex::new(Vec::new()),
        }))
    }

    /// The memory of `buffer` as the other API sees it, imported when it is first asked for.
    ///
    /// # Errors
    /// Returns an error if it cannot be exported or imported.
    pub fn memory(&self, buffer: impl Shared + 'static) -> Result<Arc<I::Memory>, InteropError> {
        let mut imports = lock(&self.imports);
        if let Some(import) = imports.get(&buffer.id()) {
            return Ok(import.memory.clone());
        }
        let memory = Arc::new(self.interop.import_memory(buffer.export()?)?);
        imports.insert(
            buffer.id(),
            Import {
                memory: memory.clone(),
                buffer: Box::new(buffer),
            },
        );
        Ok(memory)
    }

    /// Takes `images`, which are drawn when the timeline has counted to `drawn`.
    pub fn lend(self: &Arc<Self>, images: P, drawn: u64) -> Arc<Loan<I, P>> {
        Arc::new(Loan {
            lender: self.clone(),
            drawn,
            images: Some(images),
            ends: Mutex::default(),
        })
    }

    /// Gives images back to the renderer that nobody reads any more, and forgets imports of buffers
    /// that it has released. How many frames are still read. Waits for nothing.
    ///
    /// # Errors
    /// Returns an error if the other API failed: images whose release cannot be observed
    /// are never given back.
    pub fn collect(&self) -> Result<usize, InteropError> {
        let mut free = Vec::new();
        let mut failed = None;
        let waiting = {
            let mut returned = lock(&self.returned);
            for entry in std::mem::take(&mut *returned) {
                match self.is_free(&entry) {
                    Ok(true) => free.push(entry),
                    Ok(false) => returned.push(entry),
                    Err(error) => {
                        failed = Some(error);
                        // Drawing over what may be read is worse than memory that is never used
                        // again.
                        std::mem::forget(entry.images);
                    }
                }
            }
            returned.len()
        };
        // Without the lock: the renderer has locks of its own.
        drop(free);
        lock(&self.imports).retain(|_, import| import.buffer.holders() > 1);
        failed.map_or(Ok(waiting), Err)
    }

    fn is_free(&self, entry: &Returned<I, P>) -> Result<bool, InteropError> {
        if let Some(error) = &entry.lost {
            return Err(error.clone());
        }
        for event in &entry.events {
            if !self.interop.is_done(event)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Buffers that are imported.
    pub fn imports(&self) -> usize {
        lock(&self.imports).len()
    }
}

impl<I: Interop, P: Send> Drop for Lender<I, P> {
    /// The renderer is gone and nobody will collect: what is still read is waited for, as its
    /// memory goes with it.
    fn drop(&mut self) {
        for entry in std::mem::take(&mut *lock(&self.returned)) {
            let done = entry.lost.is_none()
                && entry
                    .events
                    .iter()
                    .all(|event| self.interop.finish(event).is_ok());
            if !done {
                std::mem::forget(entry.images);
            }
        }
    }
}

impl<I: Interop, P: Send> Loan<I, P> {
    /// The images.
    ///
    /// # Panics
    /// Never: they are there until it is dropped.
    pub fn images(&self) -> &P {
        self.images
            .as_ref()
            .expect("the images are there until the loan is dropped")
    }

    /// Lets `stream` read them: what comes next on it waits until they are drawn.
    ///
    /// # Errors
    /// Returns an error if the other API failed.
    pub fn hand_out(self: &Arc<Self>, stream: Stream) -> Result<Handed<I, P>, InteropError> {
        if stream != Stream::Unordered {
            self.lender
                .interop
                .wait(&self.lender.timeline, self.drawn, stream)?;
        }
        Ok(Handed {
            loan: self.clone(),
            stream,
        })
    }
}

impl<I: Interop, P: Send> Drop for Handed<I, P> {
    fn drop(&mut self) {
        let event = self.loan.lender.interop.record(self.stream.of_return());
        let mut ends = lock(&self.loan.ends);
        match event {
            Ok(event) => ends.0.push(event),
            Err(error) => ends.1 = Some(error),
        }
    }
}

impl<I: Interop, P: Send> Drop for Loan<I, P> {
    fn drop(&mut self) {
        let (events, lost) = std::mem::take(&mut *lock(&self.ends));
        if let Some(images) = self.images.take() {
            lock(&self.lender.returned).push(Returned {
                images,
                events,
                lost,
            });
        }
    }
}
