//! CUDA as the API that images are lent to, in the primary context of the device, which is
//! PyTorch's too.

use std::fmt::Write;
use std::os::fd::{IntoRawFd, OwnedFd};
use std::sync::Arc;

use crate::driver::{
    Code, EVENT_WITHOUT_TIMING, FdOrPointers, Functions, Handle, MEMORY_DEDICATED,
    MEMORY_OPAQUE_FD, MappedBuffer, MemoryHandle, NOT_READY, STREAM_LEGACY, STREAM_PER_THREAD,
    SemaphoreHandle, SemaphoreWait, TIMELINE_FD, Uuid,
};
use crate::{Exported, Interop, InteropError, Stream};

/// A CUDA device and its primary context.
pub struct Cuda(Arc<Context>);

struct Context {
    functions: &'static Functions,
    device: i32,
    ordinal: i32,
    primary: Handle,
}

// SAFETY: contexts may be used from any thread; the driver locks.
unsafe impl Send for Context {}
// SAFETY: likewise.
unsafe impl Sync for Context {}

/// Memory of the renderer, mapped.
pub struct CudaMemory {
    context: Arc<Context>,
    handle: Handle,
    address: u64,
}

/// The renderer's timeline.
pub struct CudaTimeline {
    context: Arc<Context>,
    handle: Handle,
}

/// A mark in a stream.
pub struct CudaEvent {
    context: Arc<Context>,
    handle: Handle,
}

// SAFETY: the driver's handles may be used from any thread.
unsafe impl Send for CudaMemory {}
// SAFETY: likewise.
unsafe impl Sync for CudaMemory {}
// SAFETY: likewise.
unsafe impl Send for CudaTimeline {}
// SAFETY: likewise.
unsafe impl Sync for CudaTimeline {}
// SAFETY: likewise.
unsafe impl Send for CudaEvent {}

impl Cuda {
    /// The device whose UUID is `uuid`, which Vulkan and CUDA agree on.
    ///
    /// # Errors
    /// Returns an error if there is no driver or no such device.
    pub fn open(uuid: [u8; 16]) -> Result<Self, InteropError> {
        let functions = Functions::of_process()?;
        let mut count = 0;
        // SAFETY: writes one number.
        functions.check("cuDeviceGetCount", unsafe {
            (functions.device_count)(&raw mut count)
        })?;
        let mut found = Vec::new();
        for ordinal in 0..count {
            let mut device = 0;
            // SAFETY: writes one number; the ordinal is below the count.
            functions.check("cuDeviceGet", unsafe {
                (functions.device_get)(&raw mut device, ordinal)
            })?;
            let mut own = Uuid::default();
            // SAFETY: writes 16 bytes.
            functions.check("cuDeviceGetUuid", unsafe {
                (functions.device_uuid)(&raw mut own, device)
            })?;
            if own.0 == uuid {
                return Self::retained(functions, device, ordinal);
            }
            found.push(hex(&own.0));
        }
        let found = if found.is_empty() {
            "there is none".to_owned()
        } else {
            format!("there are {}", found.join(", "))
        };
        Err(InteropError::NoSuchDevice {
            uuid: hex(&uuid),
            found,
        })
    }

    fn retained(
        functions: &'static Functions,
        device: i32,
        ordinal: i32,
    ) -> Result<Self, InteropError> {
        let mut primary: Handle = std::ptr::null_mut();
        // SAFETY: the device is one of the driver's; the context is released when the last that
        // uses it is dropped.
        functions.check("cuDevicePrimaryCtxRetain", unsafe {
            (functions.retain_primary)(&raw mut primary, device)
        })?;
        Ok(Self(Arc::new(Context {
            functions,
            device,
            ordinal,
            primary,
        })))
    }

    /// Index among the devices that CUDA lists for this process, as in PyTorch's `cuda:0`.
    #[must_use]
    pub fn ordinal(&self) -> i32 {
        self.0.ordinal
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}

impl Context {
    /// `call` with the context current on this thread, as it was afterwards.
    fn within(
        &self,
        name: &'static str,
        call: impl FnOnce(&Functions) -> Code,
    ) -> Result<(), InteropError> {
        self.check_within(name, call)
            .and_then(|code| self.functions.check(name, code))
    }

    /// Makes a call whose code says more than whether it failed, with the context current on this
    /// thread.
    fn check_within(
        &self,
        name: &'static str,
        call: impl FnOnce(&Functions) -> Code,
    ) -> Result<Code, InteropError> {
        // SAFETY: the context is retained as long as this is there.
        let pushed = unsafe { (self.functions.push_context)(self.primary) };
        self.functions.check(name, pushed)?;
        let code = call(self.functions);
        let mut popped: Handle = std::ptr::null_mut();
        // SAFETY: pops what was pushed above.
        let restored = unsafe { (self.functions.pop_context)(&raw mut popped) };
        self.functions.check(name, restored)?;
        Ok(code)
    }
}

impl Drop for Context {
    fn drop(&mut self) {
        // SAFETY: retained once when it was made. At the end of the process the driver may be gone,
        // which it says and no more.
        unsafe { (self.functions.release_primary)(self.device) };
    }
}

fn raw_stream(stream: Stream) -> Handle {
    let address = match stream {
        Stream::Own(address) => address,
        Stream::PerThread => STREAM_PER_THREAD,
        Stream::Legacy | Stream::Unordered => STREAM_LEGACY,
    };
    std::ptr::without_provenance_mut(address)
}

impl Interop for Cuda {
    type Memory = CudaMemory;
    type Timeline = CudaTimeline;
    type Event = CudaEvent;

    fn import_memory(&self, exported: Exported) -> Result<CudaMemory, InteropError> {
        let descriptor = exported.descriptor.into_raw_fd();
        let handle = FdOrPointers {
            descriptor,
            ..FdOrPointers::default()
        };
        let import = MemoryHandle {
            kind: MEMORY_OPAQUE_FD,
            handle,
            size: exported.allocation_bytes,
            flags: MEMORY_DEDICATED,
            ..MemoryHandle::default()
        };
        let mut memory: Handle = std::ptr::null_mut();
        let imported = self.0.within("cuImportExternalMemory", |functions| {
            // SAFETY: the descriptor is of memory of this device, of this size and dedicated to one
            // buffer.
            unsafe { (functions.import_memory)(&raw mut memory, &raw const import) }
        });
        taken_over(descriptor, memory, imported)?;
        let mut mapped = CudaMemory {
            context: self.0.clone(),
            handle: memory,
            address: 0,
        };
        let buffer = MappedBuffer {
            size: exported.buffer_bytes,
            ..MappedBuffer::default()
        };
        self.0
            .within("cuExternalMemoryGetMappedBuffer", |functions| {
                // SAFETY: the memory was imported above, and the buffer is no longer than it.
                unsafe {
                    (functions.map_buffer)(&raw mut mapped.address, memory, &raw const buffer)
                }
            })?;
        Ok(mapped)
    }

    fn address(memory: &CudaMemory) -> u64 {
        memory.address
    }

    fn import_timeline(&self, descriptor: OwnedFd) -> Result<CudaTimeline, InteropError> {
        let descriptor = descriptor.into_raw_fd();
        let handle = FdOrPointers {
            descriptor,
            ..FdOrPointers::default()
        };
        let import = SemaphoreHandle {
            kind: TIMELINE_FD,
            handle,
            ..SemaphoreHandle::default()
        };
        let mut semaphore: Handle = std::ptr::null_mut();
        let imported = self.0.within("cuImportExternalSemaphore", |functions| {
            // SAFETY: the descriptor is of a timeline semaphore of this device.
            unsafe { (functions.import_semaphore)(&raw mut semaphore, &raw const import) }
        });
        taken_over(descriptor, semaphore, imported)?;
        Ok(CudaTimeline {
            context: self.0.clone(),
            handle: semaphore,
        })
    }

    fn wait(
        &self,
        timeline: &CudaTimeline,
        value: u64,
        stream: Stream,
    ) -> Result<(), InteropError> {
        let wait = SemaphoreWait {
            value,
            ..SemaphoreWait::default()
        };
        self.0.within("cuWaitExternalSemaphoresAsync", |functions| {
            // SAFETY: one semaphore and one value, and a stream that the consumer says is his.
            unsafe {
                (functions.wait_semaphores)(
                    &raw const timeline.handle,
                    &raw const wait,
                    1,
                    raw_stream(stream),
                )
            }
        })
    }

    fn record(&self, stream: Stream) -> Result<CudaEvent, InteropError> {
        let mut event: Handle = std::ptr::null_mut();
        self.0.within("cuEventCreate", |functions| {
            // SAFETY: writes one handle, which is destroyed with the event.
            unsafe { (functions.create_event)(&raw mut event, EVENT_WITHOUT_TIMING) }
        })?;
        let event = CudaEvent {
            context: self.0.clone(),
            handle: event,
        };
        self.0.within("cuEventRecord", |functions| {
            // SAFETY: the event was made above, the stream is the consumer's.
            unsafe { (functions.record_event)(event.handle, raw_stream(stream)) }
        })?;
        Ok(event)
    }

    fn is_done(&self, event: &CudaEvent) -> Result<bool, InteropError> {
        let code = self.0.check_within("cuEventQuery", |functions| {
            // SAFETY: the event lives as long as it is borrowed.
            unsafe { (functions.query_event)(event.handle) }
        })?;
        if code == NOT_READY {
            Ok(false)
        } else {
            self.0.functions.check("cuEventQuery", code).map(|()| true)
        }
    }

    fn finish(&self, event: &CudaEvent) -> Result<(), InteropError> {
        self.0.within("cuEventSynchronize", |functions| {
            // SAFETY: the event lives as long as it is borrowed.
            unsafe { (functions.synchronize_event)(event.handle) }
        })
    }
}

/// Closes a descriptor that the driver refused. It takes the descriptor over when it imports it,
/// which `made` tells: a call may also fail after that, where the context cannot be put back.
fn taken_over(
    descriptor: i32,
    made: Handle,
    imported: Result<(), InteropError>,
) -> Result<(), InteropError> {
    use std::os::fd::FromRawFd;
    if imported.is_err() && made.is_null() {
        // SAFETY: the descriptor was ours, and nobody took it.
        drop(unsafe { OwnedFd::from_raw_fd(descriptor) });
    }
    imported
}

impl Drop for CudaMemory {
    fn drop(&mut self) {
        // What fails here fails because the driver is gone, and all with it.
        let _ = self.context.within("cuDestroyExternalMemory", |functions| {
            if self.address != 0 {
                // SAFETY: mapped once, and no longer read: its readers hold the memory.
                unsafe { (functions.free)(self.address) };
            }
            // SAFETY: imported once, its mapping gone.
            unsafe { (functions.destroy_memory)(self.handle) }
        });
    }
}

impl Drop for CudaTimeline {
    fn drop(&mut self) {
        let _ = self
            .context
            .within("cuDestroyExternalSemaphore", |functions| {
                // SAFETY: imported once; waits that were submitted keep what they need.
                unsafe { (functions.destroy_semaphore)(self.handle) }
            });
    }
}

impl Drop for CudaEvent {
    fn drop(&mut self) {
        let _ = self.context.within("cuEventDestroy", |functions| {
            // SAFETY: made once; the driver frees it when it is done.
            unsafe { (functions.destroy_event)(self.handle) }
        });
    }
}
