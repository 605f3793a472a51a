//! The closed loop: [`episode`] moves the world and renders it, [`planner`] drives the ego.
#![forbid(unsafe_code)]

pub mod episode;
pub mod planner;
pub mod scenario_import;
