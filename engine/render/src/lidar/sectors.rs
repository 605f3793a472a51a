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
    /// Beam of each cell, in the order of [`SectorTables::beams`].
    pub beam_of_cell: Vec<u32>,
}

/// One sector by itself.
struct Sector {
    camera: Camera,
    time_s: f64,
    record: SectorRecord,
    column_bounds: Vec<[f32; 2]>,
    row_bounds: Vec<[f32; 2]>,
    beams: Vec<BeamRecord>,
    firings: Vec<FiringRecord>,
    beam_of_cell: Vec<u32>,
}

impl Sectors {
    /// Cuts the sweep of `lidar`, whose beams and grid are given, into `count` sectors or fewer.
    /// Explicit rays always become as many sectors as a sweep can have.
    #[must_use]
    pub fn new(lidar: &Lidar, beams: &[Beam], cells: &LidarCells, count: usize) -> Self {
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
        let sector = |columns: &Range<usize>| Sector::new(lidar, beams, cells, columns.clone());
        let sectors: Vec<Sector> = pieces.par_iter().filter_map(sector).collect();
        let mut all = Self {
            cameras: Vec::new(),
            times_s: Vec::new(),
            tables: SectorTables::default(),
            beam_of_cell: Vec::new(),
        };
        for sector in sectors {
            let tables = &mut all.tables;
            let first_firing = tables.firings.len() as u32;
            tables.sectors.push(SectorRecord {
                first_column: tables.column_bounds.len() as u32,
                first_row: tables.row_bounds.len() as u32,
                ..sector.record
            });
            tables.column_bounds.extend(sector.column_bounds);
            tables.row_bounds.extend(sector.row_bounds);
            tables.firings.extend(sector.firings);
            tables
                .beams
                .extend(sector.beams.iter().map(|beam| BeamRecord {
                    firing: beam.firing + first_firing,
                    ..*beam
                }));
            all.beam_of_cell.extend(sector.beam_of_cell);
            all.cameras.push(sector.camera);
            all.times_s.push(sector.time_s);
        }
        all
    }
}

impl Sector {
    /// The sector of `columns` of the grid; `None` where they have no beam.
    fn new(
        lidar: &Lidar,
        beams: &[Beam],
        cells: &LidarCells,
        columns: Range<usize>,
    ) -> Option<Self> {
        let (width, rows) = (columns.len(), cells.rows);
        let by_column = &cells.beams[columns.start * rows..columns.end * rows];
        let of_cell = |cell: u32| (cell != NO_BEAM).then(|| &beams[cell as usize]);
        let filled = || by_column.iter().filter_map(|&cell| of_cell(cell));
        let first = *filled().next()?;
        let times = || filled().map(|beam| beam.time_s);
        let (start_s, end_s) = (
            times().fold(f64::INFINITY, f64::min),
            times().fold(f64::NEG_INFINITY, f64::max),
        );
        let time_s = 0.5 * (start_s + end_s);
        let [low_rad, high_rad] = azimuths(&first, filled());
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
        let mut fired = Fired::new(&way, velocity);
        let mut records = vec![BeamRecord::default(); width * rows];
        let mut beam_of_cell = vec![NO_BEAM; width * rows];
        let mut column_bounds = vec![[f32::INFINITY, f32::NEG_INFINITY]; width];
        let mut row_bounds = vec![[f32::INFINITY, f32::NEG_INFINITY]; rows];
        for (at, &cell) in by_column.iter().enumerate() {
            let Some(beam) = of_cell(cell) else {
                continue;
            };
            let (column, row) = (at / rows, at % rows);
            let firing = fired.at(beam.time_s);
            let turn = fired.turns[firing as usize];
            let direction = (turn * beam.direction).as_vec3();
            let index = row * width + column;
            records[index] = BeamRecord {
                direction: direction.to_array(),
                firing,
            };
            beam_of_cell[index] = cell;
            widen(&mut column_bounds[column], around(direction.x, direction.y));
            let slope = direction.z / direction.truncate().length();
            widen(&mut row_bounds[row], slope);
        }
        if is_wide {
            column_bounds.fill([-4.0, 4.0]);
        }
        make_rise(&mut column_bounds);
        row_bounds.reverse();
        make_rise(&mut row_bounds);
        row_bounds.reverse();
        let intrinsics = Intrinsics::from_horizontal_fov(width as u32, rows as u32, 1.0);
        Some(Self {
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
            beams: records,
            firings: fired.firings,
            beam_of_cell,
        })
    }
}

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

/// Times of firing of a sector, each once.
struct Fired<'a> {
    way: &'a Way<'a>,
    velocity: DVec3,
    known: HashMap<u64, u32>,
    firings: Vec<FiringRecord>,
    turns: Vec<DQuat>,
    residual_m: f64,
}

impl<'a> Fired<'a> {
    fn new(way: &'a Way<'a>, velocity: DVec3) -> Self {
        Self {
            way,
            velocity,
            known: HashMap::new(),
            firings: Vec::new(),
            turns: Vec::new(),
            residual_m: 0.0,
        }
    }

    /// Index of a time of firing.
    fn at(&mut self, time_s: f64) -> u32 {
        if let Some(&firing) = self.known.get(&time_s.to_bits()) {
            return firing;
        }
        let (offset, since_s) = (self.way.offset(time_s), time_s - self.way.time_s);
        let residual_m = (offset - self.velocity * since_s).length();
        self.residual_m = self.residual_m.max(residual_m);
        self.firings.push(FiringRecord {
            offset_m: offset.as_vec3().to_array(),
            time_s: since_s as f32,
        });
        self.turns.push(self.way.turn(time_s));
        let firing = self.firings.len() as u32 - 1;
        self.known.insert(time_s.to_bits(), firing);
        firing
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
