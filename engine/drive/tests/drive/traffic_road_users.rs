//! Trucks, buses, cyclists and pedestrians.

use std::sync::Arc;

use decouplegs_drive::{OrientedBox, RoadGraph, Traffic};
use decouplegs_scene::scenario::{TrafficAgent, Trigger};
use decouplegs_scene::{Pedestrian, RoadUser, VehicleSize, VehicleState};
use glam::DVec2;
use rayon::prelude::*;

use crate::roads::Random;
use crate::traffic_junctions::crossing;
use crate::traffic_liveness::first_stuck;
use crate::traffic_scenes::{SIZES_M, agent, check, mixed_traffic, roads, street};

fn pedestrian(from_m: DVec2, to_m: DVec2, waits_for_gap: bool) -> Pedestrian {
    Pedestrian {
        name: "walker".into(),
        asset: 0,
        size: VehicleSize::PEDESTRIAN,
        path_m: vec![from_m, to_m],
        speed_mps: 1.4,
        start: Trigger::Time { time_s: 1.0 },
        waits_for_gap,
    }
}

/// A vehicle of a kind at a place of a lane.
fn vehicle(kind: RoadUser, lane: &str, at_m: f64, speed_mps: f64) -> TrafficAgent {
    let size_m = SIZES_M.iter().find(|(other, _)| *other == kind);
    TrafficAgent {
        kind,
        size: size_m.map_or(VehicleSize::CAR, |(_, size_m)| {
            VehicleSize::from_array(*size_m)
        }),
        ..agent(kind.name(), lane, at_m, speed_mps)
    }
}

/// Vehicles and pedestrians that touch, by their indices.
fn touched(traffic: &Traffic, agents: &[TrafficAgent]) -> Option<(usize, usize)> {
    let (vehicles, walkers) = traffic.states().split_at(agents.len());
    let outline = |state: &VehicleState, size: &VehicleSize| OrientedBox::for_vehicle(state, size);
    vehicles.iter().enumerate().find_map(|(number, state)| {
        let vehicle = outline(state.as_ref()?, &agents[number].size);
        let walker = walkers
            .iter()
            .flatten()
            .position(|walker| outline(walker, &VehicleSize::PEDESTRIAN).overlaps(&vehicle))?;
        Some((number, walker))
    })
}

/// Pedestrians who cross random lanes of a graph at places without conflicts.
fn walkers(graph: &RoadGraph, count: usize, random: &mut Random) -> Vec<Pedestrian> {
    let mut walkers = Vec::new();
    while walkers.len() < count {
        let lane = (random.unit() * graph.lanes_in_map() as f64) as usize;
        let Some(lane) = graph.lane(lane).filter(|lane| lane.conflicts.is_empty()) else {
            continue;
        };
        let arc_m = random.unit() * lane.line.length_m();
        let (middle_m, left) = (
            lane.line.at(arc_m).truncate(),
            DVec2::from_angle(lane.line.heading_at(arc_m)).perp(),
        );
        let side = if random.unit() < 0.5 { 1.0 } else { -1.0 };
        let mut walker = pedestrian(
            middle_m - left * (14.0 * side),
            middle_m + left * (14.0 * side),
            random.unit() < 0.7,
        );
        walker.start = Trigger::Time {
            time_s: 20.0 * random.unit(),
        };
        walker.speed_mps = random.between(0.8, 2.0);
        walkers.push(walker);
    }
    walkers
}

fn lives(graph: &Arc<RoadGraph>, seeds: u64, seconds: f64) {
    let stuck: Vec<String> = (0..seeds)
        .into_par_iter()
        .filter_map(|seed| {
            let (traffic, agents) = mixed_traffic(graph, 20, seed);
            first_stuck(traffic, &agents, seed, seconds)
        })
        .collect();
    assert!(stuck.is_empty(), "{}\n{}", stuck.len(), stuck.join("\n"));
}

#[test]
fn mixed_traffic_keeps_apart_and_goes_on() {
    lives(&street(), 150, 90.0);
    lives(&crossing(), 150, 90.0);
    for (name, seeds) in [
        ("esmini_fabriksgatan.xodr", 60),
        ("lanelet2_mapping_example.osm", 60),
    ] {
        if let Some(graph) = roads(name) {
            lives(&graph, seeds, 90.0);
        }
    }
}

/// First contact of a vehicle with a pedestrian, number of pedestrians who arrived, and the
/// vehicles' way, km.
fn cross(graph: &Arc<RoadGraph>, seed: u64) -> (Option<String>, usize, f64) {
    let (traffic, agents) = mixed_traffic(graph, 14, seed);
    let walkers = walkers(graph, 6, &mut Random(seed ^ 0x9e0));
    let mut traffic = traffic.with_pedestrians(&walkers).unwrap();
    let (mut fault, mut driven_m) = (None, 0.0);
    for step in 0..900 {
        traffic.step(0.1, None);
        check(&traffic, &agents, &|| format!("seed {seed}, step {step}"));
        let found = touched(&traffic, &agents);
        if let Some((agent, walker)) = found
            && fault.is_none()
        {
            fault = Some(format!(
                "seed {seed}, {:.1} s: {} touches {walker}: {:?} {:?}",
                0.1 * f64::from(step),
                agents[agent].name,
                traffic.states()[agent],
                traffic.states()[agents.len() + walker],
            ));
        }
        driven_m += 0.1
            * traffic.states()[..agents.len()]
                .iter()
                .flatten()
                .map(|state| state.speed_mps)
                .sum::<f64>();
    }
    let states = &traffic.states()[agents.len()..];
    let arrived = states
        .iter()
        .flatten()
        .zip(&walkers)
        .filter(|(state, walker)| state.position_m.distance(walker.path_m[1]) < 0.1);
    (fault, arrived.count(), 1e-3 * driven_m)
}

#[test]
fn pedestrians_cross_untouched() {
    for graph in [crossing(), street()] {
        let seeds = 60;
        let all: Vec<_> = (0..seeds)
            .into_par_iter()
            .map(|seed| cross(&graph, seed))
            .collect();
        let faults: Vec<&String> = all
            .iter()
            .filter_map(|(fault, ..)| fault.as_ref())
            .collect();
        let arrived: usize = all.iter().map(|(_, arrived, _)| arrived).sum();
        let driven_km: f64 = all.iter().map(|(.., driven_km)| driven_km).sum();
        println!("{arrived} of {} arrived, {driven_km:.0} km", 6 * seeds);
        assert!(faults.is_empty(), "{}: {faults:#?}", faults.len());
        assert!(arrived as f64 > 0.8 * (6 * seeds) as f64 && driven_km > 50.0);
    }
}

#[test]
fn a_pedestrian_right_before_a_fast_vehicle_is_touched() {
    // Otherwise the test before would see nothing.
    let agents = [vehicle(RoadUser::Car, "in-0", 40.0, 13.0)];
    let traffic = Traffic::new(crossing(), &agents, 1).unwrap();
    let front_m = traffic.states()[0].unwrap().position_m + DVec2::new(7.0, 0.0);
    let walker = pedestrian(front_m, front_m + DVec2::new(0.0, 9.0), true);
    let mut traffic = traffic.with_pedestrians(&[walker]).unwrap();
    let mut brakes_hard = false;
    let hit = (0..20).any(|_| {
        traffic.step(0.1, None);
        brakes_hard |= traffic.emergencies().all(|emergency| emergency);
        touched(&traffic, &agents) == Some((0, 0))
    });
    assert!(hit && brakes_hard);
}

#[test]
fn vehicles_stop_for_a_pedestrian_who_steps_out_far_enough_ahead() {
    for kind in [RoadUser::Car, RoadUser::Truck, RoadUser::Bus] {
        let agents = [vehicle(kind, "in-0", 30.0, 10.0)];
        let traffic = Traffic::new(crossing(), &agents, 1).unwrap();
        // The road of in-0 leads along x to the middle of the crossing at 0.
        let walker = pedestrian(DVec2::new(-40.0, -9.0), DVec2::new(-40.0, 9.0), false);
        let mut traffic = traffic.with_pedestrians(&[walker]).unwrap();
        let mut least_mps = f64::INFINITY;
        let mut after_m = f64::NEG_INFINITY;
        for step in 0..300 {
            traffic.step(0.1, None);
            assert_eq!(touched(&traffic, &agents), None, "{kind:?}, step {step}");
            let Some(state) = traffic.states()[0] else {
                break;
            };
            after_m = after_m.max(state.position_m.x);
            least_mps = least_mps.min(state.speed_mps);
        }
        assert!(least_mps < 5.0, "{kind:?} does not brake: {least_mps} m/s");
        assert!(after_m > -20.0, "{kind:?} goes on: {after_m} m");
    }
}

#[test]
fn a_pedestrian_walks_at_the_given_speed_and_stands_at_the_end() {
    let path = [DVec2::new(-40.0, -9.0), DVec2::new(-40.0, 9.0)];
    let traffic = Traffic::new(crossing(), &[], 1).unwrap();
    let walker = pedestrian(path[0], path[1], true);
    let mut traffic = traffic.with_pedestrians(&[walker]).unwrap();
    let mut arrived_s = None;
    for step in 0..200 {
        let before = traffic.states()[0].unwrap();
        traffic.step(0.1, None);
        let state = traffic.states()[0].unwrap();
        assert!(state.speed_mps <= 1.4 + 1e-9);
        assert!(state.acceleration_mps2.abs() <= 4.0 + 1e-9, "{state:?}");
        let moved_m = state.position_m.distance(before.position_m);
        assert!((moved_m - 0.1 * state.speed_mps).abs() < 1e-6);
        if arrived_s.is_none() && state.position_m.distance(path[1]) < 0.01 {
            arrived_s = Some(0.1 * f64::from(step + 1));
        }
    }
    // 18 m at 1.4 m/s, a second later, and 0.7 s to start and to stop.
    let arrived_s = arrived_s.expect("the pedestrian arrives");
    assert!((13.5..15.5).contains(&arrived_s), "{arrived_s}");
    assert_eq!(traffic.states()[0].unwrap().speed_mps, 0.0);
}

#[test]
fn a_pedestrian_who_is_held_up_on_the_road_goes_back() {
    // The ego stands across the path, on the second lane.
    let ego = VehicleState {
        position_m: DVec2::new(-40.0, 1.75),
        ..VehicleState::default()
    };
    let traffic = Traffic::new(crossing(), &[], 1).unwrap();
    let walker = pedestrian(DVec2::new(-40.0, -9.0), DVec2::new(-40.0, 9.0), false);
    let mut traffic = traffic.with_pedestrians(&[walker]).unwrap();
    let mut farthest_m = f64::NEG_INFINITY;
    for _ in 0..300 {
        traffic.step(0.1, Some((&ego, &VehicleSize::CAR)));
        farthest_m = farthest_m.max(traffic.states()[0].unwrap().position_m.y);
    }
    let last_m = traffic.states()[0].unwrap().position_m.y;
    assert!(farthest_m > -1.5 && farthest_m < 0.7, "{farthest_m}");
    assert!(last_m < -3.7, "beside the road: {last_m}");
}

#[test]
fn cyclists_keep_right_and_trucks_start_slowly() {
    let graph = crossing();
    let run = |kind, speed_mps| {
        let agents = [vehicle(kind, "in-0", 20.0, speed_mps)];
        let mut traffic = Traffic::new(graph.clone(), &agents, 1).unwrap();
        (0..50).for_each(|_| traffic.step(0.1, None));
        (
            traffic.states()[0].unwrap(),
            traffic.lane_positions().next().unwrap().unwrap(),
        )
    };
    let (cyclist, place) = run(RoadUser::Cyclist, 3.0);
    assert!(cyclist.speed_mps < 20.0 / 3.6 + 1e-6, "{cyclist:?}");
    // As far right as a car reaches: the graph is for cars of 2 m, a cyclist has 0.6 m.
    let half_m = 0.5 * (graph.vehicle().width_m - 0.6);
    assert!((place.lateral_m + half_m).abs() < 1e-9, "{place:?}");
    assert!(
        (cyclist.position_m.y + 1.75 + half_m).abs() < 1e-6,
        "{cyclist:?}"
    );
    let [car, truck] = [RoadUser::Car, RoadUser::Truck].map(|kind| run(kind, 0.0).0.speed_mps);
    assert!(
        truck < 0.75 * car && truck > 1.0,
        "{truck} against {car} m/s"
    );
}
