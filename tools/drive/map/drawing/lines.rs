//! Lines on the page: what of them is seen, and the arrows along them.

use std::fmt::Write;

use glam::DVec2;

use super::Frame;

/// Points nearer than this to the one before are left out, pixels.
const SAME_PX: f64 = 0.15;
/// Distance between arrows, pixels.
const ARROW_STEP_PX: f64 = 70.0;
/// Shorter lanes have no arrow, pixels.
const ARROW_LANE_PX: f64 = 12.0;

/// The points of a line on the page that can be told apart; its ends stay.
pub fn shown(frame: &Frame, line: impl Iterator<Item = DVec2>) -> Vec<DVec2> {
    let mut kept: Vec<DVec2> = Vec::new();
    let mut left_out = None;
    for point in line.map(|point| frame.place(point)) {
        let is_seen = kept
            .last()
            .is_none_or(|last| last.distance(point) >= SAME_PX);
        left_out = if is_seen { None } else { Some(point) };
        kept.extend(is_seen.then_some(point));
    }
    kept.extend(left_out);
    kept
}

/// The data of a path through `points`.
pub fn path(points: &[DVec2]) -> String {
    let mut data = String::with_capacity(14 * points.len());
    for (at, point) in points.iter().enumerate() {
        let _ = write!(
            data,
            "{}{:.2} {:.2}",
            if at == 0 { "M" } else { "L" },
            point.x,
            point.y
        );
    }
    data
}

/// The data of a path of arrow heads along a line, evenly spread; empty where it is too short for
/// one.
pub fn arrows(points: &[DVec2], size_px: f64) -> String {
    let whole_px: f64 = points
        .windows(2)
        .map(|pair| pair[0].distance(pair[1]))
        .sum();
    let mut data = String::new();
    if whole_px < ARROW_LANE_PX {
        return data;
    }
    let count = (whole_px / ARROW_STEP_PX).floor().max(1.0);
    let mut next_px = 0.5 * whole_px / count;
    let mut passed_px = 0.0;
    for pair in points.windows(2) {
        let length_px = pair[0].distance(pair[1]);
        while next_px <= passed_px + length_px && length_px > 0.0 {
            let forward = (pair[1] - pair[0]) / length_px;
            let middle = pair[0] + forward * (next_px - passed_px);
            let side = forward.perp() * 0.62 * size_px;
            let (tip, back) = (middle + forward * size_px, middle - forward * 0.8 * size_px);
            let notch = middle - forward * 0.3 * size_px;
            data += &path(&[tip, back + side, notch, back - side]);
            data.push('Z');
            next_px += whole_px / count;
        }
        passed_px += length_px;
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_are_spread_over_the_line_and_point_along_it() {
        let line = [
            DVec2::ZERO,
            DVec2::new(100.0, 0.0),
            DVec2::new(100.0, 120.0),
        ];
        let data = arrows(&line, 5.0);
        assert_eq!(data.matches('Z').count(), 3, "{data}");
        assert!(
            data.starts_with("M41.67 0.00L"),
            "the first tip is 5 px past a sixth of the way: {data}"
        );
        assert!(
            arrows(&line[..1], 5.0).is_empty() && arrows(&[DVec2::ZERO, DVec2::X], 5.0).is_empty()
        );
    }

    #[test]
    fn what_is_too_small_to_see_is_left_out_but_ends_stay() {
        let frame = Frame::around(DVec2::ZERO, DVec2::splat(1e4));
        let dense = (0..=1000).map(|at| DVec2::new(f64::from(at), 0.0));
        let points = shown(&frame, dense);
        assert!(points.len() < 950 && points.len() > 50, "{}", points.len());
        assert_eq!(points.last(), Some(&frame.place(DVec2::new(1000.0, 0.0))));
    }
}
