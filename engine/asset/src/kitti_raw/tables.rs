//! KITTI's text files: calibration, time stamps, packets of the inertial unit.

use std::collections::HashMap;
use std::f64::consts::PI;

use decouplegs_scene::{Intrinsics, Pose};
use glam::{DMat3, DQuat, DVec3};

use crate::DecodeError;
use crate::xml::{excerpt, finite};

/// Earth's radius of KITTI's development kit, meters.
const EARTH_M: f64 = 6_378_137.0;
/// A latitude beyond this has no place on Mercator's map, radians.
const LATITUDE_MAX_RAD: f64 = 1.55;
/// Time stamps of a drive at most.
const TIMES_MAX: usize = 864_000;
/// Largest departure of a rotation from orthonormality that is taken for rounding.
const ORTHONORMAL_TOLERANCE: f64 = 1e-3;

/// Calibration of a day.
#[derive(Clone, Debug)]
pub struct Calibration {
    lidar_from_imu: Pose,
    /// Unrectified camera 0 from LiDAR.
    camera_from_lidar: Pose,
    /// Values of `calib_cam_to_cam.txt`, by name.
    cameras: HashMap<String, Vec<f64>>,
}

/// Reads a calibration from the bytes of its three files.
///
/// # Errors
/// A [`DecodeError`] that names the value at fault.
pub fn decode_calibration(
    imu_to_velo: &[u8],
    velo_to_cam: &[u8],
    cam_to_cam: &[u8],
) -> Result<Calibration, DecodeError> {
    Ok(Calibration {
        lidar_from_imu: rigid(&named_values(imu_to_velo)?, "calib_imu_to_velo.txt")?,
        camera_from_lidar: rigid(&named_values(velo_to_cam)?, "calib_velo_to_cam.txt")?,
        cameras: named_values(cam_to_cam)?,
    })
}

impl Calibration {
    /// IMU from LiDAR.
    #[must_use]
    pub fn imu_from_lidar(&self) -> Pose {
        self.lidar_from_imu.inverse()
    }

    /// Rectified pinhole of a camera, and IMU from camera. Principal points count from the corner
    /// of the image, where KITTI counts from the middle of the first pixel.
    ///
    /// # Errors
    /// A [`DecodeError`] that names the value that is missing or makes no camera.
    pub fn camera(&self, number: u32) -> Result<(Intrinsics, Pose), DecodeError> {
        let projection = self.values(&format!("P_rect_{number:02}"), 12)?;
        let size_px = self.values(&format!("S_rect_{number:02}"), 2)?;
        // All cameras are rectified to the axes of the first.
        let rotation = rotation(self.values("R_rect_00", 9)?, "R_rect_00")?;
        let (fx, fy) = (projection[0], projection[5]);
        let bad = |name: &str| {
            DecodeError::Malformed(format!("{name}_{number:02} makes no camera with an image"))
        };
        if !(fx > 0.0 && fy > 0.0 && projection[1] == 0.0 && projection[4] == 0.0) {
            return Err(bad("P_rect"));
        }
        if !size_px.iter().all(|side| (1.0..=65_535.0).contains(side)) {
            return Err(bad("S_rect"));
        }
        let intrinsics = Intrinsics {
            fx_px: fx,
            fy_px: fy,
            cx_px: projection[2] + 0.5,
            cy_px: projection[6] + 0.5,
            ..Intrinsics::from_horizontal_fov(size_px[0] as u32, size_px[1] as u32, 1.0)
        };
        // P = K [I | t]: the center of the camera is at -t in the frame of camera 0.
        let t_z = projection[11];
        let shift = DVec3::new(
            (projection[3] - projection[2] * t_z) / fx,
            (projection[7] - projection[6] * t_z) / fy,
            t_z,
        );
        let camera_from_first = Pose::new(DQuat::IDENTITY, shift);
        let rectified = Pose::new(rotation, DVec3::ZERO);
        let camera_from_imu = camera_from_first
            .then(&rectified)
            .then(&self.camera_from_lidar)
            .then(&self.lidar_from_imu);
        Ok((intrinsics, camera_from_imu.inverse()))
    }

    fn values(&self, name: &str, count: usize) -> Result<&[f64], DecodeError> {
        values(&self.cameras, name, count)
    }
}

/// Lines of `name: numbers`. Others, such as dates, have no numbers and are left out.
fn named_values(bytes: &[u8]) -> Result<HashMap<String, Vec<f64>>, DecodeError> {
    let text = text(bytes)?;
    let named = text.lines().filter_map(|line| {
        let (name, numbers) = line.split_once(':')?;
        let numbers = numbers.split_whitespace().map(finite);
        Some((
            name.trim().to_owned(),
            numbers.collect::<Option<Vec<f64>>>()?,
        ))
    });
    Ok(named.collect())
}

fn values<'a>(
    named: &'a HashMap<String, Vec<f64>>,
    name: &str,
    count: usize,
) -> Result<&'a [f64], DecodeError> {
    match named.get(name) {
        Some(values) if values.len() == count => Ok(values),
        Some(values) => Err(DecodeError::Malformed(format!(
            "{name} has {} numbers; expected {count}",
            values.len()
        ))),
        None => Err(DecodeError::Malformed(format!(
            "{name} is missing; expected a line `{name}:` with {count} numbers"
        ))),
    }
}

fn rotation(values: &[f64], name: &str) -> Result<DQuat, DecodeError> {
    let rows = DMat3::from_cols_slice(values).transpose();
    let is_rotation = (rows.transpose() * rows).abs_diff_eq(DMat3::IDENTITY, ORTHONORMAL_TOLERANCE)
        && rows.determinant() > 0.0;
    is_rotation
        .then(|| DQuat::from_mat3(&rows).normalize())
        .ok_or_else(|| DecodeError::Malformed(format!("{name} is no rotation")))
}

fn rigid(named: &HashMap<String, Vec<f64>>, file: &str) -> Result<Pose, DecodeError> {
    let rotation = rotation(values(named, "R", 9)?, &format!("R of {file}"))?;
    Ok(Pose::new(
        rotation,
        DVec3::from_slice(values(named, "T", 3)?),
    ))
}

fn text(bytes: &[u8]) -> Result<&str, DecodeError> {
    std::str::from_utf8(bytes)
        .map_err(|_| DecodeError::Malformed("not text: a file of numbers was expected".into()))
}

/// Reads time stamps, a line each, such as `2011-09-26 13:08:24.967930880`. Seconds since the first
/// midnight, rising.
///
/// # Errors
/// A [`DecodeError`] with the line at fault.
pub fn decode_times(bytes: &[u8]) -> Result<Vec<f64>, DecodeError> {
    let mut times_s: Vec<f64> = Vec::new();
    let mut first_day = None;
    for (index, line) in text(bytes)?.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let bad = |why: &str| {
            DecodeError::Malformed(format!("line {}: '{}' {why}", index + 1, excerpt(line)))
        };
        let (day, seconds) = stamp(line)
            .ok_or_else(|| bad("is no time; expected such as 2011-09-26 13:08:24.967930880"))?;
        let time_s = (day - *first_day.get_or_insert(day)) as f64 * 86_400.0 + seconds;
        if times_s.last().is_some_and(|last| *last >= time_s) {
            return Err(bad("is not later than the line before"));
        }
        if times_s.len() >= TIMES_MAX {
            return Err(DecodeError::Malformed(format!(
                "more than {TIMES_MAX} time stamps"
            )));
        }
        times_s.push(time_s);
    }
    Ok(times_s)
}

/// Day, counted from any one, and second of a time stamp.
fn stamp(line: &str) -> Option<(i64, f64)> {
    let (date, time) = line.trim().split_once(' ')?;
    let mut parts = date.split('-').map(|part| part.parse::<i64>().ok());
    let (year, month, day) = (parts.next()??, parts.next()??, parts.next()??);
    let mut parts = time.trim().split(':').map(finite);
    let (hour, minute, second) = (parts.next()??, parts.next()??, parts.next()??);
    let is_time = (0.0..24.0).contains(&hour)
        && (0.0..60.0).contains(&minute)
        && (0.0..61.0).contains(&second);
    let is_date =
        (1970..3000).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    // Days of the civil calendar, with years that begin in March.
    let (year, month) = if month > 2 {
        (year, month - 3)
    } else {
        (year - 1, month + 9)
    };
    let days = 365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day;
    (is_time && is_date).then_some((days, 3600.0 * hour + 60.0 * minute + second))
}

/// Place and attitude of a packet of the inertial unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Packet {
    latitude_rad: f64,
    longitude_rad: f64,
    altitude_m: f64,
    /// Roll, pitch and yaw, radians; yaw is 0 to the east.
    attitude_rad: [f64; 3],
}

/// Reads a packet: latitude and longitude in degrees, altitude, roll, pitch, yaw; what follows is
/// left out.
///
/// # Errors
/// A [`DecodeError`] where one of them is missing or no number.
pub fn decode_packet(bytes: &[u8]) -> Result<Packet, DecodeError> {
    let numbers = text(bytes)?.split_whitespace().take(6).map(finite);
    let numbers: Option<Vec<f64>> = numbers.collect();
    let bad = || {
        DecodeError::Malformed(
            "no packet; expected latitude, longitude, altitude, roll, pitch and yaw as numbers"
                .into(),
        )
    };
    let numbers = numbers
        .filter(|numbers| numbers.len() == 6)
        .ok_or_else(bad)?;
    let packet = Packet {
        latitude_rad: numbers[0].to_radians(),
        longitude_rad: numbers[1].to_radians(),
        altitude_m: numbers[2],
        attitude_rad: [numbers[3], numbers[4], numbers[5]],
    };
    let is_on_earth = packet.latitude_rad.abs() < LATITUDE_MAX_RAD
        && packet.longitude_rad.abs() <= 2.0 * PI
        && packet.altitude_m.abs() < 1e5;
    is_on_earth.then_some(packet).ok_or_else(bad)
}

impl Packet {
    /// Scale of Mercator's map that makes lengths right here.
    #[must_use]
    pub fn mercator_scale(&self) -> f64 {
        self.latitude_rad.cos()
    }

    /// Pose on Mercator's map with `scale`, x to the east, meters.
    #[must_use]
    pub fn pose(&self, scale: f64) -> Pose {
        let [roll, pitch, yaw] = self.attitude_rad;
        let place = DVec3::new(
            scale * EARTH_M * self.longitude_rad,
            scale * EARTH_M * (0.25 * PI + 0.5 * self.latitude_rad).tan().ln(),
            self.altitude_m,
        );
        let rotation = DQuat::from_rotation_z(yaw)
            * DQuat::from_rotation_y(pitch)
            * DQuat::from_rotation_x(roll);
        Pose::new(rotation, place)
    }
}
