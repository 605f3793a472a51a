//! Invariants of traffic on any map and with any seed: no vehicle overlaps another, none leaves the
//! lanes.

use std::sync::Arc;

use decouplegs_drive::RoadGraph;
use decouplegs_scene::{VehicleSize, VehicleState};
use rayon::prelude::*;

use crate::roads::Random;
use crate::traffic_scenes::{check, random_traffic, roads, street};

/// Stand-in for the ego.
#[derive(Clone, Copy, Debug)]
enum Stranger {
    Nobody,
    /// Drives straight on whatever comes.
    Blind,
    /// Stands across a junction, and is somewhere else every five seconds.
    Jumping,
}

/// A place on a random lane.
fn somewhere(graph: &RoadGraph, random: &mut Random) -> VehicleState {
    loop {
        let lane = graph.lane((random.unit() * graph.lanes_in_map() as f64) as usize);
        let Some(lane) = lane else { continue };
        let arc_m = random.unit() * lane.line.length_m();
        let position_m = lane.line.at(arc_m).truncate();
        return VehicleState {
            position_m,
            yaw_rad: lane.line.heading_at(arc_m),
            speed_mps: 12.0,
            acceleration_mps2: 0.0,
        };
    }
}

/// Drives `steps` steps and checks each; how many meters all agents drove.
fn drive(graph: &Arc<RoadGraph>, count: usize, steps: u32, seed: u64, stranger: Stranger) -> f64 {
    let mut random = Random(seed ^ 0xe90);
    let mut ego = somewhere(graph, &mut random);
    let (mut traffic, agents) = random_traffic(graph, count, seed);
    let mut driven_m = 0.0;
    for step in 0..steps {
        match stranger {
            Stranger::Nobody => {}
            Stranger::Blind => ego.position_m += ego.velocity() * 0.1,
            Stranger::Jumping if step % 50 == 0 => {
                ego = somewhere(graph, &mut random);
                (ego.speed_mps, ego.yaw_rad) = (0.0, ego.yaw_rad + 1.2);
            }
            Stranger::Jumping => {}
        }
        let seen = if matches!(stranger, Stranger::Nobody) {
            None
        } else {
            Some((&ego, &VehicleSize::CAR))
        };
        traffic.step(0.1, seen);
        check(&traffic, &agents, &|| {
            format!("seed {seed}, step {step}, {stranger:?}")
        });
        driven_m += traffic
            .states()
            .iter()
            .flatten()
            .map(|state| 0.1 * state.speed_mps)
            .sum::<f64>();
    }
    driven_m
}

fn drive_all(graph: &Arc<RoadGraph>, seeds: u64, count: usize, steps: u32) {
    let seeds = std::env::var("TRAFFIC_SEEDS")
        .ok()
        .and_then(|seeds| seeds.parse().ok())
        .unwrap_or(seeds);
    let strangers = [Stranger::Nobody, Stranger::Blind, Stranger::Jumping];
    let driven_m: Vec<f64> = (0..seeds)
        .into_par_iter()
        .map(|seed| drive(graph, count, steps, seed, strangers[(seed % 3) as usize]))
        .collect();
    let sum_m: f64 = driven_m.iter().sum();
    println!(
        "{seeds} seeds of {count} agents and {steps} steps: {:.0} km",
        sum_m / 1e3
    );
    // Traffic that stands still keeps all of the above.
    assert!(
        sum_m > seeds as f64 * f64::from(steps) * 0.1 * count as f64 * 1.5,
        "hardly anybody moves: {sum_m} m"
    );
}

#[test]
fn nobody_meets_another_on_the_street() {
    drive_all(&street(), 1000, 24, 150);
}

#[test]
fn nobody_meets_another_on_real_maps() {
    // Curves and a junction with narrow turns; a motorway with ramps; a town of which a part is cut
    // out, with many ends.
    let maps = [
        ("esmini_fabriksgatan.xodr", 150),
        ("esmini_soderleden.xodr", 40),
        ("lanelet2_mapping_example.osm", 40),
    ];
    for (name, seeds) in maps {
        if let Some(graph) = roads(name) {
            println!("{name}");
            drive_all(&graph, seeds, 24, 200);
        }
    }
}
