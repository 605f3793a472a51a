//! `decouplegs transform`: splats turned, moved, scaled, cut and merged.

mod steps;

use std::path::{Path, PathBuf};

use anyhow::{Result, ensure};
use decouplegs_asset::{LossReport, SplatFormat, read_splats};
use decouplegs_scene::{Similarity, SplatCloud};

use crate::convert::format::Format;
use crate::convert::report::shown;
use crate::convert::written::Writing;
use crate::convert::{finish, notes_of};
use crate::outputs::Force;
use crate::progress;
use steps::{Step, Steps};

/// Turn, move, scale, cut and merge splats, and report what was left out and lost
///
/// Steps are done in the order of the command line, and may be repeated. Positions are in the
/// file's own coordinates, as the steps before have left them, in meters. Turns and scales are
/// around the origin. Shapes and spherical harmonics turn with the splats. What was written is read
/// back and compared. Formats are those of `convert`.
#[derive(clap::Args)]
#[command(override_usage = "decouplegs transform [OPTIONS] <INPUT> <OUTPUT> <STEP>...")]
pub struct Arguments {
    #[arg(help = format!(
        "Splats ({}), or the folder of an unpacked .sog",
        SplatFormat::EXTENSIONS
    ))]
    input: PathBuf,
    /// File to write, in the format of its extension
    output: PathBuf,
    #[command(flatten)]
    steps: Steps,
    /// Format to write, regardless of the extension
    #[arg(long, value_name = "FORMAT", value_enum)]
    to: Option<Format>,
    /// Highest degree of spherical harmonics to write (default: all)
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u8).range(0..=3))]
    degree: Option<u8>,
    /// Write what was lost to this JSON file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    #[command(flatten)]
    force: Force,
}

pub fn run(arguments: &Arguments) -> Result<()> {
    let Arguments { input, output, .. } = arguments;
    let format = match arguments.to {
        Some(format) => format,
        None => Format::of_path(output)?,
    };
    let mut inputs = vec![input.as_path()];
    inputs.extend(arguments.steps.merged());
    let mut outputs = arguments.force.outputs(&inputs);
    outputs.file(output)?;
    if let Some(report) = &arguments.report {
        outputs.file(report)?;
    }
    let cloud = read(input)?;
    let splats_in = cloud.len();
    let mut work = Work {
        cloud,
        pending: Similarity::IDENTITY,
        notes: Vec::new(),
        way_back: Some(Similarity::IDENTITY),
    };
    for (words, step) in arguments.steps.in_order() {
        let doing = progress::spinner(format!("{words} of {} splats", work.cloud.len()));
        work.take(words, step)?;
        doing.finish_and_clear();
        ensure!(
            !work.cloud.is_empty(),
            "{words} leaves no splat of {}: name a larger part",
            input.display()
        );
    }
    let moving = progress::spinner(format!("moving {} splats", work.cloud.len()));
    work.move_splats()?;
    moving.finish_and_clear();
    work.notes.extend(notes_of(input)?);
    if let Some(back) = work.way_back.filter(|back| *back != Similarity::IDENTITY) {
        work.notes.push(way_back(&back));
    }
    let writing = Writing {
        input,
        output,
        format,
        degree: arguments.degree,
    };
    let report = writing.write(work.cloud, splats_in, work.notes)?;
    finish(arguments.report.as_deref(), &report)
}

fn read(path: &Path) -> Result<SplatCloud> {
    let reading = progress::spinner(format!("reading {}", path.display()));
    let cloud = read_splats(path)?;
    reading.finish_and_clear();
    ensure!(!cloud.is_empty(), "{} has no splats", path.display());
    Ok(cloud)
}

/// The sentence on the options that undo what was done, `back`.
fn way_back(back: &Similarity) -> String {
    let (moved, turned) = (back.translation, back.rotation);
    format!(
        "back with --scale {} --quaternion {},{},{},{} --translate {},{},{}",
        back.scale, turned.w, turned.x, turned.y, turned.z, moved.x, moved.y, moved.z
    )
}

/// Splats between two steps.
struct Work {
    cloud: SplatCloud,
    /// Transform that the cloud's numbers have yet to go through: moves are joined in f64, and
    /// numbers are rounded once.
    pending: Similarity,
    notes: Vec<String>,
    /// The transform that undoes all; `None` once splats of other files are among them.
    way_back: Option<Similarity>,
}

impl Work {
    /// Does `step`, which the command line gives as `words`.
    fn take(&mut self, words: &str, step: &Step) -> Result<()> {
        match step {
            Step::Move(similarity) => {
                self.pending = similarity.then(&self.pending);
                self.way_back = self.way_back.map(|back| back.then(&similarity.inverse()));
            }
            Step::Merge(path) => {
                self.move_splats()?;
                let other = read(path)?;
                self.notes
                    .push(format!("{words}: {} splats more", other.len()));
                self.cloud.append(&other);
                self.way_back = None;
            }
            Step::CropBox { min, max } => self.keep(words, |work, splat| {
                let place = work.pending.transform(work.cloud.mean_m(splat));
                place.cmpge(*min).all() && place.cmple(*max).all()
            }),
            Step::CropSphere { center, radius_m } => self.keep(words, |work, splat| {
                let place = work.pending.transform(work.cloud.mean_m(splat));
                place.distance(*center) <= *radius_m
            }),
            Step::DropFaint(least) => {
                self.keep(words, |work, splat| work.cloud.opacities[splat] >= *least);
            }
            Step::DropFloaters(share) => {
                let floaters = self.cloud.floaters(*share);
                self.keep(words, |_, splat| !floaters[splat]);
            }
        }
        Ok(())
    }

    /// Leaves out the splats that are not `wanted`.
    fn keep(&mut self, words: &str, wanted: impl Fn(&Self, usize) -> bool) {
        let kept: Vec<u32> = (0..self.cloud.len() as u32)
            .filter(|&splat| wanted(self, splat as usize))
            .collect();
        let left_out = self.cloud.len() - kept.len();
        let notes = &mut self.notes;
        notes.push(format!("{words}: {left_out} splats left out"));
        if left_out > 0 {
            self.cloud = self.cloud.select(&kept);
        }
    }

    /// Moves the splats by what is pending, and notes what that rounds.
    fn move_splats(&mut self) -> Result<()> {
        let similarity = std::mem::replace(&mut self.pending, Similarity::IDENTITY);
        if similarity == Similarity::IDENTITY {
            return Ok(());
        }
        let moved = self.cloud.transformed(&similarity);
        let defects = |cloud: &SplatCloud| {
            let splats = 0..cloud.len();
            splats
                .filter(|&splat| cloud.defect_of(splat).is_some())
                .count()
        };
        let lost = defects(&moved).saturating_sub(defects(&self.cloud));
        ensure!(
            lost == 0,
            "{lost} splats are moved or scaled beyond 3e38, the most that a file holds: give smaller numbers"
        );
        let back = moved.transformed(&similarity.inverse());
        let loss = LossReport::between(&self.cloud, &back, true);
        let mut note = format!(
            "moved and moved back, positions differ by at most {} m",
            shown(loss.position_m.max)
        );
        if let Some(colors) = loss.sh_rest {
            note += &format!(", spherical harmonics by at most {}", shown(colors.max));
        }
        self.notes.push(note);
        self.cloud = moved;
        Ok(())
    }
}
