//! Traffic goes on: with any seed and on any map, a vehicle stands only for a vehicle that moves.

use std::sync::Arc;

use decouplegs_drive::{RoadGraph, Traffic};
use decouplegs_scene::scenario::TrafficAgent;
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;
use rayon::prelude::*;

use crate::traffic_junctions::crossing;
use crate::traffic_scenes::{agent, check, random_traffic, roads, street};

/// Longest time that a vehicle may stand, seconds.
const STANDING_S: f64 = 30.0;
/// Longest time that a vehicle may stand where traffic passes that it has to let pass, seconds.
const YIELDING_S: f64 = 120.0;
/// Largest distance of the traffic that excuses standing, meters.
const NEAR_M: f64 = 80.0;
/// A vehicle starts within this time after the last one that it waited for has left, seconds.
const STARTING_S: f64 = 3.0;
/// A vehicle that moved less than this stands, meters.
const MOVED_M: f64 = 0.5;

/// Standing times of the agents of a traffic.
struct Standing {
    /// Place and time of each agent when it last moved.
    since: Vec<Option<(DVec2, f64)>>,
    /// Last time at which another vehicle near it moved.
    in_company_s: Vec<f64>,
}

impl Standing {
    fn new(agents: usize) -> Self {
        Self {
            since: vec![None; agents],
            in_company_s: vec![0.0; agents],
        }
    }

    /// Updates the times at `time_s`; the agents that stand without a reason.
    fn update(&mut self, traffic: &Traffic, time_s: f64) -> Vec<usize> {
        for (since, state) in self.since.iter_mut().zip(traffic.states()) {
            *since = state.map(|state| match *since {
                Some((place_m, since_s)) if place_m.distance(state.position_m) < MOVED_M => {
                    (place_m, since_s)
                }
                _ => (state.position_m, time_s),
            });
        }
        let moves_near = |place_m: DVec2| {
            self.since.iter().flatten().any(|(other_m, since_s)| {
                time_s - since_s < 0.5 * STANDING_S && other_m.distance(place_m) < NEAR_M
            })
        };
        for (since, in_company_s) in self.since.iter().zip(&mut self.in_company_s) {
            if since.is_none_or(|(place_m, _)| moves_near(place_m)) {
                *in_company_s = time_s;
            }
        }
        let stands = |agent: &usize| {
            let stands_s = self.since[*agent].map_or(0.0, |(_, since_s)| time_s - since_s);
            let alone_s = time_s - self.in_company_s[*agent];
            stands_s > YIELDING_S || stands_s > STANDING_S && alone_s > STARTING_S
        };
        (0..self.since.len()).filter(stands).collect()
    }
}

/// Seconds after which some vehicle stands without a reason, and which.
pub fn first_stuck(
    mut traffic: Traffic,
    agents: &[TrafficAgent],
    seed: u64,
    seconds: f64,
) -> Option<String> {
    let mut standing = Standing::new(agents.len());
    for step in 0..(10.0 * seconds) as u32 {
        let time_s = 0.1 * f64::from(step);
        traffic.step(0.1, None);
        if step % 10 == 0 {
            check(&traffic, agents, &|| format!("seed {seed}, step {step}"));
            let stuck = standing.update(&traffic, time_s);
            if !stuck.is_empty() {
                let places: Vec<_> = traffic.lane_positions().collect();
                let names = stuck.iter().map(|&agent| {
                    let place = places[agent].expect("it stands on the map");
                    let lane = traffic.graph().lane(place.lane);
                    let lane = &lane.expect("a driving lane").id;
                    format!(
                        "{} on {lane} at {:.1} m, {:.2} m aside",
                        agents[agent].name, place.arc_m, place.lateral_m
                    )
                });
                let names: Vec<_> = names.collect();
                return Some(format!("seed {seed}, {time_s:.0} s: {}", names.join("; ")));
            }
        }
    }
    None
}

fn lives(graph: &Arc<RoadGraph>, seeds: u64, count: usize, seconds: f64) {
    let seeds = std::env::var("TRAFFIC_SEEDS")
        .ok()
        .and_then(|seeds| seeds.parse().ok())
        .unwrap_or(seeds);
    let stuck: Vec<String> = (0..seeds)
        .into_par_iter()
        .filter_map(|seed| {
            let (traffic, agents) = random_traffic(graph, count, seed);
            first_stuck(traffic, &agents, seed, seconds)
        })
        .collect();
    println!("{} of {seeds} seeds stand still", stuck.len());
    assert!(stuck.is_empty(), "{}\n{}", stuck.len(), stuck.join("\n"));
}

#[test]
fn traffic_on_the_street_goes_on() {
    lives(&street(), 1000, 24, 120.0);
}

#[test]
fn traffic_on_a_narrow_crossing_goes_on() {
    lives(&crossing(), 1000, 24, 120.0);
}

#[test]
fn a_vehicle_that_stands_without_a_reason_is_found() {
    // Two vehicles before an ego that stands across their lane.
    let graph = crossing();
    let agents = [agent("a", "in-0", 60.0, 9.0), agent("b", "in-0", 40.0, 9.0)];
    let mut traffic = Traffic::new(graph, &agents, 1).unwrap();
    let ego = VehicleState {
        position_m: DVec2::new(-20.0, -1.75),
        yaw_rad: 1.5,
        ..VehicleState::default()
    };
    let mut standing = Standing::new(agents.len());
    let stuck = (0..600).find_map(|step| {
        traffic.step(0.1, Some((&ego, &VehicleSize::CAR)));
        let stuck = standing.update(&traffic, 0.1 * f64::from(step));
        (!stuck.is_empty()).then_some((step, stuck))
    });
    let (step, stuck) = stuck.expect("the test would not see a vehicle that stands for ever");
    assert!(step > 300 && stuck == [0], "{step}: {stuck:?}");
}

#[test]
fn traffic_on_real_maps_goes_on() {
    for (name, seeds) in [
        ("esmini_fabriksgatan.xodr", 200),
        ("esmini_soderleden.xodr", 60),
        ("lanelet2_mapping_example.osm", 60),
        ("../scenarios/commonroad_USA_Lanker-1_1_T-1.xml", 60),
    ] {
        if let Some(graph) = roads(name) {
            println!("{name}");
            lives(&graph, seeds, 24, 120.0);
        }
    }
}
