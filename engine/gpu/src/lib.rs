//! Vulkan layer of DecoupleGS: compute only, without knowledge of splats.
//!
//! A [`Gpu`] is opened once. Buffers are typed and counted by purpose ([`Buffer`]), kernels take
//! them as members of a structure ([`Kernel`], [`Shader`]), a [`Recorder`] lists dispatches, and
//! submitting makes a command buffer with barriers of them, or repeats one that did the same, and
//! gives a [`Ticket`] to wait for and to read times from.
//!
//! # Reading order
//! `choice` and `device` (opening), `memory` and `buffer`, `shader`, `kernel` and
//! `kernel_cache`, `recorder`, `commands` and `hazards` (all barriers),
//! `queue` (submitting, waiting, repeating), `transfer` (staged uploads and reads).
//!
//! # What is not done here
//! - No robust access: a kernel that reads or writes out of bounds is undefined, as robustness
//!   costs time in every access. Kernels check their own bounds; tests run on lavapipe with
//!   validation, where a wild access tends to be seen.
//! - No images, no graphics pipelines, no presentation, no buffer addresses: synchronization
//!   validation sees descriptors, not addresses.
//! - No ordering between the host and the device but through tickets: writing an upload buffer
//!   while submitted work reads it is the caller's race to avoid.
//!
//! This is the only crate with `unsafe`; each block is one operation and says why it is sound.

mod accounting;
mod buffer;
mod choice;
mod commands;
mod context;
mod device;
mod drill;
mod drivers;
mod error;
mod export;
mod gpu;
mod hazards;
mod info;
mod instance;
mod kernel;
mod kernel_cache;
mod memory;
mod queue;
mod recorder;
mod shader;
mod slot;
mod ticket;
mod transfer;
mod trial;

pub use buffer::{Bound, BoundMemory, Buffer, MemoryKind};
pub use choice::{DeviceChoice, DeviceOptions, DeviceSet, QueueUse};
pub use decouplegs_spirv::{Access, Binding, Interface, Kind, Member, Size, SpecConstant};
pub use drill::Drill;
pub use error::GpuError;
pub use export::ExportedMemory;
pub use gpu::{DeviceClock, Gpu};
pub use info::{DeviceInfo, DeviceKind, Limits, MemoryReport};
pub use kernel::{Constant, Kernel};
pub use kernel_cache::{KernelCache, KernelCounts};
pub use queue::QueueRole;
pub use recorder::Recorder;
pub use shader::{Shader, member_bytes};
pub use ticket::{StageTime, Ticket};
pub use transfer::Uploads;
pub use trial::{KernelReport, KernelTrial};
