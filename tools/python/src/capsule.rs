//! Capsules of DLPack (github.com/dmlc/dlpack, `dlpack.h`): tensors that one library hands to
//! another.
//!
//! A capsule owns a struct on the heap that begins with DLPack's own, and a keeper that holds the
//! memory. The consumer of the tensor renames the capsule and calls the deleter once, from any
//! thread; a capsule that nobody took calls it itself.

use std::any::Any;
use std::ffi::{CStr, c_void};

use pyo3::ffi;
use pyo3::prelude::*;

/// The version that is written: the first with flags.
const VERSION: [u32; 2] = [1, 0];
/// `DLPACK_FLAG_BITMASK_READ_ONLY`.
const READ_ONLY: u64 = 1;

const NAME: &CStr = c"dltensor";
const NAME_VERSIONED: &CStr = c"dltensor_versioned";

/// `DLDeviceType` and the device's number.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Device {
    pub kind: i32,
    pub number: i32,
}

impl Device {
    pub const CPU: i32 = 1;
    pub const CUDA: i32 = 2;
}

/// `DLDataType`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DataType {
    code: u8,
    bits: u8,
    lanes: u16,
}

impl DataType {
    pub const U8: Self = Self {
        code: 1,
        bits: 8,
        lanes: 1,
    };
    pub const F32: Self = Self {
        code: 2,
        bits: 32,
        lanes: 1,
    };
    pub const I32: Self = Self {
        code: 0,
        bits: 32,
        lanes: 1,
    };

    pub fn bytes(self) -> u64 {
        u64::from(self.bits) / 8
    }

    /// Name of the type in NumPy.
    pub fn name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::F32 => "float32",
            _ => "int32",
        }
    }
}

/// `DLTensor`.
#[repr(C)]
struct DlTensor {
    data: *mut c_void,
    device: Device,
    ndim: i32,
    dtype: DataType,
    shape: *mut i64,
    strides: *mut i64,
    byte_offset: u64,
}

/// `DLManagedTensor`, with what belongs to it behind.
#[repr(C)]
struct Managed {
    tensor: DlTensor,
    context: *mut c_void,
    deleter: unsafe extern "C" fn(*mut Managed),
    held: Held,
}

/// `DLManagedTensorVersioned`, with what belongs to it behind.
#[repr(C)]
struct ManagedVersioned {
    version: [u32; 2],
    context: *mut c_void,
    deleter: unsafe extern "C" fn(*mut ManagedVersioned),
    flags: u64,
    tensor: DlTensor,
    held: Held,
}

const _: () = assert!(size_of::<DlTensor>() == 48 && std::mem::offset_of!(Managed, held) == 64);
const _: () = assert!(
    std::mem::offset_of!(ManagedVersioned, tensor) == 32
        && std::mem::offset_of!(Managed, deleter) == 56
);

/// Data that a tensor needs while it is in use.
struct Held {
    shape: Box<[i64]>,
    strides: Box<[i64]>,
    _keeper: Box<dyn Any + Send>,
}

/// A tensor in C order.
pub struct Description {
    pub address: u64,
    pub device: Device,
    pub dtype: DataType,
    pub shape: Vec<i64>,
}

impl Description {
    fn held(&self, keeper: Box<dyn Any + Send>) -> Held {
        let mut strides = vec![1; self.shape.len()];
        for axis in (1..self.shape.len()).rev() {
            strides[axis - 1] = strides[axis] * self.shape[axis];
        }
        Held {
            shape: self.shape.clone().into(),
            strides: strides.into(),
            _keeper: keeper,
        }
    }

    /// Describes the tensor; its pointers go into `held`, whose boxes do not move.
    fn tensor(&self, held: &mut Held) -> DlTensor {
        DlTensor {
            data: std::ptr::with_exposed_provenance_mut(self.address as usize),
            device: self.device,
            ndim: self.shape.len() as i32,
            dtype: self.dtype,
            shape: held.shape.as_mut_ptr(),
            strides: held.strides.as_mut_ptr(),
            byte_offset: 0,
        }
    }

    /// A capsule of it, read-only where `versioned` capsules can say so. `keeper` is dropped when
    /// the consumer releases it.
    pub fn capsule(
        &self,
        py: Python<'_>,
        keeper: Box<dyn Any + Send>,
        versioned: bool,
    ) -> PyResult<Py<PyAny>> {
        let mut held = self.held(keeper);
        let tensor = self.tensor(&mut held);
        let (pointer, name, destructor): (*mut c_void, &CStr, ffi::PyCapsule_Destructor) =
            if versioned {
                let context = std::ptr::null_mut();
                let managed = ManagedVersioned {
                    version: VERSION,
                    context,
                    deleter: delete_versioned,
                    flags: READ_ONLY,
                    tensor,
                    held,
                };
                (
                    Box::into_raw(Box::new(managed)).cast(),
                    NAME_VERSIONED,
                    destroy_versioned,
                )
            } else {
                let managed = Managed {
                    tensor,
                    context: std::ptr::null_mut(),
                    deleter: delete,
                    held,
                };
                (Box::into_raw(Box::new(managed)).cast(), NAME, destroy)
            };
        // SAFETY: the interpreter's lock is held, the name is static, and the pointer is not null.
        let capsule = unsafe { ffi::PyCapsule_New(pointer, name.as_ptr(), Some(destructor)) };
        // SAFETY: a new reference, or null with an exception set.
        unsafe { Bound::from_owned_ptr_or_err(py, capsule) }.map(Bound::unbind)
    }
}

/// The consumer is done.
unsafe extern "C" fn delete(managed: *mut Managed) {
    // SAFETY: made by `capsule` from a box, and deleted once, as DLPack has it.
    drop(unsafe { Box::from_raw(managed) });
}

/// The consumer is done.
unsafe extern "C" fn delete_versioned(managed: *mut ManagedVersioned) {
    // SAFETY: made by `capsule` from a box, and deleted once, as DLPack has it.
    drop(unsafe { Box::from_raw(managed) });
}

/// The capsule goes. The consumer of the tensor has renamed it.
unsafe extern "C" fn destroy(capsule: *mut ffi::PyObject) {
    // SAFETY: the interpreter calls this with the capsule that it destroys.
    if let Some(managed) = unsafe { not_taken(capsule, NAME) } {
        // SAFETY: of this name are only capsules made with this struct, and nobody has deleted it.
        unsafe { delete(managed.cast()) };
    }
}

/// The capsule goes. The consumer of the tensor has renamed it.
unsafe extern "C" fn destroy_versioned(capsule: *mut ffi::PyObject) {
    // SAFETY: the interpreter calls this with the capsule that it destroys.
    if let Some(managed) = unsafe { not_taken(capsule, NAME_VERSIONED) } {
        // SAFETY: of this name are only capsules made with this struct, and nobody has deleted it.
        unsafe { delete_versioned(managed.cast()) };
    }
}

/// Pointer in `capsule` if it still has its `name`.
///
/// # Safety
/// The object is a capsule, and the interpreter's lock is held.
unsafe fn not_taken(capsule: *mut ffi::PyObject, name: &CStr) -> Option<*mut c_void> {
    // SAFETY: the caller's promise.
    let valid = unsafe { ffi::PyCapsule_IsValid(capsule, name.as_ptr()) };
    // SAFETY: it is valid under this name, so that no exception is set.
    (valid == 1).then(|| unsafe { ffi::PyCapsule_GetPointer(capsule, name.as_ptr()) })
}
