//! Position of the map on the page.

use glam::DVec2;

/// Page and scale.
pub struct Frame {
    pub width: f64,
    pub height: f64,
    /// Left edge of the map on the page, pixels.
    pub left: f64,
    pub top: f64,
    /// Size of the map, pixels.
    pub area: DVec2,
    pub px_per_m: f64,
    /// World coordinates of the middle of the map.
    middle_m: DVec2,
}

const PAGE_WIDTH: f64 = 1400.0;
const MARGIN: f64 = 28.0;
const TITLE: f64 = 80.0;
/// The legend's column.
pub const PANEL: f64 = 250.0;
/// Padding around the lanes, pixels.
const PADDING: f64 = 14.0;
const AREA_HEIGHT: [f64; 2] = [460.0, 1080.0];

impl Frame {
    /// The page for a map between two corners.
    pub fn around(min_m: DVec2, max_m: DVec2) -> Self {
        let size_m = (max_m - min_m).max(DVec2::ONE);
        let area_width = PAGE_WIDTH - PANEL - 3.0 * MARGIN;
        let inner_width = area_width - 2.0 * PADDING;
        let area_height = (inner_width * size_m.y / size_m.x + 2.0 * PADDING)
            .clamp(AREA_HEIGHT[0], AREA_HEIGHT[1]);
        let px_per_m = (inner_width / size_m.x).min((area_height - 2.0 * PADDING) / size_m.y);
        Self {
            width: PAGE_WIDTH,
            height: (TITLE + area_height + 2.0 * MARGIN + 18.0).round(),
            left: MARGIN,
            top: TITLE,
            area: DVec2::new(area_width, area_height),
            px_per_m,
            middle_m: 0.5 * (min_m + max_m),
        }
    }

    /// Position of a world point on the page; north is up.
    pub fn place(&self, point_m: DVec2) -> DVec2 {
        let from_middle = (point_m - self.middle_m) * self.px_per_m * DVec2::new(1.0, -1.0);
        DVec2::new(self.left, self.top) + 0.5 * self.area + from_middle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_lie_in_the_area_and_north_is_up() {
        for (min, max) in [
            (DVec2::ZERO, DVec2::new(900.0, 20.0)),
            (DVec2::splat(1e6), DVec2::new(1e6 + 3.0, 2e6)),
            (DVec2::ONE, DVec2::ONE),
        ] {
            let frame = Frame::around(min, max);
            for corner in [min, max] {
                let place = frame.place(corner) - DVec2::new(frame.left, frame.top);
                assert!(
                    place.cmpge(DVec2::ZERO).all() && place.cmple(frame.area).all(),
                    "{corner}: {place}"
                );
            }
            assert!(frame.place(min + DVec2::Y).y < frame.place(min).y);
        }
    }
}
