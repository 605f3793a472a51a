//! Loss of a compression, measured in images.

use std::fs;
use std::io::Write;
use std::path::Path;

use anyhow::{Context, Result};
use decouplegs_asset::write_atomically;
use decouplegs_gpu::Gpu;
use decouplegs_scene::{CodedCloud, SplatCloud};
use decouplegs_train::compress::{
    CompressOptions, Compressed, Prune, ShapeSpace, compress, importance, prune,
};
use indicatif::ProgressBar;
use serde_json::{Value, json};

use super::{Arguments, page, views};
use crate::image_quality::{QualityMeter, Score};
use crate::progress;
use crate::views::{STREET_FOCAL_PX, WINDOW_PX};

/// Shares of the splats that the curve is measured at.
const KEEP_RATIOS: [f32; 6] = [1.0, 0.9, 0.75, 0.6, 0.45, 0.3];

/// Codebooks that the curve is measured at: colors and shapes.
const BOOK_SIZES: [(usize, usize); 4] = [(64, 32), (256, 128), (512, 256), (1024, 512)];

/// Distances at which a level of detail is compared with the finest: where this many pixels lie
/// between its splats.
const PITCHES_PX: [f64; 4] = [0.5, 0.7, 1.0, 1.4];

/// Cameras of each kind, where the command line does not say.
const STREET_VIEWS: usize = 4;
const CLOSE_VIEWS: usize = 2;
const AROUND_VIEWS: usize = 7;

/// Side of the images from all around, pixels.
const AROUND_PX: u32 = 200;

/// Turns the cameras of the report away from those that visibility was measured with, radians.
const HELD_OUT_TURN_RAD: f64 = 1.1;

/// Subject of the measurement.
pub struct Subject<'a> {
    pub arguments: &'a Arguments,
    pub gpu: &'a Gpu,
    pub cloud: &'a SplatCloud,
    pub visibility: &'a [f32],
    pub options: CompressOptions,
    pub stored_bytes: u64,
}

/// One compression and its scores, in the order of the quality_meter's views.
pub struct Trial {
    pub name: String,
    /// The share kept, or the number of colors.
    pub at: f64,
    pub bytes_per_splat: f64,
    pub scores: Vec<Score>,
}

/// A level of detail at a distance.
pub struct LevelTrial {
    pub level: usize,
    pub splats: usize,
    pub pitch_px: f64,
    pub distance_m: f64,
    pub score: Score,
}

/// Data of the page.
pub struct Measured {
    pub asset: Trial,
    pub pruned_only: Vec<Trial>,
    pub kept: Vec<Trial>,
    pub books: Vec<Trial>,
    pub spaces: Vec<Trial>,
    pub levels: Vec<LevelTrial>,
}

/// Measures, and writes `report.html` and `report.json` to `folder`.
pub fn write(subject: &Subject<'_>, compressed: &Compressed, folder: &Path) -> Result<()> {
    fs::create_dir_all(folder).with_context(|| format!("{} cannot be made", folder.display()))?;
    let mut quality_meter = quality_meter(subject)?;
    let trials = KEEP_RATIOS.len() + BOOK_SIZES.len() + ShapeSpace::ALL.len();
    let bar = progress::bar("compressions", trials);
    let measured = Measured {
        asset: trial(&mut quality_meter, "the asset".into(), 0.0, compressed)?,
        pruned_only: pruned_only(subject, &mut quality_meter)?,
        kept: kept(subject, &mut quality_meter, &bar)?,
        books: books(subject, &mut quality_meter, &bar)?,
        spaces: spaces(subject, &mut quality_meter, &bar)?,
        levels: levels(subject, &mut quality_meter, &compressed.cloud)?,
    };
    bar.finish_and_clear();
    let figures = figures(subject, compressed, &quality_meter, &measured);
    write_atomically(&folder.join("report.json"), |file| {
        writeln!(file, "{figures:#}")
    })?;
    let page = page::page(subject, compressed, &mut quality_meter, &measured)?;
    write_atomically(&folder.join("report.html"), |file| {
        file.write_all(page.as_bytes())
    })?;
    Ok(())
}

fn quality_meter(subject: &Subject<'_>) -> Result<QualityMeter> {
    let drawn: Vec<u32> = (0..subject.cloud.len() as u32)
        .filter(|&at| subject.cloud.defect_of(at as usize).is_none())
        .collect();
    let bounds = subject.cloud.select(&drawn).bounds();
    let distance_m = subject.arguments.report_distance;
    let [width_px, height_px] = WINDOW_PX;
    let street = |distance_m: f64| {
        format!(
            "window of {width_px}x{height_px} px of a 1600x900 camera (focal length {STREET_FOCAL_PX} px) at {distance_m} m"
        )
    };
    let close_m = 0.4 * distance_m;
    let views_of = |by_default: usize| {
        subject
            .arguments
            .report_views
            .map_or(by_default, |views| views as usize)
    };
    let around = views_of(AROUND_VIEWS);
    let cameras = vec![
        (
            "street",
            street(distance_m),
            views::street(
                &bounds,
                views_of(STREET_VIEWS),
                distance_m,
                STREET_FOCAL_PX,
                WINDOW_PX,
            ),
        ),
        (
            "close",
            street(close_m),
            views::street(
                &bounds,
                views_of(CLOSE_VIEWS),
                close_m,
                STREET_FOCAL_PX,
                WINDOW_PX,
            ),
        ),
        (
            "around",
            format!("all of it from {around} held-out directions on a sphere, {AROUND_PX} px"),
            views::sphere(&bounds, around, AROUND_PX, HELD_OUT_TURN_RAD),
        ),
    ];
    QualityMeter::new(subject.gpu, subject.cloud, cameras)
}

fn trial(
    quality_meter: &mut QualityMeter,
    name: String,
    at: f64,
    compressed: &Compressed,
) -> Result<Trial> {
    let scores = quality_meter.score(&compressed.cloud.decoded(0))?;
    Ok(Trial {
        name,
        at,
        bytes_per_splat: compressed.report.bytes_per_splat(),
        scores,
    })
}

/// Compresses otherwise, and scores what comes of it.
fn other(
    subject: &Subject<'_>,
    quality_meter: &mut QualityMeter,
    bar: &ProgressBar,
    named: (String, f64),
    options: CompressOptions,
) -> Result<Trial> {
    let compressed = compress(subject.cloud, subject.visibility, &options, &|_| ())?;
    bar.inc(1);
    trial(quality_meter, named.0, named.1, &compressed)
}

/// Splats dropped, and nothing else done to them.
fn pruned_only(subject: &Subject<'_>, quality_meter: &mut QualityMeter) -> Result<Vec<Trial>> {
    let importance = importance(subject.cloud, subject.visibility);
    let pruned = KEEP_RATIOS.iter().map(|&ratio| {
        let kept = prune(subject.cloud, &importance, Prune::KeepRatio(ratio)).splats;
        let scores = quality_meter.score(&subject.cloud.select(&kept))?;
        Ok(Trial {
            name: format!("keep {ratio}"),
            at: ratio.into(),
            bytes_per_splat: f64::NAN,
            scores,
        })
    });
    pruned.collect()
}

fn kept(
    subject: &Subject<'_>,
    quality_meter: &mut QualityMeter,
    bar: &ProgressBar,
) -> Result<Vec<Trial>> {
    let trials = KEEP_RATIOS.iter().map(|&ratio| {
        let options = CompressOptions {
            prune: Prune::KeepRatio(ratio),
            ..subject.options
        };
        other(
            subject,
            quality_meter,
            bar,
            (format!("keep {ratio}"), ratio.into()),
            options,
        )
    });
    trials.collect()
}

fn books(
    subject: &Subject<'_>,
    quality_meter: &mut QualityMeter,
    bar: &ProgressBar,
) -> Result<Vec<Trial>> {
    let trials = BOOK_SIZES.iter().map(|&(colors, shapes)| {
        let options = CompressOptions {
            colors,
            shapes,
            ..subject.options
        };
        other(
            subject,
            quality_meter,
            bar,
            (format!("{colors} colors, {shapes} shapes"), colors as f64),
            options,
        )
    });
    trials.collect()
}

fn spaces(
    subject: &Subject<'_>,
    quality_meter: &mut QualityMeter,
    bar: &ProgressBar,
) -> Result<Vec<Trial>> {
    let trials = ShapeSpace::ALL.iter().map(|&shape_space| {
        let options = CompressOptions {
            shape_space,
            ..subject.options
        };
        other(
            subject,
            quality_meter,
            bar,
            (format!("{shape_space:?}"), 0.0),
            options,
        )
    });
    trials.collect()
}

/// Each coarser level against the finest, where [`PITCHES_PX`] lie between its splats: the root of
/// the share of its box's surface that each has.
fn levels(
    subject: &Subject<'_>,
    quality_meter: &mut QualityMeter,
    cloud: &CodedCloud,
) -> Result<Vec<LevelTrial>> {
    let finest = cloud.decoded(0);
    let [length, width, height] = cloud.dims_m.map(f64::from);
    let surface_m2 = 2.0 * (length * width + length * height + width * height);
    let views = subject
        .arguments
        .report_views
        .map_or(STREET_VIEWS, |views| views as usize);
    let mut trials = Vec::new();
    for level in 1..cloud.levels.len() {
        let decoded = cloud.decoded(level);
        let pitch_m = (surface_m2 / decoded.len() as f64).sqrt();
        for pitch_px in PITCHES_PX {
            let distance_m = pitch_m * STREET_FOCAL_PX / pitch_px;
            // As large as the asset: pixels of sky would flatter it.
            let size_px = |size_m: f64| {
                ((size_m / distance_m * STREET_FOCAL_PX).ceil() as u32).clamp(16, 400)
            };
            let window = [size_px(length.max(width)), size_px(height)];
            let cameras =
                views::street(&finest.bounds(), views, distance_m, STREET_FOCAL_PX, window);
            let score = quality_meter.compare(&decoded, &finest, &cameras)?;
            trials.push(LevelTrial {
                level,
                splats: decoded.len(),
                pitch_px,
                distance_m,
                score,
            });
        }
    }
    Ok(trials)
}

/// The same figures for programs.
fn figures(
    subject: &Subject<'_>,
    compressed: &Compressed,
    quality_meter: &QualityMeter,
    measured: &Measured,
) -> Value {
    let trial_json = |trial: &Trial| {
        let scores = quality_meter
            .views
            .iter()
            .zip(&trial.scores)
            .map(|(views, score)| (views.name.to_owned(), score.to_json()));
        json!({
            "name": trial.name,
            "at": trial.at,
            "bytes_per_splat": trial.bytes_per_splat.is_finite().then_some(trial.bytes_per_splat),
            "scores": scores.collect::<serde_json::Map<_, _>>(),
        })
    };
    let all = |trials: &[Trial]| trials.iter().map(trial_json).collect::<Vec<_>>();
    let level_json = |trial: &LevelTrial| {
        json!({
            "level": trial.level,
            "splats": trial.splats,
            "pitch_px": trial.pitch_px,
            "distance_m": trial.distance_m,
            "score": trial.score.to_json(),
        })
    };
    json!({
        "version": env!("CARGO_PKG_VERSION"),
        "device": subject.gpu.info().name,
        "file": subject.arguments.file.display().to_string(),
        "views": quality_meter.views.iter().map(|views| json!({ "name": views.name, "what": views.what })).collect::<Vec<_>>(),
        "stored_bytes": subject.stored_bytes,
        "stored_bytes_per_splat": subject.stored_bytes as f64 / compressed.report.splats as f64,
        "stored_bytes_per_kept_splat": subject.stored_bytes as f64 / compressed.report.kept as f64,
        "compression": compressed.report,
        "asset": trial_json(&measured.asset),
        "pruned_only": all(&measured.pruned_only),
        "keep_ratios": all(&measured.kept),
        "codebooks": all(&measured.books),
        "shape_spaces": all(&measured.spaces),
        "levels": measured.levels.iter().map(level_json).collect::<Vec<_>>(),
    })
}
