//! Splats as pieces of surface, and a grid to find those near a column.

use decouplegs_scene::SplatCloud;
use decouplegs_scene::shape::{PrincipalAxes, triangular_factor};
use glam::DVec2;
use rayon::prelude::*;

/// Height that a splat spans at one position where it counts half, meters. Road splats span
/// millimeters, leaves decimeters.
const FLAT_SPAN_M: f64 = 0.1;
/// Least weight in the middle of a column: smaller surfels cannot carry a surface.
const SHARE_MIN: f64 = 2e-3;
/// Radius of a splat, standard deviations.
const RADIUS_SIGMAS: f64 = 3.0;
/// Cells of the finest grid, meters; each further one has twice the size.
const CELL_M: f64 = 0.5;
/// Grids; a splat lies in the finest whose cells are as large as its radius. Wider ones count
/// within the largest cell only.
const LEVELS: usize = 5;
/// Largest distance from the origin, meters: farther away, f32 means have no centimeters left.
const EXTENT_M: f32 = 1e5;

/// Part of a splat within a column. With S the horizontal covariance of the splat, c the column's
/// sigma and d from mean to column: the share is `alpha sqrt(det S / det S') exp(-d S'^-1 d / 2)`
/// with `S' = S + c^2`, the Gaussian integrated over the column.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    pub mean: [f32; 3],
    /// S'^-1: xx, xy, yy.
    inverse: [f32; 3],
    /// Height by d of the part inside: the covariance of z with x and y, times S'^-1.
    slope: [f32; 2],
    /// Share where d is zero, thick splats' lessened.
    share: f32,
}

/// A splat as seen from a column.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Height of the part inside.
    pub height: f32,
    /// Offset of that part from the column's axis, meters: `c^2 S'^-1 (mean - axis)`.
    pub offset: [f32; 2],
    /// Weight of this part.
    pub share: f32,
}

impl Surfel {
    /// `None` for a splat that shows no surface, and its radius in meters otherwise.
    fn from_splat(cloud: &SplatCloud, splat: usize, column_sigma_m: f64) -> Option<(Self, f64)> {
        let mean = cloud.means[splat];
        if cloud.defect_of(splat).is_some() || mean.iter().any(|x| x.abs() > EXTENT_M) {
            return None;
        }
        let axes = PrincipalAxes {
            scales: cloud.scales[splat],
            rotation: cloud.rotations[splat],
        };
        let [xx, yx, yy, zx, zy, zz] = triangular_factor(&axes);
        // Sigma = L L^T; given x and y, z varies by the last diagonal entry alone.
        let (sxx, sxy, syy) = (xx * xx, xx * yx, yx * yx + yy * yy);
        let (szx, szy) = (zx * xx, zx * yx + zy * yy);
        let column = column_sigma_m * column_sigma_m;
        let (wxx, wyy) = (sxx + column, syy + column);
        let determinant = wxx * wyy - sxy * sxy;
        let inverse = [wyy / determinant, -sxy / determinant, wxx / determinant];
        let flat = 1.0 / (1.0 + (zz / FLAT_SPAN_M).powi(2));
        let share = f64::from(cloud.opacities[splat]) * flat * (xx * yy / determinant.sqrt());
        let slope = [
            szx * inverse[0] + szy * inverse[1],
            szx * inverse[1] + szy * inverse[2],
        ];
        let widest = 0.5 * (wxx + wyy) + (0.25 * (wxx - wyy).powi(2) + sxy * sxy).sqrt();
        let radius_m = RADIUS_SIGMAS * widest.sqrt();
        let surfel = Self {
            mean,
            inverse: inverse.map(|x| x as f32),
            slope: slope.map(|x| x as f32),
            share: share as f32,
        };
        let finite = radius_m.is_finite() && inverse.iter().chain(&slope).all(|x| x.is_finite());
        (finite && share >= SHARE_MIN).then_some((surfel, radius_m))
    }

    fn sample(&self, axis: DVec2, column_sigma_m: f64) -> Option<Sample> {
        let (dx, dy) = (axis.x as f32 - self.mean[0], axis.y as f32 - self.mean[1]);
        let (ix, iy) = (
            self.inverse[0] * dx + self.inverse[1] * dy,
            self.inverse[1] * dx + self.inverse[2] * dy,
        );
        let squared = ix * dx + iy * dy;
        if squared > (RADIUS_SIGMAS * RADIUS_SIGMAS) as f32 {
            return None;
        }
        let column = (column_sigma_m * column_sigma_m) as f32;
        let height = self.mean[2] + self.slope[0] * dx + self.slope[1] * dy;
        Some(Sample {
            height,
            offset: [-column * ix, -column * iy],
            share: self.share * (-0.5 * squared).exp(),
        })
    }
}

/// Surfels by the cell of their mean, in grids of several sizes.
pub struct SurfelGrid {
    levels: Vec<Level>,
    column_sigma_m: f64,
}

struct Level {
    cell_m: f64,
    /// Cells that hold any, rising.
    cells: Vec<[i32; 2]>,
    /// First surfel of each cell, and one past the last.
    starts: Vec<u32>,
    surfels: Vec<Surfel>,
}

impl SurfelGrid {
    pub fn new(cloud: &SplatCloud, column_sigma_m: f64) -> Self {
        let surfels = (0..cloud.len())
            .into_par_iter()
            .filter_map(|splat| Surfel::from_splat(cloud, splat, column_sigma_m));
        let surfels: Vec<(Surfel, f64)> = surfels.collect();
        let level_of =
            |radius_m: f64| ((radius_m / CELL_M).log2().ceil().max(0.0) as usize).min(LEVELS - 1);
        let levels = (0..LEVELS).map(|level| {
            let own: Vec<Surfel> = surfels
                .iter()
                .filter(|(_, radius_m)| level_of(*radius_m) == level)
                .map(|(surfel, _)| *surfel)
                .collect();
            Level::new(own, CELL_M * f64::from(1u32 << level))
        });
        Self {
            levels: levels.collect(),
            column_sigma_m,
        }
    }

    /// Appends the samples of the column around `axis` to `samples`.
    pub fn samples_at(&self, axis: DVec2, samples: &mut Vec<Sample>) {
        for level in self.levels.iter().filter(|level| !level.surfels.is_empty()) {
            let [x, y] = cell_of(axis, level.cell_m);
            for near_x in x - 1..=x + 1 {
                // The cells of one column of the grid follow one another.
                let from = level.cells.partition_point(|cell| *cell < [near_x, y - 1]);
                let to = from
                    + level.cells[from..]
                        .iter()
                        .take(3)
                        .take_while(|cell| **cell <= [near_x, y + 1])
                        .count();
                let surfels =
                    &level.surfels[level.starts[from] as usize..level.starts[to] as usize];
                samples.extend(
                    surfels
                        .iter()
                        .filter_map(|surfel| surfel.sample(axis, self.column_sigma_m)),
                );
            }
        }
    }

    /// Squares that any surfel may touch: lower corner and size in meters.
    pub fn reached(&self) -> impl Iterator<Item = (DVec2, f64)> + '_ {
        self.levels.iter().flat_map(|level| {
            let size = level.cell_m;
            level.cells.iter().map(move |cell| {
                (
                    DVec2::new(f64::from(cell[0]) - 1.0, f64::from(cell[1]) - 1.0) * size,
                    3.0 * size,
                )
            })
        })
    }
}

impl Level {
    fn new(mut surfels: Vec<Surfel>, cell_m: f64) -> Self {
        let cell = |surfel: &Surfel| {
            cell_of(
                DVec2::new(f64::from(surfel.mean[0]), f64::from(surfel.mean[1])),
                cell_m,
            )
        };
        // A stable sort: sums over a cell must not depend on the number of threads.
        surfels.par_sort_by_cached_key(cell);
        let (mut cells, mut starts): (Vec<[i32; 2]>, Vec<u32>) = (Vec::new(), Vec::new());
        for (at, surfel) in surfels.iter().enumerate() {
            let own = cell(surfel);
            if cells.last() != Some(&own) {
                cells.push(own);
                starts.push(at as u32);
            }
        }
        starts.push(surfels.len() as u32);
        Self {
            cell_m,
            cells,
            starts,
            surfels,
        }
    }
}

fn cell_of(at: DVec2, cell_m: f64) -> [i32; 2] {
    crate::cells::cell_of(at, cell_m).to_array()
}
