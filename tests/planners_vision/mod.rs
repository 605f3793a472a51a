//! The planner that looks, shown images of which the truth is known.

mod drawn;
mod drawn_road;
mod driven;
mod hostile;
mod rendered;

use decouplegs::planner::{EpisodeInfo, EgoMotion, Reading, Navigation, Observation, Planner, Perception, Vision};
use decouplegs::scene::{Plan, RigCamera};

use drawn_road::EGO;

/// The planner before an episode with `camera`.
fn beginner(camera: &RigCamera) -> Vision {
    let mut vision = Vision::default();
    let briefing = EpisodeInfo { scenario: "test".into(), step_s: 0.5, ego_size: EGO, cameras: vec![camera.clone()] };
    vision.begin(&briefing).expect("it needs nothing to begin");
    vision
}

/// Perception and plan at step `step`.
fn shown(vision: &mut Vision, step: u32, readings: &[Reading], ego: EgoMotion, guidance: Navigation) -> (Perception, Plan) {
    let time_s = 0.5 * f64::from(step);
    let observation = Observation { step, time_s, readings, ego, guidance, privileged: None };
    let plan = vision.plan(&observation).expect("it always has a plan");
    (vision.perception().expect("it began"), plan)
}

/// Perception of a first image.
fn glance(camera: &RigCamera, rgba: &[u8]) -> Perception {
    let ego = EgoMotion { speed_mps: 8.0, ..EgoMotion::default() };
    shown(&mut beginner(camera), 0, &[Reading::image(camera, rgba)], ego, cruising(10.0)).0
}

fn cruising(cruise_mps: f64) -> Navigation {
    Navigation { distance_m: 100.0, cruise_mps, ..Navigation::default() }
}
