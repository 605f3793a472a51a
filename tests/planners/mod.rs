//! Planners of the ego: our own on small roads, and external ones, also misbehaving ones.

mod client;
mod driving;
mod misbehaving;
mod open_scenario;
mod road_course;
mod road_users;
mod rollouts;
mod scene_ahead;
mod several_egos;
mod static_world;
mod traffic_lights;
mod traffic_signs;
mod without_readings;
