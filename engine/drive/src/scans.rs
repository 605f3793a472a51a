//! Ground and obstacles from the LiDAR scans of a recording.
//!
//! Scans are added one after the other, in world coordinates and corrected for the motion of the
//! vehicle, and are not kept: first to [`GroundScanner`], whose heights grow outward from the road
//! below the recorded way, then to [`ObstacleScanner`].

mod obstacles;

use std::collections::{HashMap, HashSet, VecDeque};

use glam::{DMat3, DVec2, DVec3, IVec2};
use rayon::prelude::*;

pub use obstacles::ObstacleScanner;

/// Side of a cell of the ground, meters.
const CELL_M: f64 = 0.25;
/// Largest distance of the ground from the way, meters.
const BESIDE_M: f64 = 25.0;
/// Side of the squares that are searched for the nearest place of the way, meters.
const SQUARE_M: f64 = 2.0;
/// Largest distance of a point from the height of the way next to it, meters.
const OFF_WAY_M: f64 = 3.0;
/// Most points that a cell keeps.
const KEPT: usize = 16;
/// Largest step between the ground of neighboring cells, meters: more than a kerb has.
const STEP_M: f64 = 0.2;
/// Fewest points of a surface.
const POINTS_MIN: usize = 3;
/// Reach of the cells that tell where a cell's ground is expected, in cells.
const REACH: i32 = 3;
/// Cells of one surface differ by less from its middle, meters.
const SURFACE_M: f64 = 0.06;
/// Least share of the cells around that are of a cell's surface; with fewer the cell is wrong.
const SURFACE_SHARE: f64 = 0.3;
/// Fewest cells of a plane.
const PLANE_CELLS_MIN: usize = 8;
const PLANE_ROUNDS: u32 = 4;
/// Weight of a slope of zero, square meters.
const SLOPE_WEIGHT: f64 = 0.02;
/// Height above the lowest points up to which points are ground, meters: grass and noise.
const THICK_M: f64 = 0.08;
/// Half of the width of the way whose height is that of the road below it, meters.
const HALF_WAY_M: f64 = 1.0;
/// Distance from the sensor within which points are those of the vehicle itself, meters.
pub const OWN_M: f64 = 2.7;

fn cell_of(xy_m: DVec2) -> IVec2 {
    crate::cells::cell_of(xy_m, CELL_M)
}

fn middle_of(cell: IVec2) -> DVec2 {
    (cell.as_dvec2() + 0.5) * CELL_M
}

/// The road below a recorded way, for the height that is expected next to it.
#[derive(Clone, Debug)]
struct Way {
    road_m: Vec<DVec3>,
    /// Index of the nearest place, by square.
    nearest: HashMap<IVec2, u32>,
}

impl Way {
    fn new(road_m: &[DVec3]) -> Self {
        let reach = (BESIDE_M / SQUARE_M).ceil() as i32;
        let mut nearest: HashMap<IVec2, u32> = HashMap::new();
        let square = |at: IVec2| (at.as_dvec2() + 0.5) * SQUARE_M;
        let road_m: Vec<DVec3> = road_m.iter().copied().filter(|at| at.is_finite()).collect();
        for (index, road) in road_m.iter().enumerate() {
            let at = road.truncate();
            let middle = crate::cells::cell_of(at, SQUARE_M);
            let around = (-reach..=reach)
                .flat_map(|x| (-reach..=reach).map(move |y| middle + IVec2::new(x, y)));
            for key in around.filter(|key| square(*key).distance(at) <= BESIDE_M) {
                let own = nearest.entry(key).or_insert(index as u32);
                let other = road_m[*own as usize].truncate();
                if square(key).distance(at) < square(key).distance(other) {
                    *own = index as u32;
                }
            }
        }
        Self { road_m, nearest }
    }

    /// The place of the road nearest to `xy_m`; `None` far from it.
    fn nearest(&self, xy_m: DVec2) -> Option<DVec3> {
        let key = crate::cells::cell_of(xy_m, SQUARE_M);
        self.nearest.get(&key).map(|&at| self.road_m[at as usize])
    }
}

/// Points of one cell: the nearest to their sensors, as errors of poses grow with the range.
#[derive(Clone, Debug, Default)]
struct Column {
    /// Ranges and heights, meters.
    points_m: Vec<[f32; 2]>,
}

impl Column {
    fn add(&mut self, range_m: f32, height_m: f32) {
        if self.points_m.len() < KEPT {
            self.points_m.push([range_m, height_m]);
            return;
        }
        let farther = |a: &&mut [f32; 2], b: &&mut [f32; 2]| a[0].total_cmp(&b[0]);
        if let Some(farthest) = self.points_m.iter_mut().max_by(farther)
            && range_m < farthest[0]
        {
            *farthest = [range_m, height_m];
        }
    }

    /// Height of the surface near `expected_m`: the middle of its lowest points.
    fn surface(&self, expected_m: f64) -> Option<f64> {
        let mut near: Vec<f64> = self.points_m.iter().map(|at| f64::from(at[1])).collect();
        near.retain(|z_m| (z_m - expected_m).abs() <= STEP_M);
        if near.len() < POINTS_MIN {
            return None;
        }
        near.sort_by(f64::total_cmp);
        let low_m = near[near.len() / 10];
        near.retain(|z_m| (low_m - THICK_M..=low_m + THICK_M).contains(z_m));
        Some(near[near.len() / 2])
    }
}

/// Gathers the ground below and beside a recorded way from scans.
#[derive(Clone, Debug)]
pub struct GroundScanner {
    way: Way,
    columns: HashMap<IVec2, Column>,
}

impl GroundScanner {
    /// A scanner along `road_m`, points of the road below the recorded way, world coordinates.
    #[must_use]
    pub fn new(road_m: &[DVec3]) -> Self {
        Self {
            way: Way::new(road_m),
            columns: HashMap::new(),
        }
    }

    /// Adds a scan from `sensor_m`, all in world coordinates, meters.
    pub fn add(&mut self, sensor_m: DVec3, points_m: &[DVec3]) {
        for point in points_m.iter().filter(|point| point.is_finite()) {
            let range_m = point.distance(sensor_m);
            if range_m < OWN_M {
                continue;
            }
            let Some(road) = self.way.nearest(point.truncate()) else {
                continue;
            };
            let above_m = point.z - road.z;
            if above_m.abs() <= OFF_WAY_M {
                let column = self.columns.entry(cell_of(point.truncate())).or_default();
                column.add(range_m as f32, point.z as f32);
            }
        }
    }

    /// The ground, grown from the way outward from cell to cell.
    #[must_use]
    pub fn ground(self) -> ScannedGround {
        let mut heights_m: HashMap<IVec2, f64> = HashMap::new();
        let mut asked: HashSet<IVec2> = HashSet::new();
        let mut next: VecDeque<IVec2> = VecDeque::new();
        let reach = (HALF_WAY_M / CELL_M).ceil() as i32;
        for road in &self.way.road_m {
            let middle = cell_of(road.truncate());
            for (x, y) in (-reach..=reach).flat_map(|x| (-reach..=reach).map(move |y| (x, y))) {
                let cell = middle + IVec2::new(x, y);
                let column = self.columns.get(&cell);
                if let Some(z_m) = column.and_then(|column| column.surface(road.z))
                    && asked.insert(cell)
                {
                    heights_m.insert(cell, z_m);
                    next.push_back(cell);
                }
            }
        }
        while let Some(from) = next.pop_front() {
            for side in [IVec2::X, IVec2::NEG_X, IVec2::Y, IVec2::NEG_Y] {
                // Rings of a scan leave gaps far away.
                for cell in (1..=2).map(|step| from + step * side) {
                    let Some(column) = self.columns.get(&cell).filter(|_| !asked.contains(&cell))
                    else {
                        continue;
                    };
                    let Some(expected_m) = expected(&heights_m, cell) else {
                        continue;
                    };
                    if let Some(z_m) = column.surface(expected_m) {
                        asked.insert(cell);
                        heights_m.insert(cell, z_m);
                        next.push_back(cell);
                    }
                }
            }
        }
        let smoothed = heights_m
            .par_iter()
            .map(|(&cell, &z_m)| (cell, smoothed(&heights_m, cell, z_m)));
        ScannedGround {
            heights_m: smoothed.collect(),
            way: self.way,
        }
    }
}

/// Height that the ground around `cell` leads to expect: the median of what is known near it.
fn expected(heights_m: &HashMap<IVec2, f64>, cell: IVec2) -> Option<f64> {
    let around = (-REACH..=REACH).flat_map(|x| (-REACH..=REACH).map(move |y| IVec2::new(x, y)));
    let mut near: Vec<f64> = around
        .filter_map(|offset| heights_m.get(&(cell + offset)).copied())
        .collect();
    near.sort_by(f64::total_cmp);
    near.get(near.len() / 2).copied()
}

/// Height `z_m` of `cell` by a plane through the cells around it that are of its surface: a cell
/// alone has the noise of a few points.
fn smoothed(heights_m: &HashMap<IVec2, f64>, cell: IVec2, z_m: f64) -> f64 {
    let around = (-REACH..=REACH).flat_map(|x| (-REACH..=REACH).map(move |y| IVec2::new(x, y)));
    let near: Vec<(DVec2, f64)> = around
        .filter_map(|offset| {
            let known = heights_m.get(&(cell + offset))?;
            Some((offset.as_dvec2() * CELL_M, *known))
        })
        .collect();
    if near.len() < PLANE_CELLS_MIN {
        return z_m;
    }
    let agree = near.iter().filter(|(_, z)| (z - z_m).abs() < SURFACE_M);
    let is_surface = agree.count() as f64 >= SURFACE_SHARE * near.len() as f64;
    let start_m = match is_surface {
        true => z_m,
        false => expected(heights_m, cell).unwrap_or(z_m),
    };
    // Height in the middle, and slopes.
    let (mut plane, mut band_m) = (DVec3::X * start_m, 2.0 * SURFACE_M);
    for _ in 0..PLANE_ROUNDS {
        // Slopes of zero where the cells do not tell them.
        let mut normal = DMat3::from_diagonal(DVec3::new(0.0, SLOPE_WEIGHT, SLOPE_WEIGHT));
        let mut right = DVec3::ZERO;
        for (offset, z) in &near {
            let row = DVec3::new(1.0, offset.x, offset.y);
            let off = (z - plane.dot(row)) / band_m;
            let weight = (1.0 - off * off).max(0.0).powi(2);
            normal += DMat3::from_cols(row * row.x, row * row.y, row * row.z) * weight;
            right += row * (weight * z);
        }
        let fitted = normal.inverse() * right;
        if !fitted.is_finite() {
            return z_m;
        }
        (plane, band_m) = (fitted, 1.5 * SURFACE_M);
    }
    plane.x
}

/// Ground along a recorded way.
#[derive(Clone, Debug)]
pub struct ScannedGround {
    way: Way,
    heights_m: HashMap<IVec2, f64>,
}

impl ScannedGround {
    /// One point per cell, world coordinates, meters, in an order that is always the same.
    #[must_use]
    pub fn points_m(&self) -> Vec<DVec3> {
        let mut cells: Vec<(IVec2, f64)> = self.heights_m.iter().map(|(c, z)| (*c, *z)).collect();
        cells.sort_unstable_by_key(|(cell, _)| cell.to_array());
        cells
            .into_iter()
            .map(|(cell, z_m)| middle_of(cell).extend(z_m))
            .collect()
    }

    /// Height of the ground at `xy_m`, from the cell or those next to it.
    #[must_use]
    pub fn height_at(&self, xy_m: DVec2) -> Option<f64> {
        let cell = cell_of(xy_m);
        let own = self.heights_m.get(&cell).copied();
        own.or_else(|| expected(&self.heights_m, cell))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A road along x with a slope of 2 % and a sidewalk of 0.12 m from y = 4 m on, and a wall from
    /// y = 8 m on; points every 0.1 m.
    fn scan() -> Vec<DVec3> {
        let mut points = Vec::new();
        for (x, y) in (0..400).flat_map(|x| (-80..80).map(move |y| (x, y))) {
            let (x, y) = (0.1 * f64::from(x), 0.1 * f64::from(y));
            let kerb = if y > 4.0 { 0.12 } else { 0.0 };
            points.push(DVec3::new(x, y, 0.02 * x + kerb));
        }
        points.extend((0..400).flat_map(|x| {
            (0..25).map(move |z| {
                DVec3::new(
                    0.1 * f64::from(x),
                    8.0,
                    0.002 * f64::from(x) + 0.1 * f64::from(z),
                )
            })
        }));
        points
    }

    fn road() -> Vec<DVec3> {
        (0..40)
            .map(|x| DVec3::new(f64::from(x), 0.0, 0.02 * f64::from(x)))
            .collect()
    }

    #[test]
    fn the_ground_grows_over_kerbs_and_not_up_walls_and_roofs() {
        let mut points = scan();
        // A roof of a parked car, and a reflection below the road.
        for (x, y) in (0..40).flat_map(|x| (0..18).map(move |y| (x, y))) {
            let at = DVec2::new(10.0 + 0.1 * f64::from(x), -5.0 + 0.1 * f64::from(y));
            points.retain(|point| point.truncate().distance(at) > 0.05);
            points.push(at.extend(1.6));
            points.push(at.extend(-1.2));
        }
        let mut scanner = GroundScanner::new(&road());
        scanner.add(DVec3::new(0.0, 0.0, 100.0), &points);
        let ground = scanner.ground();
        let found = ground.points_m();
        assert!(found.len() > 9000, "{}", found.len());
        for point in &found {
            let kerb = if point.y > 4.0 { 0.12 } else { 0.0 };
            let off_m = point.z - 0.02 * point.x - kerb;
            // The cells of the kerb itself are half of each.
            let bound_m = if (point.y - 4.0).abs() < 0.25 {
                0.13
            } else {
                0.02
            };
            assert!(off_m.abs() < bound_m, "{point}: {off_m}");
        }
        assert!((ground.height_at(DVec2::new(20.0, 6.0)).unwrap() - 0.52).abs() < 0.02);
        assert!(
            ground
                .height_at(DVec2::new(12.0, -4.0))
                .is_none_or(|z_m| z_m < 0.5)
        );
        assert!(ground.height_at(DVec2::new(20.0, 60.0)).is_none());
    }

    #[test]
    fn points_that_are_none_and_the_vehicle_itself_change_nothing() {
        let mut scanner = GroundScanner::new(&road());
        let own: Vec<DVec3> = (0..99)
            .map(|at| DVec3::new(5.0, 0.01 * f64::from(at), 0.3))
            .collect();
        scanner.add(DVec3::new(5.0, 0.0, 1.7), &own);
        scanner.add(
            DVec3::ZERO,
            &[DVec3::NAN, DVec3::splat(1e300), DVec3::INFINITY],
        );
        assert!(scanner.ground().points_m().is_empty());
        assert!(GroundScanner::new(&[]).ground().points_m().is_empty());
    }
}
