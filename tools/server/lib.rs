//! A render server for closed-loop simulators: images of scenes, and ground below vehicles, over
//! gRPC.
//!
//! | file | what it is |
//! |---|---|
//! | `proto/`, [`wire`], `codec` | the messages of the public contract, and how they are read without trusting their counts |
//! | [`options`], [`names`] | what can be set, and the names under which services are found |
//! | `guard`, `connections` | who comes in: tokens, limits, deadlines, what is counted |
//! | `sensorsim`, `physics` | the services: messages in, messages out |
//! | `request`, `poses`, `camera_spec` | a request, checked: cameras and agents where they stand at mid-shutter |
//! | `registry` | which scenes there are, and what is told of them without drawing |
//! | `render_queue`, `scene_renderer` | the one thread that draws, and a scene on the device |
//! | [`encoding`] | images as PNG, JPEG or planes, on threads of their own |
//! | [`running`] | all of it together, until it is told to stop |
//!
//! A client's `local` frame is the scene's world seen from the scene's origin: messages hold f32,
//! and a world may lie in UTM coordinates. Objects are placed by the centers of their boxes, as
//! agents are in a scene file.
#![forbid(unsafe_code)]

pub mod bench;
mod cache;
mod camera_spec;
mod codec;
mod connections;
pub mod encoding;
mod jpeg;
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
pub mod wire;
