//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use anyhow::Result;
use decouplegs::render::metrics::difference_picture;

use super::charts;
use super::fit::Line;
use super::report::{MemoryLines, Report, decibels, mebibytes};
use super::tables;
use crate::data_uri;
use crate::plot::{self, escaped};

/// What differences are multiplied by in pictures of them.
const DIFFERENCE_GAIN: f32 = 8.0;
const THUMBNAIL_WIDTH_PX: u32 = 480;

const STYLE: &str = "body{font:15px/1.55 system-ui,sans-serif;max-width:1340px;margin:2em auto;padding:0 1.2em;\
background:var(--ground);color:var(--ink)}h1{font-size:1.6em;margin-bottom:.2em}h2{margin-top:2em;font-size:1.2em}p,li{max-width:75em}\
.dim{color:var(--dim)}.wide{overflow-x:auto}table{border-collapse:collapse;margin:1em 0;\
font-variant-numeric:tabular-nums}td,th{padding:.25em .7em;border-bottom:1px solid var(--rule);text-align:right;white-space:nowrap}\
th{color:var(--dim);font-weight:600}td:first-child,th:first-child{text-align:left}td.text,th.text{text-align:left;white-space:normal}\
tr.ours td{font-weight:600}.row{display:flex;flex-wrap:wrap;gap:1.2em}figure{margin:0}figcaption{color:var(--dim)}figure img{max-width:100%}";

/// The page.
pub fn page(report: &Report) -> Result<String> {
    let title = "Stress: frames, memory and error against agents";
    let mut html = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>{title}</title><style>{}{STYLE}</style><h1>{title}</h1>",
        plot::STYLE
    );
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

/// What vanilla and decoupled come to with the most agents, as a sentence each.
fn summary(report: &Report) -> String {
    let largest = report.largest_count();
    let mut html = String::new();
    for mode in [report.vanilla(), report.decoupled()].into_iter().flatten() {
        let Some(point) = report.points_of(mode).find(|point| point.agents == largest) else { continue };
        let found = match point.measured() {
            None => tables::reason(&point.outcome),
            Some(measured) => {
                let error = measured
                    .fidelity
                    .map_or(String::new(), |fidelity| format!(", PSNR {} dB against vanilla", decibels(fidelity.psnr_all_db)));
                format!(
                    "{:.1} images/s ({:.1} rig steps/s), {:.1} MiB of device memory{error}",
                    measured.images_per_s(),
                    measured.rig_steps_per_s(),
                    mebibytes(measured.memory.total_bytes)
                )
            }
        };
        let _ = write!(html, "<p><b>{}</b> with {largest} agents: {found}.</p>", escaped(&mode.name));
    }
    html
}

fn conditions(report: &Report) -> String {
    let c = &report.conditions;
    let text = |value: &serde_json::Value| escaped(value.as_str().unwrap_or_default());
    let limit = c["memory_limit_bytes"].as_u64().map_or(String::new(), |bytes| {
        format!(" Modes that take more than {:.0} MiB are reported as out of memory.", mebibytes(bytes))
    });
    format!(
        "<p class=\"dim\">{} ({}), DecoupleGS {}. {} splats of background, degree {}; {} assets; {} camera(s) of {}x{} px, \
         8 bits a channel; {} frames timed after {} to warm up, {} s of the drive apart. {}{limit}</p>",
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
        c["warm_up"],
        c["step_s"],
        escaped(&source_text(&c["source"])),
    )
}

fn source_text(source: &serde_json::Value) -> String {
    let street = &source["synth"];
    match source["scene"].as_str() {
        Some(path) => format!("Scene {path}."),
        None => format!(
            "A street made up from seed {}, its {} cars of {} splats each before compression.",
            street["seed"], street["assets"], street["agent_splats"]
        ),
    }
}

fn thumbnails(report: &Report) -> Result<String> {
    let Some(shown) = &report.thumbnails else { return Ok(String::new()) };
    let small = |picture| data_uri::shrunk(picture, THUMBNAIL_WIDTH_PX);
    let difference = difference_picture(&shown.vanilla, &shown.decoupled, DIFFERENCE_GAIN)?;
    let mut html = format!(
        "<h2>What was drawn</h2><p class=\"dim\">The first camera at {:.2} s, with {} agents.</p><div class=\"row\">",
        shown.time_s, shown.agents
    );
    let pictures =
        [("vanilla", &shown.vanilla), ("decoupled", &shown.decoupled), ("difference, times 8, false colours", &difference)];
    for (what, picture) in pictures {
        let address = data_uri::png(&small(picture))?;
        let _ = write!(html, "<figure><img src=\"{address}\" alt=\"{what}\"><figcaption>{what}</figcaption></figure>");
    }
    html.push_str("</div>");
    Ok(html)
}

fn memory_lines(lines: &MemoryLines) -> String {
    let mut html = String::from("<ul>");
    let mut item = |what: &str, line: Option<Line>, each: &str| {
        let text = line.map_or("no line: fewer than two different counts were measured".to_owned(), |line| {
            format!(
                "{:.1} KiB {each} (R² {:.4}), from {:.2} MiB",
                line.slope / 1024.0,
                line.r_squared,
                line.offset / f64::from(1 << 20)
            )
        });
        let _ = write!(html, "<li>{what}: {text}</li>");
    };
    item("Decoupled, memory of purpose <i>assets</i>", lines.assets, "for each unique asset");
    item("Decoupled, memory of every other purpose", lines.rest, "for each agent");
    item("Decoupled, all memory", lines.total, "for each agent");
    item("Vanilla, all memory", lines.vanilla_total, "for each agent");
    html.push_str(
        "</ul><p class=\"dim\">Straight lines by least squares through our own count of bytes. Memory of purpose <i>frame</i> grows \
         with what is in sight, in steps of a sixteenth; a low R² says that it is not a line.</p>",
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
    let items = HOW_TO_READ.iter().chain(std::iter::once(&originals)).map(|item| format!("<li>{item}</li>"));
    format!("<h2>How to read this, and what is not measured</h2><ul>{}</ul>", items.collect::<String>())
}

const HOW_TO_READ: &[&str] = &[
    "Images/s and rig steps/s are timed frames by the wall clock that all of them took; a rig step draws all cameras once. A step is \
     the wall clock from the end of a frame to the end of the next; with two frames in flight, some devices end them in pairs. GPU \
     times are of the device's own clock. p99 is the value that 99 of 100 frames do not exceed: with fewer than 100 frames, the \
     slowest.",
    "<b>Vanilla is flattered.</b> Its agents are world-space copies that stand where they are in the middle of the drive while the \
     ego drives on. Moving them would mean to transform and upload every splat of every agent in every frame; that is <b>not</b> \
     charged to it, nor to prune.",
    "Errors are against vanilla's picture from the same cameras at the same moment, its copies standing where the agents are then, \
     in 32-bit float: PSNR of the mean squared error over all sampled pictures. PSNR-Veh counts the pixels where vanilla's \
     strongest splat belongs to an agent. They are not against photographs, as the paper's are, and LPIPS is not measured.",
    "Prune is what LightGaussian does first: one importance over the whole scene. Its training afterwards and its quantisation are \
     <b>not</b> done, so both its error and its memory are larger than in the paper. Importance is measured in views of all the \
     ego's cameras along all of its way: what is never seen from there is pruned without any error.",
    "Memory is our own count of all buffers after the last timed frame: scene, assets, frame, pictures, transfers. The driver's \
     figure, where it gives one, includes pipelines and unused parts of blocks. Uploads need more for a moment, which is not shown.",
    "Out of memory means more than <i>--memory-limit</i>, by prediction from the splats or by count, or a refusal of the device; the \
     table says which.",
    "Modes are measured one after the other. On a machine that does other work at the same time, differences of a few per cent say \
     nothing.",
    "Where a trajectory ends before the drive does, its agent stands at its end.",
];
