//! The road from above, unrolled along the way: markings that follow the way stand straight up in
//! it.
//!
//! The ground is taken for flat, at the height of the ego's wheels; on a hill's edge or under a car
//! that pitches, what is seen far ahead lies nearer or farther than it does in truth.

use super::camera_image::Image;
use super::way::RoadPath;

/// Distance between rows along the way, meters.
pub(super) const ROW_M: f64 = 0.25;
/// The first row, meters ahead of the middle of the ego.
const FIRST_M: f64 = 3.0;
/// The last row is nearer than this, meters: beyond, a marking is narrower than a pixel of an image
/// 320 wide.
const VIEW_M: f64 = 34.0;
/// Distance between columns across the way, meters.
pub(super) const COLUMN_M: f64 = 0.06;
/// Distance to which columns reach on either side, meters.
const HALF_WIDTH_M: f64 = 5.4;
/// Columns, the middle one on the way.
pub(super) const COLUMNS: usize = 2 * HALF_COLUMNS + 1;
/// Columns on each side of the middle.
pub(super) const HALF_COLUMNS: usize = (HALF_WIDTH_M / COLUMN_M) as usize;
/// Half the width of the brightest part of a marking, meters.
const CORE_M: f64 = 0.09;
/// Width of the soft edge of a marking, between its core and the road that it is compared with,
/// meters.
const EDGE_M: f64 = 0.10;
/// Width of what it is compared with on either side, meters.
const FLANK_M: f64 = 0.30;
/// Responses are kept within this, so that no single bright spot outweighs a line.
const RESPONSE: std::ops::Range<f32> = -0.04..0.20;

/// A row of the view: how much brighter each column is than the road on both sides of it, as a
/// share of that road's brightness.
#[derive(Clone, Debug)]
pub(super) struct Row {
    /// Meters along the way.
    pub arc_m: f64,
    /// Pixels of the image that stand behind the row, at most one.
    pub weight: f32,
    /// One for each column from right to left; zero where the image does not show it.
    pub responses: Vec<f32>,
}

/// The rows of the road along `way` between two positions on it, meters.
pub(super) fn rows(image: &Image, way: &RoadPath, from_m: f64, to_m: f64) -> Vec<Row> {
    let from_m = from_m.max(FIRST_M);
    let count = ((to_m.min(VIEW_M) - from_m) / ROW_M).max(0.0) as usize;
    (0..count)
        .filter_map(|row| row_at(image, way, from_m + row as f64 * ROW_M))
        .collect()
}

fn row_at(image: &Image, way: &RoadPath, arc_m: f64) -> Option<Row> {
    let point = way.at(arc_m);
    let mut sums = [(0.0_f32, 0_u32); COLUMNS + 1];
    for column in 0..COLUMNS {
        let left_m = (column as f64 - HALF_COLUMNS as f64) * COLUMN_M;
        let (sum, known) = sums[column];
        sums[column + 1] = match image.color_of(point.beside(left_m), 0.0) {
            Some(color) => (sum + color.luma, known + 1),
            None => (sum, known),
        };
    }
    if sums[COLUMNS].1 == 0 {
        return None;
    }
    let pixel_m = image.pixel_m(point.position_m.x);
    let window = Window::for_pixels(pixel_m);
    let responses = (0..COLUMNS)
        .map(|column| window.response(&sums, column))
        .collect();
    let weight = (image.pixels_along(point.position_m.x) * ROW_M).clamp(0.05, 1.0) as f32;
    Some(Row {
        arc_m,
        weight,
        responses,
    })
}

/// Columns of a row that are compared.
struct Window {
    core: usize,
    edge: usize,
    flank: usize,
}

impl Window {
    /// Wide enough for pixels of `pixel_m` meters.
    fn for_pixels(pixel_m: f64) -> Self {
        let columns = |meters: f64| (meters / COLUMN_M).round().max(1.0) as usize;
        Self {
            core: columns(CORE_M.max(0.5 * pixel_m)),
            edge: columns(EDGE_M.max(pixel_m)),
            flank: columns(FLANK_M.max(2.0 * pixel_m)),
        }
    }

    fn response(&self, sums: &[(f32, u32)], column: usize) -> f32 {
        let mean = |from: usize, to: usize| {
            let (sum, known) = (sums[to].0 - sums[from].0, sums[to].1 - sums[from].1);
            (known as usize == to - from).then(|| sum / known as f32)
        };
        let half_width = self.core + self.edge + self.flank;
        if column < half_width || column + half_width >= COLUMNS {
            return 0.0;
        }
        let (first, last) = (column - self.core, column + self.core + 1);
        let right = mean(first - self.edge - self.flank, first - self.edge);
        let left = mean(last + self.edge, last + self.edge + self.flank);
        let (Some(core), Some(left), Some(right)) = (mean(first, last), left, right) else {
            return 0.0;
        };
        let road = 0.5 * (left + right);
        ((core - left.max(right)) / road).clamp(RESPONSE.start, RESPONSE.end)
    }
}
