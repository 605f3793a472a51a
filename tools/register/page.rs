//! The report as one HTML page that needs nothing beside it.

use std::fmt::Write;

use decouplegs::drive::alignment::histogram;
use decouplegs::drive::{Outcome, Registration};
use decouplegs::scene::{LaneMap, Track};

use super::Arguments;
use super::measure::{Measured, MeasuredTrack};
use super::table::{cells, columns, totals};
use crate::lane_drawing::{Way, drawing};
use crate::plot::{self, Axis, Plot, Series, Shape, escaped, number};

/// Tracks that are drawn; a page of hundreds would not be read.
const DRAWN_MAX: usize = 24;
/// The histogram's reach to either side, meters, and its bars.
const REACH_M: f64 = 0.1;
const BINS: usize = 41;
const BEFORE: usize = 1;
const AFTER: usize = 0;
const TRUTH: usize = 2;

/// Subject of the page.
pub struct Subject<'a> {
    pub arguments: &'a Arguments,
    pub map: &'a LaneMap,
    pub tracks: &'a [Track],
    pub truth: Option<&'a [Track]>,
    pub registration: &'a Registration,
}

/// The page.
pub fn page(subject: &Subject<'_>, measured: &Measured) -> String {
    let arguments = subject.arguments;
    let name = arguments
        .tracks
        .file_name()
        .unwrap_or_default()
        .to_string_lossy();
    let mut html = plot::page_start(&format!("{} registered", escaped(&name)));
    let _ = write!(
        html,
        "<p>To the lanes of {}",
        escaped(&arguments.map.display().to_string())
    );
    match &arguments.scene {
        Some(scene) => {
            let _ = write!(
                html,
                ", on the ground of {}.</p>",
                escaped(&scene.display().to_string())
            );
        }
        None => html.push_str(", at the heights of the map: no scene was given.</p>"),
    }
    html.push_str("<ul>");
    totals(measured).iter().for_each(|line| {
        let _ = write!(html, "<li>{}</li>", escaped(line));
    });
    html.push_str("</ul>");
    html.push_str(&clearance_part(arguments, measured));
    html.push_str(&table(measured));
    html.push_str(&drawings(subject, measured));
    html.push_str("</html>\n");
    html
}

fn table(measured: &Measured) -> String {
    let mut html = String::from("<h2>Tracks</h2><div class=\"wide\"><table><tr>");
    for column in columns(measured) {
        let _ = write!(html, "<th>{column}");
    }
    for track in &measured.tracks {
        html.push_str("<tr>");
        for (at, cell) in cells(measured, track).iter().enumerate() {
            let class = if at + 1 == columns(measured).len() {
                " class=\"text\""
            } else {
                ""
            };
            let _ = write!(html, "<td{class}>{}", escaped(cell));
        }
    }
    html.push_str(
        "</table></div><p class=\"dim\">Shift (x y) and yaw (from x to y) are the one motion of the track, about its middle. 'known to' is one \
         standard deviation of that, across the lane and along it: near 1 m, which is what is assumed of drift before, the lanes do \
         not show it and the place along the lane is as logged. ADE is the mean distance, as logged -&gt; registered: to the nearest \
         centerline (lane changes left out) and to the truth, whose parts across and along the lane follow. GPR and p95, the distance from \
         the ground that 95 % of corners keep within, are as in Clearance. Notes count poses: no-support had no ground below and stands at \
         the height of the map; no-height had neither ground nor map nor log to tell its height, and stands at 0; uneven stands on \
         something; parked travels too little to follow lanes; lane-unsure fits several lanes about as well.</p>",
    );
    html
}

fn clearance_part(arguments: &Arguments, measured: &Measured) -> String {
    let clearances_m = measured.clearances_m();
    if clearances_m.is_empty() {
        return String::new();
    }
    let against = match (&arguments.ground_truth, &arguments.scene) {
        (Some(truth), _) => format!("Judged against the independent ground of {}.", escaped(&truth.display().to_string())),
        _ => "Judged against the same ground that the boxes were set on, the background's own splats: it shows how well four wheels fit it, not \
              whether it is right. --ground-truth names an independent one."
            .into(),
    };
    format!(
        "<h2>Clearance</h2><p>{against} Each bottom corner of each pose; negative is below the ground, positive floats. Corners farther \
         than {} cm are in the outer bars.</p><figure>{}</figure>",
        number(100.0 * REACH_M),
        clearance_svg(&clearances_m, measured.tolerance_m)
    )
}

/// Bars by clearance, those below the tolerance in another color.
fn clearance_svg(clearances_m: &[f64], tolerance_m: f64) -> String {
    const WIDTH: f64 = 640.0;
    const HEIGHT: f64 = 260.0;
    const LEFT: f64 = 70.0;
    const RIGHT: f64 = 610.0;
    const TOP: f64 = 34.0;
    const BOTTOM: f64 = 206.0;
    let counts = histogram(clearances_m, REACH_M, BINS);
    let largest = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let x = |value_m: f64| LEFT + (value_m / REACH_M + 1.0) * 0.5 * (RIGHT - LEFT);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\" aria-label=\"clearances\">\
         <text x=\"{LEFT}\" y=\"20\" class=\"title\">Corners by clearance</text>"
    );
    for (at, &count) in counts.iter().enumerate() {
        let low_m = REACH_M * (2.0 * at as f64 / BINS as f64 - 1.0);
        let high_m = REACH_M * (2.0 * (at + 1) as f64 / BINS as f64 - 1.0);
        let height = (BOTTOM - TOP) * count as f64 / largest;
        let color = if high_m <= -tolerance_m {
            BEFORE
        } else {
            AFTER
        };
        let _ = write!(
            svg,
            "<rect x=\"{:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{height:.1}\" style=\"fill:var(--c{color})\"><title>{count} from {:.1} \
             to {:.1} cm</title></rect>",
            x(low_m),
            BOTTOM - height,
            x(high_m) - x(low_m) - 1.0,
            100.0 * low_m,
            100.0 * high_m
        );
    }
    for step in -5..=5 {
        let value_m = REACH_M * f64::from(step) / 5.0;
        let _ = write!(
            svg,
            "<text x=\"{:.1}\" y=\"{}\" class=\"middle\">{}</text>",
            x(value_m),
            BOTTOM + 18.0,
            number(100.0 * value_m)
        );
    }
    let _ = write!(
        svg,
        "<line x1=\"{LEFT}\" x2=\"{RIGHT}\" y1=\"{BOTTOM}\" y2=\"{BOTTOM}\" class=\"grid\"/>\
         <line x1=\"{0:.1}\" x2=\"{0:.1}\" y1=\"{TOP}\" y2=\"{BOTTOM}\" class=\"guide\"/>\
         <text x=\"{1}\" y=\"{2}\" class=\"end\">{largest}</text><text x=\"{3}\" y=\"{4}\" class=\"middle\">clearance, cm</text></svg>",
        x(0.0),
        LEFT - 8.0,
        TOP + 8.0,
        0.5 * (LEFT + RIGHT),
        HEIGHT - 12.0
    );
    svg
}

fn drawings(subject: &Subject<'_>, measured: &Measured) -> String {
    let drawn = measured.tracks.len().min(DRAWN_MAX);
    let mut html = String::from("<h2>Before and after</h2>");
    if drawn < measured.tracks.len() {
        let _ = write!(
            html,
            "<p>The first {drawn} of {} tracks.</p>",
            measured.tracks.len()
        );
    }
    for (at, track) in measured.tracks.iter().enumerate().take(drawn) {
        let _ = write!(
            html,
            "<div class=\"row\"><figure style=\"flex:1 1 24em\">{}</figure>",
            above(subject, at)
        );
        if !track.offsets_m.before.is_empty() {
            let _ = write!(
                html,
                "<figure style=\"flex:1 1 24em\">{}</figure>",
                offsets(track)
            );
        }
        html.push_str("</div>");
        if let Some(reason) = &track.refused {
            let _ = write!(
                html,
                "<p class=\"dim\">{} was refused: it {}.</p>",
                escaped(&track.id),
                escaped(reason)
            );
        }
    }
    html
}

fn above(subject: &Subject<'_>, at: usize) -> String {
    let track = &subject.tracks[at];
    let mut ways = Vec::new();
    let places = |track: &Track| track.points.iter().map(|point| point.position_m).collect();
    if let Some(truth) = subject
        .truth
        .and_then(|truth| truth.iter().find(|truth| truth.id == track.id))
    {
        ways.push(Way {
            name: "truth",
            color: TRUTH,
            dashed: false,
            places: places(truth),
        });
    }
    ways.push(Way {
        name: "as logged",
        color: BEFORE,
        dashed: false,
        places: places(track),
    });
    if let Outcome::Registered(registered) = &subject.registration.tracks[at].outcome {
        let places = registered
            .poses
            .iter()
            .map(|pose| pose.pose.translation.truncate())
            .collect();
        ways.push(Way {
            name: "registered",
            color: AFTER,
            dashed: true,
            places,
        });
    }
    drawing(
        &format!("{} ({})", track.id, track.class),
        &subject.map.lanes,
        &ways,
        &[],
    )
}

fn offsets(track: &MeasuredTrack) -> String {
    let curve = |name: &str, color: usize, points: &[(f64, f64)]| {
        let points = points.to_vec();
        Series {
            name: name.into(),
            color,
            points,
            shape: Shape::Curve,
            end: None,
        }
    };
    let mut series = vec![curve("as logged", BEFORE, &track.offsets_m.before)];
    if !track.offsets_m.after.is_empty() {
        series.push(curve("registered", AFTER, &track.offsets_m.after));
    }
    let linear = |label| Axis {
        label,
        ..Axis::default()
    };
    let title = format!("{}: offset from the centerline of its lane", track.id);
    Plot {
        title: &title,
        x: linear("time, s"),
        y: linear("to the left, m"),
        series,
    }
    .to_svg()
}
