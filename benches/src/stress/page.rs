//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use anyhow::Result;
use decouplegs::render::metrics::difference_image;

use super::fit::Line;
use super::report::{MemoryLines, Report, decibels, mebibytes};
use super::{charts, tables};
use crate::data_uri;
use crate::plot::{self, escaped};

/// Factor on differences in images of them.
const DIFFERENCE_GAIN: f32 = 8.0;
const THUMBNAIL_WIDTH_PX: u32 = 480;

const HOW_TO_READ: &str = include_str!("how_to_read.html");

/// The page.
pub fn page(report: &Report) -> Result<String> {
    let title = "Stress: frames, memory and error against agents";
    let mut html = plot::page_start(title);
    html.push_str(&summary(report));
    html.push_str(&conditions(report));
    html.push_str(&thumbnails(report)?);
    html.push_str("<h2>Scalability</h2><div class=\"row\">");
    html.push_str(&charts::images_against_agents(report));
    html.push_str(&charts::memory_against_agents(report));
    html.push_str("</div>");
    html.push_str(&memory_lines(&report.memory_lines()));
    html.push_str("<h2>Compression, by traffic density</h2>");
    html.push_str(&tables::compression(report));
    let largest = report.largest_count();
    let _ = write!(html, "<h2>With {largest} agents</h2><div class=\"row\">");
    html.push_str(&charts::stages(report));
    html.push_str(&charts::speed_against_error(report));
    html.push_str("</div><h2>Modes</h2>");
    html.push_str(&tables::modes(report));
    html.push_str("<h2>All figures</h2>");
    html.push_str(&tables::all_times(report));
    html.push_str(&tables::all_memory(report));
    html.push_str(&how_to_read(report));
    html.push_str("</html>\n");
    Ok(html)
}

/// Results of vanilla and decoupled with the most agents, one sentence each.
fn summary(report: &Report) -> String {
    let largest = report.largest_count();
    let mut html = String::new();
    for mode in [report.vanilla(), report.decoupled()].into_iter().flatten() {
        let Some(point) = report.points_of(mode).find(|point| point.agents == largest) else {
            continue;
        };
        let found = match point.measured() {
            None => tables::reason(&point.outcome),
            Some(measured) => {
                let error = measured.fidelity.map_or(String::new(), |fidelity| {
                    format!(
                        ", PSNR {} dB against vanilla",
                        decibels(fidelity.psnr_all_db)
                    )
                });
                format!(
                    "{:.1} images/s ({:.1} rig steps/s), {:.1} MiB of device memory{error}",
                    measured.images_per_s(),
                    measured.rig_steps_per_s(),
                    mebibytes(measured.memory.total_bytes)
                )
            }
        };
        let _ = write!(
            html,
            "<p><b>{}</b> with {largest} agents: {found}.</p>",
            escaped(&mode.name)
        );
    }
    html
}

fn conditions(report: &Report) -> String {
    let c = &report.conditions;
    let text = |value: &serde_json::Value| escaped(value.as_str().unwrap_or_default());
    let limit = c["memory_limit_bytes"]
        .as_u64()
        .map_or(String::new(), |bytes| {
            format!(
                " Modes that take more than {:.0} MiB are reported as out of memory.",
                mebibytes(bytes)
            )
        });
    format!(
        "<p class=\"dim\">{} ({}), DecoupleGS {}. {} splats of background, degree {}; {} assets; {} camera(s) of {}x{} px, \
         8 bits a channel; {} frames timed, {} s of the drive apart, after {} to warm up. {}{limit}</p>",
        text(&c["device"]),
        text(&c["driver"]),
        text(&c["version"]),
        c["background_splats"],
        c["sh_degree"],
        c["assets"].as_array().map_or(0, Vec::len),
        c["cameras"],
        c["width_px"],
        c["height_px"],
        c["frames"],
        c["step_s"],
        warm_up_text(c),
        escaped(&source_text(&c["source"])),
    )
}

fn warm_up_text(conditions: &serde_json::Value) -> String {
    let (frames, least_s) = (
        &conditions["warm_up"],
        conditions["warm_up_least_s"].as_f64().unwrap_or(0.0),
    );
    if least_s > 0.0 {
        format!("at least {frames} and {least_s} s")
    } else {
        frames.to_string()
    }
}

fn source_text(source: &serde_json::Value) -> String {
    let street = &source["synth"];
    match source["scene"].as_str() {
        Some(path) => format!("Scene {path}."),
        None => format!(
            "A street generated from seed {}, its {} cars of {} splats each before compression.",
            street["seed"], street["assets"], street["agent_splats"]
        ),
    }
}

fn thumbnails(report: &Report) -> Result<String> {
    let Some(shown) = &report.thumbnails else {
        return Ok(String::new());
    };
    let small = |image| data_uri::shrunk(image, THUMBNAIL_WIDTH_PX);
    let difference = difference_image(&shown.vanilla, &shown.decoupled, DIFFERENCE_GAIN)?;
    let mut html = format!(
        "<h2>What was drawn</h2><p class=\"dim\">The first camera at {:.2} s, with {} agents.</p><div class=\"row\">",
        shown.time_s, shown.agents
    );
    let images = [
        ("vanilla", &shown.vanilla),
        ("decoupled", &shown.decoupled),
        ("difference, times 8, false colors", &difference),
    ];
    for (what, image) in images {
        let address = data_uri::png(&small(image))?;
        let _ = write!(
            html,
            "<figure><img src=\"{address}\" alt=\"{what}\"><figcaption>{what}</figcaption></figure>"
        );
    }
    html.push_str("</div>");
    Ok(html)
}

fn memory_lines(lines: &MemoryLines) -> String {
    let mut html = String::from("<ul>");
    let mut item = |what: &str, line: Option<Line>, each: &str| {
        let text = line.map_or(
            "no line: fewer than two different counts were measured".to_owned(),
            |line| {
                format!(
                    "{:.1} KiB {each} (R² {:.4}), from {:.2} MiB",
                    line.slope / 1024.0,
                    line.r_squared,
                    line.offset / f64::from(1 << 20)
                )
            },
        );
        let _ = write!(html, "<li>{what}: {text}</li>");
    };
    item(
        "Decoupled, memory of purpose <i>assets</i>",
        lines.assets,
        "for each unique asset",
    );
    item(
        "Decoupled, memory of every other purpose",
        lines.rest,
        "for each agent",
    );
    item("Decoupled, all memory", lines.total, "for each agent");
    item("Vanilla, all memory", lines.vanilla_total, "for each agent");
    html.push_str(
        "</ul><p class=\"dim\">Straight lines by least squares through our own count of bytes. Memory of purpose <i>frame</i> \
         grows with what is in sight, in steps of a sixteenth; a low R² says that it is not a line.</p>",
    );
    html
}

fn how_to_read(report: &Report) -> String {
    let originals = if report.conditions["originals_known"] == true {
        "Vanilla's copies are the splats as they were before compression."
    } else {
        "Vanilla's copies of assets that came compressed are what these decode to: what compression itself costs is then \
         <b>not</b> in the errors."
    };
    format!(
        "<h2>How to read this, and what is not measured</h2><ul>{HOW_TO_READ}<li>{originals}</li></ul>"
    )
}
