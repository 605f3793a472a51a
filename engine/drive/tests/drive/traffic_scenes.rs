//! Maps, agents and checks for tests of traffic.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use decouplegs_asset::read_map;
use decouplegs_drive::idm::BRAKING_MPS2;
use decouplegs_drive::{LanePosition, OrientedBox, RoadGraph, Traffic, TrafficError};
use decouplegs_scene::scenario::{Behavior, DriverKind, Maneuver, TrafficAgent, Trigger};
use decouplegs_scene::{Lane, LaneMap, RoadUser, VehicleSize, VehicleState};
use decouplegs_synth::street::{Street, StreetOptions};
use glam::DVec3;

use crate::roads::Random;

/// The lanes of the synthetic street.
pub fn street() -> Arc<RoadGraph> {
    static STREET: OnceLock<Arc<RoadGraph>> = OnceLock::new();
    let graph = || Arc::new(RoadGraph::new(&street_map()).unwrap());
    STREET.get_or_init(graph).clone()
}

/// The map of the synthetic street.
pub fn street_map() -> LaneMap {
    let options = StreetOptions {
        background: 0,
        agents: 1,
        agent_splats: 1,
        ..StreetOptions::default()
    };
    Street::generate(&options).lanes
}

/// The lanes of a map of the test data, or nothing and a line that says so where there is none.
pub fn roads(name: &str) -> Option<Arc<RoadGraph>> {
    let default = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let path = std::env::var_os("DECOUPLEGS_DATA")
        .map_or_else(default, PathBuf::from)
        .join("maps")
        .join(name);
    if !path.exists() {
        println!(
            "skipped: {} is not there; set DECOUPLEGS_DATA to the folder of test data",
            path.display()
        );
        return None;
    }
    Some(Arc::new(RoadGraph::new(&read_map(&path).unwrap()).unwrap()))
}

/// A lane along points.
pub fn lane(id: &str, points: &[[f64; 2]]) -> Lane {
    let centerline = points.iter().map(|&[x, y]| DVec3::new(x, y, 0.0)).collect();
    Lane {
        id: id.into(),
        centerline,
        ..Lane::default()
    }
}

/// One straight lane of `length_m`, and others beside it, each to the left of the one before.
pub fn straight(length_m: f64, lanes: usize, speed_limit_mps: f64) -> Arc<RoadGraph> {
    let mut map = LaneMap::default();
    for number in 0..lanes {
        let y = 3.5 * number as f64;
        map.lanes.push(Lane {
            speed_limit_mps: Some(speed_limit_mps),
            right_neighbor: number.checked_sub(1),
            left_neighbor: Some(number + 1).filter(|&left| left < lanes),
            ..lane(&number.to_string(), &[[0.0, y], [length_m, y]])
        });
    }
    Arc::new(RoadGraph::new(&map).unwrap())
}

/// A normal driver in a family car who keeps his lane.
pub fn agent(name: &str, lane: &str, at_m: f64, speed_mps: f64) -> TrafficAgent {
    TrafficAgent {
        name: name.into(),
        kind: RoadUser::Car,
        asset: 0,
        size: VehicleSize::CAR,
        lane: lane.into(),
        at_m,
        speed_mps,
        driver: DriverKind::Normal,
        changes_lanes: false,
        cruise_mps: None,
        behaviors: vec![],
    }
}

fn random_behavior(random: &mut Random) -> Behavior {
    let maneuver = match (3.0 * random.unit()) as u32 {
        0 => Maneuver::Brake {
            deceleration_mps2: random.between(2.0, 12.0),
            duration_s: random.between(0.5, 4.0),
        },
        1 => Maneuver::CutIn,
        _ => Maneuver::Swerve {
            amplitude_m: random.between(-2.5, 2.5),
            duration_s: random.between(1.0, 4.0),
        },
    };
    let trigger = if random.unit() < 0.5 {
        Trigger::Time {
            time_s: random.between(0.0, 15.0),
        }
    } else {
        Trigger::NearEgo {
            distance_m: random.between(5.0, 60.0),
        }
    };
    Behavior { trigger, maneuver }
}

/// Length, width and height of each kind of vehicle but cars, meters.
pub const SIZES_M: [(RoadUser, [f64; 3]); 3] = [
    (RoadUser::Truck, [7.8, 2.4, 3.3]),
    (RoadUser::Bus, [11.0, 2.5, 3.1]),
    (RoadUser::Cyclist, [1.8, 0.6, 1.75]),
];

/// Up to `count` cars with all drivers at random; those who would overlap others are left out.
pub fn random_traffic(
    graph: &Arc<RoadGraph>,
    count: usize,
    seed: u64,
) -> (Traffic, Vec<TrafficAgent>) {
    traffic_of(graph, random_cars(graph, count, seed), seed)
}

/// Traffic of which half are trucks, buses and cyclists.
pub fn mixed_traffic(
    graph: &Arc<RoadGraph>,
    count: usize,
    seed: u64,
) -> (Traffic, Vec<TrafficAgent>) {
    let mut agents = random_cars(graph, count, seed);
    for (agent, (kind, size_m)) in agents
        .iter_mut()
        .skip(1)
        .step_by(2)
        .zip(SIZES_M.iter().cycle())
    {
        (agent.kind, agent.size) = (*kind, VehicleSize::from_array(*size_m));
        agent.changes_lanes &= *kind != RoadUser::Cyclist;
    }
    traffic_of(graph, agents, seed)
}

fn random_cars(graph: &Arc<RoadGraph>, count: usize, seed: u64) -> Vec<TrafficAgent> {
    let mut random = Random(seed);
    let lanes: Vec<_> = (0..graph.lanes_in_map())
        .filter_map(|lane| graph.lane(lane))
        .collect();
    let mut agents: Vec<TrafficAgent> = Vec::new();
    for number in 0..count {
        let lane = lanes[(random.unit() * lanes.len() as f64) as usize];
        let size = VehicleSize {
            length_m: random.between(3.5, 5.3),
            width_m: random.between(1.6, 2.0),
            height_m: random.between(1.4, 2.0),
        };
        let behaviors = (0..2)
            .filter(|_| random.unit() < 0.3)
            .map(|_| ())
            .collect::<Vec<_>>();
        agents.push(TrafficAgent {
            size,
            driver: DriverKind::ALL[(4.0 * random.unit()) as usize],
            changes_lanes: random.unit() < 0.7,
            cruise_mps: None,
            behaviors: behaviors
                .into_iter()
                .map(|()| random_behavior(&mut random))
                .collect(),
            ..agent(
                &format!("{number}"),
                &lane.id,
                random.unit() * lane.line.length_m(),
                random.between(0.0, 16.0),
            )
        });
    }
    agents
}

/// Traffic of `agents` without those who would overlap others.
fn traffic_of(
    graph: &Arc<RoadGraph>,
    mut agents: Vec<TrafficAgent>,
    seed: u64,
) -> (Traffic, Vec<TrafficAgent>) {
    loop {
        match Traffic::new(graph.clone(), &agents, seed) {
            Ok(traffic) => return (traffic, agents),
            Err(TrafficError::Overlap { second, .. }) => {
                agents.retain(|agent| agent.name != second);
            }
            Err(other) => panic!("seed {seed}: {other}"),
        }
    }
}

/// State of an agent that is on the map.
pub fn state(traffic: &Traffic, number: usize) -> VehicleState {
    traffic.states()[number].expect("the agent is on the map")
}

/// Lane position of an agent that is on the map.
pub fn place(traffic: &Traffic, number: usize) -> LanePosition {
    let place = traffic.lane_positions().nth(number).flatten();
    place.expect("the agent is on the map")
}

/// Checks the invariants of agents at any moment.
pub fn check(traffic: &Traffic, agents: &[TrafficAgent], what: &dyn Fn() -> String) {
    for ((state, agent), place) in traffic
        .states()
        .iter()
        .zip(agents)
        .zip(traffic.lane_positions())
    {
        let (Some(state), Some(place)) = (state, place) else {
            continue;
        };
        let name = &agent.name;
        assert!(
            state.position_m.is_finite() && state.yaw_rad.is_finite(),
            "{}: agent {name} is nowhere",
            what()
        );
        assert!(
            state.speed_mps >= 0.0,
            "{}: agent {name} at {} m/s",
            what(),
            state.speed_mps
        );
        let acceleration = state.acceleration_mps2;
        assert!(
            (-BRAKING_MPS2 - 1e-9..=2.0 + 1e-9).contains(&acceleration),
            "{}: agent {name} at {acceleration} m/s^2",
            what()
        );
        let lane = traffic.graph().lane(place.lane).unwrap();
        assert!(
            (0.0..=lane.line.length_m() + 1e-9).contains(&place.arc_m),
            "{}: agent {name} is beyond its lane",
            what()
        );
        let off_m = lane.line.project(state.position_m).distance_m;
        assert!(
            off_m <= place.lateral_m.abs() + 0.05 && off_m < 6.0,
            "{}: agent {name} is {off_m} m off its lane",
            what()
        );
    }
    let outline = |(number, state): (usize, &Option<VehicleState>)| {
        state.map(|state| {
            (
                number,
                OrientedBox::for_vehicle(&state, &agents[number].size),
            )
        })
    };
    let vehicles = &traffic.states()[..agents.len()];
    let boxes: Vec<_> = vehicles.iter().enumerate().filter_map(outline).collect();
    for (at, &(number, a)) in boxes.iter().enumerate() {
        for &(other, b) in &boxes[at + 1..] {
            let near_m = a.half_length_m + b.half_length_m + 1.0;
            let near = a.center_m.distance_squared(b.center_m) < near_m * near_m;
            let found = |number: usize| {
                let place = place(traffic, number);
                (
                    agents[number].name.clone(),
                    traffic.graph().lane(place.lane).unwrap().id.clone(),
                    place,
                    state(traffic, number),
                )
            };
            assert!(
                !near || !a.overlaps(&b),
                "{}: overlap: {:?}, {:?}",
                what(),
                found(number),
                found(other)
            );
        }
    }
}
