//! Ways and vehicles on their lanes from above, as inline SVG.

use std::fmt::Write;

use decouplegs::scene::{Lane, LaneKind};
use glam::DVec2;

use crate::page::escaped;
use crate::plot::number;

const WIDTH_PX: f64 = 640.0;
const HEIGHT_PX: f64 = 340.0;
const MARGIN_PX: f64 = 30.0;
/// Margin around the track, meters.
const MARGIN_M: f64 = 8.0;

/// A line through positions, under a name.
pub struct Way<'a> {
    pub name: &'a str,
    /// Index of the page's color.
    pub color: usize,
    pub dashed: bool,
    pub positions: Vec<DVec2>,
}

/// A vehicle from above.
pub struct Body {
    /// Index of the page's color.
    pub color: usize,
    pub corners: [DVec2; 4],
}

/// World to image.
struct View {
    low: DVec2,
    high: DVec2,
    px_per_m: f64,
}

impl View {
    fn around<'a>(positions: impl Iterator<Item = &'a DVec2>) -> Option<Self> {
        let (low, high) = positions
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| {
                (low.min(*at), high.max(*at))
            });
        let (low, high) = (low - MARGIN_M, high + MARGIN_M);
        let room = DVec2::new(WIDTH_PX, HEIGHT_PX) - 2.0 * MARGIN_PX;
        let px_per_m = (room / (high - low)).min_element();
        // The middle of the track in the middle of the image.
        let (middle, half) = (
            0.5 * (low + high),
            0.5 * DVec2::new(WIDTH_PX, HEIGHT_PX) / px_per_m,
        );
        (px_per_m.is_finite() && px_per_m > 0.0).then_some(Self {
            low: middle - half,
            high: middle + half,
            px_per_m,
        })
    }

    fn line(&self, positions: impl Iterator<Item = DVec2>) -> String {
        let position = |at: DVec2| {
            format!(
                "{:.1},{:.1}",
                (at.x - self.low.x) * self.px_per_m,
                (self.high.y - at.y) * self.px_per_m
            )
        };
        positions.map(position).collect::<Vec<_>>().join(" ")
    }

    fn shows(&self, line: &[glam::DVec3]) -> bool {
        let bounds = line
            .iter()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| {
                (low.min(at.truncate()), high.max(at.truncate()))
            });
        bounds.0.cmple(self.high).all() && bounds.1.cmpge(self.low).all()
    }
}

/// Lanes around `ways`, and these and `bodies` over them. A way without a name is not in the
/// legend.
pub fn drawing(title: &str, lanes: &[Lane], ways: &[Way<'_>], bodies: &[Body]) -> String {
    let Some(view) = View::around(ways.iter().flat_map(|way| &way.positions)) else {
        return String::new();
    };
    let name = escaped(title);
    let mut svg = format!(
        "<svg viewBox=\"0 0 {WIDTH_PX} {HEIGHT_PX}\" width=\"{WIDTH_PX}\" role=\"img\" aria-label=\"{name}\">\
         <text x=\"{MARGIN_PX}\" y=\"20\" class=\"title\">{name}</text>"
    );
    for lane in lanes.iter().filter(|lane| view.shows(&lane.centerline)) {
        for border in [&lane.left, &lane.right]
            .into_iter()
            .filter(|border| border.len() > 1)
        {
            let line = view.line(border.iter().map(|point| point.truncate()));
            let _ = write!(
                svg,
                "<polyline points=\"{line}\" fill=\"none\" style=\"stroke:var(--rule)\"/>"
            );
        }
        if lane.left.len() > 1 && lane.right.len() > 1 {
            let outline = lane
                .left
                .iter()
                .chain(lane.right.iter().rev())
                .map(|point| point.truncate());
            let _ = write!(
                svg,
                "<polygon points=\"{}\" style=\"fill:var(--rule)\" opacity=\"0.35\"/>",
                view.line(outline)
            );
        }
        if lane.kind == LaneKind::Driving || lane.left.is_empty() {
            let line = view.line(lane.centerline.iter().map(|point| point.truncate()));
            let _ = write!(
                svg,
                "<polyline points=\"{line}\" class=\"guide\" opacity=\"0.6\"/>"
            );
        }
    }
    for way in ways {
        let (color, line) = (way.color, view.line(way.positions.iter().copied()));
        let dashes = dashes(way);
        let _ = write!(
            svg,
            "<polyline points=\"{line}\" class=\"curve\" style=\"stroke:var(--c{color});{dashes}\"/>"
        );
    }
    for body in bodies {
        let (color, outline) = (body.color, view.line(body.corners.into_iter()));
        let _ = write!(
            svg,
            "<polygon points=\"{outline}\" style=\"fill:var(--c{color});stroke:var(--ink);stroke-width:0.7\"/>"
        );
    }
    draw_legend(&mut svg, ways);
    draw_scale(&mut svg, &view);
    svg.push_str("</svg>");
    svg
}

fn dashes(way: &Way<'_>) -> &'static str {
    if way.dashed {
        "stroke-dasharray:6 5"
    } else {
        ""
    }
}

fn draw_legend(svg: &mut String, ways: &[Way<'_>]) {
    for (at, way) in ways.iter().filter(|way| !way.name.is_empty()).enumerate() {
        let (x, y) = (MARGIN_PX + 130.0 * at as f64, HEIGHT_PX - 12.0);
        let (color, dashes) = (way.color, dashes(way));
        let _ = write!(
            svg,
            "<line x1=\"{x}\" x2=\"{:.1}\" y1=\"{:.1}\" y2=\"{:.1}\" class=\"curve\" style=\"stroke:var(--c{color});{dashes}\"/>\
             <text x=\"{:.1}\" y=\"{y:.1}\" class=\"name\">{}</text>",
            x + 22.0,
            y - 4.0,
            y - 4.0,
            x + 28.0,
            escaped(way.name)
        );
    }
}

/// A bar of a round number of meters.
fn draw_scale(svg: &mut String, view: &View) {
    let about_m = 80.0 / view.px_per_m;
    let power = 10f64.powf(about_m.log10().floor());
    let length_m = [1.0, 2.0, 5.0]
        .map(|factor| factor * power)
        .into_iter()
        .rfind(|length| *length <= about_m)
        .unwrap_or(power);
    let (right, y) = (WIDTH_PX - MARGIN_PX, HEIGHT_PX - 14.0);
    let _ = write!(
        svg,
        "<line x1=\"{:.1}\" x2=\"{right}\" y1=\"{y}\" y2=\"{y}\" style=\"stroke:var(--ink);stroke-width:2\"/>\
         <text x=\"{right}\" y=\"{:.1}\" class=\"end\">{} m</text>",
        right - length_m * view.px_per_m,
        y - 6.0,
        number(length_m)
    );
}
