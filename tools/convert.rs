//! `decouplegs convert`: splats from one format to another, and checkpoints with actors to a scene.

pub mod format;
pub mod report;
pub mod written;

use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use decouplegs_asset::packed_scene::{PackedScene, is_package, read_packed_lanes};
use decouplegs_asset::scene_import::{ImportOptions, ImportedScene, read_scene};
use decouplegs_asset::{
    AssetError, LossReport, SceneFile, SplatFormat, UnfinishedFolder, khr_glb, read_bytes,
    read_splats, read_tracks,
};
use decouplegs_scene::ShFrame;

use crate::arguments::print;
use crate::outputs::{Force, Outputs};
use crate::progress;
use format::Format;
use report::Report;
use written::Writing;

/// Convert splats from one format to another, or a checkpoint with actors to a scene, and report
/// the loss
///
/// The formats that are written are listed under --to. What was written is read back and compared,
/// splat by splat. A checkpoint of drivestudio (OmniRe) or Street Gaussians, or a folder of HUGSIM
/// with its scene.pth, or a package (.usdz, also of NuRec), becomes a folder with a scene file.
#[derive(clap::Args)]
pub struct Arguments {
    #[arg(help = format!(
        "Splats ({}), the folder of an unpacked .sog, a checkpoint with actors, or a folder of HUGSIM",
        SplatFormat::EXTENSIONS
    ))]
    input: PathBuf,
    /// File to write, in the format of its extension, or folder for a scene
    output: PathBuf,
    /// Format to write, regardless of the extension
    #[arg(long, value_name = "FORMAT", value_enum)]
    to: Option<Format>,
    /// Highest degree of spherical harmonics to write (default: all)
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: Option<u8>,
    /// Write the loss to this JSON file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Frames per second of a checkpoint whose frames have no times
    #[arg(long, value_name = "HZ", allow_negative_numbers = true, default_value_t = 10.0, value_parser = rate)]
    frame_rate: f64,
    /// Trajectories of actors, for a checkpoint without tracks: a table of tracks whose ids are the
    /// models' names or numbers
    #[arg(long, value_name = "FILE")]
    tracks: Option<PathBuf>,
    /// Training image, or camera, whose color correction is taken, counted from 0 (default: the
    /// mean of all)
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    image: Option<usize>,
    #[command(flatten)]
    force: Force,
}

fn rate(text: &str) -> Result<f64, String> {
    let value = text
        .parse()
        .ok()
        .filter(|&hz: &f64| hz > 0.0 && hz <= 10_000.0);
    value.ok_or_else(|| format!("expected frames a second, above 0, found {text:?}"))
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let mut inputs = vec![arguments.input.as_path()];
    inputs.extend(arguments.tracks.as_deref());
    let mut outputs = arguments.force.outputs(&inputs);
    // What becomes a scene, in a folder, is known only when it was read.
    if arguments.output.is_file() {
        outputs.file(&arguments.output)?;
    }
    if let Some(report) = &arguments.report {
        outputs.file(report)?;
    }
    let tracks = arguments
        .tracks
        .as_deref()
        .map(read_tracks)
        .transpose()?
        .unwrap_or_default();
    let options = ImportOptions {
        frame_rate_hz: arguments.frame_rate,
        tracks,
        image: arguments.image,
    };
    let reading = progress::spinner(format!("reading {}", arguments.input.display()));
    let mut scene = read_scene(&arguments.input, &options)?;
    if let Some(scene) = scene.as_mut().filter(|_| is_package(&arguments.input)) {
        match read_packed_lanes(&arguments.input) {
            Ok(lanes) => scene.lanes = lanes,
            Err(error) => scene.notes.push(format!("the map is left out: {error}")),
        }
    }
    reading.finish_and_clear();
    match scene {
        Some(scene) => write_scene(arguments, &scene),
        None if is_package(&arguments.input) => unpack(arguments),
        None => write_splats(arguments, &mut outputs),
    }
}

/// Splats to splats.
fn write_splats(arguments: &Arguments, outputs: &mut Outputs) -> Result<()> {
    let format = match arguments.to {
        Some(format) => format,
        None => Format::of_path(&arguments.output)?,
    };
    if !arguments.output.is_file() {
        outputs.file(&arguments.output)?;
    }
    let reading = progress::spinner(format!("reading {}", arguments.input.display()));
    let before = read_splats(&arguments.input)?;
    reading.finish_and_clear();
    ensure!(
        !before.is_empty(),
        "{} has no splats",
        arguments.input.display()
    );
    let notes = notes_of(&arguments.input)?;
    let writing = Writing {
        input: &arguments.input,
        output: &arguments.output,
        format,
        degree: arguments.degree,
    };
    let splats_in = before.len();
    let report = writing.write(before, splats_in, notes)?;
    finish(arguments.report.as_deref(), &report)
}

/// The folder of a scene, written by `write`: there whole, or not at all.
fn write_folder(
    arguments: &Arguments,
    write: impl FnOnce(&Path) -> Result<SceneFile, AssetError>,
) -> Result<SceneFile> {
    let out = &arguments.output;
    if let Some(format) = arguments.to {
        bail!(
            "{} holds a scene: it becomes a folder with a scene, not {}; leave out --to",
            arguments.input.display(),
            format.name()
        );
    }
    arguments.force.outputs(&[]).whole_folder(out)?;
    let unfinished = UnfinishedFolder::begin(out)?;
    let scene = write(unfinished.path())?;
    unfinished.finish()?;
    Ok(scene)
}

/// A package of this program to a folder with its scene, as it was packed.
fn unpack(arguments: &Arguments) -> Result<()> {
    ensure!(
        arguments.report.is_none(),
        "--report: a package of this program is unpacked as it is, without loss"
    );
    let package = PackedScene::open(&arguments.input)?;
    let scene = write_folder(arguments, |folder| package.write(folder))?;
    print(&format!(
        "{}: {} cameras, {} agents\n",
        arguments.output.join("scene.toml").display(),
        scene.rig.sensors.len(),
        scene.agents.len()
    ))
}

/// A checkpoint with actors to a folder with a scene.
fn write_scene(arguments: &Arguments, scene: &ImportedScene) -> Result<()> {
    let out = &arguments.output;
    let agents = write_folder(arguments, |folder| scene.write(folder))?
        .agents
        .len();
    let mut notes = scene.notes.clone();
    let placed = format!(
        "{} of {} actors stand in the scene, their colors in {}",
        agents,
        scene.actors.len(),
        match scene.actor_frame {
            ShFrame::World => "the world's frame",
            ShFrame::Canonical => "frames of their own",
        }
    );
    notes.insert(0, placed);
    let splats: usize = scene.background.len()
        + scene
            .actors
            .iter()
            .map(|actor| actor.splats.len())
            .sum::<usize>();
    let report = Report {
        input: &arguments.input,
        output: out,
        format: "scene folder",
        splats_in: splats,
        splats_out: splats,
        bytes_in: bytes_of(&arguments.input)?,
        bytes_out: bytes_of(out)?,
        loss: Some(read_back(out, scene)?),
        notes,
    };
    finish(arguments.report.as_deref(), &report)
}

/// Loss of a scene's splats in the written files.
fn read_back(out: &Path, scene: &ImportedScene) -> Result<LossReport> {
    let mut before = scene.background.clone();
    let mut after = read_splats(&out.join("background.ply"))?;
    for (index, actor) in scene.actors.iter().enumerate() {
        before.append(&actor.splats);
        after.append(&read_splats(&out.join(scene.asset_path(index)))?);
    }
    Ok(LossReport::between(&before, &after, true))
}

/// Prints `report`, and writes it to `file`, if there is one.
pub fn finish(file: Option<&Path>, report: &Report<'_>) -> Result<()> {
    if let Some(path) = file {
        report.write(path)?;
    }
    print(&report.to_text())
}

/// Notes on properties of the input that are not read.
pub fn notes_of(path: &Path) -> Result<Vec<String>> {
    if !path.is_file() {
        return Ok(Vec::new());
    }
    let mut start = Vec::new();
    let file = fs::File::open(path).and_then(|file| file.take(4).read_to_end(&mut start));
    file.with_context(|| format!("{} cannot be read", path.display()))?;
    if start != b"glTF" {
        return Ok(Vec::new());
    }
    khr_glb::read_notes(&read_bytes(path)?)
        .with_context(|| format!("{} cannot be read", path.display()))
}

/// Bytes of a file, or of all files in a folder.
fn bytes_of(path: &Path) -> Result<u64> {
    let metadata = fs::metadata(path).with_context(|| format!("cannot read {}", path.display()))?;
    if !metadata.is_dir() {
        return Ok(metadata.len());
    }
    let entries = fs::read_dir(path).with_context(|| format!("cannot read {}", path.display()))?;
    entries.map(|entry| bytes_of(&entry?.path())).sum()
}
