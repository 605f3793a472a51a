//! Actors on a straight road: motion against closed forms.

mod events;
mod places;
mod signals;

use std::sync::Arc;

use decouplegs_scene::story::{
    Act, Action, Actor, Condition, Dynamics, Edge, Event, Extent, Limits, Priority, Rule, Shape,
    Side, Speed, Spot, Story, TargetLane, Task, Trigger, When, Who,
};
use decouplegs_scene::{Lane, LaneKind, LaneMap, RoadUser, VehicleSize, VehicleState};
use glam::{DVec2, DVec3};

use super::Stage;

const A: Who = Who(1);
const B: Who = Who(2);

/// Two roads of 500 m in a row to the east, each with three lanes, and one lane back to the west.
fn road() -> LaneMap {
    let lane = |id: &str, from: [f64; 2], to: [f64; 2], next: &[usize], before: &[usize]| Lane {
        id: id.into(),
        kind: LaneKind::Driving,
        centerline: vec![
            DVec3::new(from[0], from[1], 0.0),
            DVec3::new(to[0], to[1], 0.0),
        ],
        successors: next.to_vec(),
        predecessors: before.to_vec(),
        ..Lane::default()
    };
    let mut lanes = Vec::new();
    for (at, y_m) in [-1.75, -5.25, -8.75].into_iter().enumerate() {
        let (first, second) = (format!("1/0/-{}", at + 1), format!("2/0/-{}", at + 1));
        lanes.push(lane(&first, [0.0, y_m], [500.0, y_m], &[2 * at + 1], &[]));
        lanes.push(lane(&second, [500.0, y_m], [1000.0, y_m], &[], &[2 * at]));
    }
    lanes.push(lane("1/0/1", [500.0, 1.75], [0.0, 1.75], &[], &[]));
    LaneMap {
        lanes,
        ..LaneMap::default()
    }
}

/// An actor whose reference point is at `x_m` of lane -`lane`.
fn actor(name: &str, x_m: f64, lane: usize, speed_mps: f64) -> Actor {
    let y_m = 1.75 - 3.5 * lane as f64;
    Actor {
        name: name.into(),
        kind: RoadUser::Car,
        asset: 0,
        size_m: [4.0, 2.0, 1.5],
        center_m: 1.5,
        point_m: [x_m, y_m],
        heading_rad: 0.0,
        lane: Some(format!("1/0/-{lane}")),
        speed_mps,
        is_hidden: false,
        limits: Limits::default(),
    }
}

fn event(start: Trigger, actions: &[(Who, Action)]) -> Event {
    let tasks = actions.iter().cloned();
    Event {
        name: "e".into(),
        act: 0,
        maneuver: 0,
        priority: Priority::Parallel,
        executions: 1,
        start,
        actions: tasks.map(|(of, action)| Task { of, action }).collect(),
    }
}

fn when(when: When) -> Trigger {
    vec![vec![Condition {
        edge: Edge::None,
        delay_s: 0.0,
        when,
    }]]
}

fn from_time(value_s: f64) -> Trigger {
    let rule = Rule::GreaterOrEqual;
    when(When::Time { rule, value_s })
}

fn story(actors: &[Actor], events: &[Event]) -> Story {
    Story {
        actors: actors.to_vec(),
        acts: vec![Act::default()],
        events: events.to_vec(),
        ..Story::default()
    }
}

/// Reference points, headings and speeds of all actors after each step of 0.1 s, the start first.
fn played(story: &Story, steps: usize) -> Vec<Vec<(DVec2, f64, f64)>> {
    let mut stage = Stage::new(story, &road(), &Arc::default()).unwrap();
    let moment = |stage: &Stage| -> Vec<(DVec2, f64, f64)> {
        let states = stage.states().zip(&story.actors);
        states
            .map(|(state, actor)| {
                let state = state.unwrap();
                let point_m = state.position_m - actor.center_m * state.ahead();
                (point_m, state.yaw_rad, state.speed_mps)
            })
            .collect()
    };
    let mut moments = vec![moment(&stage)];
    for step in 0..steps {
        stage.step(step as f64 * 0.1, 0.1, None);
        moments.push(moment(&stage));
    }
    moments
}

/// Place of the first actor, which does `action` from the start on at 10 m/s, at 100 m of lane -1.
fn alone(action: Action, steps: usize) -> Vec<(DVec2, f64, f64)> {
    let story = story(
        &[actor("a", 100.0, 1, 10.0)],
        &[event(Trigger::new(), &[(A, action)])],
    );
    let moments = played(&story, steps);
    moments.into_iter().map(|moment| moment[0]).collect()
}

fn dynamics(shape: Shape, extent: Extent) -> Dynamics {
    Dynamics { shape, extent }
}

fn near(found: f64, expected: f64, within: f64) {
    assert!((found - expected).abs() < within, "{found}, not {expected}");
}

#[test]
fn an_actor_keeps_lane_and_speed_over_roads_and_stands_at_their_end() {
    let stays = story(
        &[actor("a", 400.0, 2, 20.0), actor("b", 900.0, 1, 20.0)],
        &[],
    );
    let mut on_second = stays.clone();
    on_second.actors[1].lane = Some("2/0/-1".into());
    let moments = played(&on_second, 100);
    let (point_m, yaw_rad, speed_mps) = moments[100][0];
    assert!(
        point_m.distance(DVec2::new(600.0, -5.25)) < 1e-6,
        "{point_m}"
    );
    assert_eq!((yaw_rad, speed_mps), (0.0, 20.0));
    assert_eq!(moments[100][1].0, DVec2::new(1000.0, -1.75));
    let unknown = Stage::new(
        &story(&[actor("a", 0.0, 7, 1.0)], &[]),
        &road(),
        &Arc::default(),
    );
    let message = unknown.unwrap_err().to_string();
    assert!(message.contains("no lane 1/0/-7"), "{message}");
}

#[test]
fn who_heads_against_a_lane_drives_against_it() {
    let mut back = actor("a", 300.0, 1, 10.0);
    back.heading_rad = std::f64::consts::PI;
    let moments = played(&story(&[back], &[]), 20);
    assert!(moments[20][0].0.distance(DVec2::new(280.0, -1.75)) < 1e-6);
    // Across it, a walker goes where it looks.
    let mut across = actor("a", 300.0, 1, 1.0);
    across.heading_rad = std::f64::consts::FRAC_PI_2;
    let moments = played(&story(&[across], &[]), 20);
    assert!(moments[20][0].0.distance(DVec2::new(300.0, 0.25)) < 1e-6);
}

#[test]
fn speeds_follow_their_shapes() {
    for (shape, quarter) in [
        (Shape::Linear, 0.25),
        (Shape::Cubic, 0.15625),
        (
            Shape::Sinusoidal,
            0.5 - 0.5 * (std::f64::consts::PI / 4.0).cos(),
        ),
    ] {
        let target = Speed::Mps(20.0);
        let dynamics = dynamics(shape, Extent::TimeS(4.0));
        let moments = alone(Action::Speed { target, dynamics }, 50);
        near(moments[10].2, 10.0 + 10.0 * quarter, 1e-9);
        // All three are symmetric: the mean is 15 m/s.
        near(moments[40].0.x, 160.0, 1e-6);
        near(moments[50].0.x, 180.0, 1e-6);
    }
    let slower = |extent: Extent| {
        let dynamics = dynamics(Shape::Linear, extent);
        alone(
            Action::Speed {
                target: Speed::Mps(4.0),
                dynamics,
            },
            40,
        )
    };
    // 10 to 4 m/s at 3 m/s^2, and within 14 m: both take 2 s.
    for moments in [
        slower(Extent::RatePerS(3.0)),
        slower(Extent::DistanceM(14.0)),
    ] {
        near(moments[20].0.x, 114.0, 1e-6);
        near(moments[40].0.x, 122.0, 1e-6);
    }
    let profile = Action::Profile {
        times_s: vec![1.0, 2.0],
        speeds_mps: vec![16.0, 0.0],
        limits: Limits::default(),
    };
    let moments = alone(profile, 40);
    near(moments[10].0.x, 113.0, 1e-6);
    near(moments[40].0.x, 129.0, 1e-6);
    assert_eq!(moments[40].2, 0.0);
    // A first part without a time lasts as long as its limit needs: 6 m/s at 3 m/s^2.
    let untimed = Action::Profile {
        times_s: vec![0.0, 1.0],
        speeds_mps: vec![16.0, 15.0],
        limits: Limits {
            acceleration_mps2: Some(3.0),
            ..Limits::default()
        },
    };
    let moments = alone(untimed, 40);
    near(moments[10].2, 13.0, 1e-6);
    near(moments[20].0.x, 126.0, 1e-6);
    assert_eq!(moments[30].2, 15.0);
    // The limits of a vehicle make it later.
    let mut limited = story(
        &[actor("a", 100.0, 1, 10.0)],
        &[event(
            Trigger::new(),
            &[(
                A,
                Action::Speed {
                    target: Speed::Mps(20.0),
                    dynamics: dynamics(Shape::Linear, Extent::TimeS(1.0)),
                },
            )],
        )],
    );
    limited.actors[0].limits.acceleration_mps2 = Some(5.0);
    let moments = played(&limited, 30);
    near(moments[10][0].2, 15.0, 0.01);
    near(moments[25][0].2, 20.0, 1e-9);
}

#[test]
fn lane_changes_follow_their_shapes_at_the_speed_of_the_actor() {
    let change = |target: TargetLane, dynamics: Dynamics| Action::ChangeLane {
        target,
        offset_m: 0.0,
        dynamics,
    };
    let sinusoidal = dynamics(Shape::Sinusoidal, Extent::TimeS(4.0));
    let right = TargetLane::Beside { who: A, lanes: -1 };
    let moments = alone(change(right, sinusoidal), 50);
    near(moments[20].0.y, -3.5, 1e-9);
    near(moments[40].0.y, -5.25, 1e-9);
    near(moments[50].0.y, -5.25, 1e-9);
    // Sideways it goes pi / 2 times the mean speed in the middle, within its own speed.
    let aside_mps = std::f64::consts::FRAC_PI_2 * 3.5 / 4.0;
    near(moments[20].1, -(aside_mps / 10.0).asin(), 1e-6);
    let way_m: f64 = moments
        .windows(2)
        .map(|pair| pair[0].0.distance(pair[1].0))
        .sum();
    near(way_m, 50.0, 0.01);
    // By number, over 30 m of way along the lanes.
    let over = dynamics(Shape::Cubic, Extent::DistanceM(30.0));
    let moments = alone(change(TargetLane::Id(-3), over), 60);
    let at_half = moments
        .iter()
        .find(|(point_m, ..)| point_m.x >= 115.0)
        .unwrap();
    near(at_half.0.y, -5.25, 0.4);
    near(moments[60].0.y, -8.75, 1e-9);
    // To the lane of the other direction, against it; and a lane that is not there.
    let left = TargetLane::Beside { who: A, lanes: 1 };
    let moments = alone(change(left, Dynamics::STEP), 10);
    assert!(moments[10].0.distance(DVec2::new(110.0, 1.75)) < 1e-6);
    let stays = alone(change(TargetLane::Id(9), sinusoidal), 10);
    near(stays[10].0.y, -1.75, 1e-9);
}

#[test]
fn offsets_take_the_time_that_their_lateral_acceleration_gives() {
    let moments = alone(
        Action::Offset {
            offset_m: 0.75,
            from: None,
            dynamics: dynamics(Shape::Cubic, Extent::LateralMps2(0.5)),
            continuous: false,
        },
        40,
    );
    // sqrt(6 * 0.75 / 0.5) = 3 s.
    near(moments[15].0.y, -1.75 + 0.375, 1e-6);
    near(moments[29].0.y, -1.0, 0.01);
    near(moments[30].0.y, -1.0, 1e-6);
}

#[test]
fn gaps_distances_beside_and_speeds_of_others_are_kept() {
    let gap = |limits: Limits| Action::KeepGap {
        to: B,
        gap: 20.0,
        is_time: false,
        between_boxes: true,
        side: Side::LeftOrBehind,
        continuous: true,
        limits,
    };
    let pair = [actor("a", 100.0, 1, 10.0), actor("b", 150.0, 1, 12.0)];
    let at_once = story(
        &pair,
        &[event(Trigger::new(), &[(A, gap(Limits::default()))])],
    );
    let moments = played(&at_once, 10);
    // 20 m between boxes of 4 m, and it moves on what it saw a part of a step before.
    near(moments[10][1].0.x - moments[10][0].0.x, 24.0, 0.25);
    let limits = Limits {
        acceleration_mps2: Some(3.0),
        deceleration_mps2: Some(3.0),
        ..Limits::default()
    };
    let slowly = story(&pair, &[event(Trigger::new(), &[(A, gap(limits))])]);
    let moments = played(&slowly, 200);
    assert!(
        moments
            .windows(2)
            .all(|two| (two[1][0].2 - two[0][0].2).abs() < 0.31)
    );
    near(moments[200][1].0.x - moments[200][0].0.x, 24.0, 0.1);
    near(moments[200][0].2, 12.0, 0.05);

    let beside = Action::KeepBeside {
        to: B,
        distance_m: 1.5,
        between_boxes: true,
        side: Side::RightOrAhead,
        continuous: true,
        limits: Limits::default(),
    };
    let moments = played(&story(&pair, &[event(Trigger::new(), &[(A, beside)])]), 5);
    near(moments[5][0].0.y, -1.75 - 3.5, 1e-6);

    let follows = Action::Speed {
        target: Speed::Of {
            who: B,
            factor: 0.5,
            plus_mps: 1.0,
            continuous: true,
        },
        dynamics: Dynamics::STEP,
    };
    let faster = Action::Speed {
        target: Speed::Mps(20.0),
        dynamics: dynamics(Shape::Linear, Extent::TimeS(1.0)),
    };
    let events = [
        event(Trigger::new(), &[(A, follows)]),
        event(from_time(1.0), &[(B, faster)]),
    ];
    let moments = played(&story(&pair, &events), 30);
    near(moments[5][0].2, 7.0, 1e-9);
    near(moments[30][0].2, 11.0, 1e-9);

    // A rate stays what it is while the speed that is wanted changes: from 10 to 20 + 5 m/s.
    let at_rate = Action::Speed {
        target: Speed::Of {
            who: B,
            factor: 1.0,
            plus_mps: 5.0,
            continuous: false,
        },
        dynamics: dynamics(Shape::Linear, Extent::RatePerS(1.0)),
    };
    let events = [event(Trigger::new(), &[(A, at_rate)]), events[1].clone()];
    let from_mps = pair[0].speed_mps;
    let moments = played(&story(&pair, &events), 200);
    near(moments[30][0].2, from_mps + 3.0, 1e-6);
    near(moments[80][0].2, from_mps + 8.0, 1e-6);
    near(moments[200][0].2, 25.0, 1e-6);
}

#[test]
fn two_arrive_at_the_same_time() {
    let place = |x_m: f64, y_m: f64| Spot::Point {
        at_m: [x_m, y_m],
        heading_rad: None,
    };
    let arrive = |speed: Option<f64>| Action::Arrive {
        with: B,
        at: place(250.0, -1.75),
        other_at: place(300.0, -5.25),
        tolerance_m: 0.5,
        other_tolerance_m: 0.5,
        speed: speed.map(Speed::Mps),
        steady_m: 0.0,
    };
    // The other needs 10 s; 150 m in that time, with 20 m/s at the end or at any speed.
    for speed in [None, Some(20.0), Some(5.0)] {
        let pair = [actor("a", 100.0, 1, 10.0), actor("b", 200.0, 2, 10.0)];
        let both = story(&pair, &[event(Trigger::new(), &[(A, arrive(speed))])]);
        let moments = played(&both, 100);
        near(moments[100][0].0.x, 250.0, 0.6);
        near(moments[100][0].2, speed.unwrap_or(15.0), 0.1);
    }
}

#[test]
fn lines_are_followed_at_their_times_or_at_the_actors_speed() {
    let follow = |times_s: &[f64], seen_from: Option<Who>| Action::Follow {
        points_m: match seen_from {
            None => vec![[100.0, -1.75], [140.0, -1.75], [140.0, 38.25]],
            Some(_) => vec![[0.0, 0.0], [40.0, 0.0], [40.0, 40.0]],
        },
        seen_from,
        on_lanes: false,
        places: Vec::new(),
        times_s: times_s.to_vec(),
        is_absolute: false,
    };
    for from in [None, Some(A)] {
        let moments = alone(follow(&[0.0, 2.0, 6.0], from), 80);
        assert!(moments[10].0.distance(DVec2::new(120.0, -1.75)) < 1e-6);
        assert!(moments[30].0.distance(DVec2::new(140.0, 8.25)) < 1e-6);
        near(moments[30].1, std::f64::consts::FRAC_PI_2, 1e-6);
        assert_eq!((moments[10].2, moments[30].2), (20.0, 10.0));
        // Off the road it goes on where it heads.
        near(moments[80].0.y, 58.25, 1e-6);
        let moments = alone(follow(&[], from), 50);
        assert!(moments[50].0.distance(DVec2::new(140.0, 8.25)) < 1e-6);
    }
}

#[test]
fn teleports_and_hiding_happen_at_once() {
    let to = Spot::Lane {
        who: B,
        lanes: -1,
        on_road: false,
        ahead_m: 30.0,
        left_m: Some(0.5),
    };
    let pair = [actor("a", 100.0, 1, 10.0), actor("b", 300.0, 2, 0.0)];
    let mut both = story(
        &pair,
        &[event(from_time(1.0), &[(A, Action::Teleport { to })])],
    );
    let moments = played(&both, 20);
    assert!(moments[20][0].0.distance(DVec2::new(340.0, -8.25)) < 0.21);
    both.events.push(event(
        from_time(1.0),
        &[(B, Action::Show { is_shown: false })],
    ));
    both.actors[0].is_hidden = true;
    let mut stage = Stage::new(&both, &road(), &Arc::default()).unwrap();
    assert!(stage.states().next().unwrap().is_none());
    for step in 0..12 {
        stage.step(f64::from(step) * 0.1, 0.1, None);
    }
    assert!(stage.states().all(|state| state.is_none()));
    assert_eq!(stage.shown().count(), 0);
}

/// The ego drives east at 8 m/s beside the actor, which is 20 m behind on the next lane.
#[test]
fn an_attack_meets_an_ego_that_keeps_its_speed() {
    let attack = Action::Attack {
        ahead_s: 2.0,
        every_s: 0.5,
        best: 1,
    };
    let mut own = actor("a", 80.0, 2, 10.0);
    own.lane = None;
    own.center_m = 0.0;
    let attacked = story(&[own.clone()], &[event(Trigger::new(), &[(A, attack)])]);
    let nearest = |story: &Story| {
        let mut stage = Stage::new(story, &road(), &Arc::default()).unwrap();
        let mut nearest_m = f64::INFINITY;
        let mut before = (DVec2::new(80.0, -5.25), 10.0);
        for step in 0..80 {
            let ego = VehicleState {
                position_m: DVec2::new(100.0 + 0.8 * f64::from(step), -1.75),
                speed_mps: 8.0,
                ..VehicleState::default()
            };
            stage.step(f64::from(step) * 0.1, 0.1, Some((&ego, &VehicleSize::CAR)));
            let state = stage.states().next().unwrap().unwrap();
            // It drives as a vehicle can: no leap, and no more than 6 m/s^2 of change.
            let way_m = state.position_m.distance(before.0);
            assert!(
                (way_m - 0.1 * state.speed_mps).abs() < 0.2,
                "{step}: {way_m} m"
            );
            before = (state.position_m, state.speed_mps);
            nearest_m = state.position_m.distance(ego.position_m).min(nearest_m);
        }
        nearest_m
    };
    let attacks_m = nearest(&attacked);
    let passes_m = nearest(&story(&[own], &[]));
    assert!(
        attacks_m < 1.0 && passes_m > 3.0,
        "{attacks_m} m and {passes_m} m"
    );
    assert_eq!(
        nearest(&attacked).to_bits(),
        attacks_m.to_bits(),
        "it repeats"
    );
}

#[test]
fn an_actor_beside_the_middle_of_a_bend_keeps_its_speed_over_ground() {
    // A lane on a circle of 50 m to the left.
    let at = |arc_m: f64| 50.0 * DVec3::new((arc_m / 50.0).sin(), 1.0 - (arc_m / 50.0).cos(), 0.0);
    let map = LaneMap {
        lanes: vec![Lane {
            id: "1/0/-1".into(),
            kind: LaneKind::Driving,
            centerline: (0..=200).map(|step| at(0.5 * f64::from(step))).collect(),
            ..Lane::default()
        }],
        ..LaneMap::default()
    };
    for (left_m, radius_m) in [(0.0, 50.0), (2.0, 48.0), (-3.0, 53.0)] {
        let start = at(10.0).truncate() + left_m * DVec2::from_angle(0.2).perp();
        let actor = Actor {
            point_m: start.to_array(),
            heading_rad: 0.2,
            ..actor("a", 0.0, 1, 10.0)
        };
        let mut stage = Stage::new(&story(&[actor], &[]), &map, &Arc::default()).unwrap();
        for step in 0..40 {
            stage.step(f64::from(step) * 0.1, 0.1, None);
        }
        let yaw_rad = stage.states().next().unwrap().unwrap().yaw_rad;
        near((yaw_rad - 0.2) * radius_m, 40.0, 0.1);
    }
}
