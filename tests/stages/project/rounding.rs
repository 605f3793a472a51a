//! Rounding errors of a record's values, and comparisons of a kernel with them.

use decouplegs::render::layout::{CameraRecord, LensRecord};
use decouplegs::render::reference::unscented::unscented;
use decouplegs::render::twins::color_code::COLOR_CODE_ERROR;
use decouplegs::render::twins::projection::from_camera_m;
use decouplegs::scene::rules::DILATION_PX2;
use decouplegs::scene::{DepthOrder, RayMap, Rules};
use glam::{DMat3, DVec2, DVec3, Vec3};

use super::super::scenes::ProjectedTwin;
use super::super::{ROUNDOFF, identical, within};

/// A splat that is projected.
pub struct Projection<'a> {
    pub camera: &'a CameraRecord,
    /// Lens other than a pinhole: its ray map, and its record.
    pub lens: Option<(RayMap, &'a LensRecord)>,
    pub mean_m: [f32; 3],
    /// Columns whose products with themselves sum to the covariance.
    pub axes: DMat3,
    /// Error bound of a product of a row with a column, in lengths of the column.
    pub axes_share: f64,
    pub opacity: f64,
    /// Error bound of a color channel.
    pub color: f64,
}

/// Error bounds of the values of one record, in the order in which they are stored.
///
/// A forward error analysis to first order (Higham, Accuracy and Stability of Numerical Algorithms,
/// 2002, chapter 3): both sides do the same operations, each rounded once, fused or not; a division
/// may be off by 5 roundings and a logarithm by 2^-21 or 6 roundings (Vulkan specification,
/// Precision of SPIR-V Instructions).
pub struct RecordBounds {
    footprint: [f64; 6],
    /// Error bound of the mean where its code counts steps, pixels.
    mean_px: [f64; 2],
    mean_shift: u32,
    depth_m: f64,
    color: f64,
}

impl Projection<'_> {
    pub fn bounds(&self, rules: &Rules) -> RecordBounds {
        let k = self.camera;
        let offset = from_camera_m(self.mean_m, k).as_dvec3();
        let rows = [k.row_x, k.row_y, k.row_z].map(|row| Vec3::from_array(row).as_dvec3());
        let t = DVec3::new(
            rows[0].dot(offset),
            rows[1].dot(offset),
            rows[2].dot(offset),
        );
        let u = ROUNDOFF;
        let t_error = 8.0 * u * offset.abs().element_sum();
        let radial = rules.order == DepthOrder::Radial;
        let depth_m = if radial {
            8.0 * u * offset.length()
        } else {
            t_error
        };
        if let Some((map, record)) = &self.lens {
            let axes = DMat3::from_cols(rows[0], rows[1], rows[2]).transpose() * self.axes;
            let footprint = self.through(map, record, t, t_error, axes, rules);
            return RecordBounds {
                footprint,
                mean_px: [footprint[0], footprint[1]].map(|error| error + 2.0 * k.mean_step_px()),
                mean_shift: k.mean_shift,
                depth_m,
                color: self.color,
            };
        }
        let focal = DVec2::from_array(k.focal_px.map(f64::from));
        let xy = t.truncate() / t.z;
        let xy_error = (DVec2::ONE + xy.abs()) * (t_error / t.z) + 6.0 * u * xy.abs();
        let mean_error = focal * xy_error
            + 4.0 * u * (focal * xy.abs() + DVec2::from_array(k.principal_px.map(f64::from)).abs());

        // Fine parts are 2^11 times smaller than coarse ones, which are not rounded.
        let coarse = 2f64.powi(-11);
        let fine_error = 40.0 * u * coarse * 2.0 * offset.abs().max_element() / t.z;
        let ratio_error = (DVec2::ONE + xy.abs()) * fine_error;
        let coarse_px = (17.0 - f64::from(k.mean_shift)).exp2();
        let exact_mean_error = 2.0 * focal * (ratio_error + 8.0 * u * (coarse + xy_error))
            + 8.0 * u * coarse_px * (DVec2::ONE + xy.abs())
            + 2.0 * k.mean_step_px();

        let low = DVec2::from_array(k.slope_min.map(f64::from));
        let slope = xy
            .max(low)
            .min(DVec2::from_array(k.slope_max.map(f64::from)));
        let lengths = DVec3::new(
            self.axes.x_axis.length(),
            self.axes.y_axis.length(),
            self.axes.z_axis.length(),
        );
        let [row_x, row_y, row_z] = rows.map(|row| self.axes.transpose() * row);
        // Of one of the projected axes.
        let axis = |row: DVec3, slope: f64, slope_error: f64, focal: f64| {
            let m = (row - slope * row_z) * (focal / t.z);
            let inner = lengths * (self.axes_share * (1.0 + slope.abs()) + slope_error);
            (
                m,
                (inner * (focal / t.z) + m.abs() * (t_error / t.z + 8.0 * u)).length(),
            )
        };
        let (m0, e0) = axis(row_x, slope.x, xy_error.x, focal.x);
        let (m1, e1) = axis(row_y, slope.y, xy_error.y, focal.y);
        let shape = Shape {
            m0: m0.length(),
            m1: m1.length(),
            area: m0.cross(m1).length(),
            xy: m0.dot(m1),
            e0,
            e1,
        };
        let [slope, rate_x, rate_y, log2_opacity] = shape.errors(self.opacity, rules.antialias);
        RecordBounds {
            footprint: [
                mean_error.x,
                mean_error.y,
                slope,
                rate_x,
                rate_y,
                log2_opacity,
            ],
            mean_px: exact_mean_error.to_array(),
            mean_shift: k.mean_shift,
            depth_m,
            color: self.color,
        }
    }

    /// Bounds of the footprint of a lens's seven points: the rounding error of each point times the
    /// lens's steepest slope, and the rounding of its pixel.
    fn through(
        &self,
        map: &RayMap,
        lens: &LensRecord,
        t: DVec3,
        t_error: f64,
        axes: DMat3,
        rules: &Rules,
    ) -> [f64; 6] {
        let u = ROUNDOFF;
        let principal = DVec2::from_array(self.camera.principal_px.map(f64::from));
        let offsets = [axes.x_axis, axes.y_axis, axes.z_axis].map(|axis| axis * 3f64.sqrt());
        let lengths = offsets.iter().map(|offset| offset.length()).sum::<f64>();
        let points = offsets
            .iter()
            .flat_map(|&offset| [t + offset, t - offset])
            .chain([t]);
        let point_error = points.map(|point| {
            let turned_rad =
                (t_error + (self.axes_share + 32.0 * u) * lengths) / point.length() + 40.0 * u;
            let radius_px = (map.project_extended(point) - principal).length();
            f64::from(lens.pixels_per_rad) * turned_rad + 24.0 * u * radius_px
        });
        let error = point_error.fold(0.0, f64::max);
        let spread = unscented(map, t, &axes).expect("the record of a splat that the lens shows");
        let shape = Shape {
            // With what rounding adds: splats of no size at all have nothing else.
            m0: spread.xx.sqrt() + 4.0 * error,
            m1: spread.yy.sqrt() + 4.0 * error,
            area: spread.det.sqrt(),
            xy: spread.xy,
            e0: 4.0 * error,
            e1: 4.0 * error,
        };
        let [slope, rate_x, rate_y, log2_opacity] = shape.errors(self.opacity, rules.antialias);
        let mean = 2.0 * error + 4.0 * u * (spread.mean_px.length() + principal.length());
        [mean, mean, slope, rate_x, rate_y, log2_opacity]
    }
}

/// The projected axes in pixels, their cross and dot products, and how far either axis is off.
struct Shape {
    m0: f64,
    m1: f64,
    area: f64,
    xy: f64,
    e0: f64,
    e1: f64,
}

impl Shape {
    /// Errors of slope, both rates and log2 opacity.
    fn errors(&self, opacity: f64, antialias: bool) -> [f64; 4] {
        let Self {
            m0,
            m1,
            area,
            xy,
            e0,
            e1,
        } = *self;
        let u = ROUNDOFF;
        let (xx, yy) = (m0 * m0, m1 * m1);
        let (xx_error, yy_error) = (2.0 * m0 * e0 + 4.0 * u * xx, 2.0 * m1 * e1 + 4.0 * u * yy);
        let xy_error = m0 * e1 + m1 * e0 + 4.0 * u * m0 * m1;
        let area_error = m0 * e1 + m1 * e0 + 8.0 * u * m0 * m1;
        let undilated = area * area;
        let undilated_error =
            2.0 * area * area_error + area_error * area_error + 4.0 * u * undilated;
        let determinant = undilated + DILATION_PX2 * (xx + yy) + DILATION_PX2 * DILATION_PX2;
        let determinant_share =
            (undilated_error + DILATION_PX2 * (xx_error + yy_error)) / determinant + 6.0 * u;
        let variance = yy + DILATION_PX2;
        let variance_share = yy_error / variance + 3.0 * u;
        let rate_y = (0.721 / variance).sqrt();
        let rate_x = (0.721 * variance / determinant).sqrt();
        let paid = 0.5 * (undilated_error / undilated + determinant_share) + 10.0 * u;
        let log2 = |value: f64| (6.0 * u * value.log2().abs()).max(2f64.powi(-21));
        [
            xy_error / variance + (xy / variance).abs() * (variance_share + 6.0 * u),
            rate_x * (0.5 * (variance_share + determinant_share) + 12.0 * u),
            rate_y * (0.5 * variance_share + 12.0 * u),
            if antialias {
                log2(opacity * (undilated / determinant).sqrt()) + 1.45 * paid
            } else {
                log2(opacity)
            },
        ]
    }
}

/// Holds record `record` of the kernel to the twin's; returns the largest shares used of the bounds
/// of footprint and color.
pub fn check_record(
    what: &str,
    record: usize,
    kernel: &ProjectedTwin,
    twin: &ProjectedTwin,
    bounds: &RecordBounds,
) -> Result<[f64; 2], String> {
    // Relative to the pixel of the mean, where differences are smaller than an f32 of the image.
    let shift = bounds.mean_shift;
    let origin = twin.pixel_of_mean(record, shift);
    let [a, b] =
        [kernel, twin].map(|side| (side.values(record, shift, origin), side.labels[record][1]));
    let [_, _, slope, rate_x, rate_y, log2_opacity] = bounds.footprint;
    let mean = |axis: usize| {
        let [kernel, twin] = [kernel, twin].map(|side| side.footprints[2 * record][axis]);
        if (kernel | twin) >> 31 == 0 {
            return bounds.mean_px[axis];
        }
        // Without the last digit.
        bounds.footprint[axis] + 4.0 * ROUNDOFF * f64::from(f32::from_bits(twin << 1)).abs()
    };
    let (mean_x, mean_y) = (mean(0), mean(1));
    let footprint = [
        mean_x,
        mean_y,
        slope,
        rate_x,
        rate_y,
        log2_opacity,
        bounds.depth_m,
    ];
    let footprint = within(what, &a.0, &b.0, &footprint)?;
    identical("instance", &[a.1], &[b.1])?;
    let [kernel, twin] = [kernel, twin].map(|side| side.color(record));
    // Both are rounded to a code.
    let color = bounds.color + f64::from(2.0 * COLOR_CODE_ERROR * twin.max_element());
    let colors = within(what, &kernel.to_array(), &twin.to_array(), &[color; 3])?;
    Ok([footprint, colors])
}

/// The shader computes a depth with 48 digits and the twin with 53: a step's edge may fall between
/// the two.
pub fn check_keys(kernel: &[u32], twin: &[u32]) -> Result<(), String> {
    let apart = |(a, b): (&u32, &u32)| a.abs_diff(*b);
    let different = kernel
        .iter()
        .zip(twin)
        .map(apart)
        .filter(|&steps| steps > 0)
        .count();
    if kernel.iter().zip(twin).map(apart).any(|steps| steps > 1) || different * 1000 > kernel.len()
    {
        return identical(
            "keys, which may be a step apart in one of a thousand",
            kernel,
            twin,
        );
    }
    Ok(())
}
