//! The column beside the map: which color is what; and the scale below it.

use std::fmt::Write;

use decouplegs::scene::Track;

use super::frame::{Frame, PANEL};
use super::shows_arrows;
use crate::map::style::{TRACK_CLASSES, track_class};
use crate::map::summary::KindSummary;

const LINE: f64 = 26.0;
/// Longest scale bar, pixels.
const BAR_MAX_PX: f64 = 220.0;

/// The kinds of lanes with their numbers, the number of obstacles, and the classes of tracks.
pub fn draw(
    svg: &mut String,
    frame: &Frame,
    kinds: &[(&str, KindSummary)],
    obstacles: usize,
    tracks: &[Track],
) {
    let classes: Vec<(&str, &str, usize)> = TRACK_CLASSES
        .iter()
        .map(|(class, name)| {
            (
                *class,
                *name,
                tracks
                    .iter()
                    .filter(|track| track_class(&track.class) == *class)
                    .count(),
            )
        })
        .filter(|(_, _, count)| *count > 0)
        .collect();
    let left = frame.width - PANEL - frame.left;
    let lines = 1
        + usize::from(shows_arrows(frame))
        + usize::from(obstacles > 0)
        + kinds.len()
        + if classes.is_empty() {
            0
        } else {
            2 + classes.len()
        };
    let height = LINE * lines as f64 + 20.0;
    let _ = writeln!(
        svg,
        "<rect class=\"panel\" x=\"{left}\" y=\"{}\" width=\"{PANEL}\" height=\"{height}\" rx=\"8\"/>",
        frame.top
    );
    let mut y = frame.top + 30.0;
    heading(svg, left, y, "Lanes", "number, length");
    for (class, kind) in kinds {
        y += LINE;
        let _ = writeln!(
            svg,
            "<rect class=\"lane {class}\" x=\"{:.1}\" y=\"{:.1}\" width=\"30\" height=\"15\"/>\
             <path class=\"line\" d=\"M{:.1} {:.1}h30m0 15h-30\"/>",
            left + 16.0,
            y - 12.0,
            left + 16.0,
            y - 12.0
        );
        entry(
            svg,
            left,
            y,
            class,
            &format!("{}, {}", kind.lanes, meters(kind.length_m)),
        );
    }
    if shows_arrows(frame) {
        y += LINE;
        let _ = writeln!(
            svg,
            "<path class=\"arrow\" d=\"M{0:.1} {1:.1}l-9 -4l3 4l-3 4Z\"/>\
             <text x=\"{2:.1}\" y=\"{y}\" class=\"dim\">direction of travel</text>",
            left + 36.0,
            y - 4.5,
            left + 56.0
        );
    }
    if obstacles > 0 {
        y += LINE;
        obstacle_entry(svg, left, y, obstacles);
    }
    if classes.is_empty() {
        return;
    }
    y += LINE * 1.4;
    heading(svg, left, y, "Tracks", "number");
    for (class, name, count) in classes {
        y += LINE;
        let _ = writeln!(
            svg,
            "<g class=\"{class}\"><path class=\"track\" d=\"M{0:.1} {1:.1}h18\"/>\
             <circle class=\"start\" cx=\"{0:.1}\" cy=\"{1:.1}\" r=\"2.2\"/>\
             <path class=\"body\" d=\"M{2:.1} {3:.1}h9l3 4l-3 4h-9Z\"/></g>",
            left + 16.0,
            y - 4.5,
            left + 34.0,
            y - 8.5
        );
        entry(svg, left, y, name, &count.to_string());
    }
}

fn heading(svg: &mut String, left: f64, y: f64, text: &str, numbers: &str) {
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{y:.1}\" class=\"head\">{text}</text>\
         <text x=\"{:.1}\" y=\"{y:.1}\" class=\"end dim\">{numbers}</text>",
        left + 16.0,
        left + PANEL - 16.0
    );
}

fn obstacle_entry(svg: &mut String, left: f64, y: f64, obstacles: usize) {
    let _ = writeln!(
        svg,
        "<rect class=\"obstacle\" x=\"{:.1}\" y=\"{:.1}\" width=\"10\" height=\"10\"/>",
        left + 26.0,
        y - 9.5
    );
    entry(svg, left, y, "obstacles", &obstacles.to_string());
}

fn entry(svg: &mut String, left: f64, y: f64, name: &str, value: &str) {
    let _ = writeln!(
        svg,
        "<text x=\"{:.1}\" y=\"{y:.1}\">{name}</text><text x=\"{:.1}\" y=\"{y:.1}\" class=\"end dim\">{value}</text>",
        left + 56.0,
        left + PANEL - 16.0
    );
}

/// A length in the unit that suits it.
fn meters(length_m: f64) -> String {
    if length_m < 1e4 {
        format!("{length_m:.0} m")
    } else {
        format!("{:.1} km", length_m / 1e3)
    }
}

/// A bar of a round length below the map.
pub fn draw_scale(svg: &mut String, frame: &Frame) {
    let length_m = round_length_m(BAR_MAX_PX / frame.px_per_m);
    let (left, y) = (frame.left, frame.top + frame.area.y + 26.0);
    let length_px = length_m * frame.px_per_m;
    let name = if length_m < 1000.0 {
        format!("{length_m} m")
    } else {
        format!("{} km", length_m / 1e3)
    };
    let _ = writeln!(
        svg,
        "<path class=\"bar\" d=\"M{left} {:.1}v6h{length_px:.1}v-6\"/><text x=\"{:.1}\" y=\"{:.1}\">{name}</text>\
         <text x=\"{:.1}\" y=\"{:.1}\" class=\"end dim\">x to the right, y up</text>",
        y - 6.0,
        left + length_px + 10.0,
        y + 2.0,
        left + frame.area.x,
        y + 2.0
    );
}

/// The largest of 1, 2 or 5 times a power of ten that is at most `most_m`.
fn round_length_m(most_m: f64) -> f64 {
    let power = 10.0_f64.powf(most_m.log10().floor());
    [5.0, 2.0, 1.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|length_m| *length_m <= most_m)
        .unwrap_or(power)
}

#[cfg(test)]
mod tests {
    use super::round_length_m;

    #[test]
    fn a_scale_is_round_and_fits() {
        for (most_m, expected_m) in [
            (73.0, 50.0),
            (49.9, 20.0),
            (1.99, 1.0),
            (1000.0, 1000.0),
            (0.3, 0.2),
        ] {
            let found_m: f64 = round_length_m(most_m);
            assert!((found_m - expected_m).abs() < 1e-12, "{most_m}: {found_m}");
        }
    }
}
