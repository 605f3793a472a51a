//! Ground, registration and traffic against truths that are known.

mod boxes;
mod controls;
mod ego;
mod episodes;
mod faults;
mod generate;
mod generated_difficulty;
mod generated_lights;
mod ground;
mod grounding;
mod lanes;
mod properties;
mod register;
mod roads;
mod route;
mod score;
mod traffic;
mod traffic_borders;
mod traffic_comfort;
mod traffic_invariants;
mod traffic_junctions;
mod traffic_lights;
mod traffic_liveness;
mod traffic_road_users;
mod traffic_scenes;
mod traffic_signs;
