//! Arrangement of beams in a grid in which neighbors are neighbors in space.

use super::{Beam, LidarModel, LidarPattern, Spin};

/// A cell without a beam.
pub const NO_BEAM: u32 = u32::MAX;

/// Rows of the grid of explicit rays.
const RAY_ROWS: usize = 64;

/// Blocks of time into which explicit rays are cut.
const RAY_BLOCKS: f64 = 8.0;

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
    /// First columns of blocks. The beams of a block are neighbors in time; azimuths rise within a
    /// block.
    pub blocks: Vec<usize>,
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
                    blocks: vec![0],
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
            LidarPattern::Rays(beams) => self.cells_of_rays(beams),
        }
    }

    /// The grid of explicit rays: rays that are fired one after the other may go anywhere, so time
    /// comes before azimuth.
    fn cells_of_rays(&self, beams: &[Beam]) -> LidarCells {
        let direction = |beam: u32| beams[beam as usize].direction;
        let azimuth = |beam: u32| direction(beam).y.atan2(direction(beam).x);
        let block = |beam: u32| {
            let share = beams[beam as usize].time_s / self.sweep_s;
            (RAY_BLOCKS * share).min(RAY_BLOCKS - 1.0) as usize
        };
        let mut order: Vec<u32> = (0..beams.len() as u32).collect();
        order.sort_by(|&a, &b| {
            let later = block(a).cmp(&block(b));
            later.then(azimuth(a).total_cmp(&azimuth(b)))
        });
        let mut cells = LidarCells {
            columns: 0,
            rows: RAY_ROWS,
            beams: Vec::new(),
            blocks: Vec::new(),
        };
        for together in order.chunk_by(|&a, &b| block(a) == block(b)) {
            cells.blocks.push(cells.columns);
            for column in together.chunks(RAY_ROWS) {
                let mut column = column.to_vec();
                column.sort_by(|&a, &b| direction(b).z.total_cmp(&direction(a).z));
                column.resize(RAY_ROWS, NO_BEAM);
                cells.beams.extend(column);
                cells.columns += 1;
            }
        }
        cells
    }
}
