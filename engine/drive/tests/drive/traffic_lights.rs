//! Traffic lights: agents obey them, go on, and are never green across each other.

use std::sync::Arc;

use decouplegs_drive::lights::TrafficLights;
use decouplegs_drive::{RoadGraph, Traffic};
use decouplegs_scene::scenario::TrafficAgent;
use decouplegs_scene::{LaneMap, LightColor, LightPhase, StopLine, TrafficLight, VehicleState};
use glam::DVec2;
use rayon::prelude::*;

use crate::traffic_junctions::crossing_map;
use crate::traffic_liveness::first_stuck;
use crate::traffic_scenes::{agent, check, random_traffic, street_map};

const PHASES: [(LightColor, f64); 3] = [
    (LightColor::Green, 12.0),
    (LightColor::Yellow, 3.0),
    (LightColor::Red, 19.0),
];
/// Vehicles that start too near to a red light to stop pass it in this time, seconds.
const START_S: f64 = 5.0;

pub fn light(name: &str, lines: &[(&str, f64)], offset_s: f64) -> TrafficLight {
    TrafficLight {
        name: name.into(),
        stop_lines: lines
            .iter()
            .map(|&(lane, at_m)| StopLine {
                lane: lane.into(),
                at_m,
                ..StopLine::default()
            })
            .collect(),
        phases: PHASES
            .map(|(color, duration_s)| LightPhase { color, duration_s })
            .into(),
        offset_s,
        changes: vec![],
    }
}

/// Lights of the crossing of two roads with one lane each way.
fn lights_of_crossing() -> [TrafficLight; 2] {
    [
        light("main", &[("in-0", 106.0), ("in-2", 106.0)], 0.0),
        light("cross", &[("in-1", 106.0), ("in-3", 106.0)], 17.0),
    ]
}

fn on(map: &LaneMap, lights: &[TrafficLight]) -> (Arc<RoadGraph>, Arc<TrafficLights>) {
    let graph = Arc::new(RoadGraph::new(map).unwrap());
    let lights = TrafficLights::new(map, &graph, lights).unwrap();
    (graph, Arc::new(lights))
}

/// Stop lines that agents pass at green, yellow and red in 120 s. They obey `obeyed`.
fn passes(
    graph: &Arc<RoadGraph>,
    lights: &TrafficLights,
    obeyed: &Arc<TrafficLights>,
    seed: u64,
) -> [usize; 3] {
    let (traffic, agents) = random_traffic(graph, 24, seed);
    let mut traffic = traffic.with_lights(obeyed.clone());
    let fronts = |traffic: &Traffic| -> Vec<Option<DVec2>> {
        let front = |(state, agent): (&Option<VehicleState>, &TrafficAgent)| {
            let state = (*state)?;
            Some(state.position_m + state.ahead() * (0.5 * agent.size.length_m))
        };
        traffic.states().iter().zip(&agents).map(front).collect()
    };
    let (mut passed, mut before) = ([0; 3], fronts(&traffic));
    for step in 0..1200 {
        let time_s = 0.1 * f64::from(step);
        traffic.step(0.1, None);
        check(&traffic, &agents, &|| format!("seed {seed}, step {step}"));
        let after = fronts(&traffic);
        for line in lights.lines() {
            for (from_m, to_m) in before.iter().zip(&after) {
                let (Some(from_m), Some(to_m)) = (*from_m, *to_m) else {
                    continue;
                };
                let (from, _) = line.record.locate(from_m);
                let (to, is_within) = line.record.locate(to_m);
                // Vehicles that enter the map come from elsewhere.
                let passes = from < 0.0 && to >= 0.0 && is_within && to - from < 3.0;
                if passes && time_s > START_S {
                    passed[lights.color_at(line.record.index, time_s) as usize] += 1;
                }
            }
        }
        before = after;
    }
    passed
}

#[test]
fn agents_stop_at_red_and_pass_at_green() {
    let all = |obeys: bool| {
        let (graph, lights) = on(&crossing_map(), &lights_of_crossing());
        let obeyed = if obeys {
            lights.clone()
        } else {
            Arc::default()
        };
        (0..60)
            .into_par_iter()
            .map(|seed| passes(&graph, &lights, &obeyed, seed))
            .reduce(|| [0; 3], |a, b| [a[0] + b[0], a[1] + b[1], a[2] + b[2]])
    };
    let [green, yellow, red] = all(true);
    println!("passed at green {green}, at yellow {yellow}, at red {red}");
    assert!(red == 0 && green > 1000 && yellow > 10);
    let [_, _, red] = all(false);
    assert!(red > 300, "without lights {red} pass at red");
}

#[test]
fn traffic_with_lights_goes_on() {
    let street = street_map();
    for (map, lights, seeds) in [
        (&crossing_map(), lights_of_crossing().to_vec(), 300),
        (&street, street.lights.clone(), 200),
    ] {
        let (graph, lights) = on(map, &lights);
        let stuck: Vec<String> = (0..seeds)
            .into_par_iter()
            .filter_map(|seed| {
                let (traffic, agents) = random_traffic(&graph, 24, seed);
                let traffic = traffic.with_lights(lights.clone());
                first_stuck(traffic, &agents, seed, 120.0)
            })
            .collect();
        assert!(stuck.is_empty(), "{}\n{}", stuck.len(), stuck.join("\n"));
    }
}

#[test]
fn traffic_without_lights_is_what_it_was() {
    let (graph, none) = on(&crossing_map(), &[]);
    let (mut plain, _) = random_traffic(&graph, 24, 5);
    let mut with_none = plain.clone().with_lights(none);
    for _ in 0..600 {
        plain.step(0.1, None);
        with_none.step(0.1, None);
        assert_eq!(plain.states(), with_none.states());
    }
}

#[test]
fn an_agent_stops_before_the_line_and_starts_at_green() {
    let red = [
        (LightColor::Red, 20.0),
        (LightColor::Green, 20.0),
        (LightColor::Yellow, 3.0),
    ];
    let mut lights = lights_of_crossing();
    lights[0].phases = red
        .map(|(color, duration_s)| LightPhase { color, duration_s })
        .into();
    let (graph, lights) = on(&crossing_map(), &lights);
    let agents = [agent("a", "in-0", 30.0, 12.0)];
    let mut traffic = Traffic::new(graph, &agents, 1).unwrap().with_lights(lights);
    let front_m = |traffic: &Traffic| traffic.states()[0].unwrap().position_m.x + 2.25;
    let mut braking_mps2 = 0.0_f64;
    for _ in 0..200 {
        traffic.step(0.1, None);
        braking_mps2 = braking_mps2.max(-traffic.states()[0].unwrap().acceleration_mps2);
    }
    // The line is at x = -14 m.
    let waiting_m = front_m(&traffic);
    assert!((-16.0..-14.0).contains(&waiting_m), "{waiting_m}");
    assert!(braking_mps2 < 3.0, "{braking_mps2}");
    for _ in 0..60 {
        traffic.step(0.1, None);
    }
    assert!(front_m(&traffic) > 0.0);
}

#[test]
fn stop_lines_are_on_lanes_of_the_map() {
    let map = crossing_map();
    let graph = RoadGraph::new(&map).unwrap();
    let refused = |line: (&str, f64)| {
        TrafficLights::new(&map, &graph, &[light("a", &[line], 0.0)])
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        refused(("in-9", 1.0)),
        "traffic light a: lane in-9 is not a driving lane of the map"
    );
    assert!(refused(("in-0", 109.0)).contains("109 m along lane in-0; expected 0 to 108.00"));
    let lights = TrafficLights::new(&map, &graph, &lights_of_crossing()).unwrap();
    let record = lights.lines()[0].record;
    assert!(record.middle_m().distance(DVec2::new(-14.0, -1.75)) < 1e-9);
    assert!(record.ahead().distance(DVec2::X) < 1e-9);
    let (before_m, is_within) = record.locate(DVec2::new(-15.0, -1.0));
    assert!((before_m + 1.0).abs() < 1e-9 && is_within);
    assert!(!record.locate(DVec2::new(-13.0, 1.0)).1);
}

#[test]
fn a_light_towards_one_way_holds_those_alone_that_take_it() {
    let map = crossing_map();
    let always = |name: &str, towards: &[&str], color| {
        let mut light = light(name, &[("in-0", 106.0)], 0.0);
        light.stop_lines[0].towards = towards.iter().map(|&lane| lane.into()).collect();
        light.phases = vec![LightPhase {
            color,
            duration_s: 10.0,
        }];
        light
    };
    // Lanes to the left are red for ever, the others green.
    let lights = [
        always("left", &["left-0"], LightColor::Red),
        always("others", &["straight-0", "right-0"], LightColor::Green),
    ];
    let (graph, lights) = on(&map, &lights);
    let (mut held, mut passed) = (0, 0);
    for seed in 0..24 {
        let agents = [agent("a", "in-0", 30.0, 8.0)];
        let traffic = Traffic::new(graph.clone(), &agents, seed).unwrap();
        let mut free = traffic.clone();
        let mut obeying = traffic.with_lights(lights.clone());
        let mut takes_left = false;
        for _ in 0..250 {
            free.step(0.1, None);
            obeying.step(0.1, None);
            let position = free.lane_positions().next().flatten();
            takes_left |= position.is_some_and(|at| map.lanes[at.lane].id == "left-0");
        }
        let stands = obeying.states()[0].is_some_and(|state| state.speed_mps < 0.1);
        assert_eq!(stands, takes_left, "seed {seed}");
        (held, passed) = (held + u32::from(stands), passed + u32::from(!stands));
    }
    assert!(held > 2 && passed > 2, "{held} held, {passed} passed");
    let [in_0, left, straight] = ["in-0", "left-0", "straight-0"]
        .map(|id| map.lanes.iter().position(|lane| lane.id == id).unwrap());
    let concerned = |lanes: &[usize]| -> Vec<bool> {
        lights
            .lines()
            .iter()
            .map(|line| line.concerns(lanes))
            .collect()
    };
    assert_eq!(concerned(&[in_0, left]), [true, false]);
    assert_eq!(concerned(&[in_0, straight]), [false, true]);
    let mut wrong = light("a", &[("in-0", 106.0)], 0.0);
    wrong.stop_lines[0].towards = vec!["out-2".into()];
    let refused = TrafficLights::new(&map, &graph, &[wrong]).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "traffic light a: a stop line of lane in-0 towards lane out-2; expected lanes that follow \
         it"
    );
}
