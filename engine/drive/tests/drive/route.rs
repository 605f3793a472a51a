//! Routes and the road's surface on synthetic lanes.

use std::f64::consts::FRAC_PI_2;

use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::{OrientedBox, RoadSurface, Route};
use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{Lane, LaneKind, LaneMap, VehicleSize};
use glam::{DVec2, DVec3};
use proptest::prelude::*;

const WIDTH_M: f64 = 3.5;

/// A lane along `middle`, its borders half a width away, rising by 0.05 along x.
fn lane(id: &str, middle: &[DVec2]) -> Lane {
    let high = |at: DVec2| at.extend(0.05 * at.x);
    let border = |to_left_m: f64| -> Vec<DVec3> {
        let normal = |at: usize| {
            let before = middle[at] - middle[at.saturating_sub(1)];
            let after = middle[(at + 1).min(middle.len() - 1)] - middle[at];
            (before.normalize_or_zero() + after.normalize_or_zero())
                .normalize()
                .perp()
        };
        (0..middle.len())
            .map(|at| high(middle[at] + normal(at) * to_left_m))
            .collect()
    };
    Lane {
        id: id.into(),
        centerline: middle.iter().copied().map(high).collect(),
        left: border(0.5 * WIDTH_M),
        right: border(-0.5 * WIDTH_M),
        has_height: true,
        ..Lane::default()
    }
}

fn arc(center: DVec2, radius_m: f64, from_rad: f64, to_rad: f64) -> Vec<DVec2> {
    (0..=16)
        .map(|at| {
            center
                + DVec2::from_angle(from_rad + (to_rad - from_rad) * f64::from(at) / 16.0)
                    * radius_m
        })
        .collect()
}

/// East for 100 m in two lanes (`slow`, `fast` to its left), then from `slow` right around a corner
/// of 9 m and south for 60 m.
fn corner() -> LaneMap {
    let east = |y: f64| [DVec2::new(0.0, y), DVec2::new(100.0, y)];
    let turn = arc(DVec2::new(100.0, -9.0), 9.0, FRAC_PI_2, 0.0);
    let south = [DVec2::new(109.0, -9.0), DVec2::new(109.0, -69.0)];
    let mut lanes = vec![
        lane("slow", &east(0.0)),
        lane("fast", &east(WIDTH_M)),
        lane("turn", &turn),
        lane("south", &south),
    ];
    (lanes[0].left_neighbor, lanes[1].right_neighbor) = (Some(1), Some(0));
    (lanes[0].successors, lanes[2].predecessors) = (vec![2], vec![0]);
    (lanes[2].successors, lanes[3].predecessors) = (vec![3], vec![2]);
    LaneMap {
        lanes,
        ..LaneMap::default()
    }
}

fn task(route: &[&str], start_m: f64, end_m: f64) -> EgoTask {
    let route = route.iter().map(ToString::to_string).collect();
    EgoTask {
        route,
        start_m,
        end_m,
        speed_mps: 8.0,
        cruise_mps: 10.0,
        size: VehicleSize::CAR,
        follows_recording: false,
        start_pose: None,
    }
}

/// The sharpest bend of a route, 1/m, from its points alone.
fn sharpest(route: &Route) -> f64 {
    let points: Vec<DVec2> = route
        .line()
        .points()
        .iter()
        .map(|point| point.truncate())
        .collect();
    let bend = |at: &[DVec2]| {
        wrapped((at[2] - at[1]).to_angle() - (at[1] - at[0]).to_angle()).abs()
            / at[1].distance(at[0])
    };
    points.windows(3).map(bend).fold(0.0, f64::max)
}

#[test]
fn a_route_follows_its_lanes_around_a_corner_and_names_the_turn() {
    let map = corner();
    let route = Route::new(&map, &task(&["slow", "turn", "south"], 10.0, 40.0)).unwrap();
    let length_m = 90.0 + 9.0 * FRAC_PI_2 + 40.0;
    assert!(
        (route.length_m() - length_m).abs() < 0.15,
        "{} for {length_m}",
        route.length_m()
    );
    let (start, end) = (route.pose_at(0.0), route.pose_at(1e9));
    assert!(
        start.0.distance(DVec3::new(10.0, 0.0, 0.5)) < 1e-9
            && end.0.distance(DVec3::new(109.0, -49.0, 5.45)) < 1e-9
    );
    assert!(start.1.abs() < 1e-9 && (end.1 + FRAC_PI_2).abs() < 1e-9);
    // Smoothing takes the line inwards by less than 8 cm.
    let off_m = |point: &DVec3| {
        let at = point.truncate();
        if at.x <= 100.0 {
            at.y.abs()
        } else if at.y <= -9.0 {
            (at.x - 109.0).abs()
        } else {
            (at.distance(DVec2::new(100.0, -9.0)) - 9.0).abs()
        }
    };
    let off_m = route.line().points().iter().map(off_m).fold(0.0, f64::max);
    println!(
        "off the lanes by {off_m:.4} m, sharpest bend 1/{:.2} m",
        1.0 / sharpest(&route)
    );
    assert!(off_m < 0.08 && sharpest(&route) < 1.0 / 8.0);
    let [turn] = route.turns() else {
        panic!("{:?}", route.turns())
    };
    println!("{turn:?}");
    assert!(
        (turn.begin_m - 90.0).abs() < 3.0
            && (turn.end_m - 104.1).abs() < 3.0
            && (turn.angle_rad + FRAC_PI_2).abs() < 0.05
    );
    assert_eq!(
        (
            route.next_turn(0.0),
            route.next_turn(95.0),
            route.next_turn(120.0)
        ),
        (Some(turn), Some(turn), None)
    );
    let lanes: Vec<usize> = [0.0, 89.0, 91.0, 103.0, 106.0, 1e9]
        .into_iter()
        .map(|at| route.lane_at(at))
        .collect();
    assert_eq!(lanes, [0, 0, 2, 2, 3, 3]);
    assert!(route.has_height());
}

#[test]
fn neighbors_are_changed_to_within_thirty_metres_and_that_is_no_turn() {
    let map = corner();
    let route = Route::new(&map, &task(&["fast", "slow", "turn", "south"], 5.0, 60.0)).unwrap();
    // The change lies in the middle of the 95 m that there are.
    for (at_m, y) in [
        (0.0, WIDTH_M),
        (32.0, WIDTH_M),
        (47.5, 0.5 * WIDTH_M),
        (63.0, 0.0),
        (90.0, 0.0),
    ] {
        assert!(
            (route.pose_at(at_m).0.y - y).abs() < 0.08,
            "at {at_m}: {}",
            route.pose_at(at_m).0
        );
    }
    assert_eq!(route.turns().len(), 1, "{:?}", route.turns());
    assert!((route.lane_at(40.0), route.lane_at(55.0)) == (1, 0));
    let change = Route::new(&map, &task(&["slow", "fast"], 0.0, 100.0)).unwrap();
    println!(
        "a change of lanes bends by 1/{:.1} m",
        1.0 / sharpest(&change)
    );
    assert!(change.turns().is_empty() && sharpest(&change) < 1.0 / 40.0);
}

#[test]
fn progress_does_not_jump_where_the_route_passes_itself() {
    // Once around a circle of 12 m and on over its own beginning.
    let ring = arc(DVec2::ZERO, 12.0, 0.0, 1.98 * FRAC_PI_2 * 2.0);
    let mut lanes = vec![
        lane("ring", &ring),
        lane("again", &arc(DVec2::ZERO, 12.0, 0.0, 3.0)),
    ];
    lanes[0].successors = vec![1];
    let route = Route::new(
        &LaneMap {
            lanes,
            ..LaneMap::default()
        },
        &task(&["ring", "again"], 0.0, 20.0),
    )
    .unwrap();
    let mut progress_m = 0.0;
    for at in 0..=(route.length_m() as i32) {
        let foot = route.project(
            route.pose_at(f64::from(at)).0.truncate() + DVec2::new(0.2, -0.1),
            progress_m,
        );
        assert!(
            (foot.arc_m - f64::from(at)).abs() < 0.5,
            "at {at}: {foot:?}"
        );
        progress_m = foot.arc_m;
    }
}

#[test]
fn what_is_no_route_is_refused_with_the_lane() {
    let map = corner();
    let refused = |route: &[&str], start_m: f64, end_m: f64| {
        Route::new(&map, &task(route, start_m, end_m)).unwrap_err()
    };
    for (error, names) in [
        (refused(&[], 0.0, 1.0), "no lane"),
        (refused(&["slow", "north"], 0.0, 1.0), "lane north"),
        (
            refused(&["fast", "turn"], 0.0, 1.0),
            "lane turn neither follows lane fast",
        ),
        (
            refused(&["slow"], 0.0, 130.0),
            "ends 130 m along lane slow; expected 0 to 100.0 m",
        ),
        (
            refused(&["slow"], -1.0, 50.0),
            "starts -1 m along lane slow",
        ),
        (
            refused(&["slow"], f64::NAN, 50.0),
            "starts NaN m along lane slow",
        ),
        (refused(&["slow"], 60.0, 50.0), "no length"),
        (
            refused(&["slow", "fast"], 95.0, 100.0),
            "from lane slow to lane fast with 5.0 m of room",
        ),
    ] {
        assert!(error.reason().contains(names), "{error}");
    }
    let mut twice = corner();
    twice.lanes[3].id = "slow".into();
    assert!(
        Route::new(&twice, &task(&["slow"], 0.0, 9.0))
            .unwrap_err()
            .reason()
            .contains("twice")
    );
}

#[test]
fn the_surface_ends_at_the_borders_and_small_gaps_are_forgiven() {
    let map = corner();
    let surface = RoadSurface::new(&map);
    for (x, y, on) in [
        (50.0, -1.74, true),
        (50.0, -1.76, false),
        (50.0, 5.24, true),
        (50.0, 5.26, false),
        (-0.1, 0.0, false),
        (106.3, -2.7, true),
        (101.0, -8.0, false),
        (109.0, -68.9, true),
    ] {
        assert_eq!(surface.contains(DVec2::new(x, y)), on, "({x}, {y})");
    }
    let car = |x: f64, y: f64, yaw_rad: f64| OrientedBox {
        center_m: DVec2::new(x, y),
        yaw_rad,
        half_length_m: 2.25,
        half_width_m: 0.9,
    };
    assert!(
        surface.holds_box(&car(50.0, 1.0, 0.3), 0.0),
        "over the line between two lanes"
    );
    assert!(
        surface.holds_box(&car(50.0, -0.8, 0.0), 0.0)
            && !surface.holds_box(&car(50.0, -0.9, 0.0), 0.0)
    );
    assert!(surface.holds_box(&car(50.0, -0.9, 0.0), 0.1));
    // Its corners are on the road on both sides of a gap, and its side is not.
    let mut apart = map.clone();
    for lane in &mut apart.lanes[1..2] {
        let points = lane
            .centerline
            .iter_mut()
            .chain(&mut lane.left)
            .chain(&mut lane.right);
        points.for_each(|point| point.y += 1.6);
    }
    let apart = RoadSurface::new(&apart);
    let across = OrientedBox {
        half_length_m: 2.0,
        ..car(50.0, 2.5, FRAC_PI_2)
    };
    assert!(
        across
            .corners()
            .iter()
            .all(|&corner| apart.contains(corner))
            && !apart.holds_box(&across, 0.3)
    );
    assert!(
        apart.holds_box(&across, 0.85),
        "half of the gap is within reach of each side"
    );
    // Sidewalks are no road, and a lane without borders is as wide as lanes are.
    let mut other = map;
    other.lanes[0].kind = LaneKind::Walking;
    (other.lanes[1].left, other.lanes[1].right) = (vec![], vec![]);
    let other = RoadSurface::new(&other);
    assert!(
        !other.contains(DVec2::new(50.0, 0.0)) && other.contains(DVec2::new(50.0, WIDTH_M - 1.74))
    );
    assert!(!other.contains(DVec2::new(50.0, WIDTH_M - 1.76)));
}

#[test]
fn heights_are_those_of_the_deck_that_is_asked_for() {
    let mut map = corner();
    let mut bridge = lane("bridge", &[DVec2::new(50.0, -40.0), DVec2::new(50.0, 40.0)]);
    bridge
        .centerline
        .iter_mut()
        .chain(&mut bridge.left)
        .chain(&mut bridge.right)
        .for_each(|point| point.z = 8.0);
    map.lanes.push(bridge);
    let surface = RoadSurface::new(&map);
    let at = DVec2::new(50.3, 0.4);
    let height = |at: DVec2, expected_z_m: f64| surface.height_at(at, expected_z_m);
    assert!(
        (height(at, 1.0).unwrap() - 0.05 * 50.3).abs() < 1e-9
            && (height(at, 9.0).unwrap() - 8.0).abs() < 1e-9
    );
    assert!(
        (height(DVec2::new(70.0, -3.0), 9.0).unwrap() - 3.5).abs() < 1e-9,
        "beside the road"
    );
    assert_eq!(
        (height(DVec2::new(70.0, 30.0), 0.0), height(DVec2::NAN, 0.0)),
        (None, None)
    );
    map.lanes
        .iter_mut()
        .for_each(|lane| lane.has_height = false);
    assert_eq!(RoadSurface::new(&map).height_at(at, 0.0), None);
}

#[test]
fn lines_that_are_no_lanes_make_no_surface_and_no_panic() {
    for points in [
        vec![],
        vec![DVec3::ZERO],
        vec![DVec3::ZERO; 3],
        vec![DVec3::NAN, DVec3::X],
        vec![DVec3::splat(-1e300), DVec3::splat(1e300)],
        vec![DVec3::splat(-1e9), DVec3::splat(1e9), DVec3::X],
    ] {
        let lane = Lane {
            id: "bad".into(),
            centerline: points.clone(),
            left: points.clone(),
            ..Lane::default()
        };
        let map = LaneMap {
            lanes: vec![lane],
            ..LaneMap::default()
        };
        let surface = RoadSurface::new(&map);
        assert!(!surface.contains(DVec2::new(3.0, 1e4)) && !surface.contains(DVec2::NAN));
        let _ = Route::new(&map, &task(&["bad"], 0.0, 1.0));
    }
    assert!(!RoadSurface::new(&LaneMap::default()).contains(DVec2::ZERO));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// A bend of 30 m radius is the ring between two circles, whatever points its borders have.
    #[test]
    fn the_surface_of_a_bend_is_the_ring(radius_m in 26.0f64..34.0, angle_rad in 0.05f64..2.95, dense in 2usize..6) {
        let mut bend = lane("bend", &arc(DVec2::ZERO, 30.0, 0.0, 3.0));
        bend.left = arc(DVec2::ZERO, 28.0, 0.0, 3.0).into_iter().map(|at| at.extend(0.0)).collect();
        let outer = (0..=16 * dense).map(|at| DVec2::from_angle(3.0 * at as f64 / (16 * dense) as f64) * 32.0);
        bend.right = outer.map(|at| at.extend(0.0)).collect();
        let surface = RoadSurface::new(&LaneMap { lanes: vec![bend], ..LaneMap::default() });
        let on = surface.contains(DVec2::from_angle(angle_rad) * radius_m);
        // Chords of the circles lie up to 0.13 m within them.
        if (28.0..31.85).contains(&radius_m) {
            prop_assert!(on);
        } else if !(27.85..32.01).contains(&radius_m) {
            prop_assert!(!on);
        }
    }
}
