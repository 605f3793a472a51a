//! Episodes among recorded tracks.

use std::ffi::OsStr;
use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail, ensure};
use clap::ValueEnum;
use decouplegs::asset::tracks::TrackFormat;
use decouplegs::asset::{check_readable, read_tracks};
use decouplegs::drive::generate::PlaceOptions;
use decouplegs::episode::Site;
use decouplegs::logs::write_scenario;
use decouplegs::scene::Air;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::story;
use decouplegs::track_import::import_tracks;
use serde_json::{Value, json};

use super::Arguments;
use super::folder::RunFolder;
use super::jobs::{Job, stepped};
use crate::arguments::warn;

/// Rule by which recorded vehicles are handed over to the driver model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Handover {
    Never,
    Near,
    All,
}

impl From<Handover> for story::Handover {
    fn from(rule: Handover) -> Self {
        match rule {
            Handover::Never => Self::Never,
            Handover::Near => Self::Near,
            Handover::All => Self::All,
        }
    }
}

/// Recorded tracks to drive among.
#[derive(clap::Args)]
pub struct TrackArguments {
    /// Drive among these recorded road users (CommonRoad .xml, .csv, .json, FOLDER/SCENE of
    /// nuScenes), which follow their tracks. The map is that of the CommonRoad file, or --map
    #[arg(long, value_name = "FILE", conflicts_with_all = ["scenarios", "level", "follow_recording"])]
    pub tracks: Option<PathBuf>,
    /// The ego starts with the place, route, speed and time of this recorded vehicle, which is left
    /// out; one episode each [default: the vehicle on lanes with the longest way]
    #[arg(long, value_name = "ID", requires = "tracks", conflicts_with_all = ["scenarios", "level", "follow_recording"], value_delimiter = ',')]
    ego_track: Vec<String>,
    /// Let recorded vehicles leave their tracks and drive by the driver model: never; near, where
    /// the ego or one that left its track is in the way of what was recorded; or all from the start
    #[arg(
        long,
        value_name = "never|near|all",
        value_enum,
        requires = "tracks",
        conflicts_with_all = ["scenarios", "level", "follow_recording"],
        default_value = "near",
        hide_possible_values = true
    )]
    handover: Handover,
}

impl TrackArguments {
    /// Settings that must be the same when a run is resumed; `None` without tracks.
    pub fn to_json(&self) -> Option<Value> {
        let tracks = self.tracks.as_ref()?;
        Some(json!({
            "file": tracks.display().to_string(),
            "ego": self.ego_track,
            "handover": story::Handover::from(self.handover).name(),
        }))
    }
}

/// Episodes among the tracks of the file `path`, whose scenarios are written to the folder of the
/// run.
pub fn tracked(path: &Path, arguments: &Arguments, folder: &RunFolder) -> Result<Vec<Job>> {
    let own = &arguments.tracks;
    let place = match arguments.place.lanes() {
        None if is_commonroad(path) => arguments.place.on_map(path),
        None => {
            check_readable(path)?;
            bail!(
                "{} has no map of its own: name the map that its tracks lie on with --map",
                path.display()
            )
        }
        Some(_) => arguments.place.clone(),
    };
    let tracks = read_tracks(path)?;
    let site = Site::open(&place.bare(), Path::new(""), None)
        .with_context(|| format!("no episode can be driven on the map of {}", path.display()))?;
    let whole = place_of(place.options(place.background(&site, arguments.render.0 > 0))?)?;
    let name = path.file_stem().unwrap_or(OsStr::new("tracks"));
    let name = name.to_string_lossy();
    let chosen: Vec<Option<&str>> = match own.ego_track.as_slice() {
        [] => vec![None],
        ids => ids.iter().map(|id| Some(id.as_str())).collect(),
    };
    let mut jobs = Vec::new();
    for ego in chosen {
        let chosen = (ego, own.handover.into());
        let found = import_tracks(&tracks, &site.lanes, whole.clone(), &name, chosen)
            .map_err(|error| anyhow!("{}: {error}", path.display()))?;
        for sentence in &found.notes {
            warn(&format!("{}: {sentence}", path.display()));
        }
        let scenario = stepped(found.scenario, arguments);
        ensure!(
            !scenario.story.tracks.agents.is_empty(),
            "{}: beside track {} there is nobody on a track",
            path.display(),
            found.ego
        );
        let _ = writeln!(
            std::io::stderr(),
            "{}: the ego is track {}; {} road users follow theirs, for {:.1} s",
            path.display(),
            found.ego,
            scenario.story.tracks.agents.len(),
            scenario.duration_s
        );
        write_scenario(&folder.scenario(&scenario.name), &scenario)?;
        jobs.push(Job {
            scenario,
            directory: PathBuf::new(),
            lost: None,
        });
    }
    Ok(jobs)
}

/// The place of `options`: roads under the first of their skies.
fn place_of(options: PlaceOptions) -> Result<Place> {
    Ok(match options {
        PlaceOptions::Roads {
            map,
            skies,
            background,
            agent_splats,
        } => Place::Roads {
            map,
            probe: skies.into_iter().next().map(|sky| sky.probe),
            exposure_ev: 0.0,
            air: Air::default(),
            obstacles: None,
            background,
            agent_splats,
        },
        PlaceOptions::Scene {
            scene,
            map,
            obstacles,
        } => Place::Scene {
            scene,
            map,
            obstacles,
        },
        PlaceOptions::Street { .. } => bail!("tracks lie on a map: name it with --map"),
    })
}

/// True if a file of tracks has a map, too.
pub fn is_commonroad(path: &Path) -> bool {
    let mut begin = Vec::new();
    let read = File::open(path).and_then(|file| file.take(4096).read_to_end(&mut begin));
    read.is_ok() && TrackFormat::detect(&begin) == Ok(TrackFormat::CommonRoad)
}
