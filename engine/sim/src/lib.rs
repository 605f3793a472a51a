//! The closed loop: [`episode`] moves the world and renders it, [`planner`] drives the ego,
//! [`footing`] sets agents of scene files on the ground.
#![forbid(unsafe_code)]

pub mod episode;
pub mod footing;
pub mod planner;
pub mod scenario_import;
