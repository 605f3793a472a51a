//! Interfaces of compute kernels: the buffers, push constants and specialization constants that a
//! SPIR-V module declares.
//!
//! [`reflect`] reads an [`Interface`] from a module.
#![forbid(unsafe_code)]

mod interface;
mod module;
mod reflection;

pub use interface::{Binding, Interface, Member, Record, Size, SpecConstant};
pub use module::Kind;
pub use reflection::{records, reflect};

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
