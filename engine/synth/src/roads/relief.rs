//! The height of the land and how far it is from roads, on a coarse grid over the map and its
//! surroundings.

use std::collections::VecDeque;

use glam::{Vec2, Vec3};

use super::strip_index::StripIndex;

/// Land beyond the outermost lanes, meters.
const MARGIN_M: f32 = 350.0;

/// Cells a side at most.
const CELLS_MAX: f32 = 512.0;

/// Smallest width of a cell, meters.
const CELL_M_MIN: f32 = 4.0;

/// Number of times that heights off the roads are averaged with their neighbors: embankments become
/// slopes.
const SMOOTHINGS: usize = 24;

/// Heights and distances, row by row from the corner of least x and y.
pub(super) struct Relief {
    corner: Vec2,
    cell_m: f32,
    columns: usize,
    rows: usize,
    height_m: Vec<f32>,
    distance_m: Vec<f32>,
    mean_z_m: f32,
}

impl Relief {
    pub(super) fn new(index: &StripIndex) -> Self {
        let points = || {
            index.strips.iter().flat_map(|strip| {
                strip
                    .sections
                    .iter()
                    .flat_map(|section| [section.left, section.right])
            })
        };
        let low = points().fold(Vec3::ZERO, Vec3::min).truncate() - MARGIN_M;
        let high = points().fold(Vec3::ZERO, Vec3::max).truncate() + MARGIN_M;
        let cell_m = CELL_M_MIN.max((high - low).max_element() / CELLS_MAX);
        let cells = ((high - low) / cell_m).ceil().max(Vec2::ONE);
        let (columns, rows) = (cells.x as usize, cells.y as usize);
        let count = points().count();
        let mean_z_m = points().map(|point| f64::from(point.z)).sum::<f64>() / count.max(1) as f64;
        let mut relief = Self {
            corner: low,
            cell_m,
            columns,
            rows,
            height_m: vec![mean_z_m as f32; columns * rows],
            distance_m: vec![f32::MAX; columns * rows],
            mean_z_m: mean_z_m as f32,
        };
        relief.spread(points());
        relief
    }

    fn cell(&self, point: Vec2) -> usize {
        let cell = ((point - self.corner) / self.cell_m)
            .floor()
            .max(Vec2::ZERO);
        (cell.y as usize).min(self.rows - 1) * self.columns
            + (cell.x as usize).min(self.columns - 1)
    }

    /// Up to four neighbors of a cell.
    fn neighbors(&self, cell: usize) -> impl Iterator<Item = usize> {
        let (column, row) = (cell % self.columns, cell / self.columns);
        let (columns, rows) = (self.columns, self.rows);
        let sides = [
            (column > 0, -1isize),
            (column + 1 < columns, 1),
            (row > 0, -(columns as isize)),
            (row + 1 < rows, columns as isize),
        ];
        sides
            .into_iter()
            .filter(|(there, _)| *there)
            .map(move |(_, step)| cell.wrapping_add_signed(step))
    }

    /// Spreads heights from the lowest of `points` in each cell to all land, nearest first.
    fn spread(&mut self, points: impl Iterator<Item = Vec3>) {
        let mut seeds = vec![f32::MAX; self.height_m.len()];
        for point in points {
            let cell = self.cell(point.truncate());
            seeds[cell] = seeds[cell].min(point.z);
        }
        let mut queue: VecDeque<usize> = (0..seeds.len())
            .filter(|&cell| seeds[cell] < f32::MAX)
            .collect();
        for &cell in &queue {
            self.height_m[cell] = seeds[cell];
            self.distance_m[cell] = 0.0;
        }
        while let Some(cell) = queue.pop_front() {
            for next in self.neighbors(cell).collect::<Vec<_>>() {
                if self.distance_m[next] == f32::MAX {
                    self.distance_m[next] = self.distance_m[cell] + self.cell_m;
                    self.height_m[next] = self.height_m[cell];
                    queue.push_back(next);
                }
            }
        }
        for _ in 0..SMOOTHINGS {
            let smoothed = |cell: usize| {
                let (sum, count) = self.neighbors(cell).fold((0.0, 0.0), |(sum, count), next| {
                    (sum + self.height_m[next], count + 1.0)
                });
                if self.distance_m[cell] == 0.0 || count == 0.0 {
                    self.height_m[cell]
                } else {
                    sum / count
                }
            };
            self.height_m = (0..self.height_m.len()).map(smoothed).collect();
        }
    }

    /// Height of the land, bilinear between the middles of cells, meters.
    pub(super) fn height_m(&self, point: Vec2) -> f32 {
        let half = 0.5 * self.cell_m;
        let place = (point - self.corner) / self.cell_m - 0.5;
        let place = place - place.floor();
        let at = |dx: f32, dy: f32| {
            let low = ((point - self.corner) / self.cell_m - 0.5).floor() + Vec2::new(dx, dy);
            self.height_m[self.cell(self.corner + low * self.cell_m + half)]
        };
        let low = at(0.0, 0.0) + (at(1.0, 0.0) - at(0.0, 0.0)) * place.x;
        let high = at(0.0, 1.0) + (at(1.0, 1.0) - at(0.0, 1.0)) * place.x;
        low + (high - low) * place.y
    }

    /// About how far the nearest lane is, meters; beyond the grid as at its border.
    pub(super) fn distance_m(&self, point: Vec2) -> f32 {
        let distance_m = self.distance_m[self.cell(point)];
        if distance_m == f32::MAX {
            MARGIN_M
        } else {
            distance_m
        }
    }

    /// Distance from the origin to the corners of the grid, meters.
    pub(super) fn radius_m(&self) -> f32 {
        let far = self.corner + Vec2::new(self.columns as f32, self.rows as f32) * self.cell_m;
        self.corner.abs().max(far.abs()).length()
    }

    /// Mean height of all lanes, meters.
    pub(super) fn mean_z_m(&self) -> f32 {
        self.mean_z_m
    }
}
