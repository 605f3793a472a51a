//! Driving by perception on a drawn road: what is planned is driven by the ego's bicycle, and what
//! is seen then follows from it.

use std::f64::consts::FRAC_PI_2;

use decouplegs::drive::{Ego, EgoOptions};
use decouplegs::planner::{EgoMotion, Reading};
use decouplegs::scene::VehicleState;
use glam::DVec2;

use super::drawn_road::{DrawnRoad, EGO, camera};
use super::{beginner, cruising, shown};

const STEP_S: f64 = 0.5;

fn ego_at(position_m: DVec2, yaw_rad: f64, speed_mps: f64) -> Ego {
    Ego::new(
        VehicleState {
            position_m,
            yaw_rad,
            speed_mps,
            acceleration_mps2: 0.0,
        },
        EGO,
        EgoOptions::default(),
    )
}

fn motion(ego: &Ego) -> EgoMotion {
    let VehicleState {
        speed_mps,
        acceleration_mps2,
        ..
    } = ego.state();
    EgoMotion {
        speed_mps,
        acceleration_mps2,
        steer_rad: ego.steer_rad(),
        yaw_rate_radps: ego.yaw_rate_radps(),
    }
}

/// A lane that begins at the origin along x, with an even bend.
fn seen_from(state: &VehicleState, curvature: f64) -> DrawnRoad {
    let (offset_m, lane_rad) = if curvature == 0.0 {
        (-state.position_m.y, 0.0)
    } else {
        let from_center = state.position_m - DVec2::new(0.0, 1.0 / curvature);
        let outside_m = from_center.length() - 1.0 / curvature.abs();
        (
            outside_m * curvature.signum(),
            (from_center * -curvature.signum()).to_angle() - FRAC_PI_2 * curvature.signum(),
        )
    };
    DrawnRoad {
        offset_m,
        heading_rad: lane_rad - state.yaw_rad,
        curvature,
        dashes_m: -state.position_m.x,
        ..DrawnRoad::default()
    }
}

/// Drives a lane for `steps` steps; the offset from its middle after each, meters.
fn drive_lane(curvature: f64, start: DVec2, yaw_rad: f64, steps: u32) -> Vec<f64> {
    let (camera, mut ego) = (camera(), ego_at(start, yaw_rad, 8.0));
    let mut vision = beginner(&camera);
    let mut offsets_m = Vec::new();
    for step in 0..steps {
        let rgba = seen_from(&ego.state(), curvature).image(&camera);
        let (_, plan) = shown(
            &mut vision,
            step,
            &[Reading::image(&camera, &rgba)],
            motion(&ego),
            cruising(9.0),
        );
        ego.follow(&plan);
        ego.step(STEP_S);
        offsets_m.push(seen_from(&ego.state(), curvature).offset_m);
    }
    offsets_m
}

#[test]
fn it_comes_back_to_the_middle_of_its_lane_and_stays() {
    for (start_m, yaw_rad) in [(0.5, 0.0), (-0.4, -0.03), (0.0, 0.05)] {
        let offsets_m = drive_lane(0.0, DVec2::new(0.0, start_m), yaw_rad, 24);
        assert!(
            offsets_m.iter().all(|offset_m| offset_m.abs() < 0.8),
            "{offsets_m:.2?}"
        );
        assert!(
            offsets_m[10..].iter().all(|offset_m| offset_m.abs() < 0.2),
            "{offsets_m:.2?}"
        );
    }
}

#[test]
fn it_follows_a_bend() {
    for curvature in [1.0 / 120.0, -1.0 / 120.0] {
        let offsets_m = drive_lane(curvature, DVec2::ZERO, 0.0, 30);
        assert!(
            offsets_m.iter().all(|offset_m| offset_m.abs() < 0.7),
            "{offsets_m:.2?}"
        );
    }
}

/// Drives behind a car that is `gap_m` ahead at the start and drives `speed_mps`; gap and speed
/// after each step.
fn drive_behind(gap_m: f64, lead_mps: f64, steps: u32) -> Vec<(f64, f64)> {
    let (camera, mut ego) = (camera(), ego_at(DVec2::ZERO, 0.0, 9.0));
    let mut vision = beginner(&camera);
    let rear_m = |step: u32| 0.5 * EGO.length_m + gap_m + lead_mps * STEP_S * f64::from(step);
    let gap_at =
        |step: u32, state: &VehicleState| rear_m(step) - state.position_m.x - 0.5 * EGO.length_m;
    let mut driven = Vec::new();
    for step in 0..steps {
        let gap_m = gap_at(step, &ego.state());
        let rgba = DrawnRoad {
            gap_m: Some(gap_m),
            ..seen_from(&ego.state(), 0.0)
        }
        .image(&camera);
        let (_, plan) = shown(
            &mut vision,
            step,
            &[Reading::image(&camera, &rgba)],
            motion(&ego),
            cruising(10.0),
        );
        ego.follow(&plan);
        ego.step(STEP_S);
        driven.push((gap_at(step + 1, &ego.state()), ego.state().speed_mps));
    }
    driven
}

#[test]
fn it_stops_behind_a_car_that_stands() {
    for gap_m in [25.0, 40.0, 60.0] {
        let driven = drive_behind(gap_m, 0.0, 40);
        assert!(driven.iter().all(|(gap_m, _)| *gap_m > 1.0), "{driven:.1?}");
        let (gap_m, speed_mps) = driven[driven.len() - 1];
        assert!(gap_m < 7.0 && speed_mps < 0.3, "{driven:.1?}");
    }
}

#[test]
fn it_follows_a_slower_car() {
    let driven = drive_behind(20.0, 5.0, 40);
    assert!(driven.iter().all(|(gap_m, _)| *gap_m > 3.0), "{driven:.1?}");
    let (gap_m, speed_mps) = driven[driven.len() - 1];
    assert!(
        (8.0..25.0).contains(&gap_m) && (speed_mps - 5.0).abs() < 1.0,
        "{driven:.1?}"
    );
}
