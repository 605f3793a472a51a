//! Splats as a LiDAR meets them, in f32: `lidar.glsl`, `project_lidar.comp` and `trace_lidar.comp`.

use decouplegs_scene::lidar::{ECHO_SEPARATION_M, ECHO_WEIGHT_MIN};
use glam::{Mat3, Vec2, Vec3, vec2, vec3};

use super::footprint::{LOG2_255, SQUARED_RADIUS_SLACK};
use super::projection::{ALPHA_MIN, HALF_LOG2_E, from_camera_m, to_camera_axes};
use crate::layout::{BeamEchoes, BeamState, CameraRecord, EchoRecord, FiringRecord, SectorRecord};
pub use decouplegs_shaders::constants::{SLOPE_SLACK, THICKNESS_MIN};

/// Cells of a sector: first and last column, first and last row.
pub type Cells = [i32; 4];

/// No cells.
pub const NO_CELLS: Cells = [0, -1, 0, -1];

/// A sector as the kernels have it.
#[derive(Clone, Copy, Debug)]
pub struct SectorView<'a> {
    /// Axes and grid.
    pub camera: &'a CameraRecord,
    /// Motion of the sensor.
    pub sector: &'a SectorRecord,
    /// Bounds of its columns.
    pub column_bounds: &'a [[f32; 2]],
    /// Bounds of its rows.
    pub row_bounds: &'a [[f32; 2]],
}

/// Constants of the kernels.
#[derive(Clone, Copy, Debug)]
pub struct LidarConstants {
    /// Standard deviation that is added across the direction to the mean, radians.
    pub dilation_rad: f32,
    /// True if opacity compensates dilation.
    pub antialias: bool,
    /// True if sensor or splats move.
    pub moving: bool,
    /// Room for rounding; [`SLOPE_SLACK`] in the kernels.
    pub slack: f32,
}

/// `LidarSplat`: a splat in the axes of a sector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LidarSplat {
    /// Unit direction of the mean.
    pub toward: Vec3,
    /// Distance of the mean.
    pub range_m: f32,
    /// Inverse of the triangular factor of its covariance.
    pub whiten: Mat3,
    /// Velocity of the splat.
    pub drift_mps: Vec3,
    /// Binary logarithm of its opacity.
    pub log2_opacity: f32,
}

/// A number that rises with the azimuth of a direction.
#[must_use]
pub fn around(x: f32, y: f32) -> f32 {
    let size = x.abs() + y.abs();
    let part = if size > 0.0 { y / size } else { 0.0 };
    match (x >= 0.0, y >= 0.0) {
        (true, _) => part,
        (false, true) => 2.0 - part,
        (false, false) => -2.0 - part,
    }
}

fn all_cells(view: &SectorView<'_>) -> Cells {
    let [columns, rows] = view.camera.size_px.map(|size| size as i32);
    [0, columns - 1, 0, rows - 1]
}

fn cells_between(view: &SectorView<'_>, from: Vec2, to: Vec2, slopes: [f32; 2]) -> Cells {
    let (low, high) = (around(from.x, from.y), around(to.x, to.y));
    let columns = view.column_bounds;
    let mut first = columns.partition_point(|bounds| bounds[1] < low) as i32;
    let mut last = columns.partition_point(|bounds| bounds[0] <= high) as i32 - 1;
    if low > high {
        let (left, right) = (first < columns.len() as i32, last >= 0);
        first = if right { 0 } else { first };
        last = if left { columns.len() as i32 - 1 } else { last };
    }
    let rows = view.row_bounds;
    let top = rows.partition_point(|bounds| bounds[0] > slopes[1]) as i32;
    let bottom = rows.partition_point(|bounds| bounds[1] >= slopes[0]) as i32 - 1;
    match first <= last && top <= bottom {
        true => [first, last, top, bottom],
        false => NO_CELLS,
    }
}

fn ellipsoid_cells(
    view: &SectorView<'_>,
    slack: f32,
    mean: Vec3,
    factor: Mat3,
    (drift, residual): (Vec3, f32),
) -> Cells {
    let level_m = mean.truncate().length();
    if level_m.partial_cmp(&0.0) != Some(std::cmp::Ordering::Greater) {
        return all_cells(view);
    }
    let ahead = mean.truncate() / level_m;
    let columns = [factor.x_axis, factor.y_axis, factor.z_axis];
    let size = columns.iter().map(|c| c.dot(*c)).sum::<f32>().sqrt();
    let drift_size = drift.length();
    let residual_size = 1.732_050_9 * residual;
    let total = size + drift_size + residual_size;
    let grown = (total / size).sqrt();
    let moved = match drift_size > 0.0 {
        true => drift * (total / drift_size).sqrt(),
        false => Vec3::ZERO,
    };
    let rest = match residual_size > 0.0 {
        true => residual * (total / residual_size).sqrt(),
        false => 0.0,
    };
    let row = |axis: usize| grown * vec3(columns[0][axis], columns[1][axis], columns[2][axis]);
    let x = ahead.x * row(0) + ahead.y * row(1);
    let y = ahead.x * row(1) - ahead.y * row(0);
    let z = row(2);
    let w = vec3(
        ahead.x * moved.x + ahead.y * moved.y,
        ahead.x * moved.y - ahead.y * moved.x,
        moved.z,
    );
    let xx = x.dot(x) + w.x * w.x + rest * rest;
    let yy = y.dot(y) + w.y * w.y + rest * rest;
    let zz = z.dot(z) + w.z * w.z + rest * rest;
    let xy = x.dot(y) + w.x * w.y;
    let xz = x.dot(z) + w.x * w.z;
    let depth2 = level_m * level_m - xx;
    if depth2.partial_cmp(&(1e-3 * level_m * level_m)) != Some(std::cmp::Ordering::Greater) {
        return all_cells(view);
    }
    let minor_y = (xx * yy - xy * xy - 1e-6 * xx * yy).max(0.0);
    let half_y = (level_m * level_m * yy - minor_y).max(0.0).sqrt() / depth2;
    let middle_y = -xy / depth2;
    let across = mean.z * x - level_m * z;
    let across_w = mean.z * w.x - level_m * w.z;
    let across2 = across.dot(across)
        + across_w * across_w
        + rest * rest * (mean.z * mean.z + level_m * level_m);
    let minor_z = (xx * zz - xz * xz - 1e-6 * xx * zz).max(0.0);
    let half_z = (across2 - minor_z).max(0.0).sqrt() / depth2;
    let middle_z = (level_m * mean.z - xz) / depth2;
    let slack_y = slack * (1.0 + middle_y.abs() + half_y);
    let (right, left) = (middle_y - half_y - slack_y, middle_y + half_y + slack_y);
    let slack_z = slack * (1.0 + middle_z.abs() + half_z);
    let (low, high) = (middle_z - half_z - slack_z, middle_z + half_z + slack_z);
    let cosine = 1.0 / (1.0 + (right * right).max(left * left)).sqrt();
    let side = vec2(-ahead.y, ahead.x);
    let slopes = [low.min(low * cosine), high.max(high * cosine)];
    cells_between(view, ahead + right * side, ahead + left * side, slopes)
}

/// Rotates two columns so that component `row` of the second is zero.
fn rotate_columns(first: &mut Vec3, second: &mut Vec3, row: usize) {
    let size = vec2(first[row], second[row]).length();
    let (cosine, sine) = match size > 0.0 {
        true => (first[row] / size, second[row] / size),
        false => (1.0, 0.0),
    };
    let turned = cosine * *first + sine * *second;
    *second = cosine * *second - sine * *first;
    *first = turned;
}

/// A splat whose covariance is `axes` times its transpose, and the cells of the beams that it may
/// add to. `velocity_mps` is that of its mean in the frame of the camera record.
#[must_use]
pub fn see_from_lidar(
    view: &SectorView<'_>,
    constants: &LidarConstants,
    mean_m: [f32; 3],
    axes: Mat3,
    opacity: f32,
    velocity_mps: Vec3,
) -> Option<(LidarSplat, Cells)> {
    let camera = view.camera;
    let mean = to_camera_axes(camera, from_camera_m(mean_m, camera));
    let range_m = mean.length();
    if !(range_m > 1e-6 && range_m < 1e6) {
        return None;
    }
    let toward = mean / range_m;
    let up = if toward.z.abs() < 0.7 {
        Vec3::Z
    } else {
        Vec3::X
    };
    let u = up.cross(toward).normalize();
    let v = toward.cross(u);
    let width_m = constants.dilation_rad * range_m;
    let [mut a, mut b, mut c] =
        [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| to_camera_axes(camera, axis));
    let mut opacity = opacity;
    if constants.antialias {
        let m0 = vec3(u.dot(a), u.dot(b), u.dot(c));
        let m1 = vec3(v.dot(a), v.dot(b), v.dot(c));
        let unit = width_m.max(m0.abs().max(m1.abs()).max_element());
        let (m0, m1) = (m0 / unit, m1 / unit);
        let dilation = (width_m / unit) * (width_m / unit);
        let area = m0.cross(m1);
        let undilated = area.dot(area);
        let both = m0.dot(m0) + m1.dot(m1);
        opacity *= (undilated / (undilated + dilation * both + dilation * dilation)).sqrt();
    }
    // Written so that a NaN fails.
    if !matches!(opacity.partial_cmp(&ALPHA_MIN), Some(order) if order.is_ge()) {
        return None;
    }
    let (mut d, mut e) = (width_m * u, width_m * v);
    let mut f = (THICKNESS_MIN * range_m) * toward;
    for column in [&mut b, &mut c, &mut d, &mut e, &mut f] {
        rotate_columns(&mut a, column, 0);
    }
    for column in [&mut c, &mut d, &mut e, &mut f] {
        rotate_columns(&mut b, column, 1);
    }
    for column in [&mut d, &mut e, &mut f] {
        rotate_columns(&mut c, column, 2);
    }
    let (xx, yy, zz) = (1.0 / a.x, 1.0 / b.y, 1.0 / c.z);
    let (yx, zy) = (-a.y * xx * yy, -b.z * yy * zz);
    let zx = -(a.z * xx + b.z * yx) * zz;
    let log2_opacity = opacity.log2().max(-LOG2_255);
    let radius = ((log2_opacity + LOG2_255 + SQUARED_RADIUS_SLACK) / HALF_LOG2_E).sqrt();
    let (mut drift_mps, mut drift, mut residual_m) = (Vec3::ZERO, Vec3::ZERO, 0.0);
    if constants.moving {
        drift_mps =
            to_camera_axes(camera, velocity_mps) + Vec3::from_array(camera.frame_velocity_mps);
        let of_sensor = Vec3::from_array(view.sector.velocity_mps);
        drift = (drift_mps - of_sensor) * view.sector.half_time_s;
        residual_m = view.sector.residual_m;
    }
    if !(xx.abs() < 1e30 && yy.abs() < 1e30 && zz.abs() < 1e30) {
        return None;
    }
    let factor = Mat3::from_cols(
        radius * a,
        radius * vec3(0.0, b.y, b.z),
        radius * vec3(0.0, 0.0, c.z),
    );
    let cells = ellipsoid_cells(view, constants.slack, mean, factor, (drift, residual_m));
    let seen = LidarSplat {
        toward,
        range_m,
        whiten: Mat3::from_cols(vec3(xx, yx, zx), vec3(0.0, yy, zy), vec3(0.0, 0.0, zz)),
        drift_mps,
        log2_opacity,
    };
    Some((seen, cells))
}

/// A beam, and the limits of what it meets.
#[derive(Clone, Copy, Debug)]
pub struct TwinBeam<'a> {
    /// Unit direction, sector axes.
    pub direction: Vec3,
    /// Position and time of firing; `None` where nothing moves.
    pub firing: Option<&'a FiringRecord>,
    /// Upper bound of a splat's alpha.
    pub alpha_max: f32,
    /// Splats nearer than this are passed through, meters.
    pub range_min_m: f32,
}

/// Adds a splat of the given intensity and instance to a beam and its echoes.
pub fn meet(
    splat: &LidarSplat,
    (intensity, instance): (f32, u32),
    beam: &TwinBeam<'_>,
    (state, echoes): (&mut BeamState, &mut BeamEchoes),
) {
    let TwinBeam {
        direction,
        firing,
        alpha_max,
        range_min_m,
    } = *beam;
    let a = splat.whiten * splat.toward;
    let b = splat.whiten * (direction - splat.toward);
    let e = a + b;
    let mut h = splat.range_m * a;
    let mut across = splat.range_m * a.cross(b);
    if let Some(firing) = firing {
        let offset = firing.time_s * splat.drift_mps - Vec3::from_array(firing.offset_m);
        let moved = splat.whiten * offset;
        h += moved;
        across += moved.cross(e);
    }
    let square = e.dot(e);
    let range_m = e.dot(h) / square;
    let exponent = splat.log2_opacity - HALF_LOG2_E * across.dot(across) / square;
    if !(exponent >= -LOG2_255 && range_m > range_min_m) {
        return;
    }
    let alpha = exponent.exp2().min(alpha_max);
    let weight = state.transmittance * alpha;
    state.transmittance *= 1.0 - alpha;
    state.range_sum_m += weight * range_m;
    state.intensity_sum += weight * intensity;
    if state.median_m == 0.0 && state.transmittance <= 0.5 {
        state.median_m = range_m;
        state.instances = state.instances & 0xffff_0000 | instance;
    }
    if weight > state.strongest_weight {
        state.strongest_weight = weight;
        state.strongest_m = range_m;
        state.instances = state.instances & 0xffff | instance << 16;
    }
    add_to_echo(weight, range_m, (intensity, instance), echoes);
}

/// Adds a splat to the echoes of its beam.
fn add_to_echo(
    weight: f32,
    range_m: f32,
    (intensity, instance): (f32, u32),
    found: &mut BeamEchoes,
) {
    let open = found.open;
    let off_m = (range_m * open.weight - open.range_sum_m).abs();
    let joins = off_m <= ECHO_SEPARATION_M as f32 * open.weight;
    if open.weight > 0.0 && !joins {
        if open.weight >= ECHO_WEIGHT_MIN as f32 {
            found.last = open;
            if open.weight > found.strongest.weight {
                found.strongest = open;
            }
        }
        found.open = EchoRecord::default();
        found.open_strongest = 0.0;
    }
    found.open.weight += weight;
    found.open.range_sum_m += weight * range_m;
    found.open.intensity_sum += weight * intensity;
    if weight > found.open_strongest {
        found.open_strongest = weight;
        found.open.instance = instance;
    }
}
