//! Prints how many steps per second traffic takes, and the time of a check against static
//! obstacles: `cargo run --release -p decouplegs-drive --example time_traffic`.
#![forbid(unsafe_code)]

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;
use std::time::Instant;

use decouplegs_drive::{Obstacles, OrientedBox, RoadGraph, Traffic, TrafficError};
use decouplegs_scene::scenario::{DriverKind, TrafficAgent};
use decouplegs_scene::{Lane, LaneMap, RoadUser, VehicleSize};
use decouplegs_synth::street::{Street, StreetOptions};
use glam::{DVec2, DVec3};

/// Length of a block, meters, and number of crossings along each side.
const BLOCK_M: f64 = 160.0;
const CROSSINGS: usize = 6;

/// A town of crossings, one lane each way, whose streets lead around to their other end.
fn town() -> LaneMap {
    let mut map = LaneMap::default();
    let half_m = 12.0;
    let number =
        |x: usize, y: usize, side: usize, part: usize| ((x * CROSSINGS + y) * 4 + side) * 4 + part;
    for x in 0..CROSSINGS {
        for y in 0..CROSSINGS {
            let middle = DVec2::new(x as f64, y as f64) * BLOCK_M;
            for side in 0..4 {
                let at = |along: f64, left: f64| {
                    (middle
                        + DVec2::from_angle(FRAC_PI_2 * side as f64)
                            .rotate(DVec2::new(along, left)))
                    .extend(0.0)
                };
                let arc = |radius_m: f64, sign: f64| -> Vec<DVec3> {
                    let point = |step: u32| {
                        let (sin, cos) = (FRAC_PI_2 * f64::from(step) / 12.0).sin_cos();
                        at(
                            -half_m + radius_m * sin,
                            -1.75 + sign * radius_m * (1.0 - cos),
                        )
                    };
                    (0..=12).map(point).collect()
                };
                let to = half_m - BLOCK_M;
                let lines = [
                    vec![at(to, -1.75), at(-half_m, -1.75)],
                    vec![at(-half_m, -1.75), at(half_m, -1.75)],
                    arc(half_m + 1.75, 1.0),
                    arc(half_m - 1.75, -1.0),
                ];
                for (part, centerline) in lines.into_iter().enumerate() {
                    let id = format!("{x}.{y}.{side}.{part}");
                    map.lanes.push(Lane {
                        id,
                        centerline,
                        ..Lane::default()
                    });
                }
                map.lanes[number(x, y, side, 0)].successors =
                    (1..4).map(|part| number(x, y, side, part)).collect();
                for (part, towards) in [(1, side), (2, (side + 1) % 4), (3, (side + 3) % 4)] {
                    // Streets at the edge end: there is no lane on from there.
                    let step = [(1, 0), (0, 1), (-1, 0), (0, -1)][towards];
                    let (to_x, to_y) = (x as i64 + step.0, y as i64 + step.1);
                    let inside = (0..CROSSINGS as i64).contains(&to_x)
                        && (0..CROSSINGS as i64).contains(&to_y);
                    if inside {
                        map.lanes[number(x, y, side, part)].successors =
                            vec![number(to_x as usize, to_y as usize, towards, 0)];
                    }
                }
            }
        }
    }
    map
}

fn agents(graph: &RoadGraph, count: usize) -> Vec<TrafficAgent> {
    let lanes: Vec<_> = (0..graph.lanes_in_map())
        .filter_map(|lane| graph.lane(lane))
        .filter(|lane| lane.line.length_m() > 100.0)
        .collect();
    let agent = |number: usize| {
        let (lane, row) = (lanes[number % lanes.len()], number / lanes.len());
        TrafficAgent {
            name: format!("agent {number}"),
            kind: RoadUser::Car,
            asset: 0,
            size: VehicleSize::CAR,
            lane: lane.id.clone(),
            at_m: 15.0 + 22.0 * row as f64,
            speed_mps: 8.0,
            driver: DriverKind::ALL[number % 4],
            changes_lanes: true,
            cruise_mps: None,
            behaviors: vec![],
        }
    };
    (0..count).map(agent).collect()
}

fn main() -> Result<(), TrafficError> {
    let started = Instant::now();
    let graph = Arc::new(RoadGraph::new(&town()).map_err(TrafficError::Roads)?);
    println!(
        "{} lanes, graph in {:.0?}",
        graph.lanes_in_map(),
        started.elapsed()
    );
    for count in [15, 100, 500] {
        let mut traffic = Traffic::new(graph.clone(), &agents(&graph, count), 1)?;
        let (steps, started) = (3000, Instant::now());
        let mut driven_m = 0.0;
        for _ in 0..steps {
            traffic.step(0.1, None);
            driven_m += traffic
                .states()
                .iter()
                .flatten()
                .map(|state| 0.1 * state.speed_mps)
                .sum::<f64>();
        }
        let seconds = started.elapsed().as_secs_f64();
        let (rate, speed_mps) = (
            f64::from(steps) / seconds,
            driven_m / (0.1 * f64::from(steps) * count as f64),
        );
        println!(
            "{count} agents: {rate:.0} steps/s on one thread; mean speed {speed_mps:.1} m/s over {:.0} s",
            0.1 * f64::from(steps)
        );
    }
    time_obstacles();
    Ok(())
}

/// A vehicle along the synthetic street, against all that stands there.
fn time_obstacles() {
    let options = StreetOptions {
        background: 0,
        agents: 1,
        agent_splats: 1,
        ..StreetOptions::default()
    };
    let obstacles = Obstacles::new(Street::generate(&options).obstacles);
    let (checks, started) = (100_000, Instant::now());
    let touched = (0..checks)
        .filter(|check| {
            let outline = OrientedBox {
                center_m: DVec2::new(f64::from(check % 200) - 100.0, -6.5),
                yaw_rad: 0.0,
                half_length_m: 2.3,
                half_width_m: 0.9,
            };
            obstacles.touched(&outline).is_some()
        })
        .count();
    println!(
        "{} obstacles: {:.2} microseconds a check, {touched} of {checks} touch",
        obstacles.all().len(),
        1e6 * started.elapsed().as_secs_f64() / f64::from(checks)
    );
}
