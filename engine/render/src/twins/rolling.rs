//! Projection of a Gaussian under a rolling shutter, in f32: `rolling.glsl` and `turn.glsl`.

use decouplegs_shaders::constants::{FOLLOW_MAX, LENS_STEP_RAD, TIME_STEPS};
use glam::{Mat3, Vec2, Vec3};

use super::footprint::Footprint;
use super::lens::{project_splat_seen, shows, through_lens};
use super::projection::{Variant, from_camera_m, to_camera_axes};
use crate::layout::{CameraRecord, ClusterRecord, LensRecord};

/// Change of `v` under the rotation vector `turn`, at most 1 rad long.
#[must_use]
pub fn turn_change(turn: Vec3, v: Vec3) -> Vec3 {
    let angle2 = turn.dot(turn);
    let sine =
        1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0 * (1.0 - angle2 / 42.0 * (1.0 - angle2 / 72.0)));
    let cosine =
        0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0 * (1.0 - angle2 / 56.0 * (1.0 - angle2 / 90.0)));
    let across = turn.cross(v);
    sine * across + cosine * turn.cross(across)
}

/// Mean of a splat in camera axes at some time, and its velocity there, meters per second.
#[derive(Clone, Copy)]
struct MovingPoint {
    at: Vec3,
    velocity: Vec3,
}

fn moving_point(camera: &CameraRecord, mean_m: [f32; 3], time_s: f32) -> MovingPoint {
    let (frame_turn, turn) = (
        Vec3::from_array(camera.frame_turn_rad_per_s),
        Vec3::from_array(camera.turn_rad_per_s),
    );
    let frame_velocity = Vec3::from_array(camera.frame_velocity_mps);
    let mean = Vec3::from_array(mean_m);
    let change = turn_change(time_s * frame_turn, mean);
    let mut at =
        to_camera_axes(camera, from_camera_m(mean_m, camera) + change) + time_s * frame_velocity;
    let mut velocity = to_camera_axes(camera, frame_turn.cross(mean + change)) + frame_velocity;
    let back = -time_s * turn;
    at += turn_change(back, at);
    velocity += turn_change(back, velocity);
    MovingPoint {
        at,
        velocity: velocity - turn.cross(at),
    }
}

/// The camera with its axes turned on by `time_s`.
fn turned_camera(camera: &CameraRecord, time_s: f32) -> CameraRecord {
    let on = time_s * Vec3::from_array(camera.turn_rad_per_s);
    let back = -time_s * Vec3::from_array(camera.frame_turn_rad_per_s);
    let rows = Mat3::from_cols_array_2d(&[camera.row_x, camera.row_y, camera.row_z]);
    let [row_x, row_y, row_z] = [Vec3::X, Vec3::Y, Vec3::Z].map(|axis| {
        let row = rows * (axis + turn_change(on, axis));
        (row + turn_change(back, row)).to_array()
    });
    CameraRecord {
        row_x,
        row_y,
        row_z,
        ..*camera
    }
}

/// Position of a point in the image, pixels, and its velocity there, pixels per second.
#[derive(Clone, Copy)]
struct MovingPixel {
    at_px: Vec2,
    px_per_s: Vec2,
}

fn moving_pixel(
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    point: MovingPoint,
    near_m: f32,
) -> MovingPixel {
    let principal_px = Vec2::from_array(camera.principal_px);
    let MovingPoint { at, velocity } = point;
    if let Some(lens) = lens {
        let step_s = LENS_STEP_RAD * at.length() / velocity.length().max(1e-6);
        let after = through_lens(lens, at + step_s * velocity);
        let before = through_lens(lens, at - step_s * velocity);
        return MovingPixel {
            at_px: principal_px + through_lens(lens, at),
            px_per_s: (after - before) / (2.0 * step_s),
        };
    }
    let z = at.z.max(near_m);
    let (slope, focal_px) = (at.truncate() / z, Vec2::from_array(camera.focal_px));
    let slope_per_s = if at.z < near_m {
        Vec2::ZERO
    } else {
        (velocity.truncate() - slope * velocity.z) / z
    };
    MovingPixel {
        at_px: focal_px * slope + principal_px,
        px_per_s: focal_px * slope_per_s,
    }
}

/// True if a shear shows the motion of a splat at `t`: it lies where the projection is linear, and
/// does not follow the readout through the image.
fn is_sheared(camera: &CameraRecord, lens: Option<&LensRecord>, t: Vec3, px_per_s: Vec2) -> bool {
    let near = match lens {
        Some(lens) => shows(lens, t),
        None => {
            let [low, high] = [camera.slope_min, camera.slope_max].map(Vec2::from_array);
            t.truncate().cmpge(low * t.z).all() && t.truncate().cmple(high * t.z).all()
        }
    };
    let follow = Vec2::from_array(camera.shutter_s_per_px).dot(px_per_s);
    near && px_per_s != Vec2::ZERO && follow <= FOLLOW_MAX
}

/// A footprint that moves with `w` pixels per second, and whose mean is exposed `late_s` after the
/// time that it was projected for.
fn sheared(splat: Footprint, w: Vec2, s_per_px: Vec2, late_s: f32) -> Footprint {
    let stand = 1.0 - s_per_px.dot(w);
    let mean_px = splat.mean_px + w * (late_s / stand);
    if s_per_px.x == 0.0 {
        return Footprint {
            mean_px,
            slope: w.x * s_per_px.y + splat.slope * stand,
            rate_y: splat.rate_y * stand,
            ..splat
        };
    }
    let down = w.y * s_per_px.x;
    let upper = splat.rate_x * Vec2::new(stand + splat.slope * down, -splat.slope);
    let lower = splat.rate_y * Vec2::new(-down, 1.0);
    let side2 = upper.x * upper.x + lower.x * lower.x;
    let side = side2.sqrt();
    Footprint {
        mean_px,
        slope: -(upper.x * upper.y + lower.x * lower.y) / side2,
        rate_y: splat.rate_y * (splat.rate_x * stand / side),
        rate_x: side,
        ..splat
    }
}

/// Projection of a splat: input and result of the projection at the time of its exposure.
#[derive(Clone, Copy, Debug)]
pub struct SeenSplat {
    /// Offset of the mean from the camera in the splats' axes, meters.
    pub offset_m: Vec3,
    /// Offset of the mean from the camera in camera axes, meters.
    pub t: Vec3,
    /// Footprint in the image.
    pub splat: Footprint,
    /// True if the splat is drawn.
    pub drawn: bool,
}

/// Projects a splat for any lens and shutter; a lens of `None` is a pinhole.
#[must_use]
pub fn see_splat(
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    mean_m: [f32; 3],
    axes: Mat3,
    opacity: f32,
    variant: Variant,
) -> SeenSplat {
    if !camera.rolls() {
        let offset_m = from_camera_m(mean_m, camera);
        let t = to_camera_axes(camera, offset_m);
        let (splat, drawn) = project_splat_seen(camera, lens, t, axes, opacity, variant);
        return SeenSplat {
            offset_m,
            t,
            splat,
            drawn,
        };
    }
    let s_per_px = Vec2::from_array(camera.shutter_s_per_px);
    let first_s = camera.shutter_first_s;
    let (low_s, high_s) = exposed_s(camera);
    let mut time_s = 0.0f32.max(low_s).min(high_s);
    let at = |time_s: f32| {
        let point = moving_point(camera, mean_m, time_s);
        (point, moving_pixel(camera, lens, point, variant.near_m))
    };
    let (mut point, mut position) = at(time_s);
    for _ in 0..TIME_STEPS {
        let late_s = first_s + s_per_px.dot(position.at_px) - time_s;
        let stand = (1.0 - s_per_px.dot(position.px_per_s)).max(1.0 - FOLLOW_MAX);
        time_s = (time_s + late_s / stand).max(low_s).min(high_s);
        (point, position) = at(time_s);
    }
    let turned = turned_camera(camera, time_s);
    let t = point.at;
    let [row_x, row_y, row_z] = [turned.row_x, turned.row_y, turned.row_z].map(Vec3::from_array);
    let (mut splat, mut drawn) = project_splat_seen(&turned, lens, t, axes, opacity, variant);
    if drawn && is_sheared(camera, lens, t, position.px_per_s) {
        let late_s = first_s + s_per_px.dot(splat.mean_px) - time_s;
        splat = sheared(splat, position.px_per_s, s_per_px, late_s);
        drawn = splat.rate_x > 0.0
            && splat.rate_y > 0.0
            && splat.slope.abs() < 1e30
            && splat.mean_px.abs().max_element() < 1e30;
    }
    SeenSplat {
        offset_m: row_x * t.x + row_y * t.y + row_z * t.z,
        t,
        splat,
        drawn,
    }
}

/// First and last time at which a position of the image is exposed, seconds.
fn exposed_s(camera: &CameraRecord) -> (f32, f32) {
    let [width, height] = camera.size_px.map(|size| size as f32);
    let [x, y] = camera.shutter_s_per_px;
    let first_s = camera.shutter_first_s;
    let last_s = first_s + (x * width + y * height);
    (first_s.min(last_s), first_s.max(last_s))
}

/// The cluster with a box around all positions of its means while the image is exposed.
#[must_use]
pub fn swept(cluster: &ClusterRecord, camera: &CameraRecord) -> ClusterRecord {
    if !camera.rolls() {
        return *cluster;
    }
    let (low_s, high_s) = exposed_s(camera);
    let time_s = low_s.abs().max(high_s.abs());
    let length = |vector: [f32; 3]| Vec3::from_array(vector).length();
    let half_m = length(cluster.half_extent_m);
    let moved_m = time_s
        * (length(camera.frame_velocity_mps)
            + length(camera.frame_turn_rad_per_s) * (length(cluster.center_m) + half_m));
    let distance_m = from_camera_m(cluster.center_m, camera).length() + half_m + moved_m;
    let swept_m = moved_m + time_s * length(camera.turn_rad_per_s) * distance_m;
    ClusterRecord {
        half_extent_m: cluster.half_extent_m.map(|half_m| half_m + swept_m),
        ..*cluster
    }
}
