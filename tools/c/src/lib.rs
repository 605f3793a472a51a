//! DecoupleGS for C and C++: [`decouplegs::session`] behind functions that any language can call.
//!
//! `include/decouplegs.h` is made of these sources by cbindgen, comments included, so they speak to
//! those who write C. What the header says of all functions stands in `cbindgen.toml`.
//!
//! How it is kept safe:
//! - `boundary`: every call goes through one function, where panics end and errors become a status
//!   and a sentence.
//! - `handles`: a handle is a number that is looked up, never a pointer that is followed. So
//!   whatever a program does with handles is an error and not a crash, and rules about threads are
//!   checked instead of trusted.
//! - `arguments`: pointers are examined once, when a call begins, and become Rust's types there.
//!   What no library can see, a pointer to something else or an array shorter than its count, is
//!   left to the caller.
//!
//! Why both an ABI version and sizes: arrays of structs cannot have sizes in their elements without
//! costing those who draw thousands of cameras, so poses, cameras, views and images are frozen
//! under the version; options, devices and statistics are what grows.

mod arguments;
mod batch_renderer;
mod boundary;
mod handles;
mod lidar;
mod rig;
mod scene;
mod session;
mod status;
mod types;
mod world;
