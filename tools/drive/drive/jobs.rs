//! Scenarios of a run: from files, or generated for levels.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use decouplegs::asset::maps::length_m;
use decouplegs::asset::packed_scene::is_package;
use decouplegs::asset::{
    SceneFile, check_readable, probe_paths, write_atomically, write_obstacles,
};
use decouplegs::drive::generate::{Area, PlaceOptions, Sky};
use decouplegs::episode::Site;
use decouplegs::hugsim_import::import_hugsim_scenario;
use decouplegs::logs::{read_hugsim_scenario, read_scenario, write_scenario};
use decouplegs::recorded::recorded_scenario;
use decouplegs::scenario_import::import_open_scenario;
use decouplegs::scene::scenario::Place;
use decouplegs::scene::{Air, Drivers, LaneMap, Scenario, Weather};
use serde_json::{Value, json};

use super::Arguments;
use super::folder::RunFolder;
use super::generated::generated;
use super::tracks::tracked;
use crate::arguments::warn;

/// Place of generated scenarios.
#[derive(Clone, clap::Args)]
pub struct PlaceArguments {
    /// Drive on the roads of this map, rendered as asphalt and markings, instead of the synthetic
    /// street, or instead of the map that OpenSCENARIO files name
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
    /// Light the roads of --map by the probes (.hdr, .exr) in this folder. Names with `night`,
    /// `dusk`, `dawn`, `sunset`, `sunrise`, `overcast` or `cloud` define the weather; all others
    /// count as clear days
    #[arg(
        long,
        value_name = "DIR",
        requires = "map",
        conflicts_with = "scenarios"
    )]
    probes: Option<PathBuf>,
    /// Drive in this captured scene (.toml), whose lanes are those of --map, or in a package
    /// (.usdz), which has lanes of its own. Scenarios of HUGSIM (.yaml) are driven here
    #[arg(long, value_name = "FILE", conflicts_with = "probes")]
    scene: Option<PathBuf>,
    /// Obstacles of --scene, instead of those of its recording, or of what its splats show beside
    /// the lanes. `map --obstacles` writes such a file
    #[arg(long, value_name = "FILE", requires = "scene")]
    obstacles: Option<PathBuf>,
    /// Number of background splats of a synthetic place [default: 200000, on a map at least 8 per
    /// square meter of its lanes]
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    background: Option<usize>,
    /// Number of splats of each car of a synthetic place
    #[arg(
        long,
        value_name = "N",
        allow_negative_numbers = true,
        default_value_t = 4_000
    )]
    agent_splats: usize,
}

/// An episode to be driven.
pub struct Job {
    pub scenario: Scenario,
    /// Base folder of the scenario's files.
    pub directory: PathBuf,
    /// Sentence about events of its OpenSCENARIO file that are not driven, to stand beside its
    /// score.
    pub lost: Option<String>,
}

pub fn list(arguments: &Arguments, folder: &RunFolder) -> Result<Vec<Job>> {
    let jobs = if let Some(file) = &arguments.tracks.tracks {
        tracked(file, arguments, folder)?
    } else if arguments.follow_recording {
        vec![recorded(arguments, folder)?]
    } else if arguments.scenarios.is_empty() {
        generated(arguments, folder)?
    } else {
        from_files(arguments, folder)?
    };
    let mut names: Vec<&str> = jobs.iter().map(|job| job.scenario.name.as_str()).collect();
    names.sort_unstable();
    if let Some(pair) = names.windows(2).find(|pair| pair[0] == pair[1]) {
        bail!(
            "two scenarios are called {:?}: their logs would be one; change `name` in one of the files",
            pair[0]
        );
    }
    Ok(jobs)
}

fn from_files(arguments: &Arguments, folder: &RunFolder) -> Result<Vec<Job>> {
    let ends_with = |path: &PathBuf, ends: &[&str]| {
        let extension = path
            .extension()
            .map(|extension| extension.to_ascii_lowercase());
        extension.is_some_and(|extension| ends.iter().any(|end| extension == *end))
    };
    let is_open_scenario = |path: &PathBuf| ends_with(path, &["xosc"]);
    let is_hugsim = |path: &PathBuf| ends_with(path, &["yaml", "yml"]);
    let place = &arguments.place;
    for path in &arguments.scenarios {
        let path_shown = path.display();
        if is_hugsim(path) {
            if place.scene.is_none() {
                bail!(
                    "{path_shown} is a scenario of HUGSIM: name the scene that it was made for with --scene, and its lanes with --map"
                );
            }
        } else if place.scene.is_some() {
            bail!(
                "--scene is the place of scenarios of HUGSIM (.yaml), and {path_shown} names its own"
            );
        } else if place.map.is_some() && !is_open_scenario(path) {
            bail!(
                "--map stands for the map of OpenSCENARIO files (.xosc), and {path_shown} names its own"
            );
        }
    }
    let job = |path: &PathBuf| {
        if is_hugsim(path) {
            return hugsim(path, arguments, folder);
        }
        if is_open_scenario(path) {
            return imported(path, arguments, folder);
        }
        Ok(Job {
            scenario: stepped(
                read_scenario(path).map_err(|error| explained(error, path))?,
                arguments,
            ),
            directory: path.parent().unwrap_or(Path::new("")).to_owned(),
            lost: None,
        })
    };
    arguments.scenarios.iter().map(job).collect()
}

/// `error` of a scenario, or a sentence on what to type where the file at `path` is a scene.
fn explained(error: impl Into<anyhow::Error>, path: &Path) -> anyhow::Error {
    if SceneFile::read(path).is_err() {
        return error.into();
    }
    let folder = path.parent().unwrap_or(Path::new(""));
    anyhow!(
        "{scene} is a scene; expected a scenario. To generate scenarios in it, type: decouplegs drive --scene {scene} --map {} --level easy --planner lane-follow --out run",
        folder.join("lanes.json").display(),
        scene = path.display()
    )
}

/// `scenario` with the time between plans and the drivers that were asked for, if any.
pub fn stepped(scenario: Scenario, arguments: &Arguments) -> Scenario {
    let step_s = arguments.step_s().unwrap_or(scenario.step_s);
    let drivers = arguments.drivers.map_or(scenario.drivers, Drivers::from);
    Scenario {
        step_s,
        drivers,
        ..scenario
    }
}

/// Sentences about skipped elements that are printed; all of them are in a file.
const SKIPPED_SHOWN: usize = 8;

/// The scenario of an OpenSCENARIO file, written to the folder of the run beside a list of what was
/// skipped.
fn imported(path: &Path, arguments: &Arguments, folder: &RunFolder) -> Result<Job> {
    let imported = import_open_scenario(path, arguments.place.map.as_deref())?;
    let mut scenario = stepped(imported.scenario, arguments);
    let written = folder.scenario(&scenario.name);
    if let Place::Roads {
        background,
        agent_splats,
        obstacles,
        ..
    } = &mut scenario.place
    {
        let place = &arguments.place;
        *background = place.background_on(&imported.map, arguments.render.0 > 0);
        *agent_splats = place.agent_splats;
        if !imported.obstacles.is_empty() {
            let file = written.with_extension("obstacles.json");
            write_obstacles(&file, &imported.obstacles)?;
            *obstacles = Some(std::path::absolute(file)?);
        }
    }
    let _ = writeln!(
        std::io::stderr(),
        "{}: the planner drives {}; {} of {} events of others are driven{}",
        path.display(),
        imported.ego,
        imported.events_driven,
        imported.events,
        match imported.events_unseen {
            0 => String::new(),
            unseen => format!("; {unseen} more change nothing that is shown here"),
        }
    );
    write_scenario(&written, &scenario)?;
    let list = written.with_extension("skipped.txt");
    let mut text = imported.skipped.join("\n");
    text.push('\n');
    write_atomically(&list, |file| file.write_all(text.as_bytes()))?;
    let skipped = &imported.skipped;
    for sentence in skipped.iter().take(SKIPPED_SHOWN) {
        warn(&format!("{}: {sentence}", path.display()));
    }
    if skipped.len() > SKIPPED_SHOWN {
        let more = skipped.len() - SKIPPED_SHOWN;
        warn(&format!("and {more} more: all are in {}", list.display()));
    }
    let lost = (imported.events_driven < imported.events).then(|| {
        format!(
            "{}: {} of {} events of others are driven, so its score is not that of the whole file",
            scenario.name, imported.events_driven, imported.events
        )
    });
    Ok(Job {
        scenario,
        directory: PathBuf::new(),
        lost,
    })
}

/// The scenario of a file of HUGSIM in the scene that is named, written to the folder of the run.
fn hugsim(path: &Path, arguments: &Arguments, folder: &RunFolder) -> Result<Job> {
    let file = read_hugsim_scenario(path)?;
    let site = Site::open(&arguments.place.bare(), Path::new(""), None)
        .with_context(|| format!("{} cannot be driven here", path.display()))?;
    let scene = arguments
        .place
        .scene
        .as_ref()
        .filter(|scene| !is_package(scene));
    let agents = match scene {
        Some(scene) => SceneFile::read(scene)?.agents,
        None => Vec::new(),
    };
    let tracks: Vec<_> = agents
        .into_iter()
        .map(|agent| (agent.name, agent.trajectory))
        .collect();
    let place = arguments.place.whole()?;
    let (scenario, notes) = import_hugsim_scenario(&file, &site, place, &tracks)
        .map_err(|error| anyhow!("{}: {error}", path.display()))?;
    for sentence in notes {
        warn(&format!("{}: {sentence}", path.display()));
    }
    let scenario = stepped(scenario, arguments);
    write_scenario(&folder.scenario(&scenario.name), &scenario)?;
    Ok(Job {
        scenario,
        directory: PathBuf::new(),
        lost: None,
    })
}

/// The scenario of the recorded way, written to the folder of the run.
fn recorded(arguments: &Arguments, folder: &RunFolder) -> Result<Job> {
    let site = Site::open(&arguments.place.bare(), Path::new(""), None)
        .context("the recording cannot be followed here")?;
    let place = arguments.place.whole()?;
    let scenario = stepped(recorded_scenario(&site, place)?, arguments);
    let path = folder.scenario(&scenario.name);
    if !path.exists() {
        write_scenario(&path, &scenario)?;
    }
    Ok(Job {
        scenario,
        directory: PathBuf::new(),
        lost: None,
    })
}

/// Scenarios of each level, written to the folder of the run, where people can read, edit and drive
/// them.
/// Weather of a probe, by its name.
fn weather_of(probe: &Path) -> Weather {
    let name = probe
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy()
        .to_lowercase();
    let says = |words: &[&str]| words.iter().any(|word| name.contains(word));
    match () {
        () if says(&["night"]) => Weather::Night,
        () if says(&["dusk", "dawn", "sunset", "sunrise"]) => Weather::Dusk,
        () if says(&["overcast", "cloud"]) => Weather::Overcast,
        () => Weather::Clear,
    }
}

/// A captured scene is driven in within this of the middle of its ego's way, meters, where it has
/// none: what cameras see from there.
const SEEN_M: f64 = 150.0;
/// The seed of the street's houses: the same for all runs, so that they differ by who drives.
const STREET_SEED: u64 = 1;

/// Splats of a synthetic background unless the lanes need more, and at most.
const BACKGROUND: usize = 200_000;
const BACKGROUND_MAX: usize = 8_000_000;
/// Splats per square meter of lanes below which roads look like fog.
const SPLATS_PER_M2_MIN: f64 = 8.0;
/// Width of a lane, meters, as far as this needs it.
const LANE_M: f64 = 3.5;

impl PlaceArguments {
    /// Splats of the background: as asked for, otherwise enough for the area of the lanes up to a
    /// limit. Warns where a map's roads have too few.
    pub fn background(&self, site: &Site, is_drawn: bool) -> usize {
        if self.map.is_none() || self.scene.is_some() {
            return self.background.unwrap_or(BACKGROUND);
        }
        self.background_on(&site.lanes, is_drawn)
    }

    /// Splats of the background for the roads of a map.
    fn background_on(&self, map: &LaneMap, is_drawn: bool) -> usize {
        let lengths_m = map.lanes.iter().map(|lane| length_m(&lane.centerline));
        let area_m2 = LANE_M * lengths_m.sum::<f64>();
        let needed = ((SPLATS_PER_M2_MIN * area_m2 / 1e4).ceil() * 1e4) as usize;
        let splats = self
            .background
            .unwrap_or_else(|| needed.clamp(BACKGROUND, BACKGROUND_MAX));
        if is_drawn && splats < needed {
            warn(&format!(
                "{splats} splats on {area_m2:.0} m² of lanes: images will look foggy. --background {needed} is enough"
            ));
        }
        splats
    }

    /// Place of generated scenarios. Files go by their whole path, as scenarios lie in the folder
    /// of the run.
    pub fn options(&self, background: usize) -> Result<PlaceOptions> {
        let whole = |path: &Path| {
            std::fs::canonicalize(path)
                .with_context(|| format!("{} cannot be read: expected a file", path.display()))
        };
        let agent_splats = self.agent_splats;
        let map = self.lanes();
        Ok(match (&map, &self.scene) {
            (Some(map), Some(scene)) => PlaceOptions::Scene {
                scene: whole(scene)?,
                map: whole(map)?,
                obstacles: self.obstacles.as_deref().map(whole).transpose()?,
            },
            (Some(map), None) => {
                let probes = self
                    .probes
                    .as_deref()
                    .map(probe_paths)
                    .transpose()?
                    .unwrap_or_default();
                let sky = |probe: PathBuf| {
                    Ok(Sky {
                        weather: weather_of(&probe),
                        probe: whole(&probe)?,
                    })
                };
                let skies = probes.into_iter().map(sky).collect::<Result<_>>()?;
                PlaceOptions::Roads {
                    map: whole(map)?,
                    skies,
                    background,
                    agent_splats,
                }
            }
            (None, Some(scene)) => {
                check_readable(scene)?;
                bail!(
                    "{} has no lanes of its own: name their map with --map",
                    scene.display()
                )
            }
            (None, None) => PlaceOptions::Street {
                background,
                agent_splats,
                seed: STREET_SEED,
            },
        })
    }

    /// Place of the recorded drive. Files go by their whole path, as those of generated scenarios.
    fn whole(&self) -> Result<Place> {
        match self.options(0)? {
            PlaceOptions::Scene {
                scene,
                map,
                obstacles,
            } => Ok(Place::Scene {
                scene,
                map,
                obstacles,
            }),
            PlaceOptions::Street { .. } | PlaceOptions::Roads { .. } => {
                bail!("a recording is that of a captured scene: name it with --scene")
            }
        }
    }

    /// The map of the lanes: a package's own, if no other is named.
    pub fn lanes(&self) -> Option<PathBuf> {
        let of_package = self.scene.as_ref().filter(|scene| is_package(scene));
        self.map.clone().or_else(|| of_package.cloned())
    }

    /// The same place on another map.
    pub fn on_map(&self, map: &Path) -> Self {
        Self {
            map: Some(map.to_owned()),
            ..self.clone()
        }
    }

    /// The same place with nothing to see.
    pub fn bare(&self) -> Place {
        match (self.lanes(), self.scene.clone()) {
            (Some(map), Some(scene)) => Place::Scene {
                scene,
                map,
                obstacles: self.obstacles.clone(),
            },
            (Some(map), None) => Place::Roads {
                map,
                probe: None,
                exposure_ev: 0.0,
                air: Air::default(),
                obstacles: None,
                background: 0,
                agent_splats: 0,
            },
            (None, _) => Place::Street {
                weather: Weather::Clear,
                background: 0,
                agent_splats: 0,
                seed: STREET_SEED,
            },
        }
    }

    /// Visible area of a captured scene: around the path of the vehicle that captured it.
    pub fn seen(&self, site: &Site) -> Option<Area> {
        self.scene.as_ref()?;
        let way: Vec<_> = site
            .loaded
            .ego
            .poses()
            .iter()
            .map(|timed| timed.pose.translation.truncate())
            .collect();
        let center_m = way.iter().sum::<glam::DVec2>() / way.len() as f64;
        let farthest_m = way
            .iter()
            .map(|at| at.distance(center_m))
            .fold(0.0, f64::max);
        Some(Area {
            center_m,
            radius_m: farthest_m.max(SEEN_M),
        })
    }

    pub fn to_json(&self) -> Value {
        let path = |path: &Option<PathBuf>| path.as_ref().map(|path| path.display().to_string());
        json!({
            "map": path(&self.lanes()),
            "probes": path(&self.probes),
            "scene": path(&self.scene),
            "obstacles": path(&self.obstacles),
            "background": self.background,
            "agent_splats": self.agent_splats,
        })
    }
}
