//! Planners that see images: `vision`, shown images of which the truth is known, and `learned`.

mod drawn_road;
mod driven;
mod hostile;
mod learned;

use decouplegs::planner::{
    EgoMotion, EpisodeInfo, Navigation, Observation, Perception, Planner, Reading, Vision,
};
use decouplegs::scene::{Plan, RigCamera, Sensor};

use drawn_road::EGO;

/// The planner before an episode with `camera`.
fn beginner(camera: &RigCamera) -> Vision {
    let mut vision = Vision::default();
    vision
        .begin(&briefing(camera))
        .expect("it needs nothing to begin");
    vision
}

/// Facts that a planner is told before an episode with `camera`.
fn briefing(camera: &RigCamera) -> EpisodeInfo {
    EpisodeInfo {
        scenario: "test".into(),
        seed: 1,
        step_s: 0.5,
        ego_size: EGO,
        rear_axle_to_middle_m: 1.4,
        sensors: vec![Sensor::Camera(camera.clone())],
    }
}

/// Perception and plan at step `step`.
fn shown(
    vision: &mut Vision,
    step: u32,
    readings: &[Reading],
    ego: EgoMotion,
    guidance: Navigation,
) -> (Perception, Plan) {
    let time_s = 0.5 * f64::from(step);
    let observation = Observation {
        step,
        time_s,
        readings,
        ego,
        guidance,
        localization: None,
        privileged: None,
    };
    let plan = vision.plan(&observation).expect("it always has a plan");
    (vision.perception().expect("it began"), plan)
}

fn cruising(cruise_mps: f64) -> Navigation {
    Navigation {
        distance_m: 100.0,
        cruise_mps,
        ..Navigation::default()
    }
}
