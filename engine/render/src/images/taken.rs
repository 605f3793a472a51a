//! Images that outlive their frame: another reader uses them on the device, and the renderer draws
//! on into others.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

use decouplegs_gpu::Ticket;

use crate::output::OutputBuffers;
use crate::{RenderError, Renderer};

/// Pool of image buffers: those that are free, and the number of borrowed ones.
#[derive(Default)]
pub(crate) struct ImagePool {
    waiting: Vec<((usize, usize), OutputBuffers)>,
    out: usize,
}

/// The pool of one renderer.
#[derive(Clone, Default)]
pub(crate) struct SharedImagePool(Arc<Mutex<ImagePool>>);

impl SharedImagePool {
    fn lock(&self) -> MutexGuard<'_, ImagePool> {
        lock(&self.0)
    }

    /// Buffers made for `room`, if some wait. Those of other sizes are let go: cameras that changed
    /// rarely change back.
    pub fn find(&self, room: (usize, usize)) -> Option<OutputBuffers> {
        let mut pool = self.lock();
        pool.waiting.retain(|(made_for, _)| *made_for == room);
        pool.waiting.pop().map(|(_, buffers)| buffers)
    }
}

fn lock(pool: &Mutex<ImagePool>) -> MutexGuard<'_, ImagePool> {
    pool.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The images of one frame, finished. They stay as they are until this is dropped; then their
/// memory is drawn into again.
///
/// All reads on the device must be done before the drop: the renderer cannot know.
pub struct TakenImages {
    /// `None` only while it is dropped.
    buffers: Option<OutputBuffers>,
    room: (usize, usize),
    ranges: Vec<(usize, [u32; 2])>,
    frame: Ticket,
    home: Weak<Mutex<ImagePool>>,
}

impl TakenImages {
    /// Buffers of all cameras one after the other, rows from the top.
    ///
    /// # Panics
    /// Never: the buffers are there until it is dropped.
    #[must_use]
    pub fn buffers(&self) -> &OutputBuffers {
        self.buffers
            .as_ref()
            .expect("the buffers are there until it is dropped")
    }

    /// First pixel, and width and height, of each camera's image.
    #[must_use]
    pub fn ranges(&self) -> &[(usize, [u32; 2])] {
        &self.ranges
    }

    /// The frame that drew them, which is finished: what another queue or API may wait for, so that
    /// it sees what was written.
    #[must_use]
    pub fn frame(&self) -> &Ticket {
        &self.frame
    }
}

impl Drop for TakenImages {
    fn drop(&mut self) {
        if let (Some(home), Some(buffers)) = (self.home.upgrade(), self.buffers.take()) {
            let mut pool = lock(&home);
            pool.out -= 1;
            pool.waiting.push((self.room, buffers));
        }
    }
}

impl Renderer {
    /// Takes the images of the frame that was finished last, which [`Renderer::read_images`] does
    /// not find any more. Later frames are drawn into other buffers, so that rendering goes on
    /// while these are in use; with [`crate::Outputs::exported`] another API may.
    ///
    /// `None` before the first frame, and when they were taken already.
    ///
    /// # Errors
    /// Returns an error if as many are out as [`crate::RenderOptions::taken_max`] allows: memory
    /// stays bounded where a caller forgets to drop.
    pub fn take_images(&mut self) -> Result<Option<TakenImages>, RenderError> {
        let (pool, max) = (self.image_pool().clone(), self.options().taken_max);
        if self.shown().is_some() && pool.lock().out >= max {
            return Err(RenderError::TooManyTaken { max });
        }
        let Some((shown, room, buffers)) = self.take_shown() else {
            return Ok(None);
        };
        pool.lock().out += 1;
        Ok(Some(TakenImages {
            buffers: Some(buffers),
            room,
            ranges: shown.view.ranges(),
            frame: shown.frame,
            home: Arc::downgrade(&pool.0),
        }))
    }
}
