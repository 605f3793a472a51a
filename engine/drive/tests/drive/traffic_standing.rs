//! Traffic about an ego that stands, crawls, drives or leaves: a vehicle stands only where another
//! vehicle, the ego or an occupied conflict is before it.

use std::sync::Arc;

use decouplegs_drive::{OrientedBox, RoadGraph, Traffic};
use decouplegs_scene::scenario::TrafficAgent;
use decouplegs_scene::{VehicleSize, VehicleState};
use rayon::prelude::*;

use crate::roads::Random;
use crate::traffic_junctions::crossing;
use crate::traffic_scenes::{check, random_traffic, roads, straight, street};

/// Longest time that a vehicle may stand with nothing before it, seconds.
const STANDING_S: f64 = 30.0;
/// Time for which there must have been nothing before it at its end: vehicles that pass a crossing
/// are before it now and then.
const CLEAR_S: f64 = 10.0;
/// A vehicle that is slower stands, m/s.
const SLOW_MPS: f64 = 0.1;
/// Distance before a vehicle's front in which another keeps it from going on, meters, and distance
/// of a conflict and of the room behind it.
const NEAR_M: f64 = 12.0;
const CROSSING_M: f64 = 60.0;
/// Distance across within which the middle of a car is before another, meters.
const ACROSS_M: f64 = 1.6;
/// Half the width that a way takes up, and the length of its parts, meters.
const HALF_WIDTH_M: f64 = 1.5;
const PART_M: f64 = 1.0;
const SECONDS: f64 = 120.0;

#[derive(Clone, Copy, Debug)]
enum EgoKind {
    Stands,
    Crawls,
    Drives,
    Leaves,
}

/// Ego that follows lanes without looking at lights or crossings.
struct Ego {
    kind: EgoKind,
    lane: usize,
    arc_m: f64,
    speed_mps: f64,
}

impl Ego {
    /// The ego on a random lane, with no agent near.
    fn new(traffic: &Traffic, kind: EgoKind, random: &mut Random) -> Option<Self> {
        let graph = traffic.graph();
        (0..200).find_map(|_| {
            let lane = (random.unit() * graph.lanes_in_map() as f64) as usize;
            let ego = Self {
                kind,
                lane,
                arc_m: random.unit() * graph.lane(lane)?.line.length_m(),
                speed_mps: 0.0,
            };
            let at_m = ego.state(graph).position_m;
            let mut agents = traffic.states().iter().flatten();
            agents
                .all(|state| state.position_m.distance(at_m) > 25.0)
                .then_some(ego)
        })
    }

    fn state(&self, graph: &RoadGraph) -> VehicleState {
        let line = &graph.lane(self.lane).expect("it drives on lanes").line;
        VehicleState {
            position_m: line.at(self.arc_m).truncate(),
            yaw_rad: line.heading_at(self.arc_m),
            speed_mps: self.speed_mps,
            acceleration_mps2: 0.0,
        }
    }

    /// One step on; false once it has left.
    fn advance(&mut self, traffic: &Traffic, time_s: f64) -> bool {
        let graph = traffic.graph();
        let own = OrientedBox::for_vehicle(&self.state(graph), &VehicleSize::CAR);
        let gap_m = traffic.states().iter().flatten().map(|other| {
            let at = own.to_local(other.position_m);
            let is_ahead = at.x > 0.0 && at.y.abs() < 2.5;
            if is_ahead { at.x } else { f64::INFINITY }
        });
        let gap_m = gap_m.fold(f64::INFINITY, f64::min);
        let wished_mps = match self.kind {
            EgoKind::Stands => 0.0,
            EgoKind::Crawls => 1.0,
            EgoKind::Drives => 8.0,
            EgoKind::Leaves if time_s > 0.5 * SECONDS => return false,
            EgoKind::Leaves => 0.0,
        };
        let safe_mps = (0.5 * (gap_m - 7.0)).max(0.0);
        self.speed_mps = safe_mps.min(wished_mps).min(self.speed_mps + 0.2);
        self.arc_m += 0.1 * self.speed_mps;
        let road = graph.lane(self.lane).expect("it drives on lanes");
        if self.arc_m < road.line.length_m() {
            return true;
        }
        self.arc_m -= road.line.length_m();
        let next = road.successors.first().copied();
        self.lane = next.unwrap_or(self.lane);
        next.is_some()
    }
}

/// True if something keeps the agent from going on: a box before its front, on its lanes, or in a
/// conflict that it comes to.
fn is_kept(traffic: &Traffic, number: usize, boxes: &[Option<OrientedBox>]) -> bool {
    let (graph, Some(own)) = (traffic.graph(), boxes[number]) else {
        return true;
    };
    let others = || {
        let others = boxes.iter().enumerate();
        others.filter_map(|(other, outline)| outline.filter(|_| other != number))
    };
    if others().any(|other| is_before(&own, &other)) {
        return true;
    }
    let place = traffic.lane_positions().nth(number).flatten();
    let place = place.expect("it is on the map");
    let front_m = place.arc_m + own.half_length_m;
    let mut open = vec![(place.lane, 0.0, front_m + NEAR_M)];
    while let Some((lane, start_m, until_m)) = open.pop() {
        let road = graph.lane(lane).expect("a driving lane");
        let mut conflicts = road.conflicts.iter();
        let near = |from_m: f64, to_m: f64| {
            from_m + start_m < front_m + NEAR_M && to_m + start_m > place.arc_m
        };
        // Where lanes merge, there has to be room behind.
        let merges = road.successors.iter().any(|&next| {
            let next = graph.lane(next).expect("a driving lane");
            next.predecessors.len() > 1 && near(0.0, road.line.length_m())
        });
        let until_m = match merges || conflicts.any(|at| near(at.from_m, at.to_m)) {
            true => front_m + CROSSING_M,
            false => until_m,
        };
        let end_m = start_m + road.line.length_m();
        let mut arc_m = start_m.max(front_m);
        while arc_m < end_m.min(until_m) {
            let part = OrientedBox {
                center_m: road.line.at(arc_m - start_m).truncate(),
                yaw_rad: road.line.heading_at(arc_m - start_m),
                half_length_m: 0.5 * PART_M,
                half_width_m: HALF_WIDTH_M,
            };
            if others().any(|other| other.overlaps(&part)) {
                return true;
            }
            arc_m += PART_M;
        }
        if end_m < front_m + CROSSING_M && open.len() < 32 {
            open.extend(road.successors.iter().map(|&next| (next, end_m, until_m)));
        }
    }
    false
}

/// True if `other` is before the front of `own`.
fn is_before(own: &OrientedBox, other: &OrientedBox) -> bool {
    let at = own.to_local(other.center_m);
    let distance_m_max = NEAR_M + own.half_length_m + other.half_length_m;
    at.x > 0.0 && at.x < distance_m_max && at.y.abs() < ACROSS_M + other.half_width_m - 0.9
}

/// Agents that stood too long: all, those with nothing before their front, and those with nothing
/// on their way either, told by a sentence.
#[derive(Default)]
struct Stood {
    agents: usize,
    all: usize,
    nothing_before: usize,
    unexplained: Vec<String>,
}

fn drive(graph: &Arc<RoadGraph>, count: usize, seed: u64, kind: EgoKind) -> Stood {
    let (mut traffic, agents) = random_traffic(graph, count, seed);
    let mut random = Random(seed ^ 0x57a9d);
    let mut stood = Stood {
        agents: agents.len(),
        ..Stood::default()
    };
    let mut ego = Ego::new(&traffic, kind, &mut random);
    let (mut since_s, mut kept_s) = (vec![0.0; agents.len()], vec![0.0; agents.len()]);
    let mut told = vec![false; agents.len()];
    for step in 0..(10.0 * SECONDS) as u32 {
        let time_s = 0.1 * f64::from(step);
        let state = ego.as_ref().map(|ego| ego.state(graph));
        traffic.step(0.1, state.as_ref().map(|state| (state, &VehicleSize::CAR)));
        if ego
            .as_mut()
            .is_some_and(|ego| !ego.advance(&traffic, time_s))
        {
            ego = None;
        }
        if step % 10 != 0 {
            continue;
        }
        check(&traffic, &agents, &|| {
            format!("seed {seed}, step {step}, {kind:?}")
        });
        let boxes = boxes(&traffic, &agents, state.as_ref());
        for number in 0..agents.len() {
            let moving = traffic.states()[number].is_none_or(|state| state.speed_mps > SLOW_MPS);
            if moving {
                (since_s[number], kept_s[number]) = (time_s, time_s);
                continue;
            }
            if time_s - since_s[number] + CLEAR_S < STANDING_S {
                continue;
            }
            if is_kept(&traffic, number, &boxes) {
                kept_s[number] = time_s;
            }
            if time_s - since_s[number] > STANDING_S && !told[number] {
                if time_s - since_s[number] < STANDING_S + 1.5 {
                    stood.all += 1;
                    let own = boxes[number].expect("it stands on the map");
                    let mut others = boxes.iter().flatten();
                    stood.nothing_before +=
                        usize::from(!others.any(|other| is_before(&own, other)));
                }
                if time_s - kept_s[number] > CLEAR_S {
                    told[number] = true;
                    stood
                        .unexplained
                        .push(tell(&traffic, &agents, number, (seed, time_s, kind)));
                }
            }
        }
    }
    stood
}

fn boxes(
    traffic: &Traffic,
    agents: &[TrafficAgent],
    ego: Option<&VehicleState>,
) -> Vec<Option<OrientedBox>> {
    let states = traffic.states().iter().zip(agents);
    let agents = states.map(|(state, agent)| {
        let state = state.as_ref()?;
        Some(OrientedBox::for_vehicle(state, &agent.size))
    });
    let ego = ego.map(|ego| OrientedBox::for_vehicle(ego, &VehicleSize::CAR));
    agents.chain([ego]).collect()
}

fn tell(
    traffic: &Traffic,
    agents: &[TrafficAgent],
    number: usize,
    (seed, time_s, kind): (u64, f64, EgoKind),
) -> String {
    let place = traffic.lane_positions().nth(number).flatten();
    let place = place.expect("it stands on the map");
    let lane = traffic.graph().lane(place.lane).expect("a driving lane");
    format!(
        "seed {seed}, {time_s:.0} s, the ego {kind:?}: {} on {} at {:.1} m, {:.2} m aside",
        agents[number].name, lane.id, place.arc_m, place.lateral_m
    )
}

fn nobody_stands_for_nothing(name: &str, graph: &Arc<RoadGraph>, seeds: u64, count: usize) {
    let seeds = std::env::var("TRAFFIC_SEEDS")
        .ok()
        .and_then(|seeds| seeds.parse().ok())
        .unwrap_or(seeds);
    let kinds = [
        EgoKind::Stands,
        EgoKind::Crawls,
        EgoKind::Drives,
        EgoKind::Leaves,
    ];
    let stood: Vec<Stood> = (0..seeds)
        .into_par_iter()
        .map(|seed| drive(graph, count, seed, kinds[(seed % 4) as usize]))
        .collect();
    let sum = |value: fn(&Stood) -> usize| stood.iter().map(value).sum::<usize>();
    let unexplained: Vec<&String> = stood.iter().flat_map(|stood| &stood.unexplained).collect();
    println!(
        "{name}: {seeds} seeds, {} agents: {} stood over 30 s, {} of them with nothing before their front, {} with nothing on their way",
        sum(|stood| stood.agents),
        sum(|stood| stood.all),
        sum(|stood| stood.nothing_before),
        unexplained.len(),
    );
    for line in unexplained.iter().take(12) {
        println!("    {line}");
    }
    assert!(unexplained.is_empty(), "{name}: {}", unexplained.len());
}

#[test]
fn traffic_passes_an_ego_on_the_street() {
    nobody_stands_for_nothing("street", &street(), 60, 24);
}

#[test]
fn traffic_passes_an_ego_on_a_motorway() {
    nobody_stands_for_nothing("motorway", &straight(400.0, 6, 27.0), 40, 40);
}

#[test]
fn traffic_passes_an_ego_on_a_narrow_crossing() {
    nobody_stands_for_nothing("crossing", &crossing(), 60, 24);
}

#[test]
fn traffic_passes_an_ego_on_real_maps() {
    for name in [
        "esmini_fabriksgatan.xodr",
        "esmini_soderleden.xodr",
        "lanelet2_mapping_example.osm",
        "../scenarios/commonroad_USA_Lanker-1_1_T-1.xml",
    ] {
        if let Some(graph) = roads(name) {
            nobody_stands_for_nothing(name, &graph, 24, 24);
        }
    }
}
