//! Spatial index of boxes: sorted entries of the grid squares that each box meets.

use glam::DVec2;

use crate::oriented_box::OrientedBox;

/// Side of a square, meters: a few cells of a lane, or a parked car.
const SQUARE_M: f64 = 4.0;

/// Boxes by the squares that they meet.
#[derive(Clone, Debug, Default)]
pub(crate) struct Grid {
    /// Square and box, sorted.
    squares: Vec<([i64; 2], u32)>,
}

fn squares_of(outline: &OrientedBox) -> impl Iterator<Item = [i64; 2]> + use<> {
    let corners = outline.corners().into_iter();
    let (low, high) = corners.fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(low, high), at| {
        (low.min(at), high.max(at))
    });
    let square = |x: f64| (x / SQUARE_M).floor() as i64;
    let (low, high) = (
        [square(low.x), square(low.y)],
        [square(high.x), square(high.y)],
    );
    (low[0]..=high[0]).flat_map(move |x| (low[1]..=high[1]).map(move |y| [x, y]))
}

impl Grid {
    pub(crate) fn new(boxes: &[OrientedBox]) -> Self {
        let mut squares = Vec::new();
        for (number, outline) in boxes.iter().enumerate() {
            squares.extend(squares_of(outline).map(|square| (square, number as u32)));
        }
        squares.sort_unstable();
        Self { squares }
    }

    /// The boxes of each square that has any.
    pub(crate) fn groups(&self) -> impl Iterator<Item = &[([i64; 2], u32)]> {
        self.squares.chunk_by(|a, b| a.0 == b.0)
    }

    /// Appends the boxes that may touch `outline` to `found`, sorted.
    pub(crate) fn near(&self, outline: &OrientedBox, found: &mut Vec<u32>) {
        found.clear();
        for square in squares_of(outline) {
            let first = self.squares.partition_point(|entry| entry.0 < square);
            found.extend(
                self.squares[first..]
                    .iter()
                    .take_while(|entry| entry.0 == square)
                    .map(|entry| entry.1),
            );
        }
        found.sort_unstable();
        found.dedup();
    }
}
