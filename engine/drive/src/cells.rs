//! Cells of square grids over the plane.

use glam::{DVec2, IVec2};

/// Largest number of a cell. Cells beside it can be counted in an i32 too.
const CELL_MAX: f64 = (1 << 30) as f64;

/// The cell of side `cell_m` that holds `at`. Places beyond [`CELL_MAX`] cells, and coordinates
/// that are no number, meet at the ends.
pub(crate) fn cell_of(at: DVec2, cell_m: f64) -> IVec2 {
    let cell = (at / cell_m).floor();
    let cell = cell.clamp(DVec2::splat(-CELL_MAX), DVec2::splat(CELL_MAX));
    cell.as_ivec2()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_far_away_have_neighbors() {
        assert_eq!(cell_of(DVec2::new(-0.1, 7.9), 2.0), IVec2::new(-1, 3));
        for far in [1e12, 1e300, f64::INFINITY] {
            let cell = cell_of(DVec2::new(far, -far), 0.5);
            assert_eq!(cell, IVec2::new(1 << 30, -(1 << 30)));
            assert!((cell + 1000).x > cell.x && (cell - 1000).y < cell.y);
        }
        let [x, y] = cell_of(DVec2::NAN, 1.0).to_array();
        assert!(x.checked_add(1000).is_some() && y.checked_sub(1000).is_some());
    }
}
