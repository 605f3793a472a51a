//! The report as one HTML page.

use anyhow::Result;
use decouplegs::render::metrics::difference_image;

use super::fit::Line;
use super::report::{MemoryLines, Report, decibels, mebibytes};
use super::{charts, tables};
use crate::page::{Figure, Page, escaped};
use crate::thumbnail::thumbnail;

/// Factor on differences in images of them.
const DIFFERENCE_GAIN: f32 = 8.0;
const THUMBNAIL_WIDTH_PX: u32 = 480;

const HOW_TO_READ: &str = include_str!("how_to_read.html");

/// The page.
pub fn page(report: &Report) -> Result<String> {
    let mut page = Page::new("Stress: frames, memory and error against agents");
    summary(&mut page, report);
    page.note(&conditions(report));
    thumbnails(&mut page, report)?;
    page.heading("Scalability");
    page.row([
        charts::images_against_agents(report),
        charts::memory_against_agents(report),
    ]);
    memory_lines(&mut page, &report.memory_lines());
    page.heading("Compression, by traffic density");
    tables::compression(&mut page, report);
    page.heading(&format!("With {} agents", report.largest_count()));
    page.row([charts::stages(report), charts::speed_against_error(report)]);
    page.heading("Modes");
    page.table(&tables::modes(report));
    page.heading("All figures");
    page.table(&tables::all_times(report));
    page.table(&tables::all_memory(report));
    page.heading("How to read this, and what is not measured");
    let originals = if report.conditions["originals_known"] == true {
        "Vanilla's copies are the splats as they were before compression."
    } else {
        "Vanilla's copies of assets that came compressed are what these decode to: what compression itself costs is then <b>not</b> in the \
         errors."
    };
    page.html(&format!("<ul>{HOW_TO_READ}<li>{originals}</li></ul>"));
    Ok(page.finish())
}

/// Results of vanilla and decoupled with the most agents, one sentence each.
fn summary(page: &mut Page, report: &Report) {
    let largest = report.largest_count();
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
        page.html(&format!(
            "<p><b>{}</b> with {largest} agents: {}.</p>",
            escaped(&mode.name),
            escaped(&found)
        ));
    }
}

fn conditions(report: &Report) -> String {
    let c = &report.conditions;
    let text = |value: &serde_json::Value| value.as_str().unwrap_or_default().to_owned();
    let limit = c["memory_limit_bytes"]
        .as_u64()
        .map_or(String::new(), |bytes| {
            format!(
                " Modes that take more than {:.0} MiB are reported as out of memory.",
                mebibytes(bytes)
            )
        });
    format!(
        "{} ({}), DecoupleGS {}. {} splats of background, degree {}; {} assets; {} camera(s) of {}x{} px, \
         8 bits per channel; {} frames timed, {} s of the drive apart, after {} to warm up. {}{limit}",
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
        source_text(&c["source"]),
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

fn thumbnails(page: &mut Page, report: &Report) -> Result<()> {
    let Some(shown) = &report.thumbnails else {
        return Ok(());
    };
    let difference = difference_image(&shown.vanilla, &shown.decoupled, DIFFERENCE_GAIN)?;
    page.heading("What was drawn");
    page.note(&format!(
        "The first camera at {:.2} s, with {} agents.",
        shown.time_s, shown.agents
    ));
    let small = |caption, image| Figure::image(caption, &thumbnail(image, THUMBNAIL_WIDTH_PX));
    page.row([
        small("vanilla", &shown.vanilla)?,
        small("decoupled", &shown.decoupled)?,
        small("difference, times 8, false colors", &difference)?,
    ]);
    Ok(())
}

fn memory_lines(page: &mut Page, lines: &MemoryLines) {
    let item = |what: &str, line: Option<Line>, each: &str| {
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
        format!("{what}: {text}")
    };
    let (asset, agent) = ("for each unique asset", "for each agent");
    page.list([
        item(
            "Decoupled, memory of purpose <i>assets</i>",
            lines.assets,
            asset,
        ),
        item(
            "Decoupled, memory of every other purpose",
            lines.rest,
            agent,
        ),
        item("Decoupled, all memory", lines.total, agent),
        item("Vanilla, all memory", lines.vanilla_total, agent),
    ]);
    page.note(
        "Straight lines by least squares through our own count of bytes. Memory of purpose 'frame' grows with what is in sight, in steps \
         of a sixteenth; a low R² says that it is not a line.",
    );
}
