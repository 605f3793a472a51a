//! `decouplegs register`: tracks brought onto the lanes of a map and the ground of a scene, as
//! poses.

mod measure;
mod page;
mod points;
mod table;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail, ensure};
use decouplegs::asset::tracks::{PoseRow, write_poses};
use decouplegs::asset::{open_scene, read_map, read_tracks, write_atomically};
use decouplegs::drive::{
    Ground, GroundGuides, GroundOptions, GroundQuality, Outcome, RegisterOptions, Registration,
    Survey, register,
};
use decouplegs::scene::{LaneMap, SplatScene};

use crate::arguments::{print, warn};
use crate::outputs::Force;
use crate::progress;
use measure::Measured;

/// Register tracks to the lanes of a map and to the ground of a scene
///
/// A log may drift: its cars drive beside their lanes, and float above the road or sink into it.
/// Tracks are matched to their lanes, moved by planar motions where lanes show that the log
/// drifted, and set on the splats below their four corners. The log as a whole comes first; a
/// single track is moved only by more than the habits of drivers explain. A log without drift stays
/// as it is, and the report says so. Lanes show where a track is across them; where they are
/// straight, its place along them stays as logged. Parked vehicles stay where they were logged.
/// Tracks that drive against their lanes, or follow none, are left out with the reason.
#[derive(clap::Args)]
pub struct Arguments {
    /// Lanes: OpenDRIVE (.xodr), Lanelet2 (.osm), Argoverse 2 or lane JSON, or CommonRoad (.xml)
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// Tracks: a CSV or JSON table, CommonRoad, or a scene of nuScenes as FOLDER/SCENE
    /// (v1.0-mini/scene-0061)
    #[arg(long, value_name = "FILE")]
    tracks: PathBuf,
    /// The ground: splats, a scene (.toml), its background, or points of a survey as a table of x,
    /// y and z (.csv) (default: the heights of the map)
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Poses to write (.csv or .json): time, id, position of the box's center, rotation as w, x, y,
    /// z, flags
    #[arg(long, value_name = "FILE", value_parser = pose_path)]
    out: PathBuf,
    /// Ground-truth tracks with the same ids, to measure errors against
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Clearances are measured against this ground: splats, a scene, or points of a survey as a
    /// table of x, y and z (.csv). Without it they are measured against the ground the boxes were
    /// set on, which shows how well they fit it and no more
    #[arg(long, value_name = "FILE")]
    ground_truth: Option<PathBuf>,
    /// Write a page with plots of each track, errors and clearances
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Standard deviation of the log's noise, meters; 0 disables smoothing (default: estimated per
    /// track)
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, value_parser = not_negative)]
    sigma: Option<f64>,
    /// Move all tracks together or none: for a log that drifts as a whole
    #[arg(long)]
    shared: bool,
    /// Deviation of drivers from the middle of their lane, meters; tracks are moved one by one only
    /// for more. 0: tracks belong on the middle
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, default_value_t = 0.3, value_parser = not_negative)]
    habit: f64,
    /// Corners that are deeper below the ground have penetrated it, meters
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, default_value_t = 0.02, value_parser = not_negative)]
    tolerance: f64,
    #[command(flatten)]
    force: Force,
}

fn pose_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let fits = path
        .extension()
        .is_some_and(|extension| extension == "csv" || extension == "json");
    if fits {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .csv or .json, found {text:?}"
        ))
    }
}

fn not_negative(text: &str) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|value: &f64| value.is_finite() && *value >= 0.0);
    number.ok_or_else(|| format!("expected meters, 0 or more, found {text:?}"))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut inputs = vec![arguments.map.as_path(), &arguments.tracks];
    inputs.extend(
        [&arguments.scene, &arguments.truth, &arguments.ground_truth]
            .into_iter()
            .filter_map(|path| path.as_deref()),
    );
    let mut outputs = arguments.force.outputs(&inputs);
    outputs.file(&arguments.out)?;
    if let Some(report) = &arguments.report {
        outputs.file(report)?;
    }
    let map = read_map(&arguments.map)?;
    let tracks = read_tracks(&arguments.tracks)?;
    let truth = arguments.truth.as_deref().map(read_tracks).transpose()?;
    if let Some(truth) = &truth {
        let known = tracks
            .iter()
            .any(|track| truth.iter().any(|truth| truth.id == track.id));
        ensure!(
            known,
            "{} has none of the tracks of {}",
            text_of(arguments.truth.as_deref()),
            arguments.tracks.display()
        );
    }
    let ground = arguments
        .scene
        .as_deref()
        .map(|path| ground_of(path, Some(&map)))
        .transpose()?;
    let truth_ground = arguments
        .ground_truth
        .as_deref()
        .map(|path| ground_of(path, None))
        .transpose()?;
    let options = RegisterOptions {
        noise_m: arguments.sigma,
        shared: arguments.shared,
        keeping_m: arguments.habit,
        ..RegisterOptions::default()
    };
    let working = progress::spinner(format!("registering {} tracks", tracks.len()));
    let registration = register(&map, &tracks, ground.as_ref(), &options)?;
    if arguments.shared && registration.shared.is_none() {
        warn("--shared: lanes show no motion of the log as a whole, so no track was moved");
    }
    let compared = truth_ground.as_ref().or(ground.as_ref());
    let measured = Measured::new(
        &map,
        &tracks,
        &registration,
        truth.as_deref(),
        compared,
        arguments.tolerance,
    );
    working.finish_and_clear();

    let rows = rows(&registration);
    if rows.is_empty() {
        print(&table::table(&measured))?;
        bail!(
            "none of the {} tracks of {} could be registered",
            tracks.len(),
            arguments.tracks.display()
        );
    }
    write_poses(&arguments.out, &rows)?;
    if let Some(path) = &arguments.report {
        let subject = page::Subject {
            arguments,
            map: &map,
            tracks: &tracks,
            truth: truth.as_deref(),
            registration: &registration,
        };
        write_atomically(path, |file| {
            file.write_all(page::page(&subject, &measured).as_bytes())
        })?;
    }
    print(&format!(
        "{}{}: {} poses\n",
        table::table(&measured),
        arguments.out.display(),
        rows.len()
    ))
}

fn text_of(path: Option<&Path>) -> String {
    path.map(|path| path.display().to_string())
        .unwrap_or_default()
}

/// The ground of a scene's background, or that of a survey's points.
///
/// With `map`, that and the way of the scene's ego guide it. A truth has no guides: it would be
/// compared with itself.
fn ground_of(path: &Path, map: Option<&LaneMap>) -> Result<Ground> {
    let reading = progress::spinner(format!("reading {}", path.display()));
    let (mut recorded, mut survey) = (None, None);
    let (cloud, origin) = if path.extension().is_some_and(|extension| extension == "csv") {
        points::read(path)?
    } else {
        let loaded = open_scene(path, 0.0)?;
        recorded = Some((loaded.ego, loaded.ego_height_m));
        survey = Survey::from_points(loaded.recording.ground_m);
        let SplatScene {
            splats,
            instance_from_splat,
            origin,
            ..
        } = loaded.splat_scene;
        let still: Vec<u32> = (0..splats.len() as u32)
            .filter(|&at| {
                instance_from_splat
                    .get(at as usize)
                    .is_none_or(|id| *id == 0)
            })
            .collect();
        (splats.select(&still), origin)
    };
    let mut ground = Ground::new(&cloud, origin, &GroundOptions::default());
    if let (Some(_), Some((ego, height_m))) = (map, &recorded) {
        let guides = GroundGuides {
            map,
            survey: survey.as_ref(),
            ..GroundGuides::for_way(ego.poses(), *height_m)
        };
        ground = ground.guided(&cloud, guides);
    }
    reading.finish_and_clear();
    if let Some(warning) = ground.quality().and_then(GroundQuality::warning) {
        warn(&format!("{}: {warning}", path.display()));
    }
    ensure!(
        !cloud.is_empty(),
        "{} has no splats to stand on",
        path.display()
    );
    Ok(ground)
}

fn rows(registration: &Registration) -> Vec<PoseRow> {
    let mut rows = Vec::new();
    for track in &registration.tracks {
        let Outcome::Registered(registered) = &track.outcome else {
            continue;
        };
        rows.extend(registered.poses.iter().map(|pose| PoseRow {
            id: track.id.clone(),
            class: track.class.clone(),
            time_s: pose.time_s,
            position: pose.pose.translation,
            rotation: pose.pose.rotation,
            dims_m: Some(track.dims_m),
            note: pose.flags.names().join(" "),
        }));
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nonsense_is_refused_with_what_was_found() {
        assert!(
            pose_path("poses.txt").unwrap_err().contains("poses.txt")
                && pose_path("a.json").is_ok()
        );
        for nonsense in ["-1", "NaN", "inf", "some"] {
            assert!(not_negative(nonsense).unwrap_err().contains(nonsense));
        }
        assert_eq!(not_negative("0"), Ok(0.0));
    }
}
