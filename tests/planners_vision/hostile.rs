//! Images and numbers that make no sense.

use decouplegs::planner::{EgoMotion, Planner, Reading, Vision};
use decouplegs::scene::{Plan, RigCamera};

use super::drawn_road::camera;
use super::{beginner, cruising, shown};

/// Checks that a car at `speed_mps` could follow the plan: never backwards, never far.
fn assert_drivable(plan: &Plan, speed_mps: f64, what: &str) {
    let mut before = (0.0, glam::DVec2::ZERO);
    for point in plan.points() {
        let (dt_s, moved_m) = (point.time_s - before.0, point.position_m - before.1);
        assert!(
            point.position_m.is_finite() && moved_m.length() < (speed_mps.max(20.0) + 1.0) * dt_s,
            "{what}: {plan:?}"
        );
        assert!(
            moved_m.x > -0.2 || moved_m.length() < 0.05,
            "{what}: backwards in {plan:?}"
        );
        before = (point.time_s, point.position_m);
    }
}

fn of_size(width_px: u32, height_px: u32) -> RigCamera {
    let camera = camera();
    RigCamera {
        intrinsics: camera.intrinsics.resized(width_px, height_px),
        ..camera
    }
}

#[test]
fn images_of_nothing_leave_a_plan_to_drive() {
    let mut state = 7_u64;
    for (width_px, height_px) in [(1, 1), (2, 1), (1, 90), (320, 180), (1601, 901)] {
        let camera = of_size(width_px, height_px);
        let bytes = camera.intrinsics.pixels() as usize * 4;
        let mut noise = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        let noise: Vec<u8> = (0..bytes).map(|_| noise()).collect();
        for (what, rgba) in [
            ("black", vec![0; bytes]),
            ("white", vec![255; bytes]),
            ("noise", noise),
            ("empty", vec![]),
            ("short", vec![9; 3]),
        ] {
            let mut vision = beginner(&camera);
            for step in 0..6 {
                let ego = EgoMotion {
                    speed_mps: 8.0,
                    yaw_rate_radps: 0.2,
                    ..EgoMotion::default()
                };
                let (_, plan) = shown(
                    &mut vision,
                    step,
                    &[Reading::image(&camera, &rgba)],
                    ego,
                    cruising(10.0),
                );
                assert_drivable(&plan, 8.0, &format!("{width_px}x{height_px} {what}"));
            }
        }
    }
}

#[test]
fn no_image_at_all_is_driven_through_too() {
    let mut vision = beginner(&camera());
    for step in 0..40 {
        let ego = EgoMotion {
            speed_mps: 8.0,
            ..EgoMotion::default()
        };
        let (perception, plan) = shown(&mut vision, step, &[], ego, cruising(10.0));
        assert_drivable(&plan, 8.0, "no image");
        assert!(
            (perception.unseen_m - 4.0 * f64::from(step)).abs() < 1e-9,
            "{perception:?}"
        );
    }
}

#[test]
fn a_plan_before_an_episode_is_refused() {
    let observation = decouplegs::planner::Observation {
        step: 0,
        time_s: 0.0,
        readings: &[],
        ego: EgoMotion::default(),
        guidance: cruising(10.0),
        localization: None,
        privileged: None,
    };
    let refusal = Vision::default()
        .plan(&observation)
        .unwrap_err()
        .to_string();
    assert!(refusal.contains("before an episode began"), "{refusal}");
    assert_eq!(Vision::default().perception(), None);
}
