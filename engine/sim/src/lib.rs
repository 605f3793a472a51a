//! The closed loop: [`episode`] moves the world and renders it, [`planner`] drives the ego,
//! [`recorded`] takes the ego along the way of a recording, [`track_import`] sets it among recorded
//! tracks, [`planner::agents`] are programs that drive the traffic, [`footing`] sets agents of
//! scene files on the ground, [`winnable`] tells whether a scenario can be won.
#![forbid(unsafe_code)]

pub mod episode;
pub mod footing;
pub mod hugsim_import;
pub mod names;
pub mod planner;
pub mod recorded;
pub mod scenario_import;
pub mod track_import;
pub mod winnable;
