//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use anyhow::Result;
use decouplegs::render::metrics::difference_image;
use decouplegs::train::compress::{BookReport, Compressed};

use super::report::{Measured, Subject, Trial};
use crate::data_uri;
use crate::image_quality::{QualityMeter, Score};
use crate::plot::{self, Axis, Plot, Series, Shape, escaped};

/// Factor on differences in images of them.
const DIFFERENCE_GAIN: f32 = 8.0;

/// The page.
pub fn page(
    subject: &Subject<'_>,
    compressed: &Compressed,
    quality_meter: &mut QualityMeter,
    measured: &Measured,
) -> Result<String> {
    let file = escaped(&subject.arguments.file.display().to_string());
    let mut html = plot::page_start(&format!("{file} compressed"));
    html.push_str(&summary(subject, compressed));
    let names: Vec<&str> = quality_meter.views.iter().map(|views| views.name).collect();
    html.push_str("<h2>Against the original</h2><ul>");
    for views in &quality_meter.views {
        let _ = write!(
            html,
            "<li><b>{}</b>: {}, {} views</li>",
            views.name,
            escaped(&views.what),
            views.cameras.len()
        );
    }
    html.push_str("</ul>");
    html.push_str(&trial_table(&names, std::slice::from_ref(&measured.asset)));
    html.push_str(&images(quality_meter, compressed)?);
    html.push_str(&curves(&names, compressed, measured));
    html.push_str("<h2>Shares kept, not compressed otherwise</h2>");
    html.push_str(&trial_table(&names, &measured.pruned_only));
    html.push_str("<h2>Shares kept</h2>");
    html.push_str(&trial_table(&names, &measured.kept));
    html.push_str("<h2>Sizes of the codebooks</h2>");
    html.push_str(&trial_table(&names, &measured.books));
    html.push_str(
        "<h2>Spaces of the shape codebook</h2><p>What a covariance is turned into before shapes are gathered around entries.</p>",
    );
    html.push_str(&trial_table(&names, &measured.spaces));
    html.push_str(&level_table(measured));
    html.push_str("</html>\n");
    Ok(html)
}

fn summary(subject: &Subject<'_>, compressed: &Compressed) -> String {
    let report = &compressed.report;
    let mut html = format!(
        "<p>{} of {} splats kept ({} cannot be drawn, {} are below 1/255). <b>{} bytes</b>: {:.2} for each splat that came in, {:.2} for \
         each kept. Measured on {}.</p><table><tr><th>part<th>bytes<th>bytes a kept splat</tr>",
        report.kept,
        report.splats,
        report.defects,
        report.transparent,
        subject.stored_bytes,
        subject.stored_bytes as f64 / report.splats as f64,
        subject.stored_bytes as f64 / report.kept as f64,
        escaped(&subject.gpu.info().name)
    );
    let mut row = |name: String, bytes: u64| {
        let _ = write!(
            html,
            "<tr><td>{name}<td>{bytes}<td>{:.3}</tr>",
            bytes as f64 / report.kept as f64
        );
    };
    for (level, &bytes) in report.bytes.levels.iter().enumerate() {
        row(
            format!("level {level}: {} splats", compressed.cloud.levels[level]),
            bytes as u64,
        );
    }
    row(
        format!("{} shapes", report.shapes.entries),
        report.bytes.shapes as u64,
    );
    row(
        format!(
            "{} colors of degree {}",
            report.colors.entries, compressed.cloud.sh_degree
        ),
        report.bytes.colors as u64,
    );
    row(
        "header".into(),
        subject
            .stored_bytes
            .saturating_sub(report.bytes.total() as u64),
    );
    html.push_str("</table>");
    html
}

fn score_cells(score: &Score) -> String {
    let psnr = if score.psnr_db.is_finite() {
        format!("{:.2} dB", score.psnr_db)
    } else {
        "equal".into()
    };
    format!(
        "<td>{psnr}<td>{}",
        score.ssim.map_or("-".into(), |ssim| format!("{ssim:.4}"))
    )
}

fn trial_table(names: &[&str], trials: &[Trial]) -> String {
    let mut html = String::from("<table><tr><th><th>bytes a splat");
    names.iter().for_each(|name| {
        let _ = write!(html, "<th>PSNR {name}<th>SSIM");
    });
    for trial in trials {
        let bytes = if trial.bytes_per_splat.is_finite() {
            format!("{:.2}", trial.bytes_per_splat)
        } else {
            "-".into()
        };
        let _ = write!(html, "<tr><td>{}<td>{bytes}", escaped(&trial.name));
        trial
            .scores
            .iter()
            .for_each(|score| html.push_str(&score_cells(score)));
    }
    html.push_str("</table>");
    html
}

fn level_table(measured: &Measured) -> String {
    let mut html = String::from(
        "<h2>Levels of detail</h2><p>Each level against the finest, where so many pixels lie between its splats; the window is as \
         large as the asset.</p><table><tr><th>level<th>splats<th>pitch, px<th>distance, m<th>PSNR<th>SSIM",
    );
    for trial in &measured.levels {
        let _ = write!(
            html,
            "<tr><td>{}<td>{}<td>{}<td>{:.1}{}",
            trial.level,
            trial.splats,
            trial.pitch_px,
            trial.distance_m,
            score_cells(&trial.score)
        );
    }
    html.push_str("</table>");
    html
}

fn curves(names: &[&str], compressed: &Compressed, measured: &Measured) -> String {
    let by_view = |trials: &[Trial], suffix: &str, first_color: usize| -> Vec<Series> {
        let of = |(at, name): (usize, &&str)| {
            let points = trials
                .iter()
                .map(|trial| (trial.at, trial.scores[at].psnr_db))
                .collect();
            curve(format!("{name}{suffix}"), first_color + at, points)
        };
        names.iter().enumerate().map(of).collect()
    };
    let mut kept = by_view(&measured.kept, "", 0);
    kept.extend(by_view(&measured.pruned_only, ", only pruned", names.len()));
    let linear = |label| Axis {
        label,
        ..Axis::default()
    };
    let plots = [
        Plot {
            title: "Share of the splats kept",
            x: linear("share"),
            y: linear("PSNR, dB"),
            series: kept,
        },
        Plot {
            title: "Sizes of the codebooks (half as many shapes)",
            x: linear("colors"),
            y: linear("PSNR, dB"),
            series: by_view(&measured.books, "", 0),
        },
        distortion("Distortion of shapes", &compressed.report.shapes),
        distortion("Distortion of colors", &compressed.report.colors),
    ];
    let svgs: String = plots
        .iter()
        .map(|plot| format!("<figure>{}</figure>", plot.to_svg()))
        .collect();
    format!("<h2>Curves</h2><div class=\"row\">{svgs}</div>")
}

fn curve(name: String, color: usize, points: Vec<(f64, f64)>) -> Series {
    Series {
        name,
        color,
        points,
        shape: Shape::Curve,
        end: None,
    }
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
        x: Axis {
            label: "iteration",
            from_zero: true,
            log: false,
        },
        y: Axis {
            label: "mean squared distance",
            log: true,
            from_zero: false,
        },
        series: vec![
            curve("mini-batches".into(), 0, batches.to_vec()),
            curve("all splats".into(), 1, all.to_vec()),
        ],
    }
}

/// The first image of each kind of view: before, after, and the difference.
fn images(quality_meter: &mut QualityMeter, compressed: &Compressed) -> Result<String> {
    let decoded = compressed.cloud.decoded(0);
    let mut html = String::new();
    for at in 0..quality_meter.views.len() {
        let camera = quality_meter.views[at].cameras[..1].to_vec();
        let after = quality_meter.draw(&decoded, &camera)?;
        let before = &quality_meter.views[at].original[0];
        let difference = difference_image(before, &after[0], DIFFERENCE_GAIN)?;
        html.push_str("<div class=\"row\">");
        for (what, image) in [
            ("before", before),
            ("after", &after[0]),
            ("difference, times 8", &difference),
        ] {
            let name = quality_meter.views[at].name;
            let _ = write!(
                html,
                "<figure><img class=\"pixels\" src=\"{}\" alt=\"{name} {what}\"><figcaption>{name}, {what}</figcaption></figure>",
                data_uri::png(image)?
            );
        }
        html.push_str("</div>");
    }
    Ok(html)
}
