//! LiDARs: the beams of a sweep, and the returns that a scene gives them.
//!
//! Sensor frame: x forward, y left, z up. The azimuth is `atan2(y, x)`, the elevation is the angle
//! above the xy plane.

mod cells;
mod sweep;

use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

use glam::DVec3;

use crate::{Invalid, Motion, Pose};

pub use cells::{LidarCells, NO_BEAM};
pub use sweep::{LidarPoint, LidarReturn, LidarSweep, PointFrame};

/// Beams of one sweep at most: more than any LiDAR on sale, and less than fills a memory.
pub const BEAMS_MAX: usize = 1 << 22;

/// Cells of the grid of one sweep at most: azimuth offsets make it wider than the sweep.
const CELLS_MAX: f64 = 4.0 * BEAMS_MAX as f64;

/// Rows of a spinning LiDAR at most.
pub const ROWS_MAX: usize = 1024;

/// Place of a LiDAR on the roof of a car, meters forward, left and up of the center of its box.
pub const ROOF_M: DVec3 = DVec3::new(0.0, 0.0, 1.1);

/// Longest sweep, seconds.
const SWEEP_S_MAX: f64 = 10.0;

/// Direction of rotation as seen from above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Spin {
    /// The azimuth falls from column to column.
    Clockwise,
    /// The azimuth rises.
    CounterClockwise,
}

/// Time within the sweep of T seconds at which column c of N fires.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum FiringTime {
    /// (c + 1/2) T / N.
    #[default]
    Middle,
    /// c T / N.
    Start,
    /// c T / (N - 1), as NVIDIA NCore and gsplat 1.6 count.
    Ncore,
}

/// Kind of range that a beam reports.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ReturnMode {
    /// Range of the splat at which transmittance falls to 1/2 or below.
    #[default]
    Median,
    /// Mean of the ranges of all splats by their weights.
    Expected,
    /// Range of the splat with the largest weight.
    Strongest,
    /// Up to two returns: mean ranges of the strongest and of the last [`Echo`].
    Dual,
}

/// Splats farther from the mean of an echo than this begin another, meters.
pub const ECHO_SEPARATION_M: f64 = 0.6;

/// Least weight of an echo that counts.
pub const ECHO_WEIGHT_MIN: f64 = 0.1;

/// Splats of a beam that follow one another within [`ECHO_SEPARATION_M`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Echo {
    /// Share of the beam that they take.
    pub weight: f32,
    /// Mean range by weight, meters.
    pub range_m: f32,
    /// Mean intensity by weight.
    pub intensity: f32,
    /// Instance of the splat with the largest weight.
    pub instance: u16,
}

impl ReturnMode {
    /// All modes with their names.
    pub const NAMED: [(&'static str, Self); 4] = [
        ("median", Self::Median),
        ("expected", Self::Expected),
        ("strongest", Self::Strongest),
        ("dual", Self::Dual),
    ];

    /// The mode called `name`, of [`ReturnMode::NAMED`].
    #[must_use]
    pub fn by_name(name: &str) -> Option<Self> {
        let mut named = Self::NAMED.into_iter();
        named
            .find(|(known, _)| *known == name)
            .map(|(_, mode)| mode)
    }

    /// Name in files and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        let named = Self::NAMED.into_iter().find(|(_, mode)| *mode == self);
        named.map_or("", |(name, _)| name)
    }
}

/// Options of the returns of a sweep that was traced.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReturnOptions {
    /// Kind of range.
    pub mode: ReturnMode,
    /// Share of a beam that splats have to take for a return, from 0 to 1. [`ReturnMode::Dual`] has
    /// [`ECHO_WEIGHT_MIN`] instead.
    pub opacity_min: f32,
    /// Seed of the noise of ranges, for models that have some.
    pub seed: u64,
}

impl ReturnOptions {
    /// The kind of range that `model` reports, half of a beam, and seed 0.
    #[must_use]
    pub fn for_model(model: &LidarModel) -> Self {
        Self {
            mode: model.returns,
            opacity_min: 0.5,
            seed: 0,
        }
    }
}

/// Row of a spinning LiDAR: one laser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarRow {
    /// Elevation, radians.
    pub elevation_rad: f64,
    /// Azimuth relative to that of the column, radians, positive to the left.
    pub azimuth_offset_rad: f64,
    /// The manufacturer's number of the laser.
    pub laser: u16,
}

/// Beams of one sweep, by their geometry.
#[derive(Clone, Debug, PartialEq)]
pub enum LidarPattern {
    /// Rows of lasers that fire together, column after column.
    Spinning {
        /// Rows by descending elevation.
        rows: Vec<LidarRow>,
        /// Columns of one sweep.
        columns: u32,
        /// Azimuth of the first column, radians.
        first_azimuth_rad: f64,
        /// Angle swept, radians, at most a turn.
        field_rad: f64,
        /// Direction of rotation.
        spin: Spin,
        /// Time of each column.
        firing_time: FiringTime,
    },
    /// Any beams, in any order.
    Rays(Vec<Beam>),
}

/// One firing of one laser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Unit direction in the sensor frame at the time of firing.
    pub direction: DVec3,
    /// Time of firing after the start of the sweep, seconds.
    pub time_s: f64,
    /// Row by descending elevation, or ring as given for explicit rays.
    pub ring: u16,
    /// The manufacturer's number of the laser.
    pub laser: u16,
    /// Column of firing.
    pub column: u32,
}

impl Beam {
    /// Time of firing after the start of the sweep, nanoseconds.
    #[must_use]
    pub fn offset_ns(&self) -> u32 {
        (1e9 * self.time_s).round() as u32
    }
}

/// Model of a LiDAR.
#[derive(Clone, Debug, PartialEq)]
pub struct LidarModel {
    /// Name of the model.
    pub name: String,
    /// Beams of one sweep.
    pub pattern: LidarPattern,
    /// Duration of one sweep, seconds.
    pub sweep_s: f64,
    /// Least and greatest range of a return, meters.
    pub range_m: [f64; 2],
    /// Range that a return reports.
    pub returns: ReturnMode,
    /// Standard deviation of the noise added to ranges, meters; 0 for none.
    pub range_noise_m: f64,
}

impl LidarModel {
    /// Checks counts, order and ranges.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let fail = |what: String| Err(Invalid::new(what));
        let [least, greatest] = self.range_m;
        if !(least >= 0.0 && least < greatest && greatest.is_finite()) {
            return fail(format!(
                "range_m is [{least}, {greatest}]; expected 0 <= least < greatest"
            ));
        }
        if !(self.sweep_s > 0.0 && self.sweep_s <= SWEEP_S_MAX) {
            return fail(format!(
                "a sweep takes {} s; expected more than 0 and at most {SWEEP_S_MAX}",
                self.sweep_s
            ));
        }
        if !(self.range_noise_m >= 0.0 && self.range_noise_m.is_finite()) {
            return fail(format!(
                "range_noise_m is {}; expected 0 or more",
                self.range_noise_m
            ));
        }
        match &self.pattern {
            LidarPattern::Spinning {
                rows,
                columns,
                first_azimuth_rad,
                field_rad,
                ..
            } => {
                check_rows(rows)?;
                let beams = rows.len() * *columns as usize;
                if *columns < 2 || beams > BEAMS_MAX {
                    return fail(format!(
                        "{columns} columns of {} rows; expected at least 2 columns and at most {BEAMS_MAX} beams",
                        rows.len()
                    ));
                }
                if !(*field_rad > 0.0 && *field_rad <= TAU + 1e-9 && first_azimuth_rad.is_finite())
                {
                    return fail(format!(
                        "a field of {} degrees from azimuth {}; expected more than 0 and at most 360",
                        field_rad.to_degrees(),
                        first_azimuth_rad.to_degrees()
                    ));
                }
                let offsets = || rows.iter().map(|row| row.azimuth_offset_rad);
                let spread = offsets().fold(0.0, f64::max) - offsets().fold(0.0, f64::min);
                let step_rad = field_rad / f64::from(*columns);
                let cells = rows.len() as f64 * (f64::from(*columns) + spread / step_rad);
                if cells > CELLS_MAX {
                    return fail(format!(
                        "azimuth offsets of {} degrees at columns {} degrees apart; expected offsets of fewer columns",
                        spread.to_degrees(),
                        step_rad.to_degrees()
                    ));
                }
                Ok(())
            }
            LidarPattern::Rays(beams) => check_rays(beams, self.sweep_s),
        }
    }

    /// Rows by elevation; of explicit rays, one more than the highest ring.
    #[must_use]
    pub fn rings(&self) -> usize {
        match &self.pattern {
            LidarPattern::Spinning { rows, .. } => rows.len(),
            LidarPattern::Rays(beams) => {
                let highest = beams.iter().map(|beam| beam.ring).max();
                usize::from(highest.unwrap_or(0)) + 1
            }
        }
    }

    /// Columns of one sweep; of explicit rays, one more than the highest column.
    #[must_use]
    pub fn columns(&self) -> usize {
        match &self.pattern {
            LidarPattern::Spinning { columns, .. } => *columns as usize,
            LidarPattern::Rays(beams) => {
                let highest = beams.iter().map(|beam| beam.column).max();
                highest.unwrap_or(0) as usize + 1
            }
        }
    }

    /// The beams of one sweep: those of a spinning LiDAR column by column, rows in order.
    #[must_use]
    pub fn beams(&self) -> Vec<Beam> {
        let (rows, columns) = match &self.pattern {
            LidarPattern::Rays(beams) => return beams.clone(),
            LidarPattern::Spinning { rows, columns, .. } => (rows, *columns),
        };
        let beam = |column: u32, (ring, row): (usize, &LidarRow)| {
            let azimuth_rad = self.azimuth_rad(column) + row.azimuth_offset_rad;
            let (sin, cos) = azimuth_rad.sin_cos();
            let (up, level) = row.elevation_rad.sin_cos();
            Beam {
                direction: DVec3::new(level * cos, level * sin, up),
                time_s: self.firing_s(column),
                ring: ring as u16,
                laser: row.laser,
                column,
            }
        };
        let of_column = |column| rows.iter().enumerate().map(move |row| beam(column, row));
        (0..columns).flat_map(of_column).collect()
    }

    /// Azimuth of a column without the offsets of rows, radians; 0 for explicit rays.
    fn azimuth_rad(&self, column: u32) -> f64 {
        match &self.pattern {
            LidarPattern::Rays(_) => 0.0,
            LidarPattern::Spinning {
                columns,
                first_azimuth_rad,
                field_rad,
                spin,
                ..
            } => {
                let swept = f64::from(column) * field_rad / f64::from(*columns);
                match spin {
                    Spin::Clockwise => first_azimuth_rad - swept,
                    Spin::CounterClockwise => first_azimuth_rad + swept,
                }
            }
        }
    }

    /// Time at which a column fires, seconds; 0 for explicit rays.
    fn firing_s(&self, column: u32) -> f64 {
        match &self.pattern {
            LidarPattern::Rays(_) => 0.0,
            LidarPattern::Spinning {
                columns,
                firing_time,
                ..
            } => {
                let (column, columns) = (f64::from(column), f64::from(*columns));
                self.sweep_s
                    * match firing_time {
                        FiringTime::Middle => (column + 0.5) / columns,
                        FiringTime::Start => column / columns,
                        FiringTime::Ncore => column / (columns - 1.0),
                    }
            }
        }
    }
}

fn check_rows(rows: &[LidarRow]) -> Result<(), Invalid> {
    if rows.is_empty() || rows.len() > ROWS_MAX {
        return Err(Invalid::new(format!(
            "{} rows; expected 1 to {ROWS_MAX}",
            rows.len()
        )));
    }
    let within = |row: &LidarRow| {
        row.elevation_rad.abs() < FRAC_PI_2 && row.azimuth_offset_rad.abs() <= FRAC_PI_2
    };
    if let Some(at) = rows.iter().position(|row| !within(row)) {
        return Err(Invalid::new(format!(
            "row {at} has elevation {} and azimuth offset {} degrees; expected elevations between -90 and 90, offsets of at most 90",
            rows[at].elevation_rad.to_degrees(),
            rows[at].azimuth_offset_rad.to_degrees()
        )));
    }
    let descends = |pair: &[LidarRow]| pair[0].elevation_rad > pair[1].elevation_rad;
    if let Some(at) = rows.windows(2).position(|pair| !descends(pair)) {
        return Err(Invalid::new(format!(
            "row {} has elevation {} degrees, row {at} before it {}; expected descending elevations",
            at + 1,
            rows[at + 1].elevation_rad.to_degrees(),
            rows[at].elevation_rad.to_degrees()
        )));
    }
    Ok(())
}

fn check_rays(beams: &[Beam], sweep_s: f64) -> Result<(), Invalid> {
    if beams.is_empty() || beams.len() > BEAMS_MAX {
        return Err(Invalid::new(format!(
            "{} rays; expected 1 to {BEAMS_MAX}",
            beams.len()
        )));
    }
    let right = |beam: &Beam| {
        (beam.direction.length() - 1.0).abs() < 1e-6
            && (0.0..=sweep_s).contains(&beam.time_s)
            && usize::from(beam.ring) < ROWS_MAX
            && (beam.column as usize) < BEAMS_MAX
    };
    match beams.iter().position(|beam| !right(beam)) {
        Some(at) => Err(Invalid::new(format!(
            "ray {at} is {:?}; expected a unit direction, a time within the sweep of {sweep_s} s, and a ring below {ROWS_MAX}",
            beams[at]
        ))),
        None => Ok(()),
    }
}

/// A LiDAR fixed to a vehicle.
#[derive(Clone, Debug, PartialEq)]
pub struct RigLidar {
    /// Names the sweep; unique in the rig.
    pub name: String,
    /// Model of the sensor.
    pub model: Arc<LidarModel>,
    /// Pose on the vehicle.
    pub rig_from_lidar: Pose,
}

impl RigLidar {
    /// The sweep that starts when the vehicle passes `world_from_rig` with `motion`.
    #[must_use]
    pub fn sweep_from(&self, world_from_rig: &Pose, motion: &Motion) -> Lidar {
        Lidar {
            name: self.name.clone(),
            model: self.model.clone(),
            rig_from_lidar: self.rig_from_lidar,
            world_from_rig: *world_from_rig,
            motion: *motion,
        }
    }

    /// The sweep that ends when the vehicle passes `world_from_rig` with `motion`.
    #[must_use]
    pub fn sweep_until(&self, world_from_rig: &Pose, motion: &Motion) -> Lidar {
        let start = match motion.is_rest() {
            true => *world_from_rig,
            false => world_from_rig.moved(motion, -self.model.sweep_s),
        };
        self.sweep_from(&start, motion)
    }
}

/// A LiDAR in the world for one sweep, on a vehicle that moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Lidar {
    /// Names the sweep; unique in the rig.
    pub name: String,
    /// Model of the sensor.
    pub model: Arc<LidarModel>,
    /// Pose on the vehicle.
    pub rig_from_lidar: Pose,
    /// Pose of the vehicle at the start of the sweep, f64 world coordinates.
    pub world_from_rig: Pose,
    /// Motion of the vehicle during the sweep.
    pub motion: Motion,
}

impl Lidar {
    /// Pose of the vehicle `time_s` after the start of the sweep.
    #[must_use]
    pub fn rig_at(&self, time_s: f64) -> Pose {
        match self.motion.is_rest() {
            true => self.world_from_rig,
            false => self.world_from_rig.moved(&self.motion, time_s),
        }
    }

    /// Pose of the sensor `time_s` after the start of the sweep.
    #[must_use]
    pub fn pose_at(&self, time_s: f64) -> Pose {
        self.rig_at(time_s).then(&self.rig_from_lidar)
    }
}
