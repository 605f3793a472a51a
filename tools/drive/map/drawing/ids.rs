//! Ids of lanes on the page, where there is room.

use std::fmt::Write;

use decouplegs::scene::{Lane, LaneKind};
use glam::DVec2;

use super::frame::Frame;
use crate::page::escaped;

/// Size of the letters, and about the width of one, pixels.
const SIZE_PX: f64 = 8.0;
const LETTER_PX: f64 = 4.9;
/// Most letters of an id that is drawn; longer ids are left to the lanes' tooltips.
const LETTERS_MAX: usize = 16;
/// Room around an id, pixels.
const MARGIN_PX: f64 = 2.0;
/// Ids on a page.
const IDS_MAX: usize = 400;

/// Writes ids at the middles of lanes that traffic drives on, the longest lanes first, none over
/// another.
pub fn draw(svg: &mut String, frame: &Frame, lanes: &[Lane]) {
    let mut named: Vec<(f64, DVec2, &Lane)> =
        lanes.iter().filter_map(|lane| place(frame, lane)).collect();
    named.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut taken: Vec<(DVec2, DVec2)> = Vec::new();
    let _ = writeln!(svg, "<g class=\"id\" font-size=\"{SIZE_PX}\">");
    for (length_px, middle, lane) in named {
        let letters = lane.id.chars().count();
        let half = 0.5 * DVec2::new(LETTER_PX * letters as f64, SIZE_PX) + MARGIN_PX;
        let overlaps = |(other, other_half): &(DVec2, DVec2)| {
            let apart = (middle - *other).abs();
            apart.x < half.x + other_half.x && apart.y < half.y + other_half.y
        };
        if taken.len() == IDS_MAX
            || letters > LETTERS_MAX
            || length_px < 2.0 * half.x
            || taken.iter().any(overlaps)
        {
            continue;
        }
        let _ = writeln!(
            svg,
            "<text x=\"{:.1}\" y=\"{:.1}\">{}</text>",
            middle.x,
            middle.y,
            escaped(&lane.id)
        );
        taken.push((middle, half));
    }
    svg.push_str("</g>\n");
}

/// Length of a lane on the page, and its middle.
fn place<'a>(frame: &Frame, lane: &'a Lane) -> Option<(f64, DVec2, &'a Lane)> {
    let line = &lane.centerline;
    let length_px = frame.px_per_m * decouplegs::asset::maps::length_m(line);
    let middle = line.get(line.len() / 2)?;
    matches!(lane.kind, LaneKind::Driving | LaneKind::Bicycle)
        .then(|| (length_px, frame.place(middle.truncate()), lane))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn ids_do_not_cover_each_other_and_are_escaped() {
        let frame = Frame::around(DVec2::ZERO, DVec2::new(200.0, 100.0));
        let lane = |id: &str, y: f64, to: f64| Lane {
            id: id.into(),
            centerline: [0.0, 0.5, 1.0]
                .map(|share| DVec3::new(to * share, y, 0.0))
                .to_vec(),
            ..Lane::default()
        };
        let lanes = [
            lane("a<b", 50.0, 200.0),
            lane("beneath", 50.5, 199.0),
            lane("apart", 10.0, 200.0),
            lane("short", 90.0, 1.0),
        ];
        let mut svg = String::new();
        draw(&mut svg, &frame, &lanes);
        assert!(
            svg.contains("a&lt;b")
                && svg.contains("apart")
                && !svg.contains("beneath")
                && !svg.contains("short"),
            "{svg}"
        );
    }
}
