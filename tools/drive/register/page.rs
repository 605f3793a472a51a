//! The report as one HTML page.

use std::fmt::Write;

use decouplegs::drive::alignment::histogram;
use decouplegs::drive::{Outcome, Registration};
use decouplegs::scene::{LaneMap, Track};

use super::Arguments;
use super::measure::{Measured, MeasuredTrack};
use super::table::{cells, columns, totals};
use crate::lane_drawing::{Way, drawing};
use crate::page::{Figure, Page, Table, escaped};
use crate::plot::{Axis, Plot, Series, number};

/// Tracks that are drawn; a page of hundreds would not be read.
const DRAWN_MAX: usize = 24;
/// Largest clearance of the histogram to either side, meters; number of bars.
const LIMIT_M: f64 = 0.1;
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
    let name = arguments.tracks.file_name().unwrap_or_default();
    let mut page = Page::new(&format!("{} registered", name.to_string_lossy()));
    let ground = match &arguments.scene {
        Some(scene) => format!("on the ground of {}", scene.display()),
        None => "at the heights of the map: no scene was given".to_owned(),
    };
    page.text(&format!(
        "To the lanes of {}, {ground}.",
        arguments.map.display()
    ));
    page.list(totals(measured).iter().map(|line| escaped(line)));
    clearance_part(&mut page, arguments, measured);
    table(&mut page, measured);
    drawings(&mut page, subject, measured);
    page.finish()
}

fn table(page: &mut Page, measured: &Measured) {
    page.heading("Tracks");
    let columns = columns(measured);
    let last = columns.len() - 1;
    let mut table = Table::new(columns).with_text_in(last);
    for track in &measured.tracks {
        table.row(cells(measured, track));
    }
    page.table(&table);
    page.note(
        "Shift (x y) and yaw (from x to y) are the one motion of the track, about its middle. 'known to' is one standard deviation of \
         that, across the lane and along it: near 1 m, which is what is assumed of drift before, the lanes do not show it and the \
         position along the lane is as logged. ADE is the mean distance, as logged -> registered: to the nearest centerline (lane changes \
         left out) and to the truth, whose parts across and along the lane follow. GPR and p95, the distance from the ground that \
         95 % of corners keep within, are explained under Clearance. Notes count poses. no-support: there was no ground below, and the pose has \
         the height of the map. no-height: there was no ground, map or log with a height, and the pose has height 0. uneven: the ground below \
         the box is no plane. parked: the vehicle moves too little to follow lanes. lane-unsure: several lanes fit about equally well.",
    );
}

fn clearance_part(page: &mut Page, arguments: &Arguments, measured: &Measured) {
    let clearances_m = measured.clearances_m();
    if clearances_m.is_empty() {
        return;
    }
    let against = match &arguments.ground_truth {
        Some(truth) => format!("Judged against the independent ground of {}.", truth.display()),
        None => "Judged against the same ground that the boxes were set on, the background's own splats: it shows how well four wheels \
                 fit it, not whether it is right. --ground-truth names an independent one."
            .into(),
    };
    page.heading("Clearance");
    page.text(&format!(
        "{against} Each bottom corner of each pose; negative is below the ground, positive floats. Corners farther than {} cm are in \
         the outer bars.",
        number(100.0 * LIMIT_M)
    ));
    page.row([Figure::svg(&clearance_svg(
        &clearances_m,
        measured.tolerance_m,
    ))]);
}

/// Bars by clearance, those below the tolerance in another color.
fn clearance_svg(clearances_m: &[f64], tolerance_m: f64) -> String {
    const WIDTH: f64 = 640.0;
    const HEIGHT: f64 = 260.0;
    const LEFT: f64 = 70.0;
    const RIGHT: f64 = 610.0;
    const TOP: f64 = 34.0;
    const BOTTOM: f64 = 206.0;
    let counts = histogram(clearances_m, LIMIT_M, BINS);
    let largest = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let x = |value_m: f64| LEFT + (value_m / LIMIT_M + 1.0) * 0.5 * (RIGHT - LEFT);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH} {HEIGHT}\" width=\"{WIDTH}\" role=\"img\" aria-label=\"clearances\">\
         <text x=\"{LEFT}\" y=\"20\" class=\"title\">Corners by clearance</text>"
    );
    for (at, &count) in counts.iter().enumerate() {
        let low_m = LIMIT_M * (2.0 * at as f64 / BINS as f64 - 1.0);
        let high_m = LIMIT_M * (2.0 * (at + 1) as f64 / BINS as f64 - 1.0);
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
        let value_m = LIMIT_M * f64::from(step) / 5.0;
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

fn drawings(page: &mut Page, subject: &Subject<'_>, measured: &Measured) {
    let (drawn, all) = (measured.tracks.len().min(DRAWN_MAX), measured.tracks.len());
    page.heading("Before and after");
    if drawn < all {
        page.text(&format!("The first {drawn} of {all} tracks."));
    }
    for (at, track) in measured.tracks.iter().enumerate().take(drawn) {
        let offsets = (!track.offsets_m.before.is_empty()).then(|| offsets(track));
        let svgs = std::iter::once(above(subject, at)).chain(offsets);
        page.row(svgs.map(|svg| Figure::flexible_svg(&svg)));
        if let Some(reason) = &track.refused {
            page.note(&format!("{} was refused: it {reason}.", track.id));
        }
    }
}

fn above(subject: &Subject<'_>, at: usize) -> String {
    let track = &subject.tracks[at];
    let mut ways = Vec::new();
    let positions = |track: &Track| track.points.iter().map(|point| point.position_m).collect();
    if let Some(truth) = subject
        .truth
        .and_then(|truth| truth.iter().find(|truth| truth.id == track.id))
    {
        ways.push(Way {
            name: "truth",
            color: TRUTH,
            dashed: false,
            positions: positions(truth),
        });
    }
    ways.push(Way {
        name: "as logged",
        color: BEFORE,
        dashed: false,
        positions: positions(track),
    });
    if let Outcome::Registered(registered) = &subject.registration.tracks[at].outcome {
        let positions = registered
            .poses
            .iter()
            .map(|pose| pose.pose.translation.truncate())
            .collect();
        ways.push(Way {
            name: "registered",
            color: AFTER,
            dashed: true,
            positions,
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
    let mut series = vec![Series::curve(
        "as logged",
        BEFORE,
        track.offsets_m.before.clone(),
    )];
    if !track.offsets_m.after.is_empty() {
        let after = track.offsets_m.after.clone();
        series.push(Series::curve("registered", AFTER, after));
    }
    let title = format!("{}: offset from the centerline of its lane", track.id);
    Plot {
        title: &title,
        x: Axis::linear("time, s"),
        y: Axis::linear("to the left, m"),
        series,
    }
    .to_svg()
}
