//! Sectors of a sweep: runs of columns of the grid of beams, each drawn like an image of its own.

use std::collections::HashMap;
use std::ops::Range;

use decouplegs_scene::lidar::{Beam, LidarCells, NO_BEAM};
use decouplegs_scene::{Camera, Intrinsics, Lidar, Motion, Pose};
use glam::{DQuat, DVec3, Vec3};
use rayon::prelude::*;

use crate::layout::{BeamRecord, FiringRecord, SectorRecord};
use crate::stages::SectorTables;

/// A sector with more than this angle lists every splat in all of its columns: the order of
/// azimuths has an end.
const SPAN_MAX_RAD: f64 = 5.5;

/// What rounding may add to the way of the sensor, meters.
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
    #[must_use]
    pub fn new(lidar: &Lidar, beams: &[Beam], cells: &LidarCells, count: usize) -> Self {
        let count = count.clamp(1, cells.columns);
        let columns_of =
            |index: usize| cells.columns * index / count..cells.columns * (index + 1) / count;
        let cut = |index: usize| Sector::new(lidar, beams, cells, columns_of(index));
        let sectors: Vec<Sector> = (0..count).into_par_iter().filter_map(cut).collect();
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
        let fired = || by_column.iter().filter_map(|&cell| of_cell(cell));
        let first = *fired().next()?;
        let times = || fired().map(|beam| beam.time_s);
        let (start_s, end_s) = (
            times().fold(f64::INFINITY, f64::min),
            times().fold(f64::NEG_INFINITY, f64::max),
        );
        let time_s = 0.5 * (start_s + end_s);
        // Azimuths are counted from that of the first column, so that none is cut at half a turn.
        let start_rad = first.direction.y.atan2(first.direction.x);
        let turn = DQuat::from_rotation_z(-start_rad);
        let azimuth = |beam: &Beam| {
            let direction = turn * beam.direction;
            direction.y.atan2(direction.x)
        };
        let span = fired()
            .map(azimuth)
            .fold([0.0f64; 2], |[low, high], angle| {
                [low.min(angle), high.max(angle)]
            });
        let is_wide = span[1] - span[0] > SPAN_MAX_RAD;
        let middle_rad = start_rad + 0.5 * (span[0] + span[1]);
        let sensor_from_sector = Pose::new(DQuat::from_rotation_z(middle_rad), DVec3::ZERO);
        let middle = lidar.pose_at(time_s).then(&sensor_from_sector);
        let to_sector = middle.rotation.conjugate();
        let place =
            |time_s: f64| to_sector * (lidar.pose_at(time_s).translation - middle.translation);

        let mut firings: Vec<FiringRecord> = Vec::new();
        let mut turns: Vec<DQuat> = Vec::new();
        let mut known: HashMap<u64, u32> = HashMap::new();
        let velocity = match end_s > start_s {
            true => (place(end_s) - place(start_s)) / (end_s - start_s),
            false => DVec3::ZERO,
        };
        let mut residual_m = 0.0f64;
        let mut records = vec![BeamRecord::default(); width * rows];
        let mut beam_of_cell = vec![NO_BEAM; width * rows];
        let mut column_bounds = vec![[f32::INFINITY, f32::NEG_INFINITY]; width];
        let mut row_bounds = vec![[f32::INFINITY, f32::NEG_INFINITY]; rows];
        for (at, &cell) in by_column.iter().enumerate() {
            let Some(beam) = of_cell(cell) else {
                continue;
            };
            let (column, row) = (at / rows, at % rows);
            let firing = *known.entry(beam.time_s.to_bits()).or_insert_with(|| {
                let offset = place(beam.time_s);
                let since_s = beam.time_s - time_s;
                residual_m = residual_m.max((offset - velocity * since_s).length());
                firings.push(FiringRecord {
                    offset_m: offset.as_vec3().to_array(),
                    time_s: since_s as f32,
                });
                turns.push(to_sector * lidar.pose_at(beam.time_s).rotation);
                firings.len() as u32 - 1
            });
            let direction = (turns[firing as usize] * beam.direction).as_vec3();
            let place = row * width + column;
            records[place] = BeamRecord {
                direction: direction.to_array(),
                firing,
            };
            beam_of_cell[place] = cell;
            widen(&mut column_bounds[column], around(direction));
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
                residual_m: (residual_m + ROUNDING_M) as f32,
                ..SectorRecord::default()
            },
            column_bounds,
            row_bounds,
            beams: records,
            firings,
            beam_of_cell,
        })
    }
}

/// A number that rises with the azimuth of a direction, as in `lidar.glsl`.
fn around(direction: Vec3) -> f32 {
    let Vec3 { x, y, .. } = direction;
    let part = y / (x.abs() + y.abs());
    match (x >= 0.0, y >= 0.0) {
        (true, _) => part,
        (false, true) => 2.0 - part,
        (false, false) => -2.0 - part,
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
