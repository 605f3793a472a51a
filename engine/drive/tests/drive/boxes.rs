//! Boxes against closed forms and against brute force that shares nothing with them.

use decouplegs_drive::{OrientedBox, PlanarTransform, time_to_collision};
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;
use proptest::prelude::*;

const HORIZON_S: f64 = 10.0;

fn car(x: f64, y: f64, yaw_rad: f64) -> OrientedBox {
    let state = VehicleState {
        position_m: DVec2::new(x, y),
        yaw_rad,
        ..VehicleState::default()
    };
    OrientedBox::for_vehicle(&state, &VehicleSize::CAR)
}

/// True if two outlines cross, or one is within the other.
fn touch(a: &[DVec2; 4], b: &[DVec2; 4]) -> bool {
    let side = |from: DVec2, to: DVec2, at: DVec2| (to - from).perp_dot(at - from);
    let within = |outline: &[DVec2; 4], at: DVec2| {
        (0..4).all(|k| side(outline[k], outline[(k + 1) % 4], at) >= 0.0)
    };
    let edges = |outline: &[DVec2; 4]| [0, 1, 2, 3].map(|k| (outline[k], outline[(k + 1) % 4]));
    let cross = |(p, q): (DVec2, DVec2), (r, s): (DVec2, DVec2)| {
        side(p, q, r) * side(p, q, s) <= 0.0 && side(r, s, p) * side(r, s, q) <= 0.0
    };
    within(a, b[0])
        || within(b, a[0])
        || edges(a)
            .iter()
            .any(|&edge| edges(b).iter().any(|&other| cross(edge, other)))
}

#[test]
fn closed_forms() {
    let (a, east) = (car(0.0, 0.0, 0.0), DVec2::X);
    // 10 m from bumper to bumper, head on at 5 m/s each.
    let ahead = car(14.5, 0.0, std::f64::consts::PI);
    assert!((a.distance_m(&ahead) - 10.0).abs() < 1e-12);
    let ttc_s = time_to_collision(&a, 5.0 * east, &ahead, -5.0 * east, HORIZON_S).unwrap();
    assert!((ttc_s - 1.0).abs() < 1e-12);
    // As fast as the one ahead, or slower: never. Within the horizon or not.
    assert_eq!(
        time_to_collision(&a, 5.0 * east, &ahead, 5.0 * east, HORIZON_S),
        None
    );
    assert_eq!(
        time_to_collision(&a, 4.0 * east, &ahead, 5.0 * east, HORIZON_S),
        None
    );
    assert_eq!(time_to_collision(&a, east, &ahead, DVec2::ZERO, 9.9), None);
    assert!((time_to_collision(&a, east, &ahead, DVec2::ZERO, 10.1).unwrap() - 10.0).abs() < 1e-12);
    // In the next lane: past each other by 1.2 m, whatever the speed.
    assert_eq!(
        time_to_collision(&a, 5.0 * east, &car(14.5, 3.0, 0.0), DVec2::ZERO, HORIZON_S),
        None
    );
    // A corner first: one turned by 45 degrees reaches (4.5 + 1.8) / sqrt(8) from its middle, with
    // a corner (4.5 - 1.8) / sqrt(8) aside.
    let turned = car(20.0, 2.7 / 8.0_f64.sqrt(), std::f64::consts::FRAC_PI_4);
    let gap_m = 20.0 - 2.25 - 6.3 / 8.0_f64.sqrt();
    assert!(
        (time_to_collision(&a, 10.0 * east, &turned, DVec2::ZERO, HORIZON_S).unwrap()
            - gap_m / 10.0)
            .abs()
            < 1e-12
    );
    // Within one another.
    assert_eq!(
        time_to_collision(&a, east, &car(0.5, 0.3, 1.0), -east, HORIZON_S),
        Some(0.0)
    );
    assert_eq!(
        (
            a.distance_m(&car(4.0, 1.0, 0.2)),
            a.overlaps(&car(4.0, 1.0, 0.2))
        ),
        (0.0, true)
    );
}

#[test]
fn what_is_no_number_collides_with_nothing() {
    let a = car(0.0, 0.0, 0.0);
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        assert_eq!(
            time_to_collision(&a, DVec2::X, &car(bad, 0.0, 0.0), DVec2::ZERO, HORIZON_S),
            None
        );
        assert_eq!(
            time_to_collision(
                &a,
                DVec2::splat(bad),
                &car(9.0, 0.0, 0.0),
                DVec2::ZERO,
                HORIZON_S
            ),
            None
        );
        assert!(!a.overlaps(&car(bad, 0.0, 0.0)));
    }
    assert_eq!(
        time_to_collision(&a, DVec2::X, &car(9.0, 0.0, 0.0), DVec2::ZERO, f64::NAN),
        None
    );
}

fn any_box() -> impl Strategy<Value = OrientedBox> {
    (
        -15.0f64..15.0,
        -15.0f64..15.0,
        -3.2f64..3.2,
        0.2f64..4.0,
        0.2f64..2.0,
    )
        .prop_map(|(x, y, yaw_rad, half_length_m, half_width_m)| OrientedBox {
            center_m: DVec2::new(x, y),
            yaw_rad,
            half_length_m,
            half_width_m,
        })
}

fn any_velocity() -> impl Strategy<Value = DVec2> {
    (-12.0f64..12.0, -12.0f64..12.0).prop_map(|(x, y)| DVec2::new(x, y))
}

fn moved(outline: &OrientedBox, by_m: DVec2) -> OrientedBox {
    OrientedBox {
        center_m: outline.center_m + by_m,
        ..*outline
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn the_first_touch_is_the_one_that_stepping_finds(a in any_box(), b in any_box(), va in any_velocity(), vb in any_velocity()) {
        const STEP_S: f64 = 1e-3;
        let horizon_s = 4.0;
        let found = time_to_collision(&a, va, &b, vb, horizon_s);
        let at = |time_s: f64| touch(&a.corners(), &moved(&b, (vb - va) * time_s).corners());
        let stepped = (0..=4000).map(|step| f64::from(step) * STEP_S).find(|&time_s| at(time_s));
        match (found, stepped) {
            // A touch shorter than a step may be stepped over: then the boxes hardly overlap in its
            // middle.
            (Some(found_s), None) => prop_assert!(at(found_s + 1e-9) && !at(found_s + 2.0 * STEP_S), "{found_s}"),
            (Some(found_s), Some(stepped_s)) => {
                prop_assert!(found_s <= stepped_s + 1e-9, "{found_s} {stepped_s}");
                prop_assert!(stepped_s - found_s <= STEP_S || !at(found_s + 2.0 * STEP_S), "{found_s} {stepped_s}");
            }
            (None, stepped) => prop_assert!(stepped.is_none_or(|stepped_s| stepped_s > horizon_s - 1e-6), "{stepped:?}"),
        }
    }

    #[test]
    fn overlap_and_gap_are_those_of_the_outlines(a in any_box(), b in any_box()) {
        prop_assert_eq!(a.overlaps(&b), touch(&a.corners(), &b.corners()));
        let outline = |of: &OrientedBox| {
            let corners = of.corners();
            (0..400).map(|at| corners[at / 100].lerp(corners[(at / 100 + 1) % 4], (at % 100) as f64 / 100.0)).collect::<Vec<_>>()
        };
        let (of_a, of_b) = (outline(&a), outline(&b));
        let sampled_m = of_a.iter().flat_map(|p| of_b.iter().map(move |q| p.distance(*q))).fold(f64::INFINITY, f64::min);
        let gap_m = a.distance_m(&b);
        prop_assert!(gap_m <= sampled_m + 1e-9);
        // Places on the outlines are at most 0.08 m apart, so one is within 0.04 m of each.
        prop_assert!(a.overlaps(&b) || sampled_m - gap_m < 0.085, "{gap_m} {sampled_m}");
    }

    #[test]
    fn neither_order_nor_frame_matter(
        a in any_box(), b in any_box(), va in any_velocity(), vb in any_velocity(),
        yaw_rad in -3.1f64..3.1, x in -6e5f64..6e5, y in -6e6f64..6e6,
    ) {
        let motion = PlanarTransform { pivot_m: DVec2::ZERO, yaw_rad, shift_m: DVec2::new(x, y) };
        let there = |of: &OrientedBox| OrientedBox { center_m: motion.apply(of.center_m), yaw_rad: of.yaw_rad + yaw_rad, ..*of };
        let turned = |velocity: DVec2| DVec2::from_angle(yaw_rad).rotate(velocity);
        let here_s = time_to_collision(&a, va, &b, vb, HORIZON_S);
        let others = [
            time_to_collision(&b, vb, &a, va, HORIZON_S),
            time_to_collision(&there(&a), turned(va), &there(&b), turned(vb), HORIZON_S),
        ];
        for other_s in others {
            // Grazing by less than rounding may be seen from one side only.
            let grazing = |shrink: f64| {
                let thin = OrientedBox { half_length_m: a.half_length_m - shrink, half_width_m: a.half_width_m - shrink, ..a };
                time_to_collision(&thin, va, &b, vb, HORIZON_S)
            };
            match (here_s, other_s) {
                (Some(here_s), Some(other_s)) => prop_assert!((here_s - other_s).abs() < 1e-5 || grazing(1e-6).is_none()),
                (None, None) => {}
                _ => prop_assert!(grazing(1e-6).is_some() != grazing(-1e-6).is_some(), "{here_s:?} {other_s:?}"),
            }
        }
        prop_assert!((a.distance_m(&b) - b.distance_m(&a)).abs() < 1e-12);
        prop_assert!((a.distance_m(&b) - there(&a).distance_m(&there(&b))).abs() < 1e-7);
    }
}
