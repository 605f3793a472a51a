//! DecoupleGS: 3D Gaussian Splatting for driving simulation, in Rust and Vulkan compute.
//!
//! A scene is a static background and agents that move in it. Both are clouds of 3D Gaussians, and
//! all of them meet in one depth order, so that agents and background hide each other exactly, per
//! pixel. All cameras of a vehicle's rig are drawn in one submission, on any Vulkan 1.3 device,
//! including lavapipe, which is software.
//!
//! This crate joins the engine's crates under one name: [`session`], the interface for other
//! programs (many scenes, worlds and views on one device); [`episode`], the closed loop; and
//! [`planner`], its planners.
//!
//! Most programs need only the names at the top of this crate: a [`Session`] opens a device and
//! scenes on it, a [`World`] moves agents over a scene, and a [`BatchRenderer`] draws worlds for
//! cameras.
//!
//! | module | content | depends on |
//! |---|---|---|
//! | [`scene`] | data types: splats, poses, cameras, lenses, rules, light, lane maps, episodes | - |
//! | [`asset`] | file formats: splats, maps, tracks, scene files, probes | `scene` |
//! | [`logs`] | files of the closed loop: logs, scenarios | `scene`, `asset` |
//! | [`synth`] | procedural streets, roads of maps as splats, environment probes | `scene` |
//! | [`train`] | compression by vector quantization | `scene` |
//! | [`drive`] | lanes, ground, registration of tracks, traffic, scores | `scene` |
//! | [`gpu`] | Vulkan: device, queues, memory, kernels; the only `unsafe` code | - |
//! | [`render`] | images: the GPU frame, its f64 reference, differences between images | `scene`, `gpu` |
//!
//! Units are meters, seconds and radians. World: z up. Vehicle and agent: x forward, y left, z up.
//! Camera: OpenCV (x right, y down, z forward). Coordinates of the world are f64, so that a world
//! in UTM coordinates keeps its millimeters.
#![forbid(unsafe_code)]

pub use decouplegs_scene::explain;

pub use decouplegs_asset as asset;
pub use decouplegs_drive as drive;
pub use decouplegs_gpu as gpu;
pub use decouplegs_logs as logs;
pub use decouplegs_render as render;
pub use decouplegs_scene as scene;
pub use decouplegs_session::{
    self as session, AgentInstance, measure_movable_scene, open_movable_scene,
};
pub use decouplegs_sim::{
    episode, footing, hugsim_import, names, planner, recorded, scenario_import, track_import,
    winnable,
};
pub use decouplegs_synth as synth;
pub use decouplegs_train as train;
pub use glam;
pub use scene::{Camera, Framing, Intrinsics, Pose, Rig, Rules, Scenario, SplatCloud, Trajectory};
pub use session::{
    BatchRenderer, HostImages, RigRenderer, RigSweep, Scene, Session, SessionError, SessionOptions,
    World, WorldView, save_png,
};
