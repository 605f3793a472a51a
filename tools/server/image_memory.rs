//! Memory of images on the host, handed out again and again.

use std::sync::{Arc, Condvar, Mutex, PoisonError};

use decouplegs::session::HostImages;

/// Frames whose images there may be at a time. When encoding falls so far behind, drawing waits:
/// memory stays bounded.
const FRAMES_MAX: usize = 4;

/// Images of one submission, in the order of its cameras. Their memory serves another frame
/// afterwards.
pub struct Images {
    /// The images.
    pub bytes: HostImages,
    memory: Arc<ImageMemory>,
}

/// Memory of images, handed out again and again.
#[derive(Default)]
pub struct ImageMemory {
    /// Free buffers, and the number of borrowed ones.
    free: Mutex<(Vec<HostImages>, usize)>,
    given_back: Condvar,
}

impl ImageMemory {
    /// Memory for one frame, once there is some.
    pub fn take(self: &Arc<Self>) -> Images {
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free = self
            .given_back
            .wait_while(free, |(_, out)| *out >= FRAMES_MAX)
            .unwrap_or_else(PoisonError::into_inner);
        free.1 += 1;
        Images {
            bytes: free.0.pop().unwrap_or_default(),
            memory: Arc::clone(self),
        }
    }
}

impl Drop for Images {
    fn drop(&mut self) {
        let mut free = self
            .memory
            .free
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        free.0.push(std::mem::take(&mut self.bytes));
        free.1 -= 1;
        self.memory.given_back.notify_one();
    }
}
