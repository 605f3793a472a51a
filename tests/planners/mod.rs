//! Who drives the ego: our own planners on small roads, and those of others, however they behave.

mod client;
mod driving;
mod misbehaving;
mod road_course;
mod rollouts;
mod scene_ahead;
