//! Capacity of roads with drawn drivers: vehicles an hour and lane on a motorway, and behind a
//! traffic light that turns green before a long queue.

use std::f64::consts::TAU;
use std::sync::Arc;

use decouplegs_drive::lights::TrafficLights;
use decouplegs_drive::{RoadGraph, Traffic};
use decouplegs_scene::scenario::{Drivers, TrafficAgent};
use decouplegs_scene::{Lane, LaneMap, LightColor, LightPhase, StopLine, TrafficLight};
use glam::DVec3;
use rayon::prelude::*;

use crate::traffic_scenes::{agent, straight};

/// Radius of the ring, meters: no bend of it is slow.
const RADIUS_M: f64 = 500.0;
const MOTORWAY_MPS: f64 = 100.0 / 3.6;
const TOWN_MPS: f64 = 50.0 / 3.6;
const STEP_S: f64 = 0.1;

/// A ring of one lane in four parts.
fn ring() -> Arc<RoadGraph> {
    let line = |quarter: u32, radius_m: f64| -> Vec<DVec3> {
        let from_rad = 0.25 * TAU * f64::from(quarter);
        let point = |at: u32| {
            let rad = from_rad + 0.25 * TAU * f64::from(at) / 800.0;
            DVec3::new(radius_m * rad.cos(), radius_m * rad.sin(), 0.0)
        };
        (0..=800).map(point).collect()
    };
    let lanes = (0..4).map(|quarter: u32| Lane {
        id: quarter.to_string(),
        centerline: line(quarter, RADIUS_M),
        speed_limit_mps: Some(MOTORWAY_MPS),
        successors: vec![(quarter as usize + 1) % 4],
        ..Lane::default()
    });
    let map = LaneMap {
        lanes: lanes.collect(),
        ..LaneMap::default()
    };
    Arc::new(RoadGraph::new(&map).unwrap())
}

/// Vehicles an hour that pass a place on the ring with `count` cars, after they have found their
/// speeds: density times mean speed.
fn flow(graph: &Arc<RoadGraph>, count: usize, drivers: Drivers, seed: u64) -> f64 {
    // The line is a little shorter than the arc.
    let quarter_m = 0.25 * TAU * RADIUS_M * (1.0 - 1e-6);
    let spacing_m = 4.0 * quarter_m / count as f64;
    let agents: Vec<TrafficAgent> = (0..count)
        .map(|number| {
            let at_m = spacing_m * (number as f64 + 0.5);
            let quarter = (at_m / quarter_m) as usize;
            let at_m = at_m - quarter_m * quarter as f64;
            agent(&number.to_string(), &quarter.to_string(), at_m, 15.0)
        })
        .collect();
    let traffic = Traffic::new(graph.clone(), &agents, seed).unwrap();
    let mut traffic = traffic.with_drivers(drivers, &agents);
    let (mut sum_mps, mut steps) = (0.0, 0);
    for step in 0..3000 {
        traffic.step(STEP_S, None);
        if step >= 1800 {
            let speeds = traffic.states().iter().flatten();
            sum_mps += speeds.map(|state| state.speed_mps).sum::<f64>() / count as f64;
            steps += 1;
        }
    }
    3600.0 * (sum_mps / f64::from(steps)) / spacing_m
}

/// The largest flow over all densities, vehicles an hour: mean of some seeds.
fn capacity(drivers: Drivers) -> f64 {
    let graph = ring();
    let seeds = 1..=3_u64;
    let largest = |seed: u64| {
        let counts = [40, 50, 60, 70, 80, 90, 100, 110].into_par_iter();
        let flows = counts.map(|count| flow(&graph, count, drivers, seed));
        flows.reduce(|| 0.0, f64::max)
    };
    let count = seeds.clone().count() as f64;
    seeds.map(largest).sum::<f64>() / count
}

#[test]
fn a_motorway_with_drawn_drivers_carries_what_real_ones_do() {
    let carries = |flow: f64| (1900.0..=2300.0).contains(&flow);
    let (drawn, kinds) = (capacity(Drivers::Drawn), capacity(Drivers::Kinds));
    println!("capacity in vehicles an hour and lane: drawn {drawn:.0}, normal kind {kinds:.0}");
    assert!(carries(drawn), "{drawn}");
    assert!(!carries(kinds), "{kinds}");
}

/// Flow of a queue of `count` cars over a line whose light turns green, vehicles an hour, from the
/// fourth to the last as the Highway Capacity Manual counts.
fn saturation(drivers: Drivers, seed: u64) -> f64 {
    const LINE_M: f64 = 400.0;
    const COUNT: usize = 30;
    const RED_S: f64 = 5.0;
    let graph = straight(1200.0, 1, TOWN_MPS);
    let agents: Vec<TrafficAgent> = (0..COUNT)
        .map(|number| {
            agent(
                &number.to_string(),
                "0",
                LINE_M - 4.0 - 7.2 * number as f64,
                0.0,
            )
        })
        .collect();
    let line = StopLine {
        lane: "0".into(),
        at_m: LINE_M,
        ..StopLine::default()
    };
    let phase = |color, duration_s| LightPhase { color, duration_s };
    let light = TrafficLight {
        name: "light".into(),
        stop_lines: vec![line],
        phases: vec![
            phase(LightColor::Red, RED_S),
            phase(LightColor::Green, 300.0),
        ],
        offset_s: 0.0,
        changes: vec![],
    };
    let map = LaneMap {
        lanes: vec![Lane {
            id: "0".into(),
            centerline: vec![DVec3::ZERO, DVec3::new(1200.0, 0.0, 0.0)],
            ..Lane::default()
        }],
        ..LaneMap::default()
    };
    let lights = Arc::new(TrafficLights::new(&map, &graph, &[light]).unwrap());
    let traffic = Traffic::new(graph, &agents, seed).unwrap();
    let mut traffic = traffic.with_drivers(drivers, &agents).with_lights(lights);
    let mut passed_s = vec![None; COUNT];
    for step in 1..2000 {
        traffic.step(STEP_S, None);
        for (passed_s, state) in passed_s.iter_mut().zip(traffic.states()) {
            let is_over = state.is_some_and(|state| state.position_m.x + 2.25 > LINE_M);
            if is_over && passed_s.is_none() {
                *passed_s = Some(STEP_S * f64::from(step));
            }
        }
        if passed_s.iter().all(Option::is_some) {
            break;
        }
    }
    let [fourth_s, last_s] = [3, COUNT - 1].map(|at| passed_s[at].unwrap());
    assert!(passed_s[0].unwrap() > RED_S, "the first waits for green");
    3600.0 * (COUNT - 4) as f64 / (last_s - fourth_s)
}

#[test]
fn a_queue_of_drawn_drivers_leaves_a_light_faster_than_one_of_normal_drivers() {
    let mean = |drivers: Drivers| (1..=8).map(|seed| saturation(drivers, seed)).sum::<f64>() / 8.0;
    let (drawn, kinds) = (mean(Drivers::Drawn), mean(Drivers::Kinds));
    println!("saturation flow in vehicles an hour: drawn {drawn:.0}, normal kind {kinds:.0}");
    // Real lights let through about 1,800: drawn drivers start less briskly than real ones.
    let is_near = |flow: f64| (1400.0..=1900.0).contains(&flow);
    assert!(is_near(drawn), "{drawn}");
    assert!(!is_near(kinds), "{kinds}");
}
