//! Comfort of agents: bounded jerk and acceleration across, emergencies apart.

use std::sync::Arc;

use decouplegs_drive::{RoadGraph, Traffic};
use decouplegs_scene::scenario::{Behavior, Maneuver, Trigger};
use rayon::prelude::*;

use crate::traffic_scenes::{agent, random_traffic, roads, state, straight, street};

/// Largest jerk outside of emergencies, m/s^3, largest acceleration across, m/s^2, and the share of
/// steps in which an agent brakes in an emergency.
fn extremes(graph: &Arc<RoadGraph>, seed: u64) -> [f64; 3] {
    let (mut traffic, _) = random_traffic(graph, 24, seed);
    let (mut jerk, mut across, mut emergencies, mut count) = (0.0_f64, 0.0_f64, 0, 0);
    // Speeds at the start are those of the scenario, in curves too.
    for _ in 0..100 {
        traffic.step(0.1, None);
    }
    let mut before = traffic.states().to_vec();
    let mut was_emergency: Vec<bool> = traffic.emergencies().collect();
    for _ in 0..600 {
        traffic.step(0.1, None);
        let steps = before
            .iter()
            .zip(traffic.states())
            .zip(traffic.emergencies());
        for (((before, after), emergency), was) in steps.zip(&mut was_emergency) {
            let was_emergency = std::mem::replace(was, emergency);
            let (Some(before), Some(after)) = (before, after) else {
                continue;
            };
            let turn_rad = (after.yaw_rad - before.yaw_rad).sin().asin();
            across = across.max((after.speed_mps * turn_rad / 0.1).abs());
            let change = (after.acceleration_mps2 - before.acceleration_mps2) / 0.1;
            // The end of an emergency may be as sudden as its beginning.
            if !emergency && !was_emergency {
                jerk = jerk.max(change.abs());
            }
            emergencies += u32::from(emergency);
            count += 1;
        }
        before.copy_from_slice(traffic.states());
    }
    [jerk, across, f64::from(emergencies) / f64::from(count)]
}

#[test]
fn agents_drive_comfortably() {
    let maps = [
        "esmini_fabriksgatan.xodr",
        "esmini_soderleden.xodr",
        "lanelet2_mapping_example.osm",
    ];
    let graphs = maps.map(|name| roads(name).map(|graph| (name, graph)));
    let street = [Some(("street", street()))];
    for (name, graph) in street.into_iter().chain(graphs).flatten() {
        let all: Vec<[f64; 3]> = (0..50)
            .into_par_iter()
            .map(|seed| extremes(&graph, seed))
            .collect();
        let most = |which: usize| all.iter().map(|one| one[which]).fold(0.0, f64::max);
        let share = all.iter().map(|one| one[2]).sum::<f64>() / all.len() as f64;
        let (jerk, across) = (most(0), most(1));
        println!(
            "{name}: jerk {jerk:.2} m/s^3, across {across:.2} m/s^2, emergencies {:.2} % of steps",
            100.0 * share
        );
        assert!(jerk <= 10.0 + 1e-6, "{name}: {jerk} m/s^3");
        assert!(across <= 4.0, "{name}: {across} m/s^2");
        assert!(share < 0.02, "{name}: {share}");
    }
}

#[test]
fn scripted_braking_ends_gently() {
    for deceleration_mps2 in [3.0, 5.5, 8.0] {
        // To a stand, and while it still drives.
        for duration_s in [0.8, 6.0] {
            let mut braking = agent("a", "0", 100.0, 12.0);
            braking.behaviors.push(Behavior {
                trigger: Trigger::Time { time_s: 1.0 },
                maneuver: Maneuver::Brake {
                    deceleration_mps2,
                    duration_s,
                },
            });
            let graph = straight(2000.0, 1, 50.0 / 3.6);
            let mut traffic = Traffic::new(graph, &[braking], 1).unwrap();
            let (mut before, mut hardest_mps2, mut slowest_mps) = (0.0, 0.0_f64, f64::INFINITY);
            for step in 0..120 {
                traffic.step(0.1, None);
                let (now, speed_mps) = (
                    state(&traffic, 0).acceleration_mps2,
                    state(&traffic, 0).speed_mps,
                );
                assert!(
                    now - before <= 1.0 + 1e-6,
                    "{deceleration_mps2} m/s^2 for {duration_s} s, step {step}: {before} to {now}"
                );
                hardest_mps2 = hardest_mps2.max(-now);
                slowest_mps = slowest_mps.min(speed_mps);
                before = now;
            }
            assert!(
                (hardest_mps2 - deceleration_mps2).abs() < 0.1,
                "{hardest_mps2}"
            );
            assert_eq!(slowest_mps == 0.0, duration_s > 5.0, "{slowest_mps}");
        }
    }
}
