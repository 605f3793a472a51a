//! Arrangement of beams in a grid in which neighbors are neighbors in space.

use super::{LidarModel, LidarPattern, Spin};

/// A cell without a beam.
pub const NO_BEAM: u32 = u32::MAX;

/// Rows of the grid of explicit rays.
const RAY_ROWS: usize = 64;

/// Beams of a sweep in a grid: columns by rising azimuth, rows by falling elevation. Each beam has
/// one cell.
///
/// The row offsets of a spinning LiDAR shift beams by whole columns. The grid does not wrap around:
/// beams that cross the seam of the sweep have cells beyond it, beside others of their own time.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarCells {
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
    /// Beam of each cell, `[column][row]`, or [`NO_BEAM`].
    pub beams: Vec<u32>,
}

impl LidarModel {
    /// The grid of the beams that [`LidarModel::beams`] lists.
    #[must_use]
    pub fn cells(&self) -> LidarCells {
        match &self.pattern {
            LidarPattern::Spinning {
                rows,
                columns,
                field_rad,
                spin,
                ..
            } => {
                let step_rad = field_rad / f64::from(*columns);
                let shift = |offset_rad: f64| (offset_rad / step_rad).round() as i64;
                let shifts: Vec<i64> = rows
                    .iter()
                    .map(|row| shift(row.azimuth_offset_rad))
                    .collect();
                // Columns to the left of the leftmost place that a row can have.
                let least = shifts.iter().copied().min().unwrap_or(0);
                let greatest = shifts.iter().copied().max().unwrap_or(0);
                let count = *columns as usize;
                let place = |column: usize, row: usize| {
                    let along = match spin {
                        Spin::Clockwise => count - 1 - column,
                        Spin::CounterClockwise => column,
                    };
                    along + (shifts[row] - least) as usize
                };
                let mut cells = LidarCells {
                    columns: count + (greatest - least) as usize,
                    rows: rows.len(),
                    beams: Vec::new(),
                };
                cells.beams = vec![NO_BEAM; cells.columns * cells.rows];
                for column in 0..count {
                    for row in 0..rows.len() {
                        let cell = place(column, row) * rows.len() + row;
                        cells.beams[cell] = (column * rows.len() + row) as u32;
                    }
                }
                cells
            }
            LidarPattern::Rays(beams) => {
                let azimuth = |beam: u32| {
                    let direction = beams[beam as usize].direction;
                    direction.y.atan2(direction.x)
                };
                let up = |beam: u32| beams[beam as usize].direction.z;
                let mut order: Vec<u32> = (0..beams.len() as u32).collect();
                order.sort_by(|&a, &b| azimuth(a).total_cmp(&azimuth(b)));
                let mut cells = LidarCells {
                    columns: beams.len().div_ceil(RAY_ROWS),
                    rows: RAY_ROWS,
                    beams: order,
                };
                for column in cells.beams.chunks_mut(RAY_ROWS) {
                    column.sort_by(|&a, &b| up(b).total_cmp(&up(a)));
                }
                cells.beams.resize(cells.columns * RAY_ROWS, NO_BEAM);
                cells
            }
        }
    }
}
