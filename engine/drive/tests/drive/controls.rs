//! An ego that is steered by hand, through the plans that this makes.

use decouplegs_drive::{Ego, EgoOptions};
use decouplegs_scene::{VehicleSize, VehicleState};

const WHEELBASE_M: f64 = 0.6 * 4.5;

fn ego(speed_mps: f64) -> Ego {
    Ego::new(
        VehicleState {
            speed_mps,
            ..VehicleState::default()
        },
        VehicleSize::CAR,
        EgoOptions::default(),
    )
}

/// Drives steps of half a second, steered anew at each.
fn steered(ego: &mut Ego, steer_rad: f64, acceleration_mps2: f64, steps: usize) {
    for _ in 0..steps {
        ego.follow(&ego.plan_under(steer_rad, acceleration_mps2, 2.0).unwrap());
        for _ in 0..5 {
            ego.step(0.1);
        }
    }
}

#[test]
fn held_wheels_drive_the_circle_of_their_angle() {
    // Plans are of the middle of the box, which is faster in a bend than the rear axle, whose speed
    // the ego keeps: what it gains by that with every new plan is bounded here, over four seconds.
    for (steer_rad, gain) in [(-0.3_f64, 0.1), (-0.05, 0.005), (0.1, 0.015), (0.4, 0.16)] {
        let mut ego = ego(5.0);
        steered(&mut ego, steer_rad, 0.0, 8);
        let wanted = 5.0 * steer_rad.tan() / WHEELBASE_M;
        let share = (ego.yaw_rate_radps() - wanted) / wanted;
        assert!(
            share.abs() < gain,
            "steer {steer_rad}: turns {} instead of {wanted} rad/s",
            ego.yaw_rate_radps()
        );
        assert!(
            (ego.steer_rad() - steer_rad).abs() < 0.01,
            "steer {steer_rad}: the wheels are at {}",
            ego.steer_rad()
        );
        assert!(
            (ego.state().speed_mps / 5.0 - 1.0).abs() < gain,
            "{:?}",
            ego.state()
        );
    }
}

#[test]
fn acceleration_is_kept_up_within_what_the_ego_can_do() {
    for (wanted_mps2, kept_mps2) in [(1.5, 1.5), (-2.0, -2.0), (50.0, 3.0), (-1.0, -1.0)] {
        let mut ego = ego(10.0);
        steered(&mut ego, 0.0, wanted_mps2, 4);
        assert!(
            (ego.state().speed_mps - (10.0 + 2.0 * kept_mps2)).abs() < 0.1,
            "{wanted_mps2}: {:?}",
            ego.state()
        );
        assert_eq!(ego.state().position_m.y, 0.0);
    }
}

#[test]
fn braking_ends_in_a_halt_and_the_ego_starts_again() {
    let mut ego = ego(6.0);
    steered(&mut ego, 0.2, -6.0, 6);
    let halted = ego.state();
    assert_eq!(halted.speed_mps, 0.0);
    steered(&mut ego, 0.0, 0.0, 2);
    assert_eq!(ego.state().position_m, halted.position_m);
    steered(&mut ego, 0.0, 2.0, 4);
    assert!(
        (ego.state().speed_mps - 4.0).abs() < 0.2,
        "{:?}",
        ego.state()
    );
}

#[test]
fn what_is_no_control_is_refused() {
    let ego = ego(5.0);
    assert!(
        ego.plan_under(f64::NAN, 0.0, 2.0)
            .unwrap_err()
            .contains("NaN rad")
    );
    assert!(
        ego.plan_under(0.0, f64::INFINITY, 2.0)
            .unwrap_err()
            .contains("inf m/s2")
    );
    for horizon_s in [0.0, -1.0, f64::NAN, 31.0] {
        assert!(
            ego.plan_under(0.0, 0.0, horizon_s)
                .unwrap_err()
                .contains("at most 30")
        );
    }
    assert_eq!(
        ego.plan_under(0.0, 0.0, 0.25)
            .unwrap()
            .points()
            .last()
            .unwrap()
            .time_s,
        0.25
    );
}
