//! Functions required of the API that borrows images.

use std::os::fd::OwnedFd;

/// Memory that another API gave away, and how large its allocation is, which may be more than its
/// buffer.
#[derive(Debug)]
pub struct Exported {
    /// An opaque descriptor of the memory.
    pub descriptor: OwnedFd,
    /// Allocated size, bytes.
    pub allocation_bytes: u64,
    /// Mapped size from the start, bytes.
    pub buffer_bytes: u64,
}

/// Reason why images could not be shared.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InteropError {
    /// The machine has no CUDA.
    #[error("CUDA is not there: {0}")]
    Missing(String),
    /// CUDA does not know the device.
    #[error("no CUDA device has the UUID {uuid} of the Vulkan device: {found}")]
    NoSuchDevice {
        /// The device's, in hexadecimal.
        uuid: String,
        /// Value found.
        found: String,
    },
    /// A call failed.
    #[error("{call} failed: {code}")]
    Call {
        /// The function.
        call: &'static str,
        /// Result code.
        code: String,
    },
    /// The memory could not be exported.
    #[error("the renderer could not export its images: {0}")]
    Export(String),
}

/// A queue of work of the consumer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// The default stream, in order with all others that block.
    Legacy,
    /// The default stream of the thread.
    PerThread,
    /// A stream of the consumer's own, by its address.
    Own(usize),
    /// No synchronization: the consumer orders its reads after the frame.
    Unordered,
}

impl Stream {
    /// Converts the argument `stream` of `__dlpack__` on CUDA devices (array API standard,
    /// 2024.12): none or 1 is the legacy default stream, 2 that of the thread, -1 no order, and
    /// anything above the address of a stream.
    ///
    /// # Errors
    /// A sentence: 0 is refused by the standard, as it could be none, 1 or 2.
    pub fn of_dlpack(stream: Option<i64>) -> Result<Self, String> {
        match stream {
            None | Some(1) => Ok(Self::Legacy),
            Some(2) => Ok(Self::PerThread),
            Some(-1) => Ok(Self::Unordered),
            Some(own) if own > 2 => Ok(Self::Own(own as usize)),
            Some(other) => Err(format!(
                "stream {other} names no CUDA stream: expected None or 1 (legacy default), 2 (per thread), -1 (no order) or an address"
            )),
        }
    }

    /// Stream on which the event is recorded that ends the loan. The thread that releases it may be
    /// another than the one that took: the legacy stream is behind the default streams of all
    /// threads.
    #[must_use]
    pub fn of_return(self) -> Self {
        match self {
            Self::Own(address) => Self::Own(address),
            Self::Legacy | Self::PerThread | Self::Unordered => Self::Legacy,
        }
    }
}

/// An API that memory and timelines can be imported into. Whatever it gives is released when it is
/// dropped.
pub trait Interop: Send + Sync + 'static {
    /// Imported and mapped memory.
    type Memory: Send + Sync + 'static;
    /// An imported timeline.
    type Timeline: Send + Sync + 'static;
    /// A mark in a stream.
    type Event: Send + 'static;

    /// Imports memory that belongs to one buffer alone.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn import_memory(&self, exported: Exported) -> Result<Self::Memory, InteropError>;

    /// Mapped address.
    fn address(memory: &Self::Memory) -> u64;

    /// Imports a timeline.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn import_timeline(&self, descriptor: OwnedFd) -> Result<Self::Timeline, InteropError>;

    /// Makes what comes next on `stream` wait until `timeline` has counted to `value`. Nothing is
    /// waited for here.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn wait(
        &self,
        timeline: &Self::Timeline,
        value: u64,
        stream: Stream,
    ) -> Result<(), InteropError>;

    /// A mark behind everything submitted to `stream` so far.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn record(&self, stream: Stream) -> Result<Self::Event, InteropError>;

    /// True if the device has passed the mark, without a wait.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn is_done(&self, event: &Self::Event) -> Result<bool, InteropError>;

    /// Waits until the device has come to the mark.
    ///
    /// # Errors
    /// Returns an error if a call fails.
    fn finish(&self, event: &Self::Event) -> Result<(), InteropError>;
}
