//! Memory of buffers: where it comes from, who holds how much of it, and the sentence when there is
//! no more.

use std::sync::{
    Arc, Mutex, PoisonError,
    atomic::{AtomicU64, Ordering},
};

use ash::vk;
use gpu_allocator::{
    AllocationError, MemoryLocation,
    vulkan::{Allocation, AllocationCreateDesc, AllocationScheme},
};

use crate::{
    ExportedMemory, GpuError, MemoryKind, context::Context, drill::DrillState, error::failed,
    export,
};

/// Size from which a buffer has its own allocation, bytes: freed, it goes back to the driver at
/// once, and capacities that grow leave no holes.
const OWN_ALLOCATION_FROM_BYTES: u64 = 4 << 20;

/// The least that is bound: a buffer of no elements still needs a descriptor.
const BOUND_BYTES_MIN: u64 = 16;

/// A buffer and its memory, freed with the last clone of whatever holds it.
pub(crate) struct BufferMemory {
    pub(crate) context: Arc<Context>,
    pub(crate) raw: vk::Buffer,
    /// Different for each buffer of this process: what barriers are derived by.
    pub(crate) id: u64,
    pub(crate) name: &'static str,
    pub(crate) memory_kind: MemoryKind,
    /// Requested size.
    pub(crate) byte_len: u64,
    /// Size of the descriptor's range: `byte_len` in whole words, at least [`BOUND_BYTES_MIN`].
    pub(crate) bound_bytes: u64,
    purpose: &'static str,
    counted_bytes: u64,
    device_local: bool,
    /// `None` only while it is dropped. Locked while the host reads or writes it.
    allocation: Mutex<Option<Held>>,
}

/// Storage of a buffer's bytes.
enum Held {
    /// Block of the allocator, or an allocation of its own that the allocator knows.
    Allocated(Allocation),
    /// Memory that may be exported, and its size, bytes.
    Exported(vk::DeviceMemory, u64),
}

impl BufferMemory {
    pub(crate) fn new(
        context: &Arc<Context>,
        name: &'static str,
        purpose: &'static str,
        byte_len: u64,
        memory_kind: MemoryKind,
    ) -> Result<Self, GpuError> {
        static NEXT_ID: AtomicU64 = AtomicU64::new(0);
        let limit_bytes = context.limits.storage_buffer_bytes_max;
        if byte_len > limit_bytes {
            return Err(GpuError::BufferTooLarge {
                name,
                wanted_bytes: byte_len,
                limit_bytes,
            });
        }
        let bound_bytes = byte_len.next_multiple_of(4).max(BOUND_BYTES_MIN);
        refuse_above_heap(context, name, purpose, bound_bytes, memory_kind)?;
        let exported = memory_kind == MemoryKind::Exported;
        if exported {
            context.exports()?;
        }
        let raw = create(context, bound_bytes, exported)
            .map_err(|code| translate(context, name, purpose, bound_bytes, code))?;
        let held = if exported {
            let made = allocate_exported(context, raw);
            made.map(|(memory, bytes)| (Held::Exported(memory, bytes), bytes, true))
                .map_err(|code| translate(context, name, purpose, bound_bytes, code))
        } else {
            allocate_and_bind(context, raw, name, purpose, memory_kind)
        };
        let (held, counted_bytes, device_local) = match held {
            Ok(held) => held,
            Err(error) => {
                // SAFETY: made above, bound to nothing and known to nobody.
                unsafe { context.device.destroy_buffer(raw, None) };
                return Err(error);
            }
        };
        context.set_name(raw, name);
        context
            .accounting
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .add(purpose, counted_bytes, device_local);
        Ok(Self {
            context: context.clone(),
            raw,
            id: NEXT_ID.fetch_add(1, Ordering::Relaxed),
            name,
            memory_kind,
            byte_len,
            bound_bytes,
            purpose,
            counted_bytes,
            device_local,
            allocation: Mutex::new(Some(held)),
        })
    }

    /// # Panics
    /// For memory that is not of the kind `wanted`, one that the host sees.
    fn require(&self, wanted: MemoryKind) {
        assert!(
            !matches!(self.memory_kind, MemoryKind::Device | MemoryKind::Exported),
            "buffer {}: lives on the device; the host reaches it through the Gpu only",
            self.name
        );
        assert!(
            self.memory_kind == wanted,
            "buffer {}: made as {:?}, and used as {wanted:?}",
            self.name,
            self.memory_kind
        );
    }

    /// Runs `body` on the buffer's bytes as the host writes them.
    ///
    /// # Panics
    /// For a buffer that is not [`MemoryKind::Upload`].
    pub(crate) fn write_host_bytes(&self, body: impl FnOnce(&mut [u8])) {
        self.require(MemoryKind::Upload);
        let mut allocation = self
            .allocation
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Some(Held::Allocated(allocation)) = allocation.as_mut() else {
            unreachable!("only device memory is exported")
        };
        let bytes = allocation
            .mapped_slice_mut()
            .expect("host-visible memory is mapped while it lives");
        body(&mut bytes[..self.byte_len as usize]);
    }

    /// The buffer's bytes as the host reads them.
    ///
    /// # Panics
    /// For a buffer that is not [`MemoryKind::Readback`].
    pub(crate) fn host_bytes(&self) -> &[u8] {
        self.require(MemoryKind::Readback);
        let allocation = self
            .allocation
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Some(Held::Allocated(allocation)) = allocation.as_ref() else {
            unreachable!("only device memory is exported")
        };
        let bytes = allocation
            .mapped_slice()
            .expect("host-visible memory is mapped while it lives");
        // SAFETY: the allocation is mapped at the same place until this memory is dropped, and no
        // code of the host writes memory of this kind.
        unsafe { std::slice::from_raw_parts(bytes.as_ptr(), self.byte_len as usize) }
    }

    /// # Panics
    /// For a buffer without [`MemoryKind::Exported`].
    pub(crate) fn export(&self) -> Result<ExportedMemory, GpuError> {
        let held = self
            .allocation
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        let Some(Held::Exported(memory, allocation_bytes)) = *held else {
            panic!(
                "buffer {}: its memory was not made to be exported",
                self.name
            )
        };
        Ok(ExportedMemory {
            descriptor: self.context.exports()?.memory_descriptor(memory)?,
            allocation_bytes,
        })
    }
}

impl Drop for BufferMemory {
    fn drop(&mut self) {
        // SAFETY: submitted work holds what it uses until it is done, so no device work uses the
        // buffer any more.
        unsafe { self.context.device.destroy_buffer(self.raw, None) };
        match self
            .allocation
            .get_mut()
            .unwrap_or_else(PoisonError::into_inner)
            .take()
        {
            Some(Held::Allocated(allocation)) => {
                // An error would mean that the allocation is not of this allocator; there is nobody
                // to tell in a drop.
                let _ = self
                    .context
                    .allocator
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .free(allocation);
            }
            // SAFETY: its buffer is gone, and what was imported holds the memory by itself.
            Some(Held::Exported(memory, _)) => unsafe {
                self.context.device.free_memory(memory, None);
            },
            None => {}
        }
        let mut accounting = self
            .context
            .accounting
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        accounting.remove(self.purpose, self.counted_bytes, self.device_local);
    }
}

/// Some drivers promise more than the heap has and fail when it is touched; so what cannot fit is
/// refused here.
fn refuse_above_heap(
    context: &Context,
    name: &'static str,
    purpose: &'static str,
    bytes: u64,
    memory_kind: MemoryKind,
) -> Result<(), GpuError> {
    let used = context
        .accounting
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .device_local_bytes;
    let is_full = context.drill.as_ref().is_some_and(DrillState::is_full)
        || used.saturating_add(bytes) > context.limits.device_memory_bytes;
    if matches!(memory_kind, MemoryKind::Device | MemoryKind::Exported) && is_full {
        return Err(out_of_memory(context, name, purpose, bytes));
    }
    Ok(())
}

fn create(context: &Context, bytes: u64, exported: bool) -> Result<vk::Buffer, vk::Result> {
    use vk::BufferUsageFlags as Usage;
    let families = [
        context.families.main,
        context.families.update.unwrap_or(context.families.main),
    ];
    let mut create = vk::BufferCreateInfo::default().size(bytes).usage(
        Usage::STORAGE_BUFFER
            | Usage::UNIFORM_BUFFER
            | Usage::INDIRECT_BUFFER
            | Usage::TRANSFER_SRC
            | Usage::TRANSFER_DST,
    );
    if context.families.update.is_some() {
        // Buffers need no ownership transfers: storage buffers lose nothing by being shared on the
        // devices that we know.
        create = create
            .sharing_mode(vk::SharingMode::CONCURRENT)
            .queue_family_indices(&families);
    }
    let mut export = export::buffer_info();
    if exported {
        create = create.push_next(&mut export);
    }
    // SAFETY: the size is not zero, and the families are two different ones of this device where
    // sharing is concurrent.
    context.code_of("vkCreateBuffer", || unsafe {
        context.device.create_buffer(&create, None)
    })
}

/// The allocation, the bytes it is counted with, and whether these are local to the device.
fn allocate_and_bind(
    context: &Context,
    buffer: vk::Buffer,
    name: &'static str,
    purpose: &'static str,
    memory_kind: MemoryKind,
) -> Result<(Held, u64, bool), GpuError> {
    // SAFETY: a query on a live buffer of this device.
    let requirements = unsafe { context.device.get_buffer_memory_requirements(buffer) };
    let own = requirements.size >= OWN_ALLOCATION_FROM_BYTES;
    let description = AllocationCreateDesc {
        name,
        requirements,
        location: match memory_kind {
            MemoryKind::Device | MemoryKind::Exported => MemoryLocation::GpuOnly,
            MemoryKind::Upload => MemoryLocation::CpuToGpu,
            MemoryKind::Readback => MemoryLocation::GpuToCpu,
        },
        linear: true,
        allocation_scheme: if own {
            AllocationScheme::DedicatedBuffer(buffer)
        } else {
            AllocationScheme::GpuAllocatorManaged
        },
    };
    // The allocator makes the call only where it has no block with room: each is counted.
    context
        .code_of("vkAllocateMemory", || Ok(()))
        .map_err(|code| translate(context, name, purpose, requirements.size, code))?;
    let mut allocator = context
        .allocator
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    let allocation = allocator
        .allocate(&description)
        .map_err(|error| match error {
            AllocationError::OutOfMemory => {
                out_of_memory(context, name, purpose, requirements.size)
            }
            other => GpuError::Driver {
                call: "allocating memory",
                code: other.to_string(),
            },
        })?;
    // SAFETY: the memory is of this device, large enough and aligned as the buffer requires, and
    // the buffer is bound to nothing yet.
    let bound = context.code_of("vkBindBufferMemory", || unsafe {
        let device = &context.device;
        device.bind_buffer_memory(buffer, allocation.memory(), allocation.offset())
    });
    if let Err(code) = bound {
        // The allocation is unbound and of this allocator: freeing cannot fail, and the first error
        // is the one to report.
        let _ = allocator.free(allocation);
        return Err(translate(context, name, purpose, requirements.size, code));
    }
    let device_local = allocation
        .memory_properties()
        .contains(vk::MemoryPropertyFlags::DEVICE_LOCAL);
    Ok((Held::Allocated(allocation), requirements.size, device_local))
}

/// Device-local memory for `buffer` alone, bound to it, that can be exported; and its size.
fn allocate_exported(
    context: &Context,
    buffer: vk::Buffer,
) -> Result<(vk::DeviceMemory, u64), vk::Result> {
    // SAFETY: a query on a live buffer of this device.
    let requirements = unsafe { context.device.get_buffer_memory_requirements(buffer) };
    let memory_type = context
        .device_local_type(requirements.memory_type_bits)
        .ok_or(vk::Result::ERROR_OUT_OF_DEVICE_MEMORY)?;
    let mut export = export::memory_info();
    let mut dedicated = vk::MemoryDedicatedAllocateInfo::default().buffer(buffer);
    let allocate = vk::MemoryAllocateInfo::default()
        .allocation_size(requirements.size)
        .memory_type_index(memory_type)
        .push_next(&mut export)
        .push_next(&mut dedicated);
    // SAFETY: the type is one of those that the buffer may have, and the buffer was made for
    // exported memory.
    let memory = context.code_of("vkAllocateMemory", || unsafe {
        context.device.allocate_memory(&allocate, None)
    })?;
    // SAFETY: the memory was made for this buffer, which is bound to nothing yet.
    let bound = context.code_of("vkBindBufferMemory", || unsafe {
        context.device.bind_buffer_memory(buffer, memory, 0)
    });
    if let Err(code) = bound {
        // SAFETY: made above and bound to nothing.
        unsafe { context.device.free_memory(memory, None) };
        return Err(code);
    }
    Ok((memory, requirements.size))
}

fn translate(
    context: &Context,
    name: &'static str,
    purpose: &'static str,
    bytes: u64,
    code: vk::Result,
) -> GpuError {
    match code {
        vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
            out_of_memory(context, name, purpose, bytes)
        }
        _ => failed("making a buffer")(code),
    }
}

fn out_of_memory(
    context: &Context,
    name: &'static str,
    purpose: &'static str,
    wanted_bytes: u64,
) -> GpuError {
    let accounting = context
        .accounting
        .lock()
        .unwrap_or_else(PoisonError::into_inner);
    GpuError::OutOfMemory {
        name,
        purpose,
        wanted_bytes,
        used_bytes: accounting.report().total_bytes,
        used_by_purpose: accounting.used_by_purpose(),
        heap_bytes: context.limits.device_memory_bytes,
    }
}
