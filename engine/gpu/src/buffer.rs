//! Typed buffers.

use std::{fmt, marker::PhantomData, sync::Arc};

use bytemuck::Pod;

use crate::{ExportedMemory, GpuError, memory::BufferMemory};

/// Memory location of a buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryKind {
    /// Device-local: fast for kernels, out of the host's reach but by copies.
    Device,
    /// Mapped; the host writes, kernels read. Slow for the host to read.
    Upload,
    /// Mapped and cached; kernels write, the host reads.
    Readback,
    /// Device memory as [`MemoryKind::Device`], in an allocation of its own that another API on the
    /// same device may import ([`Buffer::export`]). Only where [`crate::Gpu::can_export`].
    Exported,
}

/// `len` values of `T` on the device. Clones share the memory, which is freed with the last of them
/// and the last submitted work that uses it.
///
/// A kernel's descriptor covers the buffer in whole 32-bit words and at least 16 bytes of it, so
/// that a buffer of no elements can be bound; what lies behind `len` has no defined content.
pub struct Buffer<T> {
    pub(crate) memory: Arc<BufferMemory>,
    len: usize,
    element: PhantomData<fn() -> T>,
}

impl<T> Clone for Buffer<T> {
    fn clone(&self) -> Self {
        Self {
            memory: self.memory.clone(),
            len: self.len,
            element: PhantomData,
        }
    }
}

impl<T> fmt::Debug for Buffer<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} x {} ({:?})",
            self.name(),
            self.len,
            std::any::type_name::<T>(),
            self.memory.memory_kind
        )
    }
}

impl<T> Buffer<T> {
    /// `memory` must hold `len` values of `T`.
    pub(crate) fn new(memory: Arc<BufferMemory>, len: usize) -> Self {
        Self {
            memory,
            len,
            element: PhantomData,
        }
    }

    /// Number of values.
    #[must_use]
    pub fn len(&self) -> usize {
        self.len
    }

    /// True if it has no elements.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Size of its values in bytes.
    #[must_use]
    pub fn byte_len(&self) -> u64 {
        self.memory.byte_len
    }

    /// The name it was made with.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.memory.name
    }

    /// Exports the memory for another API on the same device. Each call gives a descriptor of its
    /// own; the memory lives until the buffer and all that was imported are gone.
    ///
    /// # Errors
    /// Returns an error if the driver cannot.
    ///
    /// # Panics
    /// Panics if the buffer was not made with [`MemoryKind::Exported`].
    pub fn export(&self) -> Result<ExportedMemory, GpuError> {
        self.memory.export()
    }

    /// Tells it from all other buffers that are alive; clones share it.
    #[must_use]
    pub fn id(&self) -> usize {
        Arc::as_ptr(&self.memory).addr()
    }

    /// Number of owners of the buffer, submitted work that uses it included.
    #[must_use]
    pub fn holders(&self) -> usize {
        Arc::strong_count(&self.memory)
    }

    /// The buffer, to be bound to a kernel that has values of `T` in it.
    #[must_use]
    pub fn bound(&self) -> Bound<'_, T> {
        Bound {
            memory: BoundMemory {
                memory: &self.memory,
            },
            element: PhantomData,
        }
    }
}

impl<T: Pod> Buffer<T> {
    /// Writes `data` from element `first` on, at once. Submitted work that reads these elements
    /// must be done.
    ///
    /// # Panics
    /// Panics if the buffer is not for uploads or `data` does not fit.
    pub fn write_host(&self, first: usize, data: &[T]) {
        let bytes: &[u8] = bytemuck::cast_slice(data);
        let range = self.byte_range(first, data.len());
        self.memory
            .write_host_bytes(|host| host[range].copy_from_slice(bytes));
    }

    /// Elements as the host sees them. Submitted work that writes them must be done.
    ///
    /// # Panics
    /// Panics if the buffer is not for reading back.
    #[must_use]
    pub fn read_host(&self) -> Vec<T> {
        self.as_host(self.len).to_vec()
    }

    /// The first `count` elements where they lie. Submitted work that writes them must be done.
    ///
    /// # Panics
    /// Panics if the buffer is not for reading back or has fewer elements.
    #[must_use]
    pub fn as_host(&self, count: usize) -> &[T] {
        bytemuck::cast_slice(&self.memory.host_bytes()[self.byte_range(0, count)])
    }

    /// # Panics
    /// Panics if the elements are not all inside the buffer.
    pub(crate) fn byte_range(&self, first: usize, count: usize) -> std::ops::Range<usize> {
        let end = first.checked_add(count).filter(|&end| end <= self.len);
        let Some(end) = end else {
            panic!(
                "buffer {}: elements {first} + {count} wanted, it has {}",
                self.name(),
                self.len
            )
        };
        first * size_of::<T>()..end * size_of::<T>()
    }
}

/// A buffer as a kernel sees it: values of `T`.
pub struct Bound<'a, T> {
    memory: BoundMemory<'a>,
    element: PhantomData<fn() -> T>,
}

impl<T> Clone for Bound<'_, T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Bound<'_, T> {}

impl<'a, T> Bound<'a, T> {
    /// The same memory for a kernel that has values of `U` in it: `u32` where it copies words, a
    /// vector where it reads several values at once.
    #[must_use]
    pub fn cast<U>(self) -> Bound<'a, U> {
        Bound {
            memory: self.memory,
            element: PhantomData,
        }
    }

    /// The buffer without its type.
    #[must_use]
    pub fn memory(self) -> BoundMemory<'a> {
        self.memory
    }
}

/// A buffer without the type of its values.
#[derive(Clone, Copy)]
pub struct BoundMemory<'a> {
    pub(crate) memory: &'a Arc<BufferMemory>,
}

impl fmt::Debug for BoundMemory<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({} bytes)", self.memory.name, self.memory.byte_len)
    }
}
