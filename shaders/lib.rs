//! Compute kernels: GLSL sources, and their SPIR-V in `spirv`, which `make shaders` compiles with
//! shaderc. The build refuses SPIR-V that is older than its sources; `.ci/run` compiles all of it
//! again and compares the bytes.
//!
//! Each `NAME.comp` in this folder is a [`Kernel`] here called `NAME` in capitals. Names of
//! buffers, structure members and specialization constants are kept in the SPIR-V: `make shaders`
//! makes Rust types of them, in `interfaces`.
#![forbid(unsafe_code)]

/// One compiled compute shader.
#[derive(Debug)]
pub struct Kernel {
    /// The stem of its source file.
    pub name: &'static str,
    /// SPIR-V words.
    pub spirv: &'static [u32],
}

include!(concat!(env!("OUT_DIR"), "/kernels.rs"));

/// Numbers that shaders and host share. Their one source is the shared GLSL.
pub mod constants {
    #![expect(clippy::approx_constant, reason = "written as the shaders write them")]
    include!(concat!(env!("OUT_DIR"), "/constants.rs"));
}
