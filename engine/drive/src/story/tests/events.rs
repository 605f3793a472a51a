//! Events of stories: conditions, priorities and acts.

use std::sync::Arc;

use decouplegs_scene::story::{
    Act, Action, Change, Condition, Direction, Dynamics, Edge, End, Event, Extent, Measure,
    Priority, Rule, Shape, Speed, Spot, State, Trigger, When, Who,
};
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::{A, B, Stage, actor, dynamics, event, from_time, near, played, road, story, when};

/// Time at which the only event of the first actor begins, seconds.
fn begins_s(start: Trigger, others: &[Event]) -> Option<f64> {
    let stop = Action::Speed {
        target: Speed::Mps(0.0),
        dynamics: Dynamics::STEP,
    };
    let mut events = vec![event(start, &[(A, stop)])];
    events.extend_from_slice(others);
    let pair = [actor("a", 100.0, 1, 10.0), actor("b", 150.0, 1, 5.0)];
    let mut whole = story(&pair, &events);
    whole.variables = vec![("n".into(), "1".into())];
    let mut stage = Stage::new(&whole, &road(), &Arc::default()).unwrap();
    let (state, size) = (
        VehicleState {
            position_m: DVec2::new(90.0, -5.25),
            ..VehicleState::default()
        },
        VehicleSize::CAR,
    );
    for step in 0..200 {
        stage.step(f64::from(step) * 0.1, 0.1, Some((&state, &size)));
        if stage.courses[0].begun_s.is_some() {
            return stage.courses[0].begun_s;
        }
    }
    None
}

fn value(of: Who, measure: Measure, rule: Rule, value: f64) -> Trigger {
    when(When::Value {
        of: vec![of],
        all: false,
        measure,
        rule,
        value,
    })
}

#[test]
fn values_of_any_road_user_are_measured() {
    let distance = |direction: Direction, between_boxes: bool| Measure::Distance {
        to: End::Who(B),
        direction,
        between_boxes,
    };
    let reach = Measure::Distance {
        to: End::At(Spot::Point {
            at_m: [200.0, -1.75],
            heading_rad: None,
        }),
        direction: Direction::Straight,
        between_boxes: false,
    };
    // A closes 50 m at 5 m/s; boxes are 4 m long. The ego stands 10 m behind, a lane beside.
    for (of, measure, rule, limit, expected_s) in [
        (
            A,
            distance(Direction::Straight, false),
            Rule::Less,
            20.0,
            6.0,
        ),
        (
            A,
            distance(Direction::AlongLanes, true),
            Rule::Less,
            20.0,
            5.2,
        ),
        (
            A,
            distance(Direction::Ahead, true),
            Rule::LessOrEqual,
            16.0,
            6.0,
        ),
        (B, distance(Direction::Beside, false), Rule::Less, 1.0, 0.0),
        (
            A,
            Measure::Headway {
                to: B,
                direction: Direction::AlongLanes,
                between_boxes: false,
            },
            Rule::Less,
            2.0,
            6.0,
        ),
        (
            A,
            Measure::TimeToCollision {
                to: End::Who(B),
                direction: Direction::Straight,
                between_boxes: false,
            },
            Rule::Less,
            4.0,
            6.0,
        ),
        // Who is ahead has none until it is passed.
        (
            B,
            Measure::Headway {
                to: A,
                direction: Direction::Ahead,
                between_boxes: false,
            },
            Rule::Less,
            99.0,
            10.0,
        ),
        (A, Measure::RelativeSpeed { to: B }, Rule::Equal, 5.0, 0.0),
        (A, Measure::Traveled, Rule::GreaterOrEqual, 50.0, 5.0),
        (B, reach, Rule::LessOrEqual, 25.0, 5.0),
        (Who::EGO, Measure::Standing, Rule::GreaterOrEqual, 2.0, 2.0),
        (
            A,
            Measure::Touched { with: vec![B] },
            Rule::GreaterOrEqual,
            1.0,
            9.2,
        ),
        (
            A,
            Measure::Near {
                with: vec![],
                ahead_m: 0.0,
                behind_m: 30.0,
                lanes: [-1, -1],
                between_boxes: false,
            },
            Rule::Less,
            1.0,
            1.9,
        ),
        (
            A,
            Measure::Turn {
                heading_rad: 0.0,
                is_relative: true,
            },
            Rule::LessOrEqual,
            0.1,
            0.0,
        ),
    ] {
        let found_s = begins_s(value(of, measure.clone(), rule, limit), &[]);
        let is_near = found_s.is_some_and(|found_s| (found_s - expected_s).abs() < 0.15);
        assert!(is_near, "{measure:?}: {found_s:?}, not {expected_s}");
    }
    for never in [
        value(A, Measure::OffRoad, Rule::GreaterOrEqual, 0.0),
        value(Who(7), Measure::Speed, Rule::GreaterOrEqual, 0.0),
        when(When::Always { holds: false }),
    ] {
        assert_eq!(begins_s(never, &[]), None);
    }
    assert_eq!(
        begins_s(value(A, Measure::AtEnd, Rule::GreaterOrEqual, 0.0), &[]),
        None
    );
}

#[test]
fn edges_delays_groups_variables_and_other_events_decide() {
    let condition = |edge: Edge, delay_s: f64, when: When| Condition {
        edge,
        delay_s,
        when,
    };
    let time = |value_s: f64| When::Time {
        rule: Rule::GreaterOrEqual,
        value_s,
    };
    let near_s = |found_s: Option<f64>, expected_s: f64| {
        let is_near = found_s.is_some_and(|found_s| (found_s - expected_s).abs() < 0.03);
        assert!(is_near, "{found_s:?}, not {expected_s}");
    };
    near_s(
        begins_s(vec![vec![condition(Edge::Rising, 0.5, time(1.0))]], &[]),
        1.5,
    );
    // What holds from the beginning does not rise.
    assert_eq!(
        begins_s(vec![vec![condition(Edge::Rising, 0.0, time(0.0))]], &[]),
        None
    );
    let before = When::Time {
        rule: Rule::Less,
        value_s: 2.0,
    };
    near_s(
        begins_s(vec![vec![condition(Edge::Falling, 0.0, before)]], &[]),
        2.0,
    );
    let both = vec![
        vec![condition(Edge::None, 0.0, time(9.0))],
        vec![
            condition(Edge::None, 0.0, time(2.0)),
            condition(Edge::None, 0.0, time(3.0)),
        ],
    ];
    near_s(begins_s(both, &[]), 3.0);

    let slower = Action::Speed {
        target: Speed::Mps(1.0),
        dynamics: dynamics(Shape::Linear, Extent::TimeS(2.0)),
    };
    let other = event(from_time(1.0), &[(B, slower)]);
    for (state, expected_s) in [
        (State::Begun, 1.0),
        (State::Runs, 1.0),
        (State::Ended, 3.0),
        (State::Over, 3.0),
        (State::Waits, 0.0),
        // An act begins before its events do, also before the one that waits for it.
        (State::ActBegun, 0.0),
        (State::ActRuns, 0.0),
    ] {
        let events = vec![1];
        let trigger = when(When::Events { events, state });
        near_s(begins_s(trigger, std::slice::from_ref(&other)), expected_s);
    }
    let add = Action::Set {
        variable: "n".into(),
        value: "2".into(),
        by: Change::Add,
    };
    let mut adds = event(from_time(1.0), &[(Who::EGO, add)]);
    adds.executions = 3;
    let seven = When::Variable {
        variable: "n".into(),
        rule: Rule::Equal,
        value: "7".into(),
    };
    near_s(begins_s(when(seven), &[adds]), 1.06);
}

#[test]
fn priorities_acts_and_stops_decide_which_event_runs() {
    let speed = |mps: f64| Action::Speed {
        target: Speed::Mps(mps),
        dynamics: dynamics(Shape::Linear, Extent::TimeS(4.0)),
    };
    let aside = Action::Offset {
        offset_m: 0.5,
        from: None,
        dynamics: Dynamics::STEP,
        continuous: true,
    };
    for (priority, expected) in [
        // The first stops half way; it goes on beside; the second does not begin.
        (Priority::Override, (15.0, -1.25)),
        (Priority::Parallel, (20.0, -1.25)),
        (Priority::Skip, (20.0, -1.75)),
    ] {
        let mut second = event(from_time(2.0), &[(A, aside.clone())]);
        second.priority = priority;
        let events = [event(Trigger::new(), &[(A, speed(20.0))]), second];
        let mut one = story(&[actor("a", 100.0, 1, 10.0)], &events);
        if priority == Priority::Skip {
            // Otherwise it would begin after the first.
            one.acts[0].stop = from_time(3.9);
        }
        let moments = played(&one, 39);
        let (point_m, _, speed_mps) = moments[39][0];
        near(
            speed_mps,
            if priority == Priority::Skip {
                19.75
            } else {
                expected.0
            },
            0.3,
        );
        near(point_m.y, expected.1, 1e-6);
    }
    // An act that begins later, and one that stops what runs.
    let mut late = story(
        &[actor("a", 100.0, 1, 10.0)],
        &[event(Trigger::new(), &[(A, speed(20.0))])],
    );
    late.acts[0] = Act {
        start: from_time(1.0),
        stop: from_time(3.0),
    };
    near(played(&late, 80)[80][0].2, 15.0, 0.06);
}

#[test]
fn a_story_is_over_once_its_conditions_have_held() {
    let ends_s = |stop: Trigger| {
        let stand = Action::Speed {
            target: Speed::Mps(0.0),
            dynamics: dynamics(Shape::Linear, Extent::TimeS(2.0)),
        };
        let mut one = story(
            &[actor("a", 100.0, 1, 10.0)],
            &[event(from_time(1.0), &[(A, stand)])],
        );
        one.stop = stop;
        let mut stage = Stage::new(&one, &road(), &Arc::default()).unwrap();
        (0..100).find(|step| {
            stage.step(f64::from(*step) * 0.1, 0.1, None);
            stage.is_over()
        })
    };
    let ended = When::Events {
        events: vec![0],
        state: State::Ended,
    };
    // The event begins after 1 s and takes 2 s; its end is seen in the part after it.
    let delayed = vec![vec![Condition {
        edge: Edge::Rising,
        delay_s: 2.0,
        when: ended.clone(),
    }]];
    let traveled = |way_m: f64| value(A, Measure::Traveled, Rule::GreaterOrEqual, way_m);
    assert_eq!(ends_s(traveled(5.0)), Some(5));
    // It stands after 20 m.
    assert_eq!(ends_s(traveled(25.0)), None);
    assert_eq!(ends_s(Trigger::new()), None);
    let first = ends_s(when(ended)).unwrap();
    assert!((29..=31).contains(&first), "{first}");
    assert_eq!(ends_s(delayed), Some(first + 20));
    let both = [traveled(25.0), traveled(5.0)].concat();
    assert_eq!(ends_s(both), Some(5), "one group is enough");
}
