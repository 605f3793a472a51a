//! A render server for closed-loop simulators: images of scenes, and ground below vehicles, over
//! gRPC.
//!
//! | module | content |
//! |---|---|
//! | `proto/`, [`wire`], `codec` | the messages of the public contract, and how they are read without trusting their counts |
//! | [`options`], [`names`] | options, and the names of the services |
//! | `request_guard`, `connections` | admission: tokens, limits, deadlines, metrics |
//! | `sensorsim`, `lidar`, `physics` | the services: messages in, messages out |
//! | `render_request`, `sweep_request`, `poses`, `camera_spec` | a checked request: cameras, LiDARs and agents |
//! | `scene_registry` | scenes that are served, and their metadata |
//! | `render_queue`, `scene_renderer` | the thread that draws, and a scene on the device |
//! | [`encoding`] | images as PNG, JPEG or planes, on threads of their own |
//! | [`conform`] | the client that judges any server of the contract |
//! | [`egodriver`] | the client of driving policies: a planner of the closed loop |
//! | [`running`] | the server as a whole, until it is stopped |
//!
//! A client's `local` frame is the scene's world seen from the scene's origin: messages hold f32,
//! and a world may lie in UTM coordinates. Objects are placed by the centers of their boxes, as
//! agents are in a scene file.
#![forbid(unsafe_code)]

pub mod bench;
mod cache;
mod camera_spec;
mod codec;
pub mod conform;
mod connections;
pub mod egodriver;
pub mod encoding;
mod image_memory;
mod lidar;
mod log_limit;
mod metrics;
mod metrics_page;
pub mod names;
pub mod options;
mod physics;
mod poses;
mod render_queue;
mod render_request;
mod request_guard;
pub mod running;
mod scene_registry;
mod scene_renderer;
mod sensorsim;
mod sweep_request;
pub mod wire;
