//! The ego against closed forms, and how well it keeps to plans.

use std::f64::consts::FRAC_PI_2;

use decouplegs_drive::{Ego, EgoOptions, Polyline};
use decouplegs_scene::{Plan, PlanPoint, VehicleSize, VehicleState};
use glam::DVec2;
use proptest::prelude::*;

const SIZE: VehicleSize = VehicleSize::CAR;
const WHEELBASE_M: f64 = 0.6 * 4.5;

fn ego(speed_mps: f64) -> Ego {
    Ego::new(
        VehicleState {
            speed_mps,
            ..VehicleState::default()
        },
        SIZE,
        EgoOptions::default(),
    )
}

/// A plan through positions of the ego's frame at even times.
fn plan(step_s: f64, positions: impl IntoIterator<Item = DVec2>) -> Plan {
    let point = |(at, position_m): (usize, DVec2)| PlanPoint {
        time_s: step_s * (at + 1) as f64,
        position_m,
    };
    Plan::new(positions.into_iter().enumerate().map(point).collect()).unwrap()
}

/// Plan straight ahead, with the way driven after each number of seconds.
fn ahead(way_m: impl Fn(f64) -> f64) -> Plan {
    plan(
        0.5,
        (1..=8).map(|at| DVec2::new(way_m(0.5 * f64::from(at)), 0.0)),
    )
}

/// Drives along a line at a speed as a planner with a map would: a plan of 3 s from the nearest
/// position on, made every half second. Answers the ego after each tenth of a second.
fn drive_along(line: &Polyline, speed_mps: f64, seconds: f64, ego: &mut Ego) -> Vec<VehicleState> {
    let mut driven = Vec::new();
    let mut arc_m = 0.0;
    for _ in 0..(seconds / 0.5) as usize {
        let state = ego.state();
        arc_m = line
            .project_within(state.position_m, arc_m, arc_m + 20.0)
            .arc_m;
        let position =
            |at: i32| state.to_local(line.at(arc_m + speed_mps * 0.5 * f64::from(at)).truncate());
        ego.follow(&plan(0.5, (1..=6).map(position)));
        for _ in 0..5 {
            ego.step(0.1);
            driven.push(ego.state());
        }
    }
    driven
}

fn line(points: impl IntoIterator<Item = DVec2>) -> Polyline {
    Polyline::new(points.into_iter().map(|point| point.extend(0.0))).unwrap()
}

/// Farthest from a line, meters.
fn farthest(line: &Polyline, driven: &[VehicleState]) -> f64 {
    driven
        .iter()
        .map(|state| line.project(state.position_m).distance_m)
        .fold(0.0, f64::max)
}

#[test]
fn wheels_that_do_not_turn_drive_a_circle() {
    // A way straight to the left holds the wheels at their stop; once they are there, the middle of
    // the box runs on a circle.
    let options = EgoOptions {
        steer_max_rad: 0.3,
        ..EgoOptions::default()
    };
    let mut ego = Ego::new(
        VehicleState {
            speed_mps: 4.0,
            ..VehicleState::default()
        },
        SIZE,
        options,
    );
    let around =
        |at: i32| DVec2::new(0.0, 2.0) + 2.0 * DVec2::from_angle(f64::from(at) * 0.5 - FRAC_PI_2);
    ego.follow(&plan(0.25, (1..=80).map(around)));
    ego.step(1.0);
    assert_eq!(ego.steer_rad(), 0.3);
    let (before, speed_mps) = (ego.state(), ego.state().speed_mps);
    let rear_radius_m = WHEELBASE_M / 0.3_f64.tan();
    let rear_m = before.to_world(DVec2::new(-0.5 * WHEELBASE_M, 0.0));
    let center_m = rear_m + before.ahead().perp() * rear_radius_m;
    for _ in 0..50 {
        ego.step(0.1);
        assert_eq!(ego.steer_rad(), 0.3);
        let radius_m = ego.state().position_m.distance(center_m);
        assert!(
            (radius_m - rear_radius_m.hypot(0.5 * WHEELBASE_M)).abs() < 1e-9,
            "{radius_m}"
        );
    }
    let rate_radps = ego.state().speed_mps / rear_radius_m;
    assert!((ego.yaw_rate_radps() - rate_radps).abs() < 1e-12);
    assert!(
        (ego.lateral_acceleration_mps2() - rate_radps * ego.state().speed_mps).abs() < 1e-12
            && speed_mps > 2.0
    );
}

#[test]
fn a_plan_of_constant_acceleration_is_driven_as_planned() {
    for (speed_mps, acceleration_mps2) in [(10.0, 0.0), (10.0, -2.0), (3.0, 1.5), (0.0, 2.0)] {
        let mut ego = ego(speed_mps);
        let way_m = |time_s: f64| speed_mps * time_s + 0.5 * acceleration_mps2 * time_s * time_s;
        ego.follow(&ahead(way_m));
        for step in 1..=40 {
            ego.step(0.1);
            let time_s = 0.1 * f64::from(step);
            let off_m = (ego.state().position_m.x - way_m(time_s)).abs();
            assert!(
                off_m < 0.01,
                "{speed_mps} {acceleration_mps2} after {time_s}: {off_m} m"
            );
        }
        let off_mps = (ego.state().speed_mps - speed_mps - 4.0 * acceleration_mps2).abs();
        assert!(off_mps < 0.02 && (ego.state().acceleration_mps2 - acceleration_mps2).abs() < 0.05);
        assert_eq!((ego.state().position_m.y, ego.state().yaw_rad), (0.0, 0.0));
    }
}

#[test]
fn standing_still_means_braking_as_hard_as_it_can_and_no_creeping() {
    let mut ego = ego(12.0);
    ego.follow(&Plan::standing());
    let mut time_s = 0.0;
    while ego.state().speed_mps > 0.0 {
        ego.step(0.1);
        time_s += 0.1;
        assert!(time_s < 3.0);
    }
    // 12 m/s at 8 m/s2 takes 9 m.
    let way_m = ego.state().position_m.x;
    println!("stopped in {way_m:.3} m after {time_s:.1} s");
    assert!((way_m - 9.0).abs() < 0.1, "{way_m}");
    for _ in 0..20 {
        ego.follow(&Plan::standing());
        ego.step(0.5);
        assert_eq!(
            (ego.state().speed_mps, ego.state().position_m.x),
            (0.0, way_m)
        );
    }
    // A planner that means to stand, but jitters.
    for at in 0..20 {
        ego.follow(&plan(
            0.5,
            (0..6).map(|point| 0.1 * DVec2::from_angle(f64::from(at * 7 + point))),
        ));
        ego.step(0.5);
        assert_eq!(ego.state().position_m.x, way_m);
    }
}

#[test]
fn a_plan_that_stops_stops_the_ego_where_it_says() {
    // From 10 m/s with 2.5 m/s2: 20 m in 4 s.
    let way_m = |time_s: f64| {
        if time_s < 4.0 {
            10.0 * time_s - 1.25 * time_s * time_s
        } else {
            20.0
        }
    };
    let mut ego = ego(10.0);
    ego.follow(&plan(
        0.5,
        (1..=14).map(|at| DVec2::new(way_m(0.5 * f64::from(at)), 0.0)),
    ));
    for _ in 0..65 {
        ego.step(0.1);
    }
    println!(
        "stopped {:+.3} m from the plan's end",
        ego.state().position_m.x - 20.0
    );
    assert!(
        ego.state().speed_mps == 0.0 && (ego.state().position_m.x - 20.0).abs() < 0.1,
        "{:?}",
        ego.state()
    );
    // Anew every half second, as in an episode.
    let mut again = Ego::new(
        VehicleState {
            speed_mps: 10.0,
            ..VehicleState::default()
        },
        SIZE,
        EgoOptions::default(),
    );
    for step in 0..14 {
        let from_m = again.state().position_m.x;
        let rest = |at: i32| DVec2::new((way_m(0.5 * f64::from(step + at)) - from_m).max(0.0), 0.0);
        again.follow(&plan(0.5, (1..=6).map(rest)));
        again.step(0.5);
    }
    println!("with new plans {:+.3} m", again.state().position_m.x - 20.0);
    assert!(
        again.state().speed_mps == 0.0 && (again.state().position_m.x - 20.0).abs() < 0.25,
        "{:?}",
        again.state()
    );
}

#[test]
fn nobody_reverses_and_who_has_no_plan_brakes_gently() {
    let mut back = ego(6.0);
    back.follow(&ahead(|time_s| -3.0 * time_s));
    let mut before_m = 0.0;
    for _ in 0..40 {
        back.step(0.1);
        assert!(back.state().speed_mps >= 0.0 && back.state().position_m.x >= before_m);
        before_m = back.state().position_m.x;
    }
    assert!(
        back.state().speed_mps == 0.0 && before_m < 2.9,
        "{before_m}"
    );
    assert_eq!(back.state().position_m.y, 0.0);
    // Forward and back: the turning point is as far as it goes.
    let mut turns_back = ego(4.0);
    turns_back.follow(&plan(
        0.5,
        [2.0, 3.5, 4.0, 3.0, 1.0, -2.0].map(|x| DVec2::new(x, 0.0)),
    ));
    turns_back.step(3.0);
    assert!(
        turns_back.state().speed_mps == 0.0
            && (3.5..4.3).contains(&turns_back.state().position_m.x)
    );
    // No plan at all, and one that is over.
    let (mut none, mut stale) = (ego(6.0), ego(6.0));
    none.step(1.0);
    assert!(
        (none.state().speed_mps - 4.0).abs() < 1e-9
            && (none.state().position_m.x - 5.0).abs() < 1e-9
    );
    assert!((none.state().acceleration_mps2 + 2.0).abs() < 1e-9);
    stale.follow(&plan(0.5, [DVec2::new(3.0, 0.0)]));
    stale.step(0.5);
    assert!((stale.state().speed_mps - 6.0).abs() < 0.05);
    stale.step(1.0);
    assert!((stale.state().speed_mps - 4.0).abs() < 0.1);
    stale.step(10.0);
    assert_eq!(stale.state().speed_mps, 0.0);
    for dt_s in [0.0, -1.0, f64::NAN] {
        let before = stale.state();
        stale.step(dt_s);
        assert_eq!(stale.state(), before);
    }
}

#[test]
fn an_offset_from_a_straight_line_dies_out() {
    let way = line([DVec2::new(-10.0, 1.5), DVec2::new(400.0, 1.5)]);
    for speed_mps in [2.0, 5.0, 10.0, 20.0, 30.0] {
        let mut ego = ego(speed_mps);
        let driven = drive_along(&way, speed_mps, 12.0, &mut ego);
        let off: Vec<f64> = driven
            .iter()
            .map(|state| state.position_m.y - 1.5)
            .collect();
        let over_m = off.iter().copied().fold(0.0, f64::max);
        let late_m = off[80..].iter().map(|off| off.abs()).fold(0.0, f64::max);
        println!("{speed_mps} m/s: over by {over_m:.3} m, after 8 s within {late_m:.4} m");
        assert!(
            over_m < 0.25 && late_m < 0.05,
            "{speed_mps}: {over_m} {late_m}"
        );
    }
}

#[test]
fn lane_changes_and_sharp_turns_are_kept_to() {
    let smooth = |share: f64| share.powi(3) * (10.0 + share * (6.0 * share - 15.0));
    let change = |length_m: f64| {
        line((0..=160).map(|x| {
            let x = f64::from(x);
            DVec2::new(x, 3.5 * smooth(((x - 20.0) / length_m).clamp(0.0, 1.0)))
        }))
    };
    for (speed_mps, length_m) in [(8.0, 30.0), (14.0, 40.0)] {
        let way = change(length_m);
        let off_m = farthest(
            &way,
            &drive_along(&way, speed_mps, 8.0, &mut ego(speed_mps)),
        );
        println!("lane change over {length_m} m at {speed_mps} m/s: {off_m:.3} m");
        assert!(off_m < 0.25, "{speed_mps} m/s: {off_m}");
    }
    let turn = |radius_m: f64| {
        let bend = (0..=18).map(move |at| {
            DVec2::new(20.0, -radius_m)
                + radius_m * DVec2::from_angle(FRAC_PI_2 * (1.0 - f64::from(at) / 18.0))
        });
        line(
            [DVec2::ZERO]
                .into_iter()
                .chain(bend)
                .chain([DVec2::new(20.0 + radius_m, -radius_m - 60.0)]),
        )
    };
    for (radius_m, speed_mps, bound_m) in [(9.0, 5.0, 0.3), (9.0, 3.0, 0.3), (15.0, 7.0, 0.3)] {
        let way = turn(radius_m);
        let off_m = farthest(
            &way,
            &drive_along(&way, speed_mps, 9.0, &mut ego(speed_mps)),
        );
        println!("right turn of {radius_m} m at {speed_mps} m/s: {off_m:.3} m");
        assert!(off_m < bound_m, "{radius_m} m at {speed_mps} m/s: {off_m}");
    }
}

#[test]
fn long_and_short_steps_drive_the_same_way() {
    let bend = |at: i32| {
        12.0 * DVec2::from_angle(0.15 * f64::from(at) - FRAC_PI_2) + DVec2::new(0.0, 12.0)
    };
    let drive = |steps: u32, dt_s: f64| {
        let mut ego = ego(7.0);
        ego.follow(&plan(0.4, (1..=10).map(bend)));
        for _ in 0..steps {
            ego.step(dt_s);
        }
        (ego.state(), ego.steer_rad())
    };
    let (long, short, finest) = (drive(30, 0.1), drive(300, 0.01), drive(3000, 0.001));
    println!("0.1 s {:?}\n0.001 s {:?}", long.0, finest.0);
    assert!(
        long.0.position_m.distance(short.0.position_m) < 1e-6 && (long.1 - short.1).abs() < 1e-6
    );
    // The parts of a step are short enough: ten times shorter ones make a difference of a
    // millimeter.
    assert!(
        long.0.position_m.distance(finest.0.position_m) < 0.003,
        "{}",
        long.0.position_m.distance(finest.0.position_m)
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn limits_hold_for_any_plan(
        speed_mps in 0.0f64..30.0,
        points in prop::collection::vec((0.01f64..1.0, -2000.0f64..2000.0, -200.0f64..200.0), 1..20),
        scale in prop::sample::select(vec![1e-3, 1e-2, 0.1, 0.5]),
    ) {
        let mut time_s = 0.0;
        let points = points.iter().map(|&(span_s, x, y)| {
            time_s += span_s;
            PlanPoint { time_s, position_m: scale * DVec2::new(x, y) }
        });
        let plan = Plan::new(points.collect()).unwrap();
        let (options, mut ego) = (EgoOptions::default(), ego(speed_mps));
        ego.follow(&plan);
        for _ in 0..100 {
            let (before, steer_rad) = (ego.state(), ego.steer_rad());
            ego.step(0.1);
            let after = ego.state();
            prop_assert!(after.position_m.is_finite() && after.yaw_rad.is_finite() && after.speed_mps >= 0.0);
            prop_assert!(after.acceleration_mps2 <= options.acceleration_max_mps2 + 1e-9);
            prop_assert!(after.acceleration_mps2 >= -options.braking_max_mps2 - 1e-9);
            prop_assert!(ego.steer_rad().abs() <= options.steer_max_rad + 1e-12);
            prop_assert!((ego.steer_rad() - steer_rad).abs() <= 0.1 * options.steer_rate_max_radps + 1e-9);
            // The middle moves a little faster than the rear axle, where speed is measured; and
            // within a step it may be faster than at both ends.
            let speed_mps = before.speed_mps.max(after.speed_mps) + 0.1 * options.acceleration_max_mps2;
            prop_assert!(after.position_m.distance(before.position_m) <= 0.1 * speed_mps * 1.07 + 1e-9);
        }
    }

    /// The same plan from another position in the world is the same drive there.
    #[test]
    fn the_frame_does_not_matter(yaw_rad in -3.1f64..3.1, x in -6e5f64..6e5, y in -6e6f64..6e6, bend in -0.08f64..0.08) {
        let positions = |at: i32| { let s = 4.0 * f64::from(at); DVec2::new(s, 0.5 * bend * s * s) };
        let away = VehicleState { position_m: DVec2::new(x, y), yaw_rad, speed_mps: 8.0, acceleration_mps2: 0.0 };
        let (mut here, mut there) = (ego(8.0), Ego::new(away, SIZE, EgoOptions::default()));
        for ego in [&mut here, &mut there] {
            ego.follow(&plan(0.5, (1..=6).map(positions)));
            ego.step(2.5);
        }
        let back = away.to_local(there.state().position_m);
        prop_assert!(back.distance(here.state().position_m) < 1e-6, "{back} {}", here.state().position_m);
    }
}
