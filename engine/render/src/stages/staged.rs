//! Tables that the host writes: a buffer of the host, and its copy on the device, which a command
//! makes.

use bytemuck::Pod;
use decouplegs_gpu::{Bound, Buffer, Gpu, GpuError, MemoryKind, Recorder};

use super::PURPOSE;

/// A buffer that the host writes, and its copy on the device.
pub struct Staged<T> {
    name: &'static str,
    host: Buffer<T>,
    device: Buffer<T>,
    count: usize,
}

impl<T: Pod> Staged<T> {
    /// No values yet.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn new(gpu: &Gpu, name: &'static str) -> Result<Self, GpuError> {
        Self::with_room(gpu, name, 0)
    }

    fn with_room(gpu: &Gpu, name: &'static str, room: usize) -> Result<Self, GpuError> {
        Ok(Self {
            name,
            host: gpu.buffer(name, PURPOSE, room, MemoryKind::Upload)?,
            device: gpu.buffer(name, PURPOSE, room, MemoryKind::Device)?,
            count: 0,
        })
    }

    /// Writes `values`, into new buffers where they have no room. Submitted work that uses the
    /// buffers must be done.
    ///
    /// # Errors
    /// Returns an error if the device is out of memory.
    pub fn set(&mut self, gpu: &Gpu, values: &[T]) -> Result<(), GpuError> {
        if values.len() > self.host.len() {
            *self = Self::with_room(gpu, self.name, values.len() + values.len() / 4)?;
        }
        self.host.write_host(0, values);
        self.count = values.len();
        Ok(())
    }

    /// Records the copy to the device.
    pub fn copy(&self, recorder: &mut Recorder) {
        recorder.copy(&self.host, 0, &self.device, 0, self.count);
    }

    /// The buffer on the device.
    #[must_use]
    pub fn device(&self) -> &Buffer<T> {
        &self.device
    }

    /// The buffer on the device, for a kernel.
    #[must_use]
    pub fn bound(&self) -> Bound<'_, T> {
        self.device.bound()
    }
}
