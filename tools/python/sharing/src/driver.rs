//! The CUDA driver's functions, looked up at run time: what is built here runs where there is no
//! CUDA.

use std::ffi::{CStr, c_char, c_int, c_uint, c_void};
use std::sync::OnceLock;

use libloading::Library;

use crate::InteropError;

/// The driver's library. NVIDIA installs it under this name alone.
const LIBRARY: &str = "libcuda.so.1";

pub type Code = c_int;
/// Opaque pointers of the driver: contexts, streams, events, imported memory and semaphores.
pub type Handle = *mut c_void;

pub const SUCCESS: Code = 0;
pub const NOT_READY: Code = 600;

/// `CU_EXTERNAL_MEMORY_HANDLE_TYPE_OPAQUE_FD`.
pub const MEMORY_OPAQUE_FD: c_uint = 1;
/// `CUDA_EXTERNAL_MEMORY_DEDICATED`: the memory belongs to one buffer alone. Without it imports of
/// such memory may read elsewhere.
pub const MEMORY_DEDICATED: c_uint = 1;
/// `CU_EXTERNAL_SEMAPHORE_HANDLE_TYPE_TIMELINE_SEMAPHORE_FD`.
pub const TIMELINE_FD: c_uint = 9;
/// `CU_EVENT_DISABLE_TIMING`: such events cost less.
pub const EVENT_WITHOUT_TIMING: c_uint = 2;
/// `CU_STREAM_LEGACY` and `CU_STREAM_PER_THREAD`.
pub const STREAM_LEGACY: usize = 1;
pub const STREAM_PER_THREAD: usize = 2;

/// `CUuuid`.
#[repr(C)]
#[derive(Clone, Copy, Default)]
pub struct Uuid(pub [u8; 16]);

/// `CUDA_EXTERNAL_MEMORY_HANDLE_DESC`.
#[repr(C)]
#[derive(Default)]
pub struct MemoryHandle {
    pub kind: c_uint,
    pub handle: FdOrPointers,
    pub size: u64,
    pub flags: c_uint,
    pub reserved: [c_uint; 16],
}

/// A union of a descriptor and two pointers, of which only the descriptor is used: the little end
/// comes first.
#[repr(C, align(8))]
#[derive(Default)]
pub struct FdOrPointers {
    pub descriptor: c_int,
    pub unused: [c_uint; 3],
}

/// `CUDA_EXTERNAL_MEMORY_BUFFER_DESC`.
#[repr(C)]
#[derive(Default)]
pub struct MappedBuffer {
    pub offset: u64,
    pub size: u64,
    pub flags: c_uint,
    pub reserved: [c_uint; 16],
}

/// `CUDA_EXTERNAL_SEMAPHORE_HANDLE_DESC`.
#[repr(C)]
#[derive(Default)]
pub struct SemaphoreHandle {
    pub kind: c_uint,
    pub handle: FdOrPointers,
    pub flags: c_uint,
    pub reserved: [c_uint; 16],
}

/// `CUDA_EXTERNAL_SEMAPHORE_WAIT_PARAMS`.
#[repr(C)]
#[derive(Default)]
pub struct SemaphoreWait {
    /// Target value of a timeline.
    pub value: u64,
    pub unused: [u64; 3],
    pub reserved: [c_uint; 10],
    pub flags: c_uint,
    pub reserved_too: [c_uint; 16],
}

// The sizes that cuda.h gives them on 64-bit Linux.
const _: () = assert!(size_of::<MemoryHandle>() == 104 && size_of::<MappedBuffer>() == 88);
const _: () = assert!(size_of::<SemaphoreHandle>() == 96 && size_of::<SemaphoreWait>() == 144);
const _: () = assert!(
    std::mem::offset_of!(MemoryHandle, size) == 24
        && std::mem::offset_of!(SemaphoreWait, flags) == 72
);

macro_rules! functions {
    ($($field:ident = $name:literal: fn($($argument:ty),*);)*) => {
        /// The functions that are needed.
        pub struct Functions {
            $(pub $field: unsafe extern "C" fn($($argument),*) -> Code,)*
            /// Keeps them loaded.
            _library: Library,
        }

        impl Functions {
            fn load() -> Result<Self, InteropError> {
                let missing = |error: libloading::Error| InteropError::Missing(error.to_string());
                // SAFETY: the driver's library does nothing when it is loaded that has to be
                // prepared for.
                let library = unsafe { Library::new(LIBRARY) }.map_err(missing)?;
                $(
                    // SAFETY: the type is that of the function of this name in cuda.h, which its
                    // version in the name keeps.
                    let $field = *unsafe { library.get::<unsafe extern "C" fn($($argument),*) -> Code>(concat!($name, "\0").as_bytes()) }
                        .map_err(missing)?;
                )*
                Ok(Self { $($field,)* _library: library })
            }
        }
    };
}

functions! {
    init = "cuInit": fn(c_uint);
    error_name = "cuGetErrorName": fn(Code, *mut *const c_char);
    device_count = "cuDeviceGetCount": fn(*mut c_int);
    device_get = "cuDeviceGet": fn(*mut c_int, c_int);
    device_uuid = "cuDeviceGetUuid": fn(*mut Uuid, c_int);
    retain_primary = "cuDevicePrimaryCtxRetain": fn(*mut Handle, c_int);
    release_primary = "cuDevicePrimaryCtxRelease_v2": fn(c_int);
    push_context = "cuCtxPushCurrent_v2": fn(Handle);
    pop_context = "cuCtxPopCurrent_v2": fn(*mut Handle);
    import_memory = "cuImportExternalMemory": fn(*mut Handle, *const MemoryHandle);
    map_buffer = "cuExternalMemoryGetMappedBuffer": fn(*mut u64, Handle, *const MappedBuffer);
    destroy_memory = "cuDestroyExternalMemory": fn(Handle);
    free = "cuMemFree_v2": fn(u64);
    import_semaphore = "cuImportExternalSemaphore": fn(*mut Handle, *const SemaphoreHandle);
    destroy_semaphore = "cuDestroyExternalSemaphore": fn(Handle);
    wait_semaphores = "cuWaitExternalSemaphoresAsync": fn(*const Handle, *const SemaphoreWait, c_uint, Handle);
    create_event = "cuEventCreate": fn(*mut Handle, c_uint);
    record_event = "cuEventRecord": fn(Handle, Handle);
    query_event = "cuEventQuery": fn(Handle);
    synchronize_event = "cuEventSynchronize": fn(Handle);
    destroy_event = "cuEventDestroy_v2": fn(Handle);
}

impl Functions {
    /// The driver, initialized once for the process.
    pub fn of_process() -> Result<&'static Self, InteropError> {
        static FUNCTIONS: OnceLock<Result<Functions, InteropError>> = OnceLock::new();
        let loaded = FUNCTIONS.get_or_init(|| {
            let functions = Self::load()?;
            // SAFETY: may be called at any time; flags must be 0.
            let code = unsafe { (functions.init)(0) };
            functions
                .check("cuInit", code)
                .map_err(|error| InteropError::Missing(error.to_string()))?;
            Ok(functions)
        });
        loaded.as_ref().map_err(Clone::clone)
    }

    /// An error where `code` is one.
    pub fn check(&self, call: &'static str, code: Code) -> Result<(), InteropError> {
        if code == SUCCESS {
            Ok(())
        } else {
            Err(InteropError::Call {
                call,
                code: self.name_of(code),
            })
        }
    }

    fn name_of(&self, code: Code) -> String {
        let mut name: *const c_char = std::ptr::null();
        // SAFETY: writes a pointer to a text that lives as long as the library, or leaves it null
        // for an unknown code.
        let found = unsafe { (self.error_name)(code, &raw mut name) };
        if found != SUCCESS || name.is_null() {
            return format!("CUDA error {code}");
        }
        // SAFETY: the driver's names are texts that end in a zero and are never freed.
        unsafe { CStr::from_ptr(name) }
            .to_string_lossy()
            .into_owned()
    }
}
