//! Files of the closed loop: [`episode_log`] (what happened in an episode), [`scenario_file`] (a
//! scenario as TOML), [`open_scenario`] (ASAM OpenSCENARIO XML), [`hugsim_scenario`] (YAML of
//! HUGSIM).
#![forbid(unsafe_code)]

pub mod episode_log;
pub mod hugsim_scenario;
pub mod open_scenario;
pub mod scenario_file;
mod yaml;

pub use episode_log::{EpisodeLog, read_episode_log};
pub use hugsim_scenario::{HugsimScenario, read_hugsim_scenario};
pub use open_scenario::{OpenScenario, read_open_scenario};
pub use scenario_file::{read_scenario, write_scenario};
