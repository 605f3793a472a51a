//! Comparison of the actors of an OpenSCENARIO file with trajectories that another player wrote:
//! `cargo run -p decouplegs-sim --example compare_stories -- FILE.xosc TRAJECTORIES.csv`.
//!
//! The table has the columns time, name, x, y, heading, speed without a header: seconds, meters,
//! radians and m/s of reference points. The ego goes where the table says, so that conditions about
//! it are met alike. Prints for each actor how far it is off at most, and when.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;

use decouplegs_drive::lights::TrafficLights;
use decouplegs_drive::{RoadGraph, Traffic};
use decouplegs_scene::VehicleState;
use decouplegs_sim::scenario_import::import_open_scenario;
use glam::DVec2;

/// Place, heading and speed at a time.
type Moment = (f64, DVec2, f64, f64);

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().skip(1).collect();
    let [scenario, table] = arguments.as_slice() else {
        eprintln!("expected an OpenSCENARIO file and a table of trajectories");
        return ExitCode::from(2);
    };
    match compare(Path::new(scenario), Path::new(table)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn compare(scenario: &Path, table: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let tracks = read(table)?;
    let imported = import_open_scenario(scenario, None)?;
    let story = &imported.scenario.story;
    let ego = tracks
        .get(&imported.ego)
        .ok_or_else(|| format!("the table has no {}", imported.ego))?;
    let graph = Arc::new(RoadGraph::new(&imported.map)?);
    let lights = TrafficLights::new(&imported.map, &graph, &imported.scenario.lights)?;
    let traffic = Traffic::new(graph, &[], 1)?.with_lights(Arc::new(lights));
    let mut traffic = traffic.with_story(story, &imported.map)?;
    let size = imported.scenario.ego.size;
    let mut worst: Vec<(f64, f64, f64, f64)> = vec![(0.0, 0.0, 0.0, 0.0); story.actors.len()];
    for pair in ego.windows(2) {
        let (time_s, point_m, yaw_rad, speed_mps) = pair[0];
        let dt_s = pair[1].0 - time_s;
        if dt_s < 1e-6 {
            continue;
        }
        let state = VehicleState {
            position_m: point_m + story.ego_center_m * DVec2::from_angle(yaw_rad),
            yaw_rad,
            speed_mps: speed_mps.max(0.0),
            acceleration_mps2: (pair[1].3 - speed_mps) / dt_s,
        };
        // The table may have gaps: steps are at most 0.1 s.
        let parts = (dt_s / 0.1 - 1e-9).ceil().max(1.0);
        for _ in 0..parts as u32 {
            traffic.step(dt_s / parts, Some((&state, &size)));
        }
        for ((actor, state), worst) in story.actors.iter().zip(traffic.states()).zip(&mut worst) {
            let (Some(track), Some(state)) = (tracks.get(&actor.name), state) else {
                continue;
            };
            let Some(other) = track.iter().find(|one| (one.0 - pair[1].0).abs() < 1e-6) else {
                continue;
            };
            let own_m = state.position_m - actor.center_m * state.ahead();
            let apart_m = own_m.distance(other.1);
            if apart_m > worst.0 {
                (worst.0, worst.1) = (apart_m, other.0);
            }
            let faster_mps = (state.speed_mps - other.3.max(0.0)).abs();
            if faster_mps > worst.2 {
                (worst.2, worst.3) = (faster_mps, other.0);
            }
        }
    }
    for (actor, (apart_m, at_s, faster_mps, then_s)) in story.actors.iter().zip(worst) {
        println!(
            "{}: {}: {apart_m:.3} m at {at_s:.2} s, {faster_mps:.3} m/s at {then_s:.2} s, over {:.1} s",
            scenario.display(),
            actor.name,
            ego.last().map_or(0.0, |moment| moment.0)
        );
    }
    Ok(())
}

/// Tracks by the names of entities.
fn read(table: &Path) -> Result<BTreeMap<String, Vec<Moment>>, Box<dyn std::error::Error>> {
    let mut tracks: BTreeMap<String, Vec<Moment>> = BTreeMap::new();
    for (index, line) in std::fs::read_to_string(table)?.lines().enumerate() {
        let fault = || {
            format!(
                "line {}: expected time, name, x, y, heading, speed",
                index + 1
            )
        };
        let parts: Vec<&str> = line.split(',').collect();
        let [time_s, name, x_m, y_m, yaw_rad, speed_mps] = parts[..] else {
            return Err(fault().into());
        };
        let number = |text: &str| text.trim().parse::<f64>().map_err(|_| fault());
        tracks.entry(name.replace(' ', "_")).or_default().push((
            number(time_s)?,
            DVec2::new(number(x_m)?, number(y_m)?),
            number(yaw_rad)?,
            number(speed_mps)?,
        ));
    }
    Ok(tracks)
}
