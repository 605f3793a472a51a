//! A map from above as SVG: lanes in the colors of their kinds, borders, centerlines with arrows,
//! tracks, scale and legend.

mod frame;
mod ids;
mod legend;
mod lines;

use std::fmt::Write;

use decouplegs::drive::obstacles::outline;
use decouplegs::scene::{Lane, LaneKind, LaneMap, Obstacle, Track};
use glam::DVec2;

use self::frame::Frame;
use self::lines::{arrows, path, shown};
use super::style::{STYLE, lane_class, track_class};
use super::summary::{KINDS, MapSummary};
use crate::page::escaped;

/// Contents of the drawing.
pub struct Drawing<'a> {
    /// Name of the file.
    pub name: &'a str,
    pub map: &'a LaneMap,
    pub summary: &'a MapSummary,
    pub tracks: &'a [Track],
    pub obstacles: &'a [Obstacle],
}

/// Width of lanes without borders in the drawing, meters.
const WIDTH_M: f64 = 3.0;
/// Lanes drawn narrower have no arrows, pixels.
const ARROW_WIDTH_PX: f64 = 2.5;
/// Road users are not drawn smaller, pixels: they would not be seen.
const BODY_MIN_PX: f64 = 5.0;
/// The size of a road user that has none, meters.
const BODY_M: [f64; 2] = [4.5, 1.8];
/// Kinds in the order in which they are painted: crossings lie over roads.
const PAINTED: [LaneKind; 5] = [
    LaneKind::Other,
    LaneKind::Driving,
    LaneKind::Parking,
    LaneKind::Bicycle,
    LaneKind::Walking,
];

impl Drawing<'_> {
    /// The whole file.
    pub fn to_svg(&self) -> String {
        let frame = Frame::around(self.summary.min.truncate(), self.summary.max.truncate());
        let (width, height) = (frame.width, frame.height);
        let mut svg = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" \
             role=\"img\" aria-label=\"lanes of {0}\"><style>{STYLE}</style>\n\
             <rect class=\"ground\" width=\"100%\" height=\"100%\"/>\n\
             <clipPath id=\"map\"><rect x=\"{1}\" y=\"{2}\" width=\"{3:.1}\" height=\"{4:.1}\"/></clipPath>\n\
             <g clip-path=\"url(#map)\">\n",
            escaped(self.name),
            frame.left,
            frame.top,
            frame.area.x,
            frame.area.y
        );
        self.draw_lanes(&mut svg, &frame);
        for obstacle in self.obstacles {
            let corners = shown(&frame, outline(obstacle).corners().into_iter());
            if corners.len() > 2 {
                let _ = writeln!(svg, "<path class=\"obstacle\" d=\"{}Z\"/>", path(&corners));
            }
        }
        ids::draw(&mut svg, &frame, &self.map.lanes);
        for track in self.tracks {
            draw_track(&mut svg, &frame, track);
        }
        svg.push_str("</g>\n");
        self.draw_title(&mut svg, &frame);
        self.draw_legend(&mut svg, &frame);
        legend::draw_scale(&mut svg, &frame);
        svg.push_str("</svg>\n");
        svg
    }

    fn draw_lanes(&self, svg: &mut String, frame: &Frame) {
        for kind in PAINTED {
            for lane in self.map.lanes.iter().filter(|lane| lane.kind == kind) {
                draw_surface(svg, frame, lane);
            }
        }
        // Lines that would cover the lanes are thinner, and still there for who looks closer.
        let _ = writeln!(
            svg,
            "<g stroke-width=\"{:.2}\">",
            (0.3 * frame.px_per_m).clamp(0.15, 1.0)
        );
        for lane in &self.map.lanes {
            for border in [&lane.left, &lane.right] {
                let points = shown(frame, border.iter().map(|point| point.truncate()));
                if points.len() > 1 {
                    let _ = writeln!(svg, "<path class=\"line\" d=\"{}\"/>", path(&points));
                }
            }
        }
        svg.push_str("</g>\n");
        // A lane of a few pixels is hidden by its own arrows.
        if !shows_arrows(frame) {
            return;
        }
        let size_px = (0.32 * WIDTH_M * frame.px_per_m).clamp(2.4, 7.0);
        for lane in self
            .map
            .lanes
            .iter()
            .filter(|lane| matches!(lane.kind, LaneKind::Driving | LaneKind::Bicycle))
        {
            let points = shown(frame, lane.centerline.iter().map(|point| point.truncate()));
            if WIDTH_M * frame.px_per_m > 5.0 && points.len() > 1 {
                let _ = writeln!(svg, "<path class=\"center\" d=\"{}\"/>", path(&points));
            }
            let arrows = arrows(&points, size_px);
            if !arrows.is_empty() {
                let _ = writeln!(svg, "<path class=\"arrow\" d=\"{arrows}\"/>");
            }
        }
    }

    fn draw_title(&self, svg: &mut String, frame: &Frame) {
        let length_m = self.summary.length_m();
        let length = if length_m < 1e4 {
            format!("{length_m:.0} m")
        } else {
            format!("{:.1} km", length_m / 1e3)
        };
        let mut line = format!("{} lanes, {length} of centerline", self.summary.lanes());
        if !self.tracks.is_empty() {
            line += &format!(", {} tracks", self.tracks.len());
        }
        let _ = writeln!(
            svg,
            "<text x=\"{0}\" y=\"38\" class=\"title\">{1}</text><text x=\"{0}\" y=\"60\" class=\"dim\">{line}</text>",
            frame.left,
            escaped(self.name)
        );
    }

    fn draw_legend(&self, svg: &mut String, frame: &Frame) {
        let kinds = KINDS
            .iter()
            .zip(self.summary.kinds)
            .filter(|(_, found)| found.lanes > 0);
        let kinds = kinds
            .map(|(kind, found)| (lane_class(*kind), found))
            .collect::<Vec<_>>();
        legend::draw(svg, frame, &kinds, self.obstacles.len(), self.tracks);
    }
}

/// True if lanes are wide enough on the page for arrows.
fn shows_arrows(frame: &Frame) -> bool {
    WIDTH_M * frame.px_per_m >= ARROW_WIDTH_PX
}

/// Draws the area of a lane: between its borders, or a band along its centerline.
fn draw_surface(svg: &mut String, frame: &Frame, lane: &Lane) {
    let class = lane_class(lane.kind);
    let title = format!(
        "<title>{} ({})</title>",
        escaped(&lane.id),
        lane.kind.name()
    );
    if lane.left.is_empty() || lane.right.is_empty() {
        let points = shown(frame, lane.centerline.iter().map(|point| point.truncate()));
        let width_px = (WIDTH_M * frame.px_per_m).max(1.5);
        let _ = writeln!(
            svg,
            "<path class=\"wide {class}\" stroke-width=\"{width_px:.1}\" d=\"{}\">{title}</path>",
            path(&points)
        );
        return;
    }
    let outline = lane
        .left
        .iter()
        .chain(lane.right.iter().rev())
        .map(|point| point.truncate());
    let _ = writeln!(
        svg,
        "<path class=\"lane {class}\" d=\"{}Z\">{title}</path>",
        path(&shown(frame, outline))
    );
}

/// The way of a road user, a ring where it starts, and its body, nose first, where it ends.
fn draw_track(svg: &mut String, frame: &Frame, track: &Track) {
    let class = track_class(&track.class);
    let points = shown(frame, track.points.iter().map(|point| point.position_m));
    let (Some(first), Some(last)) = (points.first(), track.points.last()) else {
        return;
    };
    let title = format!(
        "<title>{} ({})</title>",
        escaped(&track.id),
        escaped(&track.class)
    );
    let _ = writeln!(
        svg,
        "<g class=\"{class}\">{title}<path class=\"track\" d=\"{}\"/>",
        path(&points)
    );
    let _ = writeln!(
        svg,
        "<circle class=\"start\" cx=\"{:.1}\" cy=\"{:.1}\" r=\"2.2\"/>",
        first.x, first.y
    );
    let [length_m, width_m] = track.dims_m.map_or(BODY_M, |dims| [dims[0], dims[1]]);
    let length_px = (length_m * frame.px_per_m).max(BODY_MIN_PX);
    let half_px = DVec2::new(length_px, (width_m * frame.px_per_m).max(0.5 * BODY_MIN_PX)) * 0.5;
    let towards = last.yaw_rad.map(DVec2::from_angle).or_else(|| {
        let before = track
            .points
            .iter()
            .rev()
            .find(|point| point.position_m.distance(last.position_m) > 0.1)?;
        (last.position_m - before.position_m).try_normalize()
    });
    // The image's y runs down.
    let forward = towards.unwrap_or(DVec2::X) * DVec2::new(1.0, -1.0);
    let corner = |along: f64, across: f64| {
        frame.place(last.position_m)
            + forward * along * half_px.x
            + forward.perp() * across * half_px.y
    };
    let body = [
        corner(-1.0, -1.0),
        corner(0.6, -1.0),
        corner(1.0, 0.0),
        corner(0.6, 1.0),
        corner(-1.0, 1.0),
    ];
    let _ = writeln!(svg, "<path class=\"body\" d=\"{}Z\"/></g>", path(&body));
}
