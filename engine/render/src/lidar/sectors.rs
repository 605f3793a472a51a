//! Sectors of a sweep: runs of columns of the grid of beams, each drawn like an image of its own.

use std::collections::HashMap;
use std::ops::Range;

use decouplegs_scene::lidar::{Beam, LidarCells, NO_BEAM};
use decouplegs_scene::{Camera, Intrinsics, Lidar, Motion, Pose};
use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::layout::{BeamRecord, CAMERAS_MAX, FiringRecord, SectorRecord};
use crate::stages::SectorTables;
use crate::twins::lidar::around;

/// A sector with more than this angle lists every splat in all of its columns: the order of
/// azimuths has an end.
const SPAN_MAX_RAD: f64 = 5.5;

/// Rounding of the way of the sensor, at most, meters.
const ROUNDING_M: f64 = 1e-5;

/// Cut of a model's grid into sectors, which all of its sweeps have in common.
#[derive(Clone, Debug)]
pub struct SectorPlan {
    sectors: Vec<PlannedSector>,
}

/// One sector of a plan.
#[derive(Clone, Debug)]
struct PlannedSector {
    /// Columns of the grid.
    columns: Range<usize>,
    /// First and last time of firing, seconds after the start of the sweep.
    time_s: [f64; 2],
    /// Lowest and highest azimuth, radians.
    azimuth_rad: [f64; 2],
    /// Times of firing, each once.
    times_s: Vec<f64>,
    /// Times of firing of the sectors before.
    first_firing: u32,
    /// Cells as they are read, `[row][column]`.
    cells: Vec<PlannedCell>,
}

/// A cell of the grid of a sector.
#[derive(Clone, Copy, Debug)]
struct PlannedCell {
    /// Direction of its beam in the axes of the sensor.
    direction: DVec3,
    /// Index of its beam; [`NO_BEAM`] where it has none.
    beam: u32,
    /// Index in `times_s`.
    firing: u32,
}

impl SectorPlan {
    /// The grid `cells` of `beams`, cut into `count` sectors or fewer. Explicit rays always become
    /// as many sectors as a sweep can have.
    #[must_use]
    pub fn new(beams: &[Beam], cells: &LidarCells, count: usize) -> Self {
        let blocks = cells.blocks.len();
        let pieces = match blocks {
            1 => count,
            _ => CAMERAS_MAX / blocks,
        };
        let ends = cells.blocks.iter().copied().skip(1).chain([cells.columns]);
        let cut = |(&first, end): (&usize, usize)| {
            let columns = end - first;
            let pieces = pieces.clamp(1, columns);
            let at = move |piece: usize| first + columns * piece / pieces;
            (0..pieces).map(move |piece| at(piece)..at(piece + 1))
        };
        let pieces: Vec<Range<usize>> = cells.blocks.iter().zip(ends).flat_map(cut).collect();
        let sector = |columns: &Range<usize>| PlannedSector::new(beams, cells, columns.clone());
        let mut sectors: Vec<PlannedSector> = pieces.par_iter().filter_map(sector).collect();
        let mut first_firing = 0;
        for sector in &mut sectors {
            sector.first_firing = first_firing;
            first_firing += sector.times_s.len() as u32;
        }
        Self { sectors }
    }
}

impl PlannedSector {
    /// The sector of `columns`; `None` where they have no beam.
    fn new(beams: &[Beam], cells: &LidarCells, columns: Range<usize>) -> Option<Self> {
        let by_column = &cells.beams[columns.start * cells.rows..columns.end * cells.rows];
        let of_cell = |cell: u32| (cell != NO_BEAM).then(|| &beams[cell as usize]);
        let filled = || by_column.iter().filter_map(|&cell| of_cell(cell));
        let first = *filled().next()?;
        let mut known: HashMap<u64, u32> = HashMap::new();
        let mut times_s = Vec::new();
        let width = columns.len();
        let empty = PlannedCell {
            direction: DVec3::ZERO,
            beam: NO_BEAM,
            firing: 0,
        };
        let mut planned = vec![empty; by_column.len()];
        for (index, &cell) in by_column.iter().enumerate() {
            let Some(beam) = of_cell(cell) else { continue };
            let firing = *known.entry(beam.time_s.to_bits()).or_insert_with(|| {
                times_s.push(beam.time_s);
                times_s.len() as u32 - 1
            });
            planned[index % cells.rows * width + index / cells.rows] = PlannedCell {
                direction: beam.direction,
                beam: cell,
                firing,
            };
        }
        Some(Self {
            columns,
            time_s: [
                times_s.iter().copied().fold(f64::INFINITY, f64::min),
                times_s.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            ],
            azimuth_rad: azimuths(&first, filled()),
            times_s,
            first_firing: 0,
            cells: planned,
        })
    }
}

/// Sectors of one sweep.
#[derive(Clone, Debug)]
pub struct Sectors {
    /// A camera per sector, whose pose is the sector's axes in the middle of its time, and whose
    /// image is its grid.
    pub cameras: Vec<Camera>,
    /// Middle of each sector's time after the start of the sweep, seconds.
    pub times_s: Vec<f64>,
    /// Tables of the kernels.
    pub tables: SectorTables,
}

/// One sector by itself.
struct Sector {
    camera: Camera,
    time_s: f64,
    record: SectorRecord,
    column_bounds: Vec<[f32; 2]>,
    row_bounds: Vec<[f32; 2]>,
    firings: Vec<FiringRecord>,
}

impl Sectors {
    /// The sectors of the sweep of `lidar`, whose grid and plan are given. The memory of `records`
    /// becomes that of the beams of the tables.
    #[must_use]
    pub fn new(
        lidar: &Lidar,
        cells: &LidarCells,
        plan: &SectorPlan,
        mut records: Vec<BeamRecord>,
    ) -> Self {
        let sizes = || plan.sectors.iter().map(|sector| sector.cells.len());
        records.resize(sizes().sum(), BeamRecord::default());
        let mut rest = &mut records[..];
        let of_sectors: Vec<&mut [BeamRecord]> = sizes()
            .map(|size| rest.split_off_mut(..size).expect("sizes add up"))
            .collect();
        let sectors: Vec<Sector> = (plan.sectors.par_iter().zip(of_sectors))
            .map(|(planned, records)| Sector::new(lidar, cells.rows, planned, records))
            .collect();
        let mut all = Self {
            cameras: Vec::new(),
            times_s: Vec::new(),
            tables: SectorTables {
                beams: records,
                ..SectorTables::default()
            },
        };
        for sector in sectors {
            let tables = &mut all.tables;
            tables.sectors.push(SectorRecord {
                first_column: tables.column_bounds.len() as u32,
                first_row: tables.row_bounds.len() as u32,
                ..sector.record
            });
            tables.column_bounds.extend(sector.column_bounds);
            tables.row_bounds.extend(sector.row_bounds);
            tables.firings.extend(sector.firings);
            all.cameras.push(sector.camera);
            all.times_s.push(sector.time_s);
        }
        all
    }
}

impl Sector {
    /// The sector `planned`, whose beams become `records`, row by row.
    fn new(
        lidar: &Lidar,
        rows: usize,
        planned: &PlannedSector,
        records: &mut [BeamRecord],
    ) -> Self {
        let columns = &planned.columns;
        let width = columns.len();
        let [start_s, end_s] = planned.time_s;
        let time_s = 0.5 * (start_s + end_s);
        let [low_rad, high_rad] = planned.azimuth_rad;
        let is_wide = high_rad - low_rad > SPAN_MAX_RAD;
        let middle_rad = 0.5 * (low_rad + high_rad);
        let sensor_from_sector = Pose::new(DQuat::from_rotation_z(middle_rad), DVec3::ZERO);
        let middle = lidar.pose_at(time_s).then(&sensor_from_sector);
        let way = Way {
            lidar,
            middle,
            time_s,
        };
        let velocity = match end_s > start_s {
            true => (way.offset(end_s) - way.offset(start_s)) / (end_s - start_s),
            false => DVec3::ZERO,
        };
        let fired = Fired::new(&way, velocity, &planned.times_s);
        let mut row_bounds = vec![NOTHING; rows];
        let cells = planned.cells.par_chunks(width);
        let of_rows = records.par_chunks_mut(width).zip(cells);
        let of_rows = of_rows.zip(&mut row_bounds);
        let place = |mut columns: Vec<[f32; 2]>, ((records, cells), bounds): RowOfSector<'_>| {
            for ((record, cell), column) in records.iter_mut().zip(cells).zip(&mut columns) {
                if cell.beam == NO_BEAM {
                    *record = BeamRecord::default();
                    continue;
                }
                let direction = fired.turns[cell.firing as usize] * cell.direction;
                let direction = direction.as_vec3();
                *record = BeamRecord {
                    direction: direction.to_array(),
                    firing: planned.first_firing + cell.firing,
                    index: cell.beam,
                };
                widen(bounds, direction.z / direction.truncate().length());
                if !is_wide {
                    widen(column, around(direction.x, direction.y));
                }
            }
            columns
        };
        let none = || vec![NOTHING; width];
        // Of rows that one thread has, some columns may have no beam: their bounds are those of
        // nothing, and add nothing.
        let mut column_bounds = of_rows.fold(none, place).reduce(none, |mut all, others| {
            for (bounds, [low, high]) in all.iter_mut().zip(others) {
                *bounds = [bounds[0].min(low), bounds[1].max(high)];
            }
            all
        });
        if is_wide {
            column_bounds.fill([-4.0, 4.0]);
        }
        make_rise(&mut column_bounds);
        row_bounds.reverse();
        make_rise(&mut row_bounds);
        row_bounds.reverse();
        let intrinsics = Intrinsics::from_horizontal_fov(width as u32, rows as u32, 1.0);
        Self {
            camera: Camera {
                name: format!(
                    "{}, columns {} to {}",
                    lidar.name, columns.start, columns.end
                ),
                intrinsics,
                world_from_camera: middle,
                motion: Motion::REST,
            },
            time_s,
            record: SectorRecord {
                velocity_mps: velocity.as_vec3().to_array(),
                half_time_s: (0.5 * (end_s - start_s) * 1.001) as f32,
                residual_m: (fired.residual_m + ROUNDING_M) as f32,
                ..SectorRecord::default()
            },
            column_bounds,
            row_bounds,
            firings: fired.firings,
        }
    }
}

/// Bounds of no values.
const NOTHING: [f32; 2] = [f32::INFINITY, f32::NEG_INFINITY];

/// Records of a row that are written, its cells, and the bounds of its slopes.
type RowOfSector<'a> = ((&'a mut [BeamRecord], &'a [PlannedCell]), &'a mut [f32; 2]);

/// Lowest and highest azimuth of `beams`, radians. They are counted from that of `first`, so that
/// none is cut at half a turn.
fn azimuths<'a>(first: &Beam, beams: impl Iterator<Item = &'a Beam>) -> [f64; 2] {
    let start_rad = first.direction.y.atan2(first.direction.x);
    let turn = DQuat::from_rotation_z(-start_rad);
    let beyond = |beam: &Beam| {
        let direction = turn * beam.direction;
        direction.y.atan2(direction.x)
    };
    let [low, high] = beams.map(beyond).fold([0.0f64; 2], |[low, high], angle| {
        [low.min(angle), high.max(angle)]
    });
    [start_rad + low, start_rad + high]
}

/// Way of the sensor during a sector, in the axes of the sector.
struct Way<'a> {
    lidar: &'a Lidar,
    /// Axes and origin of the sector.
    middle: Pose,
    /// Middle of its time.
    time_s: f64,
}

impl Way<'_> {
    /// Position of the sensor.
    fn offset(&self, time_s: f64) -> DVec3 {
        let position = self.lidar.pose_at(time_s).translation;
        self.middle.rotation.conjugate() * (position - self.middle.translation)
    }

    /// Rotation of the sensor.
    fn turn(&self, time_s: f64) -> DQuat {
        self.middle.rotation.conjugate() * self.lidar.pose_at(time_s).rotation
    }
}

/// The sensor at the times of firing of a sector.
struct Fired {
    firings: Vec<FiringRecord>,
    turns: Vec<DQuat>,
    /// Longest distance of the sensor from where its mean velocity has it.
    residual_m: f64,
}

impl Fired {
    fn new(way: &Way<'_>, velocity: DVec3, times_s: &[f64]) -> Self {
        let mut fired = Self {
            firings: Vec::with_capacity(times_s.len()),
            turns: Vec::with_capacity(times_s.len()),
            residual_m: 0.0,
        };
        for &time_s in times_s {
            let (offset, since_s) = (way.offset(time_s), time_s - way.time_s);
            let residual_m = (offset - velocity * since_s).length();
            fired.residual_m = fired.residual_m.max(residual_m);
            fired.firings.push(FiringRecord {
                offset_m: offset.as_vec3().to_array(),
                time_s: since_s as f32,
            });
            fired.turns.push(way.turn(time_s));
        }
        fired
    }
}

fn widen(bounds: &mut [f32; 2], value: f32) {
    *bounds = [bounds[0].min(value), bounds[1].max(value)];
}

/// Widens bounds until both ends rise from one to the next: they are searched by halves.
fn make_rise(bounds: &mut [[f32; 2]]) {
    let mut highest = f32::NEG_INFINITY;
    for bound in &mut *bounds {
        highest = highest.max(bound[1]);
        bound[1] = highest;
    }
    let mut lowest = f32::INFINITY;
    for bound in bounds.iter_mut().rev() {
        lowest = lowest.min(bound[0]);
        bound[0] = lowest;
    }
}
