//! Interfaces of compute kernels: the buffers, push constants and specialization constants that a
//! SPIR-V module declares.
//!
//! [`reflect`] reads an [`Interface`] from a module.
#![forbid(unsafe_code)]

mod module;
mod reflection;

pub use module::Kind;
pub use reflection::{Block, Interface, ReflectedBinding, ReflectedConstant, reflect};

/// Access of a kernel to a buffer, from `readonly` and `writeonly` in the shader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Declared `readonly`.
    Read,
    /// Declared `writeonly`.
    Write,
    /// Declared neither.
    ReadWrite,
}
