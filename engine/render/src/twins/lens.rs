//! Projection of a Gaussian through a lens other than a pinhole, in f32: `lens.glsl`.

use decouplegs_shaders::constants::{
    BEND_TERMS, BENDING_FADE_Z, SIGMA_SPREAD, SQRT_SIXTH, UNSCENTED_RADIUS,
};
use glam::{Mat3, Vec2, Vec3, vec2};

use super::footprint::{Footprint, LOG2_255};
use super::projection::{
    ALPHA_MIN, DILATION_PX2, HALF_LOG2_E, Variant, from_camera_m, project_splat, to_camera_axes,
};
use super::visibility::{DILATION_RADIUS_PX, cluster_overlaps, farthest};
use crate::layout::{CameraRecord, ClusterRecord, LENS_INTERVALS, LensKind, LensRecord};

/// The ray behind the windshield of a point in camera axes; the point itself without a windshield.
fn bent(lens: &LensRecord, t: Vec3) -> Vec3 {
    let limit = Vec2::from_array(lens.bend_limit);
    if limit.x == 0.0 {
        return t;
    }
    let ray = t.normalize();
    let cosines = (1.0 - ray.truncate() * ray.truncate()).max(Vec2::ZERO);
    let tangents = ray.truncate() / (1.0 + vec2(cosines.x.sqrt(), cosines.y.sqrt()));
    let at = (tangents / limit).clamp(Vec2::splat(-1.0), Vec2::ONE);
    let row = |row: &[[f32; 2]; BEND_TERMS as usize]| {
        let terms = row.iter().rev();
        terms.fold(Vec2::ZERO, |sum, &term| sum * at.x + Vec2::from_array(term))
    };
    let rows = lens.bending.iter().rev();
    let change = rows.fold(Vec2::ZERO, |sum, of| sum * at.y + row(of));
    let sines = ray.truncate() + (ray.z / BENDING_FADE_Z).clamp(0.0, 1.0) * change;
    let z = if ray.z > 0.0 {
        (1.0 - sines.dot(sines)).max(0.0).sqrt()
    } else {
        ray.z
    };
    sines.extend(z)
}

fn shows_bent(lens: &LensRecord, t: Vec3) -> bool {
    t.z > 0.0 && t.truncate().length() <= lens.tan_limit * t.z
}

pub(super) fn shows(lens: &LensRecord, point: Vec3) -> bool {
    shows_bent(lens, bent(lens, point))
}

fn distorted(lens: &LensRecord, p: Vec2) -> Vec2 {
    let [k1, k2, k3, k4, k5, k6] = lens.radial;
    let [p1, p2] = lens.tangential;
    let [s1, s2, s3, s4] = lens.thin_prism;
    let r2 = p.dot(p);
    let over = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
    let under = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
    let square = Vec2::splat(r2) + 2.0 * p * p;
    let bent = vec2(
        2.0 * p.x * p.y * p1 + square.x * p2,
        square.y * p1 + 2.0 * p.x * p.y * p2,
    );
    p * (over / under) + bent + r2 * (vec2(s1, s3) + r2 * vec2(s2, s4))
}

fn radius_at(lens: &LensRecord, chord: f32) -> f32 {
    let position = chord * lens.chord_intervals;
    let interval = (position as usize).min(LENS_INTERVALS - 1);
    let s = position - interval as f32;
    let [low, by_low] = lens.table[interval];
    let [high, by_high] = lens.table[interval + 1];
    let rise = high - low;
    low + s
        * (by_low + s * (3.0 * rise - 2.0 * by_low - by_high + s * (by_low + by_high - 2.0 * rise)))
}

/// Projection of a point in camera axes, pixels from the principal point.
#[must_use]
pub fn through_lens(lens: &LensRecord, point: Vec3) -> Vec2 {
    let t = bent(lens, point);
    let ray = t.normalize();
    let across = ray.truncate().length();
    let chord = if ray.z >= 0.0 {
        across * (2.0 / (1.0 + ray.z)).sqrt()
    } else {
        (2.0 - 2.0 * ray.z).sqrt()
    };
    let direction = if across > 0.0 {
        ray.truncate() / across
    } else {
        vec2(if ray.z < 0.0 { 1.0 } else { 0.0 }, 0.0)
    };
    let shown = shows_bent(lens, t);
    let mut p = if lens.kind == LensKind::Planar as u32 {
        distorted(
            lens,
            if shown {
                t.truncate() / t.z
            } else {
                direction * lens.tan_limit
            },
        )
    } else {
        direction
            * radius_at(
                lens,
                if shown {
                    chord.min(lens.chord_limit)
                } else {
                    lens.chord_limit
                },
            )
    };
    if !shown {
        p += direction * (lens.slope_beyond * (chord - lens.chord_limit));
    }
    let [xx, yx, xy, yy] = lens.matrix;
    p.x * vec2(xx, yx) + p.y * vec2(xy, yy)
}

/// [`project_splat`] for a lens that is no pinhole.
fn project_splat_unscented(
    camera: &CameraRecord,
    lens: &LensRecord,
    t: Vec3,
    axes: Mat3,
    opacity: f32,
    variant: Variant,
) -> (Footprint, bool) {
    let nothing = (Footprint::default(), false);
    // Written so that a NaN fails.
    if t.z.is_nan() || t.z < variant.near_m {
        return nothing;
    }
    let middle = through_lens(lens, t);
    let mut columns =
        [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| to_camera_axes(camera, axis));
    for (row, first, second) in [(0, 0, 1), (0, 0, 2), (1, 1, 2)] {
        let (a, b) = (columns[first], columns[second]);
        let side = vec2(a[row], b[row]).length();
        if side > 0.0 {
            let (c, s) = (a[row] / side, b[row] / side);
            (columns[first], columns[second]) = (c * a + s * b, c * b - s * a);
        }
    }
    let offsets = columns.map(|column| SIGMA_SPREAD * column);
    let around = offsets
        .into_iter()
        .flat_map(|offset| [t + offset, t - offset]);
    if !shows(lens, t) && !around.clone().any(|point| shows(lens, point)) {
        return nothing;
    }
    let mut points = [Vec2::ZERO; 7];
    for (point, from) in points[1..].iter_mut().zip(around) {
        *point = through_lens(lens, from) - middle;
    }
    let shift = points[1..].iter().sum::<Vec2>() / 6.0;
    points[0] = -std::f32::consts::SQRT_2 * shift;
    points[1..]
        .iter_mut()
        .for_each(|point| *point = SQRT_SIXTH * (*point - shift));
    let unit_px = points
        .iter()
        .map(|point| point.abs().max_element())
        .fold(1.0, f32::max);
    points.iter_mut().for_each(|point| *point /= unit_px);
    let sum = |f: fn(&Vec2) -> f32| points.iter().map(f).sum::<f32>();
    let (xx, xy, yy) = (sum(|p| p.x * p.x), sum(|p| p.x * p.y), sum(|p| p.y * p.y));
    let minors = (0..7).flat_map(|i| (0..i).map(move |j| (i, j)));
    let undilated: f32 = minors
        .map(|(i, j)| points[i].perp_dot(points[j]).powi(2))
        .sum();
    let dilation = DILATION_PX2 / (unit_px * unit_px);
    let determinant = undilated + dilation * (xx + yy) + dilation * dilation;
    let variance_y = yy + dilation;
    let opacity = if variant.antialias {
        opacity * (undilated / determinant).sqrt()
    } else {
        opacity
    };
    let splat = Footprint {
        mean_px: Vec2::from_array(camera.principal_px) + (middle + shift),
        slope: xy / variance_y,
        rate_x: (HALF_LOG2_E * variance_y / determinant).sqrt() / unit_px,
        rate_y: (HALF_LOG2_E / variance_y).sqrt() / unit_px,
        log2_opacity: opacity.log2().max(-LOG2_255),
    };
    let drawn = opacity >= ALPHA_MIN
        && splat.rate_x > 0.0
        && splat.rate_y > 0.0
        && splat.slope.abs() < 1e30
        && splat.mean_px.x.abs() < 1e30
        && splat.mean_px.y.abs() < 1e30;
    (splat, drawn)
}

/// The lens of camera `camera` among `lenses`, one per camera or none at all; `None` for a pinhole.
#[must_use]
pub fn lens_of(lenses: &[LensRecord], camera: usize) -> Option<&LensRecord> {
    lenses
        .get(camera)
        .filter(|lens| lens.kind != LensKind::Pinhole as u32)
}

/// [`project_splat`], whatever the camera's lens; `None` is a pinhole.
#[must_use]
pub fn project_splat_seen(
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    t: Vec3,
    axes: Mat3,
    opacity: f32,
    variant: Variant,
) -> (Footprint, bool) {
    match lens {
        Some(lens) => project_splat_unscented(camera, lens, t, axes, opacity, variant),
        None => project_splat(camera, t, axes, opacity, variant),
    }
}

/// Upper bound of the arc sine, for sines up to a quarter.
fn arc_sine_bound(s: f32) -> f32 {
    s / (1.0 - s * s).sqrt()
}

/// [`cluster_overlaps`], whatever the camera's lens; `None` is a pinhole.
#[must_use]
pub fn cluster_overlaps_any_lens(
    cluster: &ClusterRecord,
    camera: &CameraRecord,
    lens: Option<&LensRecord>,
    near_m: f32,
) -> bool {
    let Some(lens) = lens else {
        return cluster_overlaps(cluster, camera, near_m);
    };
    let center = from_camera_m(cluster.center_m, camera);
    let half_extent = Vec3::from_array(cluster.half_extent_m);
    let slack =
        1e-5 * (center.abs().element_sum() + half_extent.element_sum() + cluster.splat_radius_m);
    let nearest = farthest(cluster, center, Vec3::from_array(camera.row_z)) + slack;
    if cluster.splat_radius_m < 0.0 || nearest.is_nan() || nearest < near_m {
        return false;
    }
    let distance_m = center.length();
    let spread_m = half_extent.length() + slack;
    let (spread, radius) = (
        spread_m / distance_m,
        cluster.splat_radius_m / (distance_m - spread_m),
    );
    let t = to_camera_axes(camera, center);
    if !(spread < 0.25 && radius < 0.25 && t.z > 0.0) {
        return true;
    }
    let angle_rad = 1.001 * (arc_sine_bound(spread) + UNSCENTED_RADIUS * arc_sine_bound(radius));
    let margin = Vec2::splat(lens.pixels_per_rad * angle_rad + DILATION_RADIUS_PX + 1.0);
    let pixel = Vec2::from_array(camera.principal_px) + through_lens(lens, t);
    let size = vec2(camera.size_px[0] as f32, camera.size_px[1] as f32);
    pixel.cmpge(-margin).all() && pixel.cmple(size + margin).all()
}
