//! Stop and yield signs: agents stand at one, give way at both, and go on.

use std::sync::Arc;

use decouplegs_drive::RoadGraph;
use decouplegs_drive::signs::TrafficSigns;
use decouplegs_scene::{SignKind, StopLine, TrafficSign, VehicleState};
use rayon::prelude::*;

use crate::traffic_junctions::crossing_map;
use crate::traffic_liveness::first_stuck;
use crate::traffic_scenes::{check, random_traffic};

/// Vehicles that start too near to a sign to stop pass it in this time, seconds.
const START_S: f64 = 5.0;

/// Signs on the roads to the crossing of two roads with one lane each way.
fn signs(kinds: [Option<SignKind>; 4]) -> (Arc<RoadGraph>, Arc<TrafficSigns>) {
    let map = crossing_map();
    let graph = Arc::new(RoadGraph::new(&map).unwrap());
    let sides = kinds.into_iter().enumerate();
    let signs: Vec<TrafficSign> = sides
        .filter_map(|(side, kind)| {
            let lane = format!("in-{side}");
            let line = StopLine {
                lane,
                at_m: 106.0,
                ..StopLine::default()
            };
            Some(TrafficSign { kind: kind?, line })
        })
        .collect();
    let signs = TrafficSigns::new(&map, &graph, &signs).unwrap();
    (graph, Arc::new(signs))
}

/// Passages of lines by agents in 120 s: those that stood before, and those that did not.
fn passages(
    graph: &Arc<RoadGraph>,
    signs: &TrafficSigns,
    obeyed: &Arc<TrafficSigns>,
    seed: u64,
) -> [usize; 2] {
    let (traffic, agents) = random_traffic(graph, 20, seed);
    let mut traffic = traffic.with_signs(obeyed.clone());
    let mut stood = vec![false; agents.len()];
    let mut passed = [0; 2];
    let mut before: Vec<Option<VehicleState>> = traffic.states().to_vec();
    for step in 0..1200 {
        let time_s = 0.1 * f64::from(step);
        traffic.step(0.1, None);
        check(&traffic, &agents, &|| format!("seed {seed}, step {step}"));
        for line in signs.lines() {
            for (number, agent) in agents.iter().enumerate() {
                let (Some(from), Some(to)) = (before[number], traffic.states()[number]) else {
                    continue;
                };
                let front = |state: VehicleState| {
                    let front_m = state.position_m + state.ahead() * (0.5 * agent.size.length_m);
                    line.record.locate(front_m)
                };
                let ((from_m, _), (to_m, is_within)) = (front(from), front(to));
                if is_within && (-4.0..0.0).contains(&to_m) && to.speed_mps < 0.1 {
                    stood[number] = true;
                }
                if is_within && from_m < 0.0 && to_m >= 0.0 && to_m - from_m < 3.0 {
                    passed[usize::from(!stood[number])] += usize::from(time_s > START_S);
                    stood[number] = false;
                }
            }
        }
        before.copy_from_slice(traffic.states());
    }
    passed
}

#[test]
fn agents_stand_at_stop_signs() {
    let (graph, signs) = signs([Some(SignKind::Stop); 4]);
    let all = |obeyed: &Arc<TrafficSigns>| {
        let seeds = (0..40_u64).into_par_iter();
        let each = seeds.map(|seed| passages(&graph, &signs, obeyed, seed));
        each.reduce(|| [0; 2], |a, b| [a[0] + b[0], a[1] + b[1]])
    };
    let [stood, ran] = all(&signs);
    println!("{stood} vehicles stood, {ran} did not");
    assert!(ran == 0 && stood > 800, "{stood}, {ran}");
    let [stood, ran] = all(&Arc::default());
    println!("without signs {stood} stood, {ran} did not");
    assert!(ran > 300, "the test would not see who runs a sign: {ran}");
}

#[test]
fn traffic_with_signs_goes_on() {
    let (stop, give_way) = (Some(SignKind::Stop), Some(SignKind::Yield));
    for kinds in [
        [stop; 4],
        [None, stop, None, stop],
        [None, give_way, None, give_way],
        [None, stop, give_way, None],
    ] {
        let (graph, signs) = signs(kinds);
        let stuck: Vec<String> = (0..150_u64)
            .into_par_iter()
            .filter_map(|seed| {
                let (traffic, agents) = random_traffic(&graph, 20, seed);
                first_stuck(traffic.with_signs(signs.clone()), &agents, seed, 120.0)
            })
            .collect();
        assert!(
            stuck.is_empty(),
            "{kinds:?}: {}\n{}",
            stuck.len(),
            stuck.join("\n")
        );
    }
}

#[test]
fn vehicles_on_the_road_with_priority_wait_less() {
    // Share of time that vehicles stand on the last 30 m before the crossing: roads 0 and 2, and
    // roads 1 and 3.
    let standing = |kinds| {
        let (graph, signs) = signs(kinds);
        let seeds = (0..60_u64).into_par_iter();
        let each = seeds.map(|seed| {
            let (traffic, _) = random_traffic(&graph, 12, seed);
            let mut traffic = traffic.with_signs(signs.clone());
            let mut counts = [[0_u32; 2]; 2];
            for _ in 0..900 {
                traffic.step(0.1, None);
                for (place, state) in traffic.lane_positions().zip(traffic.states()) {
                    let (Some(place), Some(state)) = (place, state) else {
                        continue;
                    };
                    let id = &graph.lane(place.lane).unwrap().id;
                    if let Some(side) = id.strip_prefix("in-")
                        && place.arc_m > 78.0
                    {
                        let road = side.parse::<usize>().unwrap() % 2;
                        counts[road][usize::from(state.speed_mps < 0.5)] += 1;
                    }
                }
            }
            counts
        });
        let sum = each.reduce(
            || [[0; 2]; 2],
            |a, b| [0, 1].map(|road| [0, 1].map(|at| a[road][at] + b[road][at])),
        );
        sum.map(|[moves, stands]| f64::from(stands) / f64::from(moves + stands))
    };
    let none = standing([None; 4]);
    let give_way = standing([None, Some(SignKind::Yield), None, Some(SignKind::Yield)]);
    println!(
        "standing without signs {none:.3?}, with yield signs on the second road {give_way:.3?}"
    );
    assert!(give_way[0] < 0.8 * none[0], "{none:?}, {give_way:?}");
    assert!(give_way[0] < 0.5 * give_way[1], "{give_way:?}");
}

#[test]
fn signs_are_on_lanes_of_the_map() {
    let map = crossing_map();
    let graph = RoadGraph::new(&map).unwrap();
    let at = |lane: &str, at_m: f64| {
        let line = StopLine {
            lane: lane.into(),
            at_m,
            ..StopLine::default()
        };
        let kind = SignKind::Stop;
        TrafficSigns::new(&map, &graph, &[TrafficSign { kind, line }])
    };
    assert!(at("in-0", 106.0).is_ok());
    let error = at("nowhere", 1.0).unwrap_err().to_string();
    assert!(
        error.contains("stop sign 0: lane nowhere is not"),
        "{error}"
    );
    let error = at("in-0", 200.0).unwrap_err().to_string();
    assert!(error.contains("200 m along lane in-0"), "{error}");
}
