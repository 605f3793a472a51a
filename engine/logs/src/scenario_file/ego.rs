//! The TOML form of an ego.

use decouplegs_scene::VehicleSize;
use decouplegs_scene::scenario::EgoTask;
use serde::{Deserialize, Serialize};

use super::form::default_size_m;

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub(super) struct EgoForm {
    pub(super) route: Vec<String>,
    pub(super) start_m: f64,
    pub(super) end_m: f64,
    pub(super) speed_mps: f64,
    pub(super) cruise_mps: f64,
    #[serde(default = "default_size_m")]
    pub(super) size_m: [f64; 3],
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub(super) follows_recording: bool,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub(super) start_pose: Option<[f64; 3]>,
}

impl EgoForm {
    pub(super) fn from_task(ego: &EgoTask) -> Self {
        Self {
            route: ego.route.clone(),
            start_m: ego.start_m,
            end_m: ego.end_m,
            speed_mps: ego.speed_mps,
            cruise_mps: ego.cruise_mps,
            size_m: ego.size.to_array(),
            follows_recording: ego.follows_recording,
            start_pose: ego.start_pose,
        }
    }

    pub(super) fn task(&self) -> EgoTask {
        EgoTask {
            route: self.route.clone(),
            start_m: self.start_m,
            end_m: self.end_m,
            speed_mps: self.speed_mps,
            cruise_mps: self.cruise_mps,
            size: VehicleSize::from_array(self.size_m),
            follows_recording: self.follows_recording,
            start_pose: self.start_pose,
        }
    }
}
