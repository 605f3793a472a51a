//! `decouplegs map`: the lanes of a map, as a table and as an image, and where tracks run over
//! them.

mod drawing;
mod style;
mod summary;

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Result;
use decouplegs::asset::maps::lane_json;
use decouplegs::asset::{read_map, read_tracks, write_atomically, write_obstacles};
use decouplegs::episode::Site;
use decouplegs::scene::scenario::Place;

use crate::arguments::print;
use crate::outputs::Force;
use drawing::Drawing;
use summary::{MapSummary, TrackSummary};

/// Describe and draw the lanes of a map: kinds, lengths, heights, links; and tracks on it
#[derive(clap::Args)]
pub struct Arguments {
    /// OpenDRIVE (.xodr), Lanelet2 (.osm), Argoverse 2 or lane JSON, or CommonRoad (.xml)
    file: PathBuf,
    /// Draw the lanes from above into an SVG file, with their ids where there is room. In a
    /// browser, hovering over a lane shows its id
    #[arg(long, value_name = "FILE")]
    svg: Option<PathBuf>,
    /// Write all lanes as lane JSON: ids, centerlines, borders, links. Scenarios name lanes by
    /// these ids, and all commands read the file
    #[arg(long, value_name = "FILE")]
    lanes: Option<PathBuf>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
    /// Tracks to describe and draw as well: a CSV or JSON table, CommonRoad, or a scene of
    /// nuScenes as FOLDER/SCENE
    #[arg(long, value_name = "FILE")]
    tracks: Option<PathBuf>,
    /// Captured scene (.toml) on these lanes, whose obstacles are counted and drawn
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Write the obstacles of --scene as JSON, a line each, to edit and give to `drive --obstacles`
    #[arg(long, value_name = "FILE", requires = "scene")]
    obstacles: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

/// Checks the files that are to be written.
fn check_outputs(arguments: &Arguments) -> Result<()> {
    let inputs = [
        Some(&arguments.file),
        arguments.tracks.as_ref(),
        arguments.scene.as_ref(),
    ];
    let inputs: Vec<&Path> = inputs.into_iter().flatten().map(PathBuf::as_path).collect();
    let written = [&arguments.svg, &arguments.lanes, &arguments.obstacles];
    arguments
        .force
        .files(&inputs, written.into_iter().flatten())
}

pub fn run(arguments: &Arguments) -> Result<()> {
    check_outputs(arguments)?;
    let map = read_map(&arguments.file)?;
    let tracks = arguments.tracks.as_deref().map(read_tracks).transpose()?;
    let summary = MapSummary::new(&map);
    let site = arguments.scene.as_ref().map(|scene| {
        let place = Place::Scene {
            scene: scene.clone(),
            map: arguments.file.clone(),
            obstacles: None,
        };
        Site::open(&place, Path::new(""), None)
    });
    let site = site.transpose()?;
    let obstacles = site.as_ref().map(|site| site.obstacles.all());
    if let (Some(path), Some(obstacles)) = (&arguments.obstacles, obstacles) {
        write_obstacles(path, obstacles)?;
    }
    let driven = tracks
        .as_deref()
        .map(|tracks| TrackSummary::new(tracks, &summary));
    if let Some(path) = &arguments.svg {
        let name = arguments
            .file
            .file_name()
            .unwrap_or_default()
            .to_string_lossy();
        let svg = Drawing {
            name: &name,
            map: &map,
            summary: &summary,
            tracks: tracks.as_deref().unwrap_or_default(),
            obstacles: obstacles.unwrap_or_default(),
        }
        .to_svg();
        write_atomically(path, |file| file.write_all(svg.as_bytes()))?;
    }
    if let Some(path) = &arguments.lanes {
        lane_json::write(path, &map)?;
    }
    if arguments.json {
        let mut value = summary.to_json();
        if let Some(driven) = driven {
            value["tracks"] = driven.to_json();
        }
        if let Some(obstacles) = obstacles {
            value["obstacles"] = obstacles.len().into();
        }
        return print(&format!("{value:#}\n"));
    }
    let driven = driven.map_or_else(String::new, |driven| driven.to_text());
    let obstacles = obstacles.map_or_else(String::new, |obstacles| {
        format!("{} obstacles beside the lanes\n", obstacles.len())
    });
    print(&format!(
        "{}\n{}{driven}{obstacles}",
        arguments.file.display(),
        summary.to_text()
    ))
}
