//! Integration tests: what only shows when the crates meet.

mod data;
mod device;
mod frames;
mod planners;
mod planners_vision;
mod stages;
mod tidy;
mod truths;
