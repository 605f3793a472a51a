//! The report as one HTML page.

use anyhow::Result;

use super::charts;
use super::example_crops::{ANGLE_MAX_DEG, ExampleCrops};
use super::figures::{Report, arm_cells, decibels, percent, row_cells};
use super::reinsert::{Arm, Reinserted};
use super::system::{System, Without};
use crate::page::{Figure, Page, Table};
use crate::thumbnail::thumbnail;

const HOW_TO_READ: &str = include_str!("how_to_read.html");
const CROP_WIDTH_PX: u32 = 320;

/// The page.
pub fn page(report: &Report) -> Result<String> {
    let mut page = Page::new("Ablation: cars put back, and the system without its parts");
    page.list(summary(report));
    page.note(&conditions(report));
    page.heading("Cars put back where they truly stood");
    page.table(&meanings(
        "arm",
        Arm::ALL.iter().map(|arm| [arm.name(), arm.what()]),
    ));
    page.row([charts::angles(report)]);
    for found in &report.reinsertions {
        weather(&mut page, found)?;
    }
    system(&mut page, &report.system);
    page.heading("How to read this, and what it does not show");
    page.html(&format!("<ul>{HOW_TO_READ}</ul>"));
    Ok(page.finish())
}

/// A table of names and what they mean.
fn meanings(of: &str, rows: impl Iterator<Item = [&'static str; 2]>) -> Table {
    let mut table = Table::new([of, "what it is"]).with_text_in(1);
    rows.for_each(|row| table.row(row));
    table
}

/// Summaries of relighting and registration as HTML, one sentence each.
fn summary(report: &Report) -> Vec<String> {
    let mut sentences = Vec::new();
    for found in &report.reinsertions {
        let of = |arm| found.arms.iter().find(|figures| figures.arm == arm);
        let (Some(plain), Some(ours)) = (of(Arm::NoRelighting), of(Arm::Ours)) else {
            continue;
        };
        let angles = |figures: &super::reinsert::ArmFigures| {
            figures
                .vehicles
                .angle_deg
                .map_or(f64::NAN, |angle| angle.p95)
        };
        sentences.push(format!(
            "<b>{}</b>: relighting takes the PSNR over vehicles from {} dB to {} dB, and the angle between colors (p95) from \
             {:.1}° to {:.1}°.",
            found.weather.name(),
            decibels(plain.vehicles.psnr_db),
            decibels(ours.vehicles.psnr_db),
            angles(plain),
            angles(ours)
        ));
    }
    let row = |without| report.system.rows.iter().find(|row| row.without == without);
    if let (Some(full), Some(logged)) = (row(Without::Nothing), row(Without::Registration)) {
        sentences.push(format!(
            "Registration takes the mean distance to the nearest centerline from {:.3} m to {:.3} m, and to the true position from \
             {:.3} m to {:.3} m.",
            logged.placing.ade_lane_m,
            full.placing.ade_lane_m,
            logged.placing.ade_truth_m,
            full.placing.ade_truth_m
        ));
    }
    sentences
}

fn conditions(report: &Report) -> String {
    let c = &report.conditions;
    let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
    format!(
        "{} ({}), DecoupleGS {}. Streets of {} splats generated from seed {}; {} cars that drive, {} distinct ones of \
         {} splats each; {} camera(s) of {}x{} px; images compared at {} moment(s), {} frames timed; light transfer {}.",
        text(&c["device"]),
        text(&c["driver"]),
        text(&c["version"]),
        c["background_splats"],
        c["seed"],
        c["agents"],
        c["assets"],
        c["agent_splats"],
        c["cameras"],
        c["width_px"],
        c["height_px"],
        c["moments"],
        c["frames"],
        text(&c["light"]),
    )
}

fn weather(page: &mut Page, found: &Reinserted) -> Result<()> {
    page.subheading(found.weather.name());
    let unlit = match found.unlit {
        0 => String::new(),
        count => format!(" {count} cars stood where nothing tells of the light."),
    };
    page.note(&format!(
        "{} pixels of vehicles, {} of them bright enough for a hue. The ground about vehicles is {} darker in truth than without them. \
         I_dom is {:.2} in the mean; the light comes from one side to {:.4}.{unlit}",
        found.arms[0].vehicles.pixels,
        found.arms[0].vehicles.bright,
        percent(found.truth_darkness),
        found.starkness,
        found.directionality,
    ));
    let mut table = Table::new([
        "arm",
        "PSNR, vehicles, dB",
        "PIE, max / p99 / p95 / mean",
        "PAE, degrees, max / p99 / p95 / mean",
        "PSNR, ground about, dB",
        "ground darker by",
    ]);
    for arm in &found.arms {
        let cells = std::iter::once(arm.arm.name().to_owned()).chain(arm_cells(arm));
        table.row_that_stands_out(arm.arm == Arm::Ours, cells);
    }
    page.table(&table);
    images(page, &found.example_crops)
}

fn images(page: &mut Page, example_crops: &ExampleCrops) -> Result<()> {
    if example_crops.images.is_empty() {
        return Ok(());
    }
    // All of a large image would make the page megabytes.
    let figures = example_crops
        .images
        .iter()
        .map(|(what, image)| Figure::image(what, &thumbnail(image, CROP_WIDTH_PX)));
    page.row(figures.collect::<Result<Vec<_>>>()?);
    page.note(&format!(
        "Car {} in camera {} at {:.2} s. Angles from black (0°) to white ({ANGLE_MAX_DEG}° and more).",
        example_crops.car, example_crops.camera, example_crops.time_s
    ));
    Ok(())
}

fn system(page: &mut Page, system: &System) {
    page.heading("The system without its parts");
    page.text(&format!(
        "In the street of the first weather, {}: {} splats of background, {} with all whole cars. Tracks drift; the system registers \
         them.",
        system.weather.name(),
        system.splats[0],
        system.splats[1]
    ));
    let mut table = Table::new([
        "row",
        "images/s",
        "step, ms, p50 / p99",
        "ADE, m, to truth (to lane)",
        "PAE at true poses, degrees, max / p95",
        "PAE as placed, degrees, max / p95",
        "paper: FPS / ADE, m / PAE, degrees",
    ]);
    for row in &system.rows {
        let paper = row.without.paper().map_or("-".into(), |[fps, ade_m, pae]| {
            format!("{fps} / {ade_m} / {pae}")
        });
        let mut cells = vec![row.without.name().to_owned()];
        cells.extend(row_cells(row));
        cells.push(paper);
        table.row_that_stands_out(row.without == Without::Nothing, cells);
    }
    page.table(&table);
    page.note(
        "The paper's figures (table 4) are of other scenes, on an RTX 4090, at a resolution it does not state: they stand beside ours for \
         the order of things, not to be compared.",
    );
    page.subheading("Where cars stand, and what they take");
    page.table(&placing(system));
    page.table(&meanings(
        "row",
        Without::ALL.iter().map(|row| [row.name(), row.what()]),
    ));
}

fn placing(system: &System) -> Table {
    let mut table = Table::new([
        "row",
        "ADE to truth, m",
        "of it across",
        "and along",
        "ADE to nearest centerline, m",
        "corners in the ground",
        "clearance p95, cm",
        "tracks refused",
        "device memory, MiB",
    ]);
    for row in &system.rows {
        let p = &row.placing;
        let mebibytes = row.speed.memory.total_bytes as f64 / f64::from(1 << 20);
        table.row([
            row.without.name().to_owned(),
            format!("{:.3}", p.ade_truth_m),
            format!("{:.3}", p.across_m),
            format!("{:.3}", p.along_m),
            format!("{:.3}", p.ade_lane_m),
            percent(Some(p.penetration_rate)),
            format!("{:.2}", 100.0 * p.clearance_p95_m),
            format!("{} of {}", p.refused, p.tracks),
            format!("{mebibytes:.1}"),
        ]);
    }
    table
}
