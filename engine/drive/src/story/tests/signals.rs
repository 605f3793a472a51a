//! Traffic lights that events change, and events that wait for them.

use std::sync::Arc;

use decouplegs_scene::story::{Action, LightController, Story, When};
use decouplegs_scene::{LightChange, LightColor, LightCourse, LightPhase, StopLine, TrafficLight};

use super::{A, Stage, actor, event, from_time, road, story, when};
use crate::lights::TrafficLights;
use crate::road_graph::RoadGraph;

/// Lights `a` and `b` on the first lane, green for 6 s and red for 4.
fn lights() -> Arc<TrafficLights> {
    let map = road();
    let light = |name: &str, at_m: f64| TrafficLight {
        name: name.into(),
        stop_lines: vec![StopLine {
            lane: "1/0/-1".into(),
            at_m,
            ..StopLine::default()
        }],
        phases: [(LightColor::Green, 6.0), (LightColor::Red, 4.0)]
            .map(|(color, duration_s)| LightPhase { color, duration_s })
            .to_vec(),
        ..TrafficLight::default()
    };
    let lights = [light("a", 100.0), light("b", 300.0)];
    Arc::new(TrafficLights::new(&map, &RoadGraph::new(&map).unwrap(), &lights).unwrap())
}

/// A story whose controller `c` has both lights, in phases `go` and `stop`.
fn controlled(events: &[decouplegs_scene::story::Event]) -> Story {
    Story {
        controllers: vec![LightController {
            name: "c".into(),
            phases: vec![("go".into(), 6.0), ("stop".into(), 4.0)],
            offset_s: 0.0,
            lights: vec!["a".into(), "b".into()],
        }],
        ..story(&[actor("x", 0.0, 1, 10.0)], events)
    }
}

fn held(color: LightColor) -> Action {
    let light = "a".into();
    Action::Light { light, color }
}

fn begun(phase: &str) -> Action {
    let (controller, phase) = ("c".into(), phase.into());
    Action::Phase { controller, phase }
}

/// Times at which each event began, and the stage after 20 s.
fn run(story: &Story) -> (Vec<Option<f64>>, Stage) {
    let mut stage = Stage::new(story, &road(), &lights()).unwrap();
    for step in 0..200 {
        stage.step(f64::from(step) * 0.1, 0.1, None);
    }
    let begun = stage.courses.iter().map(|course| course.begun_s);
    (begun.collect(), stage)
}

#[test]
fn a_light_keeps_the_color_that_an_event_gives_it() {
    use LightColor::{Green, Red, Yellow};
    let (_, mut stage) = run(&controlled(&[
        event(from_time(2.0), &[(A, held(Yellow))]),
        event(from_time(9.0), &[(A, held(Red))]),
    ]));
    let colors = [1.9, 2.0, 8.9, 9.0, 15.0].map(|time_s| stage.lights().color_at(0, time_s));
    assert_eq!(colors, [Green, Yellow, Yellow, Red, Red]);
    assert_eq!(stage.lights().color_at(1, 15.0), Green, "the other one");
    let changes = stage.take_light_changes();
    let change = |time_s, color| LightChange {
        time_s,
        course: LightCourse::Held(color),
    };
    let found: Vec<_> = changes.iter().map(|record| record.change).collect();
    assert_eq!(found, [change(2.0, Yellow), change(9.0, Red)]);
    assert!(stage.take_light_changes().is_empty(), "they were taken");
}

#[test]
fn a_phase_that_begins_moves_the_cycle_of_all_lights_of_its_controller() {
    let (_, stage) = run(&controlled(&[event(from_time(2.0), &[(A, begun("stop"))])]));
    for light in 0..2 {
        let colors = [1.9, 2.0, 5.9, 6.1, 11.9, 12.1];
        let colors = colors.map(|time_s| stage.lights().color_at(light, time_s));
        use LightColor::{Green, Red};
        assert_eq!(colors, [Green, Red, Red, Green, Green, Red], "{light}");
    }
}

#[test]
fn events_wait_for_colors_and_phases() {
    let wait = Action::Wait { duration_s: 0.1 };
    let color = |color| {
        when(When::Light {
            light: "b".into(),
            color,
        })
    };
    let phase = |phase: &str| {
        when(When::Phase {
            controller: "c".into(),
            phase: phase.into(),
        })
    };
    let (begun_s, _) = run(&controlled(&[
        event(color(LightColor::Red), &[(A, wait.clone())]),
        event(phase("stop"), &[(A, wait.clone())]),
        event(phase("none"), &[(A, wait.clone())]),
        event(color(LightColor::Yellow), &[(A, wait.clone())]),
    ]));
    assert_eq!(begun_s, [Some(6.0), Some(6.0), None, None]);
    // An event may change what another waits for.
    let (begun_s, _) = run(&controlled(&[
        event(from_time(1.0), &[(A, begun("stop"))]),
        event(phase("stop"), &[(A, wait.clone())]),
        event(color(LightColor::Red), &[(A, wait)]),
    ]));
    assert_eq!(begun_s, [Some(1.0), Some(1.0), Some(1.0)]);
}

#[test]
fn lights_and_controllers_that_are_not_there_are_named() {
    let none = Action::Light {
        light: "z".into(),
        color: LightColor::Red,
    };
    let of_none = Story {
        controllers: vec![],
        ..controlled(&[event(from_time(1.0), &[(A, begun("go"))])])
    };
    for (story, name) in [
        (
            controlled(&[event(from_time(1.0), &[(A, none)])]),
            "a traffic light z",
        ),
        (of_none, "a controller c"),
    ] {
        let error = Stage::new(&story, &road(), &lights()).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
    }
}
