//! Inputs of the planners under test: two cameras, an agent and a route.

use decouplegs::planner::{
    EgoMotion, EpisodeInfo, External, KnownAgent, Navigation, Observation, Privileged, Reading,
    Timeouts, Transport, Turn,
};
use decouplegs::scene::{Intrinsics, Pose, RigCamera, RoadUser, Sensor, VehicleSize, VehicleState};
use glam::{DQuat, DVec2, DVec3};
use std::path::Path;
use std::time::Duration;

/// Long enough for a Python on a machine that does other things; no test waits for it to pass.
pub const PATIENT: Timeouts = Timeouts {
    hello: Duration::from_secs(120),
    answer: Duration::from_secs(120),
};

/// A script of this folder as a command.
pub fn script(name: &str, arguments: &[&str]) -> Transport {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/planners");
    let path = folder.join(name).to_string_lossy().into_owned();
    // Without -B Python leaves compiled files beside the sources.
    let words = ["python3".to_owned(), "-B".to_owned(), path].into_iter();
    Transport::Command(
        words
            .chain(arguments.iter().map(|&word| word.to_owned()))
            .collect(),
    )
}

/// The planner of a script that says hello as it should.
pub fn opened(name: &str, arguments: &[&str], timeouts: Timeouts) -> External {
    External::open(script(name, arguments), timeouts).expect("python3 runs the script")
}

pub fn cameras() -> Vec<RigCamera> {
    let camera = |name: &str, width_px, height_px, fov_rad| RigCamera {
        name: name.into(),
        intrinsics: Intrinsics::from_horizontal_fov(width_px, height_px, fov_rad),
        rig_from_camera: Pose::new(
            DQuat::from_xyzw(-0.5, 0.5, -0.5, 0.5),
            DVec3::new(1.5, 0.0, 0.75),
        ),
    };
    vec![camera("front", 37, 11, 1.2), camera("rear", 8, 5, 1.7)]
}

pub fn briefing() -> EpisodeInfo {
    EpisodeInfo {
        scenario: "test".into(),
        seed: 1,
        step_s: 0.5,
        ego_size: VehicleSize::CAR,
        rear_axle_to_middle_m: 1.35,
        sensors: cameras().into_iter().map(Sensor::Camera).collect(),
    }
}

pub fn privileged() -> Privileged {
    let state = |x: f64, yaw_rad| VehicleState {
        position_m: DVec2::new(x, -2.0),
        yaw_rad,
        speed_mps: 7.3,
        acceleration_mps2: 0.0,
    };
    Privileged {
        ego: state(512.123_456_789, 0.0),
        ego_size: VehicleSize::CAR,
        route_m: vec![DVec2::ZERO, DVec2::new(600.0, 0.1)],
        agents: vec![KnownAgent {
            kind: RoadUser::Car,
            state: state(20.0, std::f64::consts::FRAC_PI_3),
            size: VehicleSize::CAR,
        }],
        stop_lines: vec![],
        signs: vec![],
    }
}

/// An observation of step `step`.
pub fn observation<'a>(
    step: u32,
    readings: &'a [Reading<'a>],
    privileged: Option<&'a Privileged>,
) -> Observation<'a> {
    Observation {
        step,
        time_s: 0.5 * f64::from(step),
        readings,
        ego: EgoMotion {
            speed_mps: 7.3,
            ..EgoMotion::default()
        },
        guidance: Navigation {
            turn: Turn::Left,
            angle_rad: 1.25,
            cruise_mps: 10.0,
            ..Navigation::default()
        },
        localization: None,
        privileged,
    }
}
