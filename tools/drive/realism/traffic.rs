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
use decouplegs::asset::{read_map, read_tracks, write_atomically};
use decouplegs::scene::VehicleSize;

use self::motion::{Model, Recording};
use self::report::Compared;
use self::roads::Roads;
use crate::arguments::{print, seconds_within};
use crate::drive::is_commonroad;
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
    /// New folder for realism.html and realism.json
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

fn seconds(text: &str) -> Result<f64, String> {
    seconds_within(text, &(1.0..=60.0))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let (path, out) = (&arguments.tracks, &arguments.out);
    Force::default().outputs(&[]).whole_folder(out)?;
    let map = match &arguments.map {
        Some(map) => map.clone(),
        None if is_commonroad(path) => path.clone(),
        None => bail!(
            "{} has no map of its own: name the map that its tracks lie on with --map",
            path.display()
        ),
    };
    let tracks = read_tracks(path)?;
    let sizes = tracks.iter().filter_map(|track| track.dims_m);
    let roads = Roads::new(read_map(&map)?)
        .and_then(|roads| roads.for_vehicles(sizes.map(VehicleSize::from_array)))
        .map_err(|error| anyhow!("{}: {error}", map.display()))?;
    let recording = Recording::new(&tracks);
    let starts_s = recording.starts_s(arguments.seconds);
    ensure!(
        !starts_s.is_empty(),
        "{}: no second with a vehicle; expected tracks of 1 s or more",
        path.display()
    );
    let bar = progress::bar("parts", starts_s.len() * Model::ALL.len());
    let mut compared = Compared::new(arguments.seconds);
    for start_s in starts_s {
        let recorded = recording.part(&roads, start_s, arguments.seconds);
        for model in Model::ALL {
            let simulated = recorded
                .simulated(&roads, model, arguments.rollouts, arguments.seed)
                .map_err(|error| anyhow!("{}: {error}", path.display()))?;
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
