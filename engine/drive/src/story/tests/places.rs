//! Places that count along bends, from others and from junctions, against circles.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::Arc;

use decouplegs_scene::story::{Action, Limits, Place, Side, Spot, Trigger, Who};
use decouplegs_scene::{Lane, LaneKind, LaneMap, VehicleSize, VehicleState};
use glam::{DVec2, DVec3};

use super::super::roads::Roads;
use super::super::seen::Scene;
use super::{A, B, Stage, actor, event, near, played, story};

/// Radius of the reference line of [`bend`], meters.
const RADIUS_M: f64 = 50.0;

/// Point of a circle to the left of the x axis, `left_m` to the left of the reference line.
fn on_circle(angle_rad: f64, left_m: f64) -> DVec3 {
    let out = RADIUS_M - left_m;
    DVec3::new(out * angle_rad.sin(), RADIUS_M - out * angle_rad.cos(), 0.0)
}

/// A quarter of a circle to the left with two lanes to the right of its reference line and one to
/// the left of it. Traffic keeps to the right or to the left.
fn bend(keeps_right: bool) -> LaneMap {
    let line = |left_m: f64, is_along: bool| -> Vec<DVec3> {
        let steps = (0..=400).map(|step| if is_along { step } else { 400 - step });
        let angles = steps.map(|step| f64::from(step) * FRAC_PI_2 / 400.0);
        angles.map(|angle| on_circle(angle, left_m)).collect()
    };
    let lane = |id: &str, middle_m: f64| {
        let is_along = id.contains('-') == keeps_right;
        let left_m = if is_along { 1.75 } else { -1.75 };
        Lane {
            id: id.into(),
            kind: LaneKind::Driving,
            centerline: line(middle_m, is_along),
            left: line(middle_m + left_m, is_along),
            right: line(middle_m - left_m, is_along),
            ..Lane::default()
        }
    };
    LaneMap {
        lanes: vec![
            lane("1/0/-1", -1.75),
            lane("1/0/-2", -5.25),
            lane("1/0/1", 1.75),
        ],
        ..LaneMap::default()
    }
}

/// Place of a spot that counts from an actor on lane -1 at an angle of 0.2.
fn found(spot: &Spot, keeps_right: bool) -> DVec2 {
    let mut one = actor("a", 0.0, 1, 0.0);
    one.point_m = on_circle(0.2, -1.75).truncate().to_array();
    one.heading_rad = if keeps_right { 0.2 } else { 0.2 + PI };
    let stage = Stage::new(&story(&[one], &[]), &bend(keeps_right), &Arc::default()).unwrap();
    let scene = Scene {
        roads: &stage.roads,
        all: &stage.seen,
    };
    scene.spot(spot).unwrap().0
}

#[test]
fn ways_along_a_road_count_on_its_reference_line() {
    let who = A;
    let cases = [(20.0, 0.5, true), (-8.0, -0.5, true), (20.0, 0.5, false)];
    for (along_m, left_m, keeps_right) in cases {
        let angle = 0.2 + along_m / RADIUS_M;
        for (lanes, middle_m) in [(0, -1.75), (-1, -5.25), (1, 1.75)] {
            let spot = Spot::Lane {
                who,
                lanes,
                ahead_m: along_m,
                on_road: true,
                left_m: Some(left_m),
            };
            let expected_m = on_circle(angle, middle_m + left_m).truncate();
            let found_m = found(&spot, keeps_right);
            assert!(
                found_m.distance(expected_m) < 0.02,
                "{lanes}: {found_m} {expected_m}"
            );
        }
        let road = Spot::Road {
            who,
            along_m,
            left_m,
        };
        let expected_m = on_circle(angle, -1.75 + left_m).truncate();
        assert!(found(&road, keeps_right).distance(expected_m) < 0.02);
    }
    // Along the lane, which is longer here, it does not come as far.
    let along_lane = Spot::Lane {
        who,
        lanes: -1,
        ahead_m: 20.0,
        on_road: false,
        left_m: Some(0.0),
    };
    let expected_m = on_circle(0.2 + 20.0 / (RADIUS_M + 5.25), -5.25).truncate();
    assert!(found(&along_lane, true).distance(expected_m) < 0.02);
}

#[test]
fn places_on_a_road_count_in_its_direction_whoever_asks() {
    // On the lane that runs to the west, along a reference line to the east.
    let mut one = actor("a", 400.0, 1, 0.0);
    (one.point_m, one.heading_rad) = ([400.0, 1.75], PI);
    one.lane = Some("1/0/1".into());
    let stage = Stage::new(&story(&[one], &[]), &super::road(), &Arc::default()).unwrap();
    let scene = Scene {
        roads: &stage.roads,
        all: &stage.seen,
    };
    let lane = |lanes: i64, on_road: bool| Spot::Lane {
        who: A,
        lanes,
        ahead_m: 30.0,
        on_road,
        left_m: Some(0.5),
    };
    let road = Spot::Road {
        who: A,
        along_m: 30.0,
        left_m: 0.5,
    };
    for (spot, expected_m) in [
        (lane(0, true), [430.0, 2.25]),
        (lane(-1, true), [430.0, -1.25]),
        (lane(0, false), [370.0, 1.25]),
        // To its left are those that run to the east.
        (lane(1, false), [370.0, -2.25]),
        (road, [430.0, 2.25]),
    ] {
        let found_m = scene.spot(&spot).unwrap().0;
        assert!(
            found_m.distance(DVec2::from_array(expected_m)) < 1e-6,
            "{found_m}"
        );
    }
}

#[test]
fn points_of_a_line_count_from_road_users_each_in_its_way() {
    let lane = |lanes: i64, ahead_m: f64| Spot::Lane {
        who: B,
        lanes,
        ahead_m,
        on_road: true,
        left_m: Some(0.0),
    };
    let beside = Place::Beside {
        of: lane(0, 40.0),
        turn_rad: FRAC_PI_2,
        offset_m: [2.0, -10.0],
    };
    let between = Place::Between {
        of: vec![lane(0, 50.0), lane(-1, 70.0)],
        shares: vec![0.25, 0.75],
    };
    let follow = |places: Vec<Place>| Action::Follow {
        points_m: Vec::new(),
        seen_from: None,
        on_lanes: false,
        places,
        times_s: vec![0.0, 1.0, 2.0, 3.0],
        is_absolute: false,
    };
    let places = vec![
        Place::At(lane(0, 0.0)),
        Place::At(lane(-1, 30.0)),
        beside,
        between,
    ];
    let pair = [actor("a", 100.0, 1, 10.0), actor("b", 200.0, 1, 0.0)];
    let moments = played(
        &story(&pair, &[event(Trigger::new(), &[(A, follow(places))])]),
        30,
    );
    let at = [
        (10, DVec2::new(230.0, -5.25)),
        // Turned to the left, two meters ahead are two to the left.
        (20, DVec2::new(250.0, 0.25)),
        (30, DVec2::new(265.0, -1.75 - 0.75 * 3.5)),
    ];
    for (step, expected_m) in at {
        let own_m = moments[step][0].0;
        assert!(own_m.distance(expected_m) < 1e-6, "{step}: {own_m}");
    }
    // Without a lane there, nothing is followed.
    let nowhere = follow(vec![Place::At(lane(-9, 0.0)); 4]);
    let moments = played(&story(&pair, &[event(Trigger::new(), &[(A, nowhere)])]), 10);
    near(moments[10][0].0.x, 110.0, 1e-6);
}

#[test]
fn of_lanes_that_begin_at_one_place_the_straightest_counts() {
    let line = |turn: f64| -> Vec<DVec3> {
        let along = (0..=60).map(|step| 0.5 * f64::from(step));
        along
            .map(|x_m| DVec3::new(x_m, turn * x_m * x_m, 0.0))
            .collect()
    };
    // Whichever comes first in the file.
    for turns in [[0.02, 0.0], [0.0, 0.02]] {
        let lanes = turns.iter().enumerate().map(|(at, &turn)| Lane {
            id: format!("{at}/0/-1"),
            kind: LaneKind::Driving,
            centerline: line(turn),
            ..Lane::default()
        });
        let map = LaneMap {
            lanes: lanes.collect(),
            ..LaneMap::default()
        };
        let roads = Roads::new(&map);
        for x_m in [0.0, 0.3, 5.0] {
            let place = roads.at(DVec2::new(x_m, 0.0), 0.0).unwrap();
            assert_eq!(turns[place.lane], 0.0, "{x_m}");
        }
        // On the bend itself, the bend.
        let place = roads.at(DVec2::new(10.0, 2.0), 0.38).unwrap();
        assert_eq!(turns[place.lane], 0.02);
    }
}

#[test]
fn a_distance_beside_another_is_reached_within_speed_acceleration_and_jerk() {
    let beside = |limits: Limits| Action::KeepBeside {
        to: B,
        distance_m: 3.5,
        between_boxes: false,
        side: Side::RightOrAhead,
        continuous: true,
        limits,
    };
    let pair = [actor("a", 100.0, 1, 20.0), actor("b", 150.0, 1, 20.0)];
    // Lateral places of A, every 0.1 s, which begins 3.5 m from where it is to go.
    let left_m = |limits: Limits| -> Vec<f64> {
        let both = story(&pair, &[event(Trigger::new(), &[(A, beside(limits))])]);
        let moments = played(&both, 100);
        moments.iter().map(|moment| moment[0].0.y).collect()
    };
    let slowly = left_m(Limits {
        speed_mps: Some(0.5),
        ..Limits::default()
    });
    near(slowly[20], -1.75 - 1.0, 0.02);
    near(slowly[100], -5.25, 1e-6);
    // A spring with w^2 = 0.4 a: x(t) = x(0) (1 + w t) e^(-w t) where a is never reached.
    let sprung = left_m(Limits {
        acceleration_mps2: Some(3.0),
        ..Limits::default()
    });
    let w = (0.4f64 * 3.0).sqrt();
    for step in [10usize, 20, 40] {
        let left = w * 0.1 * step as f64;
        // The pull would be 4.2 m/s^2 at first, and is held to 3.
        near(
            sprung[step],
            -5.25 + 3.5 * (1.0 + left) * (-left).exp(),
            0.15,
        );
    }
    let gentle = left_m(Limits {
        acceleration_mps2: Some(3.0),
        acceleration_rate_mps3: Some(1.0),
        deceleration_rate_mps3: Some(1.0),
        ..Limits::default()
    });
    // After a second the acceleration is 1 m/s^2: t^3 / 6.
    near(gentle[10], -1.75 - 1.0 / 6.0, 0.02);
    assert!(sprung[10] < gentle[10] - 0.5);
    near(gentle[100], -5.25, 0.1);
}

#[test]
fn an_arrival_survives_a_place_that_is_farther_by_a_hair() {
    // The other steps back by a centimeter first, as players do when a line begins.
    let arrive = Action::Arrive {
        with: Who::EGO,
        at: Spot::Point {
            at_m: [200.0, -1.75],
            heading_rad: None,
        },
        other_at: Spot::Point {
            at_m: [300.0, -5.25],
            heading_rad: None,
        },
        tolerance_m: 0.0,
        other_tolerance_m: 0.0,
        speed: None,
        steady_m: 0.0,
    };
    let at_m = |back_m: f64| {
        let one = story(
            &[actor("a", 100.0, 1, 10.0)],
            &[event(Trigger::new(), &[(A, arrive.clone())])],
        );
        let mut stage = Stage::new(&one, &super::road(), &Arc::default()).unwrap();
        for step in 0..101 {
            let x_m = 200.0 + 10.0 * f64::from(step) * 0.1 - if step > 0 { back_m } else { 0.0 };
            let ego = VehicleState {
                position_m: DVec2::new(x_m, -5.25),
                speed_mps: 10.0,
                ..VehicleState::default()
            };
            stage.step(f64::from(step) * 0.1, 0.1, Some((&ego, &VehicleSize::CAR)));
        }
        let state = stage.states().next().unwrap().unwrap();
        state.position_m.x - 1.5
    };
    near(at_m(0.0), 200.0, 1.1);
    // The ego's first second is lost, and a tenth of it more: it still arrives with it.
    near(at_m(1.01), 200.0, 1.1);
}
