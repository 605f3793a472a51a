//! `decouplegs compress`: splats of an agent as a small asset.

mod page;
mod report;

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use decouplegs_asset::{CodedAsset, Provenance, SplatFormat, read_bytes, read_splats, write_coded};
use decouplegs_scene::codebook::{COLORS_MAX, SHAPES_MAX};
use decouplegs_scene::{ShFrame, SplatCloud};
use decouplegs_train::compress::{
    CompressOptions, Compressed, Progress, Prune, THRESHOLD, compress,
};
use indicatif::ProgressBar;

use crate::arguments::print;
use crate::device::{DeviceArguments, check_validation};
use crate::outputs::Force;
use crate::visibility::VIEW_PX_MAX;
use crate::{progress, views, visibility};

/// Compress the splats of an agent: prune unimportant splats, and quantize shapes and colors by
/// codebooks
///
/// An agent is what moves through a scene, such as a car. Its splats are drawn from all around;
/// those that hardly show are dropped, and the shapes and colors of the others become entries of
/// two codebooks, so that a splat takes 12 bytes. The asset stands in a scene file where plain
/// splats may, `inspect` describes it and `decompress` turns it back into plain splats.
#[derive(clap::Args)]
pub struct Arguments {
    #[arg(help = format!(
        "Splats in the agent's own frame: meters, x forward, y left, z up ({})",
        SplatFormat::EXTENSIONS
    ))]
    file: PathBuf,
    /// Compressed asset to write (.safetensors)
    #[arg(long, value_name = "FILE", value_parser = asset_path)]
    out: PathBuf,
    /// Share of the most important splats to keep, above 0 and at most 1 (default: by --tau)
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true, conflicts_with = "tau", value_parser = keep_ratio)]
    keep: Option<f32>,
    /// Least importance to keep, 0 to 1; a value above 0 removes splats that no view shows
    #[arg(long, value_name = "SHARE", allow_negative_numbers = true, default_value_t = THRESHOLD, value_parser = importance)]
    tau: f32,
    /// Number of entries of the color codebook
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = COLORS_MAX as u64,
        value_parser = clap::value_parser!(u64).range(1..=COLORS_MAX as u64))]
    colors: u64,
    /// Number of entries of the shape codebook
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = SHAPES_MAX as u64,
        value_parser = clap::value_parser!(u64).range(1..=SHAPES_MAX as u64))]
    shapes: u64,
    /// Seed of all randomness: the same seed gives the same bytes
    #[arg(
        long,
        value_name = "SEED",
        allow_negative_numbers = true,
        default_value_t = 1
    )]
    seed: u64,
    /// Frame of colors that change with the viewing direction
    #[arg(long, value_name = "FRAME", value_enum, default_value_t = Frame::Canonical)]
    sh_frame: Frame,
    /// Number of views around the asset that measure the visibility of its splats
    #[arg(long, value_name = "N", allow_negative_numbers = true, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..=4096))]
    views: u32,
    /// Side of these views, pixels
    #[arg(long, value_name = "PIXELS", allow_negative_numbers = true, default_value_t = 256, value_parser = clap::value_parser!(u32).range(16..=VIEW_PX_MAX as i64))]
    view_size: u32,
    /// Measure the loss, with other settings too, and write report.html and report.json to this
    /// folder; takes minutes
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Distance of the report's street cameras, meters: ten is for cars
    #[arg(long, value_name = "METERS", allow_negative_numbers = true, default_value_t = 10.0, value_parser = distance)]
    report_distance: f64,
    /// Cameras of each kind in the report (default: 4 on the street, 2 close by, 7 all around)
    #[arg(long, value_name = "N", allow_negative_numbers = true, value_parser = clap::value_parser!(u32).range(1..=64))]
    report_views: Option<u32>,
    #[command(flatten)]
    force: Force,
    #[command(flatten)]
    device: DeviceArguments,
}

/// Frame of an asset's colors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Frame {
    /// Colors turn with the agent: captures of objects
    Canonical,
    /// Colors stay in the world's frame: trained in place, as HUGSIM and drivestudio export
    World,
}

fn asset_path(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    let fits = decouplegs_asset::coded_asset::has_extension(&path);
    if fits {
        Ok(path)
    } else {
        Err(format!(
            "expected a name that ends with .safetensors, found {text:?}"
        ))
    }
}

fn number_within(text: &str, what: &str, fits: impl Fn(f64) -> bool) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|&value| fits(value))
        .ok_or_else(|| format!("expected {what}, found {text:?}"))
}

fn keep_ratio(text: &str) -> Result<f32, String> {
    number_within(text, "a share above 0, at most 1", |value| {
        value > 0.0 && value <= 1.0
    })
    .map(|value| value as f32)
}

fn importance(text: &str) -> Result<f32, String> {
    number_within(text, "an importance from 0 to 1", |value| {
        (0.0..=1.0).contains(&value)
    })
    .map(|value| value as f32)
}

fn distance(text: &str) -> Result<f64, String> {
    number_within(text, "meters above 0", |value| value > 0.0 && value <= 1e6)
}

pub fn run(arguments: &Arguments) -> Result<()> {
    check_outputs(arguments)?;
    let source = read_bytes(&arguments.file)?;
    let cloud = read_splats(&arguments.file)?;
    let drawn: Vec<u32> = (0..cloud.len() as u32)
        .filter(|&splat| cloud.defect_of(splat as usize).is_none())
        .collect();
    ensure!(
        !drawn.is_empty(),
        "{} has no splat that can be drawn",
        arguments.file.display()
    );
    let gpu = arguments.device.open()?;
    // The box of what can be drawn: a mean that is NaN has no place in it.
    let cameras = views::sphere(
        &cloud.select(&drawn).bounds(),
        arguments.views as usize,
        arguments.view_size,
        0.0,
    );
    let visibility = visibility::visibility(&gpu, &cloud, &cameras)?;
    let options = options(arguments);
    let compressed = compressed_with_bar(&cloud, &visibility, &options)?;
    let asset = CodedAsset {
        cloud: compressed.cloud.clone(),
        provenance: provenance(arguments, &source, &options),
    };
    write_coded(&arguments.out, &asset)?;
    let stored_bytes = fs::metadata(&arguments.out)
        .with_context(|| format!("cannot read {}", arguments.out.display()))?
        .len();
    print(&summary(arguments, &compressed, stored_bytes))?;
    if let Some(folder) = &arguments.report {
        let subject = report::Subject {
            arguments,
            gpu: &gpu,
            cloud: &cloud,
            visibility: &visibility,
            options,
            stored_bytes,
        };
        report::write(&subject, &compressed, folder)?;
        print(&format!("{}\n", folder.join("report.html").display()))?;
    }
    check_validation(&gpu)
}

/// Refuses, before minutes of work, what could not be written after them.
fn check_outputs(arguments: &Arguments) -> Result<()> {
    let mut outputs = arguments.force.outputs(&[&arguments.file]);
    outputs.file(&arguments.out)?;
    match &arguments.report {
        Some(report) => outputs.folder(report),
        None => Ok(()),
    }
}

fn options(arguments: &Arguments) -> CompressOptions {
    CompressOptions {
        prune: arguments
            .keep
            .map_or(Prune::Threshold(arguments.tau), Prune::KeepRatio),
        colors: arguments.colors as usize,
        shapes: arguments.shapes as usize,
        seed: arguments.seed,
        sh_frame: match arguments.sh_frame {
            Frame::Canonical => ShFrame::Canonical,
            Frame::World => ShFrame::World,
        },
        ..CompressOptions::default()
    }
}

fn compressed_with_bar(
    cloud: &SplatCloud,
    visibility: &[f32],
    options: &CompressOptions,
) -> Result<Compressed> {
    let working = progress::spinner("pruning".into());
    let done = compress(cloud, visibility, options, &|progress| {
        show(&working, progress, options.iterations_max);
    });
    working.finish_and_clear();
    Ok(done?)
}

fn show(working: &ProgressBar, progress: Progress, iterations_max: usize) {
    working.set_message(match progress {
        Progress::Pruning => "pruning and merging".into(),
        Progress::Shapes(done) => format!("shapes: iteration {done} of at most {iterations_max}"),
        Progress::Colors(done) => format!("colors: iteration {done} of at most {iterations_max}"),
        Progress::Coding => "coding".into(),
    });
}

fn provenance(arguments: &Arguments, source: &[u8], options: &CompressOptions) -> Provenance {
    let name = arguments
        .file
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let mut provenance = Provenance::of_source(name, source);
    let prune = match options.prune {
        Prune::Threshold(least) => ("tau", least.to_string()),
        Prune::KeepRatio(ratio) => ("keep", ratio.to_string()),
    };
    let settings = [
        prune,
        ("colors", options.colors.to_string()),
        ("shapes", options.shapes.to_string()),
        ("seed", options.seed.to_string()),
        ("views", arguments.views.to_string()),
        ("view_size", arguments.view_size.to_string()),
    ];
    provenance.settings = settings.map(|(key, value)| (key.to_owned(), value)).into();
    provenance
}

fn summary(arguments: &Arguments, compressed: &Compressed, stored_bytes: u64) -> String {
    let Compressed { cloud, report, .. } = compressed;
    let levels: Vec<String> = cloud.levels.iter().map(ToString::to_string).collect();
    format!(
        "{}: {} of {} splats kept, levels of {} splats, {} shapes, {} colors\n{stored_bytes} bytes, {:.2} for each splat that came \
         in, {:.2} for each that was kept\n",
        arguments.out.display(),
        report.kept,
        report.splats,
        levels.join(", "),
        cloud.shapes.len(),
        cloud.color_count(),
        stored_bytes as f64 / report.splats as f64,
        stored_bytes as f64 / report.kept as f64
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nonsense_is_refused_with_what_was_found() {
        for nonsense in ["0", "1.01", "-1", "NaN", "all"] {
            assert!(keep_ratio(nonsense).unwrap_err().contains(nonsense));
        }
        assert!(importance("-0.1").is_err() && importance("0").is_ok());
        assert!(distance("inf").is_err() && distance("10").is_ok());
        assert!(
            asset_path("car.ply").unwrap_err().contains("car.ply")
                && asset_path("car.safetensors").is_ok()
        );
    }
}
