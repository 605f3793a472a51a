//! Logs, scenario files and OpenSCENARIO as their users meet them.

mod episode_logs;
mod frozen;
mod open_scenarios;
mod scenario_files;
mod scenarios;
mod several_egos;
mod stories;
