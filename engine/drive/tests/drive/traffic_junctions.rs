//! Giving way and getting across.

use std::sync::Arc;

use decouplegs_drive::{OrientedBox, RoadGraph, Traffic};
use decouplegs_scene::scenario::{DriverKind, TrafficAgent};
use decouplegs_scene::{LaneMap, VehicleSize, VehicleState};
use glam::DVec2;

use crate::traffic_scenes::{agent, check, lane, street};

/// A crossing of two roads with one lane each way. From each side `in-k` leads over `straight-k`,
/// `left-k` and `right-k` to an `out`.
pub fn crossing() -> Arc<RoadGraph> {
    Arc::new(RoadGraph::new(&crossing_map()).unwrap())
}

/// The map of that crossing.
pub fn crossing_map() -> LaneMap {
    let mut map = LaneMap::default();
    let turned = |side: usize, x: f64, y: f64| {
        DVec2::from_angle(std::f64::consts::FRAC_PI_2 * side as f64)
            .rotate(DVec2::new(x, y))
            .to_array()
    };
    for side in 0..4 {
        let at = |x: f64, y: f64| turned(side, x, y);
        map.lanes.push(lane(
            &format!("in-{side}"),
            &[at(-120.0, -1.75), at(-12.0, -1.75)],
        ));
        map.lanes.push(lane(
            &format!("out-{side}"),
            &[at(12.0, -1.75), at(200.0, -1.75)],
        ));
        map.lanes.push(lane(
            &format!("straight-{side}"),
            &[at(-12.0, -1.75), at(12.0, -1.75)],
        ));
        let arc = |radius_m: f64, sign: f64| -> Vec<[f64; 2]> {
            let point = |step: u32| {
                let (sin, cos) = (std::f64::consts::FRAC_PI_2 * f64::from(step) / 12.0).sin_cos();
                at(
                    -12.0 + radius_m * sin,
                    -1.75 + sign * radius_m * (1.0 - cos),
                )
            };
            (0..=12).map(point).collect()
        };
        map.lanes
            .push(lane(&format!("left-{side}"), &arc(13.75, 1.0)));
        map.lanes
            .push(lane(&format!("right-{side}"), &arc(10.25, -1.0)));
    }
    for side in 0..4 {
        for (way, to) in [(2, side), (3, (side + 1) % 4), (4, (side + 3) % 4)] {
            map.lanes[5 * side].successors.push(5 * side + way);
            map.lanes[5 * side + way].successors.push(5 * to + 1);
        }
    }
    map
}

/// True if an agent is on a lane whose name begins so.
fn is_on(traffic: &Traffic, number: usize, name: &str) -> bool {
    let place = traffic.lane_positions().nth(number).flatten();
    place.is_some_and(|place| {
        let lane = traffic.graph().lane(place.lane).unwrap();
        lane.id.starts_with(name)
    })
}

/// A seed with which the first agent's first way over the crossing is `name`.
fn seed_for(graph: &Arc<RoadGraph>, agents: &[TrafficAgent], name: &str) -> u64 {
    let goes = |seed: &u64| {
        let mut traffic = Traffic::new(graph.clone(), &agents[..1], *seed).unwrap();
        (0..600).any(|_| {
            traffic.step(0.1, None);
            is_on(&traffic, 0, name)
        })
    };
    (0..40).find(goes).unwrap()
}

#[test]
fn every_two_conflicting_lanes_agree_on_who_goes_first() {
    let graph = crossing();
    let mut conflicts = 0;
    for number in 0..graph.lanes_in_map() {
        for conflict in &graph.lane(number).unwrap().conflicts {
            let back = graph
                .lane(conflict.other)
                .unwrap()
                .conflicts
                .iter()
                .find(|back| back.other == number)
                .unwrap();
            assert_ne!(conflict.goes_first, back.goes_first);
            assert_eq!(
                (conflict.from_m, conflict.to_m),
                (back.other_from_m, back.other_to_m)
            );
            conflicts += 1;
        }
    }
    let goes_first = |a: &str, b: &str| {
        let [a, b] = [a, b].map(|id| graph.find(id).unwrap());
        graph
            .lane(a)
            .unwrap()
            .conflicts
            .iter()
            .find(|conflict| conflict.other == b)
            .map(|conflict| conflict.goes_first)
    };
    assert_eq!(
        goes_first("straight-0", "left-2"),
        Some(true),
        "straight on before who turns left from the front"
    );
    assert_eq!(
        goes_first("straight-0", "straight-1"),
        Some(false),
        "side 1 comes from the right"
    );
    assert_eq!(
        goes_first("right-0", "left-2"),
        Some(true),
        "to the right before to the left"
    );
    assert_eq!(goes_first("straight-0", "straight-2"), None);
    assert_eq!(goes_first("right-0", "right-2"), None);
    assert!(conflicts >= 40, "{conflicts}");
}

/// Time at which the first agent leaves the crossing, seconds.
fn time_to_leave(
    graph: &Arc<RoadGraph>,
    agents: &[TrafficAgent],
    seed: u64,
    way: &str,
) -> (f64, Vec<f64>) {
    let mut traffic = Traffic::new(graph.clone(), agents, seed).unwrap();
    for step in 0..900 {
        traffic.step(0.1, None);
        check(&traffic, agents, &|| format!("step {step}"));
        if is_on(&traffic, 0, way) {
            return (
                0.1 * f64::from(step),
                traffic
                    .states()
                    .iter()
                    .flatten()
                    .map(|state| state.position_m.x)
                    .collect(),
            );
        }
    }
    panic!("{way} is never reached");
}

#[test]
fn who_turns_left_waits_for_who_comes_straight_on() {
    let graph = crossing();
    let mut agents = vec![agent("turns", "in-0", 95.0, 5.0)];
    let seed = seed_for(&graph, &agents, "left-0");
    let (alone_s, _) = time_to_leave(&graph, &agents, seed, "out-1");
    // An oncoming vehicle that is too far away to request the crossing yet, with a seed by which
    // he goes straight on.
    agents.push(TrafficAgent {
        driver: DriverKind::Hurried,
        ..agent("comes", "in-2", 64.0, 10.0)
    });
    let meet = |seed: &u64| {
        let mut probe = Traffic::new(graph.clone(), &agents, *seed).unwrap();
        let mut seen = [false; 2];
        for _ in 0..300 {
            probe.step(0.1, None);
            seen = [
                seen[0] || is_on(&probe, 0, "left-0"),
                seen[1] || is_on(&probe, 1, "straight-2"),
            ];
        }
        seen == [true; 2]
    };
    let seed = (0..200).find(meet).unwrap();
    let (waits_s, places) = time_to_leave(&graph, &agents, seed, "out-1");
    assert!(
        waits_s > alone_s + 1.0,
        "{alone_s} s alone, {waits_s} s with a vehicle that has priority"
    );
    assert!(places[1] < -12.0, "he is through: {places:?}");
}

#[test]
fn a_crossing_full_of_cars_clears() {
    let graph = crossing();
    for seed in 0..8 {
        let mut agents = Vec::new();
        for side in 0..4 {
            for number in 0..8 {
                let (name, lane) = (format!("{side}.{number}"), format!("in-{side}"));
                let driver = DriverKind::ALL[(side + number + seed as usize) % 4];
                agents.push(TrafficAgent {
                    driver,
                    ..agent(&name, &lane, 104.0 - 8.0 * number as f64, 2.0)
                });
            }
        }
        let mut traffic = Traffic::new(graph.clone(), &agents, seed).unwrap();
        let (mut cleared_s, mut across) = (None, vec![false; agents.len()]);
        for step in 0..3000 {
            traffic.step(0.1, None);
            check(&traffic, &agents, &|| format!("seed {seed}, step {step}"));
            for (number, across) in across.iter_mut().enumerate() {
                *across |= is_on(&traffic, number, "out");
            }
            if across.iter().all(|across| *across) {
                cleared_s = Some(0.1 * f64::from(step));
                break;
            }
        }
        println!("seed {seed}: 32 cars are across after {cleared_s:?} s");
        assert!(
            cleared_s.is_some_and(|cleared_s| cleared_s < 200.0),
            "seed {seed}: {cleared_s:?}"
        );
    }
}

#[test]
fn nobody_enters_while_the_ego_stands_across_and_all_go_on_when_it_is_gone() {
    let graph = crossing();
    let agents: Vec<_> = (0..4)
        .map(|side| agent(&format!("{side}"), &format!("in-{side}"), 60.0, 9.0))
        .collect();
    let mut traffic = Traffic::new(graph, &agents, 3).unwrap();
    let ego = VehicleState {
        yaw_rad: 0.8,
        ..VehicleState::default()
    };
    let outline = |state: &VehicleState| OrientedBox::for_vehicle(state, &VehicleSize::CAR);
    for _ in 0..300 {
        traffic.step(0.1, Some((&ego, &VehicleSize::CAR)));
        for (number, state) in traffic.states().iter().flatten().enumerate() {
            let distance_m = outline(state).distance_m(&outline(&ego));
            assert!(
                distance_m > 1.0,
                "agent {number}, {distance_m} m from the ego"
            );
        }
    }
    let mut across = [false; 4];
    for _ in 0..300 {
        traffic.step(0.1, None);
        for (number, across) in across.iter_mut().enumerate() {
            *across |= is_on(&traffic, number, "out");
        }
    }
    assert_eq!(across, [true; 4]);
}

/// Vehicles per hour that enter lanes whose names contain `out`, after a minute, over ten.
fn flow_per_hour(graph: &Arc<RoadGraph>, agents: &[TrafficAgent], out: &str) -> u32 {
    let mut traffic = Traffic::new(graph.clone(), agents, 1).unwrap();
    let (mut before, mut passed) = (vec![false; agents.len()], 0);
    for step in 0..6600 {
        traffic.step(0.1, None);
        for (before, place) in before.iter_mut().zip(traffic.lane_positions()) {
            let is_out = place.is_some_and(|place| {
                let lane = graph.lane(place.lane).unwrap();
                lane.id.contains(out)
            });
            passed += u32::from(is_out && !*before && step >= 600);
            *before = is_out;
        }
    }
    6 * passed
}

/// Queues of `count` vehicles on each lane whose name contains `before`, from `gap_m` before its
/// end.
fn queues(graph: &RoadGraph, before: &str, count: u32, gap_m: f64) -> Vec<TrafficAgent> {
    let lanes = (0..graph.lanes_in_map()).filter_map(|lane| graph.lane(lane));
    lanes
        .filter(|lane| lane.id.contains(before))
        .flat_map(|lane| {
            (0..count).map(move |number| {
                let at_m = lane.line.length_m() - gap_m - 8.0 * f64::from(number);
                agent(&format!("{}.{number}", lane.id), &lane.id, at_m, 2.0)
            })
        })
        .collect()
}

#[test]
fn a_saturated_crossing_passes_1200_vehicles_per_hour() {
    let graph = crossing();
    let narrow = flow_per_hour(&graph, &queues(&graph, "in-", 12, 8.0), "out-");
    let graph = street();
    let wide = flow_per_hour(&graph, &queues(&graph, "/before", 12, 8.0), "/after");
    println!("one lane per approach {narrow}, two lanes {wide} vehicles per hour");
    assert!(wide >= 1200, "{wide} vehicles per hour");
}
