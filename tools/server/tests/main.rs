//! The server as clients meet it: over gRPC on the loopback, drawing on the first device there is.

mod asking;
mod calibrated;
mod carla;
mod conforming;
mod contract;
mod crowd;
mod devices;
mod ego_masks;
mod hostile;
mod lasting;
mod lidar;
mod markers;
mod python;
mod rollout;
mod same_image;
mod scenes;
mod security;
