//! DecoupleGS: 3D Gaussian Splatting for driving simulation, in Rust and Vulkan compute.
//!
//! A scene is a static background and agents that move in it. Both are clouds of 3D Gaussians, and
//! all of them meet in one depth order, so that agents and background hide each other exactly, per
//! pixel. All cameras of a vehicle's rig are drawn in one submission, on any Vulkan 1.3 device,
//! including lavapipe, which is software.
//!
//! This crate joins the engine's crates under one name and adds [`LiveScene`], where files meet the
//! device; [`session`], which is what other programs use: many scenes, worlds and views on one
//! device; [`episode`], the closed loop; and [`planner`], its drivers.
//!
//! | module | what it is | reads on |
//! |---|---|---|
//! | [`scene`] | what a world is: splats, poses, cameras, rules; plain data and mathematics | - |
//! | [`asset`] | how it is stored: splat files, maps, tracks, scene files, calibrated light, the synthetic street | `scene` |
//! | [`drive`] | how it moves: lanes, ground, registration of tracks, traffic, scores | `scene` |
//! | [`gpu`] | how we speak Vulkan: device, queue, memory, kernel; the only `unsafe` code | - |
//! | [`render`] | how it becomes images: the GPU frame, its f64 definition, and the error between two images | `scene`, `gpu` |
//!
//! Units are meters, seconds and radians. World: z up. Vehicle and agent: x forward, y left, z up.
//! Camera: OpenCV (x right, y down, z forward). Coordinates of the world are f64, so that a world
//! in UTM coordinates keeps its millimeters.
#![forbid(unsafe_code)]

pub mod episode;
pub mod explain;
mod live_scene;
pub mod planner;
pub mod session;

pub use decouplegs_asset as asset;
pub use decouplegs_drive as drive;
pub use decouplegs_gpu as gpu;
pub use decouplegs_render as render;
pub use decouplegs_scene as scene;
pub use live_scene::{AgentInstance, LiveEditError, LiveScene, SceneSnapshot};
