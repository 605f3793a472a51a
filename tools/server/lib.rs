//! A render server for closed-loop simulators: images of scenes, and ground below vehicles, over
//! gRPC.
//!
//! | module | content |
//! |---|---|
//! | [`options`], [`names`] | options, and the names of the services |
//! | `request_guard`, `incoming` | admission: tokens, limits, deadlines, metrics |
//! | `sensorsim`, `lidar`, `physics` | the services: messages in, messages out |
//! | `render_request`, `sweep_request` | a checked request: cameras, LiDARs and agents |
//! | `scene_registry`, `read_ahead` | scenes that are served, their metadata, and the only one read ahead |
//! | `render_queue`, `devices`, `placement` | requests, and the device that draws a scene |
//! | `fair_queue` | the order of requests: each connection gets the same time of a device |
//! | `render_worker`, `request_renderer` | a thread that draws, and what it draws a scene with |
//! | [`conform`] | the client that judges any server of the contract |
//! | [`running`] | the server as a whole, until it is stopped |
//!
//! Messages, and their poses, cameras and images, are those of the crate `decouplegs-alpasim`.
//!
//! A client's `local` frame is the scene's world seen from the scene's origin: messages hold f32,
//! and a world may lie in UTM coordinates. Objects are placed by the centers of their boxes, as
//! agents are in a scene file.
#![forbid(unsafe_code)]

pub mod bench;
mod cache;
pub mod conform;
mod devices;
mod ego_masks;
mod fair_queue;
mod image_memory;
mod incoming;
mod lidar;
mod log_limit;
mod metrics;
mod metrics_page;
pub mod names;
pub mod options;
mod physics;
mod placement;
mod read_ahead;
mod reference_lens;
mod render_queue;
mod render_request;
mod render_worker;
mod request_guard;
mod request_renderer;
pub mod running;
mod scene_registry;
mod sensorsim;
mod sweep_request;
