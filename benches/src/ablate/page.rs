//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use anyhow::Result;

use super::charts;
use super::example_crops::{ANGLE_MAX_DEG, ExampleCrops};
use super::figures::{Report, arm_cells, decibels, percent, row_cells};
use super::reinsert::{Arm, Reinserted};
use super::system::{System, Without};
use crate::data_uri;
use crate::plot::{self, escaped};

const HOW_TO_READ: &str = include_str!("how_to_read.html");

/// The page.
pub fn page(report: &Report) -> Result<String> {
    let mut html = plot::page_start("Ablation: cars put back, and the system without its parts");
    html.push_str(&summary(report));
    html.push_str(&conditions(report));
    html.push_str("<h2>Cars put back where they truly stood</h2>");
    html.push_str(&arms());
    html.push_str(&charts::angles(report));
    for found in &report.reinsertions {
        html.push_str(&weather(found)?);
    }
    html.push_str(&system(&report.system));
    let _ = write!(
        html,
        "<h2>How to read this, and what it does not show</h2><ul>{HOW_TO_READ}</ul></html>"
    );
    html.push('\n');
    Ok(html)
}

/// Summaries of relighting and registration, one sentence each.
fn summary(report: &Report) -> String {
    let mut html = String::new();
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
        let _ = write!(
            html,
            "<li><b>{}</b>: relighting takes the PSNR over vehicles from {} dB to {} dB, and the angle between colors (p95) from \
             {:.1}° to {:.1}°.</li>",
            found.weather.name(),
            decibels(plain.vehicles.psnr_db),
            decibels(ours.vehicles.psnr_db),
            angles(plain),
            angles(ours)
        );
    }
    let row = |without| report.system.rows.iter().find(|row| row.without == without);
    if let (Some(full), Some(logged)) = (row(Without::Nothing), row(Without::Registration)) {
        let _ = write!(
            html,
            "<li>Registration takes the mean distance to the nearest centerline from {:.3} m to {:.3} m, and to the true place from \
             {:.3} m to {:.3} m.</li>",
            logged.placing.ade_lane_m,
            full.placing.ade_lane_m,
            logged.placing.ade_truth_m,
            full.placing.ade_truth_m
        );
    }
    format!("<ul>{html}</ul>")
}

fn conditions(report: &Report) -> String {
    let c = &report.conditions;
    let text = |value: &serde_json::Value| escaped(value.as_str().unwrap_or_default());
    format!(
        "<p class=\"dim\">{} ({}), DecoupleGS {}. Streets of {} splats generated from seed {}; {} cars that drive, {} distinct ones of \
         {} splats each; {} camera(s) of {}x{} px; images compared at {} moment(s), {} frames timed; light transfer {}.</p>",
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

fn arms() -> String {
    let mut html = String::from("<table><tr><th>arm<th class=\"text\">what it is</tr>");
    for arm in Arm::ALL {
        let _ = write!(
            html,
            "<tr><td>{}<td class=\"text\">{}</tr>",
            arm.name(),
            arm.what()
        );
    }
    html.push_str("</table>");
    html
}

fn weather(found: &Reinserted) -> Result<String> {
    let mut html = format!(
        "<h3>{}</h3><p class=\"dim\">{} pixels of vehicles, {} of them bright enough for a hue. The ground about vehicles is {} darker \
         in truth than without them. I_dom is {:.2} in the mean; the light comes from one side to {:.4}.{}</p>",
        found.weather.name(),
        found.arms[0].vehicles.pixels,
        found.arms[0].vehicles.bright,
        percent(found.truth_darkness),
        found.starkness,
        found.directionality,
        if found.unlit > 0 {
            format!(
                " {} cars stood where nothing tells of the light.",
                found.unlit
            )
        } else {
            String::new()
        }
    );
    html.push_str(
        "<div class=\"wide\"><table><tr><th>arm<th>PSNR,<br>vehicles, dB<th>PIE<br>max / p99 / p95 / mean<th>PAE, degrees<br>max / p99 / \
         p95 / mean<th>PSNR, ground<br>about, dB<th>ground<br>darker by</tr>",
    );
    for arm in &found.arms {
        let ours = if arm.arm == Arm::Ours {
            " class=\"ours\""
        } else {
            ""
        };
        let _ = write!(
            html,
            "<tr{ours}><td>{}<td>{}</tr>",
            arm.arm.name(),
            arm_cells(arm).join("<td>")
        );
    }
    html.push_str("</table></div>");
    html.push_str(&images(&found.example_crops)?);
    Ok(html)
}

fn images(example_crops: &ExampleCrops) -> Result<String> {
    let mut html = String::from("<div class=\"row\">");
    for (what, image) in &example_crops.images {
        // Shown at some 300 pixels: all of a large image would make the page megabytes.
        let address = data_uri::png(&data_uri::shrunk(image, 640))?;
        let _ = write!(
            html,
            "<figure><img class=\"pixels\" width=\"300\" src=\"{address}\" alt=\"{what}\"><figcaption>{what}</figcaption></figure>"
        );
    }
    let _ = write!(
        html,
        "</div><p class=\"dim\">Car {} in camera {} at {:.2} s. Angles from black (0°) to white ({ANGLE_MAX_DEG}° and more).</p>",
        example_crops.car,
        escaped(&example_crops.camera),
        example_crops.time_s
    );
    Ok(html)
}

fn system(system: &System) -> String {
    let mut html = format!(
        "<h2>The system without its parts</h2><p>In the street of the first weather, {}: {} splats of background, {} with all whole \
         cars. Tracks drift; the system registers them.</p><div class=\"wide\"><table><tr><th>row<th>images/s<th>rig<br>steps/s<th>step, ms<br>p50 / p99<th>ADE, m<br>to \
         truth (to lane)<th>PAE, degrees, at true<br>poses: max / p99 / p95<th>PAE, degrees, as<br>placed: max / p99 / p95<th>paper: FPS /<br>ADE, m / PAE, deg</tr>",
        system.weather.name(),
        system.splats[0],
        system.splats[1]
    );
    for row in &system.rows {
        let ours = if row.without == Without::Nothing {
            " class=\"ours\""
        } else {
            ""
        };
        let paper = row.without.paper().map_or("-".into(), |[fps, ade_m, pae]| {
            format!("{fps} / {ade_m} / {pae}")
        });
        let _ = write!(
            html,
            "<tr{ours}><td>{}<td>{}<td>{paper}</tr>",
            row.without.name(),
            row_cells(row).join("<td>")
        );
    }
    html.push_str(
        "</table></div><p class=\"dim\">The paper's figures (table 4) are of other scenes, on an RTX 4090, at a resolution it does not \
         state: they stand beside ours for the order of things, not to be compared.</p>",
    );
    html.push_str(&placing(system));
    html.push_str("<table><tr><th>row<th class=\"text\">what it is</tr>");
    for without in Without::ALL {
        let _ = write!(
            html,
            "<tr><td>{}<td class=\"text\">{}</tr>",
            without.name(),
            without.what()
        );
    }
    html.push_str("</table>");
    html
}

fn placing(system: &System) -> String {
    let mut html = String::from(
        "<h3>Where cars stand, and what they take</h3><div class=\"wide\"><table><tr><th>row<th>ADE to<br>truth, m<th>of it<br>across<th>and<br>along\
         <th>ADE to nearest<br>centerline, m<th>corners in<br>the ground<th>clearance<br>p95, cm<th>tracks<br>refused<th>device memory,<br>MiB</tr>",
    );
    for row in &system.rows {
        let p = &row.placing;
        let _ = write!(
            html,
            "<tr><td>{}<td>{:.3}<td>{:.3}<td>{:.3}<td>{:.3}<td>{}<td>{:.2}<td>{} of {}<td>{:.1}</tr>",
            row.without.name(),
            p.ade_truth_m,
            p.across_m,
            p.along_m,
            p.ade_lane_m,
            percent(Some(p.penetration_rate)),
            100.0 * p.clearance_p95_m,
            p.refused,
            p.tracks,
            row.speed.memory.total_bytes as f64 / f64::from(1 << 20)
        );
    }
    html.push_str("</table></div>");
    html
}
