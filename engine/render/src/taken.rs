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

/// The shelf of one renderer.
#[derive(Clone, Default)]
pub(crate) struct SharedShelf(Arc<Mutex<ImagePool>>);

impl SharedShelf {
    fn lock(&self) -> MutexGuard<'_, ImagePool> {
        lock(&self.0)
    }

    /// Buffers made for `room`, if some wait. Those of other sizes are let go: cameras that changed
    /// rarely change back.
    pub fn find(&self, room: (usize, usize)) -> Option<OutputBuffers> {
        let mut shelf = self.lock();
        shelf.waiting.retain(|(made_for, _)| *made_for == room);
        shelf.waiting.pop().map(|(_, buffers)| buffers)
    }
}

fn lock(shelf: &Mutex<ImagePool>) -> MutexGuard<'_, ImagePool> {
    shelf.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The images of one frame, finished. They stay as they are until this is dropped; then their
/// memory is drawn into again.
///
/// All reads on the device must be done before the drop: the renderer cannot know.
pub struct TakenImages {
    /// `None` only while it is dropped.
    buffers: Option<OutputBuffers>,
    room: (usize, usize),
    places: Vec<(usize, [u32; 2])>,
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
    pub fn places(&self) -> &[(usize, [u32; 2])] {
        &self.places
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
            let mut shelf = lock(&home);
            shelf.out -= 1;
            shelf.waiting.push((self.room, buffers));
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
        let (shelf, max) = (self.shelf().clone(), self.options().taken_max);
        let Some(slot) = self.shown_slot_mut() else {
            return Ok(None);
        };
        let (Some(view), Some(frame)) = (&slot.view, &slot.done) else {
            return Ok(None);
        };
        let out = shelf.lock().out;
        if out >= max {
            return Err(RenderError::TooManyTaken { max });
        }
        let places = view
            .cameras
            .iter()
            .map(|camera| (camera.first_pixel as usize, camera.size_px))
            .collect();
        let frame = frame.clone();
        let (room, buffers) = slot.give_images();
        shelf.lock().out += 1;
        self.show_nothing();
        Ok(Some(TakenImages {
            buffers: Some(buffers),
            room,
            places,
            frame,
            home: Arc::downgrade(&shelf.0),
        }))
    }
}
