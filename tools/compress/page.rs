//! The report as one HTML page.

use anyhow::Result;
use decouplegs_render::metrics::difference_image;
use decouplegs_train::compress::{BookReport, Compressed};

use super::report::{Measured, Subject, Trial};
use crate::image_quality::{QualityMeter, Score};
use crate::page::{Figure, Page, Table, escaped};
use crate::plot::{Axis, Plot, Series};

/// Factor on differences in images of them.
const DIFFERENCE_GAIN: f32 = 8.0;

/// The page.
pub fn page(
    subject: &Subject<'_>,
    compressed: &Compressed,
    quality_meter: &mut QualityMeter,
    measured: &Measured,
) -> Result<String> {
    let mut page = Page::new(&format!("{} compressed", subject.arguments.file.display()));
    summary(&mut page, subject, compressed);
    let names: Vec<&str> = quality_meter.views.iter().map(|views| views.name).collect();
    page.heading("Against the original");
    page.list(quality_meter.views.iter().map(|views| {
        let (what, count) = (escaped(&views.what), views.cameras.len());
        format!("<b>{}</b>: {what}, {count} views", views.name)
    }));
    page.table(&trial_table(&names, std::slice::from_ref(&measured.asset)));
    images(&mut page, quality_meter, compressed)?;
    page.heading("Curves");
    page.row(curves(&names, compressed, measured));
    page.heading("Shares kept, not compressed otherwise");
    page.table(&trial_table(&names, &measured.pruned_only));
    page.heading("Shares kept");
    page.table(&trial_table(&names, &measured.kept));
    page.heading("Sizes of the codebooks");
    page.table(&trial_table(&names, &measured.books));
    page.heading("Spaces of the shape codebook");
    page.text("What a covariance is turned into before shapes are gathered around entries.");
    page.table(&trial_table(&names, &measured.spaces));
    page.heading("Levels of detail");
    page.text(
        "Each level against the finest, where so many pixels lie between its splats. The window is as large as the asset.",
    );
    page.table(&level_table(measured));
    Ok(page.finish())
}

fn summary(page: &mut Page, subject: &Subject<'_>, compressed: &Compressed) {
    let report = &compressed.report;
    page.html(&format!(
        "<p>{} of {} splats kept ({} cannot be drawn, {} are below 1/255). <b>{} bytes</b>: {:.2} for each splat that came in, {:.2} for \
         each kept. Measured on {}.</p>",
        report.kept,
        report.splats,
        report.defects,
        report.transparent,
        subject.stored_bytes,
        subject.stored_bytes as f64 / report.splats as f64,
        subject.stored_bytes as f64 / report.kept as f64,
        escaped(&subject.gpu.info().name)
    ));
    let levels = report.bytes.levels.iter().zip(&compressed.cloud.levels);
    let mut parts: Vec<(String, u64)> = levels
        .enumerate()
        .map(|(level, (&bytes, splats))| (format!("level {level}: {splats} splats"), bytes as u64))
        .collect();
    let colors = format!(
        "{} colors of degree {}",
        report.colors.entries, compressed.cloud.sh_degree
    );
    let stored = report.bytes.total() as u64;
    parts.extend([
        (
            format!("{} shapes", report.shapes.entries),
            report.bytes.shapes as u64,
        ),
        (colors, report.bytes.colors as u64),
        ("header".into(), subject.stored_bytes.saturating_sub(stored)),
    ]);
    let mut table = Table::new(["part", "bytes", "bytes per kept splat"]);
    for (name, bytes) in parts {
        let per_splat = format!("{:.3}", bytes as f64 / report.kept as f64);
        table.row([name, bytes.to_string(), per_splat]);
    }
    page.table(&table);
}

fn score_cells(score: &Score) -> [String; 2] {
    let psnr = if score.psnr_db.is_finite() {
        format!("{:.2} dB", score.psnr_db)
    } else {
        "equal".into()
    };
    [
        psnr,
        score.ssim.map_or("-".into(), |ssim| format!("{ssim:.4}")),
    ]
}

fn trial_table(names: &[&str], trials: &[Trial]) -> Table {
    let mut columns = vec![String::new(), "bytes per splat".to_owned()];
    columns.extend(
        names
            .iter()
            .flat_map(|name| [format!("PSNR {name}"), "SSIM".into()]),
    );
    let mut table = Table::new(columns);
    for trial in trials {
        let bytes = if trial.bytes_per_splat.is_finite() {
            format!("{:.2}", trial.bytes_per_splat)
        } else {
            "-".into()
        };
        let scores = trial.scores.iter().flat_map(score_cells);
        table.row([trial.name.clone(), bytes].into_iter().chain(scores));
    }
    table
}

fn level_table(measured: &Measured) -> Table {
    let mut table = Table::new([
        "level",
        "splats",
        "pitch, px",
        "distance, m",
        "PSNR",
        "SSIM",
    ]);
    for trial in &measured.levels {
        let cells = [
            trial.level.to_string(),
            trial.splats.to_string(),
            trial.pitch_px.to_string(),
            format!("{:.1}", trial.distance_m),
        ];
        table.row(cells.into_iter().chain(score_cells(&trial.score)));
    }
    table
}

fn curves(names: &[&str], compressed: &Compressed, measured: &Measured) -> [Figure; 4] {
    let by_view = |trials: &[Trial], suffix: &str, first_color: usize| -> Vec<Series> {
        let of = |(at, name): (usize, &&str)| {
            let points = trials
                .iter()
                .map(|trial| (trial.at, trial.scores[at].psnr_db))
                .collect();
            Series::curve(format!("{name}{suffix}"), first_color + at, points)
        };
        names.iter().enumerate().map(of).collect()
    };
    let mut kept = by_view(&measured.kept, "", 0);
    kept.extend(by_view(&measured.pruned_only, ", only pruned", names.len()));
    [
        Plot {
            title: "Share of the splats kept",
            x: Axis::linear("share"),
            y: Axis::linear("PSNR, dB"),
            series: kept,
        },
        Plot {
            title: "Sizes of the codebooks (half as many shapes)",
            x: Axis::linear("colors"),
            y: Axis::linear("PSNR, dB"),
            series: by_view(&measured.books, "", 0),
        },
        distortion("Distortion of shapes", &compressed.report.shapes),
        distortion("Distortion of colors", &compressed.report.colors),
    ]
    .map(|plot| Figure::svg(&plot.to_svg()))
}

fn distortion<'a>(title: &'a str, book: &BookReport) -> Plot<'a> {
    let numbered: Vec<(f64, f64)> = book
        .distortion
        .iter()
        .enumerate()
        .map(|(at, &value)| (at as f64, value))
        .collect();
    let (batches, all) = numbered.split_at(book.batches);
    Plot {
        title,
        x: Axis::from_zero("iteration"),
        y: Axis::logarithmic("mean squared distance"),
        series: vec![
            Series::curve("mini-batches", 0, batches.to_vec()),
            Series::curve("all splats", 1, all.to_vec()),
        ],
    }
}

/// The first image of each kind of view: before, after, and the difference.
fn images(
    page: &mut Page,
    quality_meter: &mut QualityMeter,
    compressed: &Compressed,
) -> Result<()> {
    let decoded = compressed.cloud.decoded(0);
    for at in 0..quality_meter.views.len() {
        let camera = quality_meter.views[at].cameras[..1].to_vec();
        let after = quality_meter.draw(&decoded, &camera)?;
        let before = &quality_meter.views[at].original[0];
        let difference = difference_image(before, &after[0], DIFFERENCE_GAIN)?;
        let name = quality_meter.views[at].name;
        page.row([
            Figure::image(&format!("{name}, before"), before)?,
            Figure::image(&format!("{name}, after"), &after[0])?,
            Figure::image(&format!("{name}, difference, times 8"), &difference)?,
        ]);
    }
    Ok(())
}
