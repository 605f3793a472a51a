//! `decouplegs realism traffic`: simulated traffic beside recorded traffic.

mod distribution;
mod features;
mod motion;
mod page;
mod report;
mod roads;
mod wosac;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use decouplegs::asset::{check_readable, read_map, read_tracks, write_atomically};
use decouplegs::planner::Timeouts;
use decouplegs::planner::agents::AgentDriverChoice;
use decouplegs::scene::{Drivers, VehicleSize};

use self::motion::{Model, Recording};
use self::report::Compared;
use self::roads::Roads;
use crate::arguments::{print, seconds_within};
use crate::drive::{DriversName, is_commonroad};
use crate::outputs::Force;
use crate::progress;

/// Compare simulated with recorded traffic on the same map, from the same start: distributions of
/// motion, gaps and places, and the likelihood of the recorded motion, as a table, JSON and a page
#[derive(clap::Args)]
pub struct Arguments {
    /// Recorded tracks: CommonRoad .xml, .csv, .json, FOLDER/SCENE of nuScenes
    #[arg(long, value_name = "FILE")]
    tracks: PathBuf,
    /// Map that the tracks lie on [default: that of the CommonRoad file]
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Length of the parts that the recording is cut into; each is simulated from its beginning
    #[arg(long, value_name = "SECONDS", allow_negative_numbers = true, default_value_t = 8.0, value_parser = seconds)]
    seconds: f64,
    /// Number of simulations of each part, with different ways at crossings
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=128))]
    rollouts: u32,
    /// Seed of the simulations
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// Parameters of simulated drivers: kinds, one set for all; or drawn, own ones for each driver,
    /// with free speeds by class of road where the map tells no limit
    #[arg(long, value_name = "kinds|drawn", value_enum, default_value_t = DriversName::Kinds, hide_possible_values = true)]
    drivers: DriversName,
    /// Free speed of all lanes in place of the map's limits: meters a second, or `recorded`, the
    /// median of the vehicles' top speeds in the first half of the recording, of which only the
    /// second half is compared then
    #[arg(long, value_name = "M/S|recorded", allow_negative_numbers = true, value_parser = free_speed)]
    free_speed: Option<FreeSpeed>,
    /// Program that drives all vehicles, to be measured beside the models: exec:COMMAND,
    /// unix:SOCKET, or onnx:MODEL, as with drive --agents. Its ways are the recorded lines
    #[arg(long, value_name = "DRIVER")]
    agents: Option<AgentDriverChoice>,
    /// Show the program of --agents the recording from its beginning to its end, in which nobody
    /// takes its commands, and measure nothing: programs learn from it
    #[arg(long, requires = "agents", conflicts_with = "out")]
    show_recording: bool,
    /// New folder for realism.html and realism.json
    #[arg(long, value_name = "DIR", required_unless_present = "show_recording")]
    out: Option<PathBuf>,
}

/// Free speed of all lanes.
#[derive(Clone, Copy, Debug, PartialEq)]
enum FreeSpeed {
    Recorded,
    Named(f64),
}

fn free_speed(text: &str) -> Result<FreeSpeed, String> {
    if text == "recorded" {
        return Ok(FreeSpeed::Recorded);
    }
    let expected = || format!("expected a speed from 1 to 70 m/s, or recorded, found {text:?}");
    let speed_mps: f64 = text.parse().map_err(|_| expected())?;
    match (1.0..=70.0).contains(&speed_mps) {
        true => Ok(FreeSpeed::Named(speed_mps)),
        false => Err(expected()),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    seconds_within(text, &(1.0..=60.0))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let path = &arguments.tracks;
    if let Some(out) = &arguments.out {
        Force::default().outputs(&[]).whole_folder(out)?;
    }
    let map = match &arguments.map {
        Some(map) => map.clone(),
        None if is_commonroad(path) => path.clone(),
        None => {
            check_readable(path)?;
            bail!(
                "{} has no map of its own: name the map that its tracks lie on with --map",
                path.display()
            )
        }
    };
    let tracks = read_tracks(path)?;
    let sizes = tracks.iter().filter_map(|track| track.dims_m);
    let recording = Recording::new(&tracks);
    let (recording, free_mps) = match arguments.free_speed {
        None => (recording, None),
        Some(FreeSpeed::Named(speed_mps)) => (recording, Some(speed_mps)),
        Some(FreeSpeed::Recorded) => {
            let (later, top_mps) = recording.halved().ok_or_else(|| {
                anyhow!(
                    "{}: no vehicle is faster than 1 m/s in the first half: name a free speed with --free-speed",
                    path.display()
                )
            })?;
            (later, Some(top_mps))
        }
    };
    let mut lanes = read_map(&map)?;
    for lane in &mut lanes.lanes {
        lane.speed_limit_mps = free_mps.or(lane.speed_limit_mps);
    }
    let roads = Roads::new(lanes)
        .and_then(|roads| roads.for_vehicles(sizes.map(VehicleSize::from_array)))
        .map_err(|error| anyhow!("{}: {error}", map.display()))?;
    let starts_s = recording.starts_s(arguments.seconds);
    ensure!(
        !starts_s.is_empty(),
        "{}: no second with a vehicle; expected tracks of 1 s or more",
        path.display()
    );
    let Some(out) = &arguments.out else {
        return show(arguments, &recording, &roads);
    };
    let drivers = Drivers::from(arguments.drivers);
    let agents = arguments.agents.as_ref();
    let mut agents = agents
        .map(|choice| choice.open(Timeouts::default()))
        .transpose()?;
    let mut models = Model::OWN.to_vec();
    models.extend(agents.iter().map(|_| Model::Agents));
    let bar = progress::bar("parts", starts_s.len() * models.len());
    let mut compared = Compared::new(&models, arguments.seconds, drivers, free_mps);
    compared.agent_driver = agents.as_ref().map(|agents| agents.name());
    for start_s in starts_s {
        let recorded = recording.part(&roads, start_s, arguments.seconds);
        for &model in &models {
            let chance = (arguments.rollouts, arguments.seed, drivers);
            let simulated = match &mut agents {
                Some(agents) if model == Model::Agents => {
                    recorded.commanded(&roads, agents.as_mut(), chance)
                }
                _ => recorded.simulated(&roads, model, chance),
            };
            let simulated = simulated.map_err(|error| anyhow!("{}: {error}", path.display()))?;
            compared.add(&roads, &recorded, model, &simulated);
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    compared.finish();
    ensure!(
        compared.vehicles() > 0,
        "{}: no vehicle is on a driving lane of {} at the start of a part: expected tracks in the coordinates of the map",
        path.display(),
        map.display()
    );
    write(out, path, &compared)
}

/// Shows the whole recording to the program of --agents.
fn show(arguments: &Arguments, recording: &Recording, roads: &Roads) -> Result<()> {
    let path = arguments.tracks.display();
    let choice = arguments.agents.as_ref();
    let mut agents = choice
        .context("--show-recording needs --agents")?
        .open(Timeouts::default())?;
    let (first_s, last_s) = recording.span_s();
    let part = recording.part(roads, first_s, last_s - first_s);
    let moments = part
        .shown(roads, agents.as_mut())
        .map_err(|error| anyhow!("{path}: {error}"))?;
    print(&format!(
        "{path}: {moments} moments were shown to {}\n",
        agents.name()
    ))
}

/// Writes the report and prints it.
fn write(out: &Path, tracks: &Path, compared: &Compared) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", out.display()))?;
    write_atomically(&out.join("realism.json"), |file| {
        writeln!(file, "{:#}", compared.to_json(tracks))
    })?;
    let file = out.join("realism.html");
    let page = page::page(compared, tracks);
    write_atomically(&file, |written| written.write_all(page.as_bytes()))?;
    print(&compared.to_text())?;
    print(&format!("{}\n", file.display()))
}
