//! Maps of rays to pixels and back, in f64.

use glam::{DMat2, DVec2, DVec3};

use super::limit::{self, Limit};
use super::radial::Radial;
use super::windshield::Bending;
use super::{Lens, OpenCv};
use crate::Intrinsics;

/// Precomputed mapping of rays by a camera's lens.
///
/// Rays are x right, y down, z forward, of any length. Up to [`RayMap::limit_rad`] the lens is
/// followed. Beyond, where the image has no pixel that a ray of the lens falls on,
/// [`RayMap::project_extended`] continues in the same direction, linearly in the chord `2 sin(angle
/// / 2)`: finite, rising and without a jump all the way to the ray that points back, so that what
/// is at the edge of the image can be told from what is far beyond it.
#[derive(Clone, Copy, Debug)]
pub struct RayMap {
    shape: Shape,
    /// Pixels from the lens's own plane.
    matrix: DMat2,
    principal_px: DVec2,
    limit: Limit,
    tan_limit: f64,
    /// Image radius in the lens's plane by chord, beyond the limit.
    slope: f64,
    /// Bending of rays before the lens.
    bending: Option<Bending>,
}

#[derive(Clone, Copy, Debug)]
enum Shape {
    Planar(OpenCv),
    Radial(Radial),
}

/// `2 sin(angle / 2)` for a ray of unit length.
fn chord(ray: DVec3) -> f64 {
    if ray.z >= 0.0 {
        ray.truncate().length() * (2.0 / (1.0 + ray.z)).sqrt()
    } else {
        (2.0 - 2.0 * ray.z).sqrt()
    }
}

impl RayMap {
    /// Builds the map of the lens of `intrinsics`, which must have passed [`Intrinsics::check`].
    #[must_use]
    pub fn new(intrinsics: &Intrinsics) -> Self {
        let k = intrinsics;
        let matrix = match &k.lens {
            Lens::FTheta(lens) => {
                let [c, d, e] = lens.linear_cde;
                DMat2::from_cols_array(&[c, e, d, 1.0])
            }
            _ => DMat2::from_diagonal(DVec2::new(k.fx_px, k.fy_px)),
        };
        let shape = match k.lens {
            Lens::Pinhole => Shape::Planar(OpenCv::default()),
            Lens::OpenCv(lens) => Shape::Planar(lens),
            Lens::Fisheye(lens) => Shape::Radial(Radial::Fisheye(lens)),
            Lens::FTheta(lens) => Shape::Radial(Radial::FTheta(lens)),
        };
        let principal_px = DVec2::new(k.cx_px, k.cy_px);
        let corner = farthest_corner(k, &matrix, principal_px);
        let limit = match &shape {
            Shape::Planar(lens) => limit::of_open_cv(lens, corner),
            Shape::Radial(lens) => limit::of_radial(lens, corner),
        };
        let rate = match &shape {
            Shape::Planar(lens) => {
                let radius = limit.angle_rad.tan();
                // What a radian adds to the radius: that of the tangent, times that of the tangent
                // by the angle.
                lens.radial_slope(radius) * (1.0 + radius * radius)
            }
            Shape::Radial(lens) if lens.is_backward() => lens.polynomial(limit.radius).1.recip(),
            Shape::Radial(lens) => lens.polynomial(limit.angle_rad).1,
        };
        // By chord; never so flat that what is far beyond comes near.
        let mean = limit.radius / (2.0 * (0.5 * limit.angle_rad).sin()).max(1e-9);
        let slope = (rate / (0.5 * limit.angle_rad).cos()).max(0.25 * mean);
        let map = Self {
            shape,
            matrix,
            principal_px,
            limit,
            tan_limit: limit.angle_rad.tan(),
            slope,
            bending: None,
        };
        let bending = k
            .windshield
            .map(|windshield| Bending::new(windshield, map.edge_sines(k)));
        Self { bending, ..map }
    }

    /// Largest sines along x and y of rays at the edges of the image.
    fn edge_sines(&self, intrinsics: &Intrinsics) -> DVec2 {
        const STEPS: u32 = 8;
        let size = DVec2::new(intrinsics.width_px.into(), intrinsics.height_px.into());
        let positions = (0..=STEPS).flat_map(|step| {
            let share = f64::from(step) / f64::from(STEPS);
            let across = [DVec2::new(share, 0.0), DVec2::new(share, 1.0)];
            across
                .into_iter()
                .chain([DVec2::new(0.0, share), DVec2::new(1.0, share)])
        });
        let beyond = DVec2::splat(self.limit.angle_rad.sin());
        let sines = |position: DVec2| {
            let ray = self.unproject(position * size);
            ray.map_or(beyond, |ray| ray.truncate().abs())
        };
        positions.map(sines).fold(DVec2::ZERO, DVec2::max)
    }

    /// Bending of rays before the lens; `None` without a windshield.
    #[must_use]
    pub fn bending(&self) -> Option<&Bending> {
        self.bending.as_ref()
    }

    fn bent(&self, ray: DVec3) -> DVec3 {
        match &self.bending {
            Some(bending) => bending.bent(ray),
            None => ray,
        }
    }

    /// The angle up to which the lens is followed, radians.
    #[must_use]
    pub fn limit_rad(&self) -> f64 {
        self.limit.angle_rad
    }

    /// Pixels from the lens's own plane, whose origin is at the principal point.
    #[must_use]
    pub fn matrix(&self) -> DMat2 {
        self.matrix
    }

    /// Growth of the image radius in the lens's plane per chord, beyond the limit.
    #[must_use]
    pub fn slope_beyond(&self) -> f64 {
        self.slope
    }

    /// The image radius in the lens's plane at an angle up to the limit, and what it grows by a
    /// radian, for lenses that are the same all around: `None` for a pinhole, distorted or not.
    #[must_use]
    pub fn radius_at(&self, angle_rad: f64) -> Option<(f64, f64)> {
        let Shape::Radial(lens) = &self.shape else {
            return None;
        };
        Some(if lens.is_backward() {
            let radius = lens.solved(angle_rad, self.limit.radius);
            (radius, lens.polynomial(radius).1.recip())
        } else {
            lens.polynomial(angle_rad)
        })
    }

    /// True if `ray`, of any length, is within the limit.
    #[must_use]
    pub fn shows(&self, ray: DVec3) -> bool {
        let ray = self.bent(ray);
        ray.z > 0.0 && ray.truncate().length() <= self.tan_limit * ray.z
    }

    /// The pixel that `ray` falls on, in the image or beside it; `None` beyond the limit.
    #[must_use]
    pub fn project(&self, ray: DVec3) -> Option<DVec2> {
        self.shows(ray).then(|| self.project_extended(ray))
    }

    /// Projection of `ray`; beyond the limit, by the linear continuation of the lens.
    #[must_use]
    pub fn project_extended(&self, ray: DVec3) -> DVec2 {
        self.principal_px + self.matrix * self.in_plane(self.bent(ray.normalize_or_zero()))
    }

    fn in_plane(&self, ray: DVec3) -> DVec2 {
        let across = ray.truncate();
        // Straight back is every direction at once: any of them.
        let direction = if across == DVec2::ZERO && ray.z < 0.0 {
            DVec2::X
        } else {
            across.normalize_or_zero()
        };
        let angle_rad = across.length().atan2(ray.z);
        let held_rad = angle_rad.min(self.limit.angle_rad);
        let held = match &self.shape {
            Shape::Planar(lens) if held_rad == angle_rad => lens.distorted(across / ray.z).0,
            Shape::Planar(lens) => lens.distorted(direction * held_rad.tan()).0,
            Shape::Radial(_) => {
                direction * self.radius_at(held_rad).map_or(0.0, |(radius, _)| radius)
            }
        };
        if held_rad == angle_rad {
            return held;
        }
        held + direction * (self.slope * (chord(ray) - 2.0 * (0.5 * held_rad).sin()))
    }

    /// The ray of unit length that falls on `pixel`; `None` where there is none.
    #[must_use]
    pub fn unproject(&self, pixel: DVec2) -> Option<DVec3> {
        let ray = self.unproject_by_lens(pixel)?;
        match &self.bending {
            Some(bending) => bending.unbent(ray),
            None => Some(ray),
        }
    }

    /// The ray behind the windshield that falls on `pixel`.
    fn unproject_by_lens(&self, pixel: DVec2) -> Option<DVec3> {
        let v = self.matrix.inverse() * (pixel - self.principal_px);
        if !v.is_finite() {
            return None;
        }
        match &self.shape {
            Shape::Planar(lens) => {
                let tangent = self.limit.angle_rad.tan();
                // A little beyond the limit: what rounding adds to a ray at it is none of its
                // fault.
                let point = lens
                    .undistorted(v, tangent)
                    .filter(|point| point.length() <= tangent * (1.0 + 1e-12))?;
                Some(point.extend(1.0).normalize())
            }
            Shape::Radial(lens) => {
                let radius = v.length();
                if radius > self.limit.radius * (1.0 + 1e-12) {
                    return None;
                }
                let radius = radius.min(self.limit.radius);
                let angle_rad = if lens.is_backward() {
                    lens.polynomial(radius).0
                } else {
                    lens.solved(radius, self.limit.angle_rad)
                };
                Some((v.normalize_or_zero() * angle_rad.sin()).extend(angle_rad.cos()))
            }
        }
    }

    /// Checks that each pixel that the lens shows has one ray before the windshield.
    fn check_bending(&self, intrinsics: &Intrinsics) -> Result<(), String> {
        const STEPS: u32 = 8;
        if self.bending.is_none() {
            return Ok(());
        }
        let size = DVec2::new(intrinsics.width_px.into(), intrinsics.height_px.into());
        for position in 0..(STEPS + 1) * (STEPS + 1) {
            let steps = DVec2::new(
                (position % (STEPS + 1)).into(),
                (position / (STEPS + 1)).into(),
            );
            let pixel = steps / f64::from(STEPS) * size;
            if self.unproject_by_lens(pixel).is_none() {
                continue;
            }
            let back = self.unproject(pixel).map(|ray| self.project_extended(ray));
            // Written so that a NaN fails.
            if !back.is_some_and(|back| (back - pixel).length() < 1e-3) {
                return Err(format!(
                    "windshield: no ray before it reaches the pixel {pixel}; the polynomials have no inverse there"
                ));
            }
        }
        Ok(())
    }

    /// Checks that the lens does not fold the image of `intrinsics` at any pixel, and gives the
    /// reason if it does.
    pub(crate) fn check(&self, intrinsics: &Intrinsics) -> Result<(), String> {
        self.check_bending(intrinsics)?;
        let corner = farthest_corner(intrinsics, &self.matrix, self.principal_px);
        let Limit {
            angle_rad,
            radius,
            turns,
        } = self.limit;
        match &self.shape {
            Shape::Planar(_) if turns && radius < 0.5 * corner => Err(format!(
                "lens: distortion folds the image {angle_rad:.3} rad off the axis, before half of the way to its farthest corner"
            )),
            Shape::Radial(lens) if turns && radius < corner => Err(format!(
                "lens: the polynomial turns over at {angle_rad:.3} rad, inside the image and before the max angle of {:.3} rad: \
                 lower the max angle to where it still rises",
                lens.max_angle_rad()
            )),
            _ if !(self.slope.is_finite() && radius > 0.0) => {
                Err("lens: it has no image at all".into())
            }
            _ => Ok(()),
        }
    }
}

/// The distance from the principal point to the farthest corner of the image, in the lens's plane.
fn farthest_corner(intrinsics: &Intrinsics, matrix: &DMat2, principal_px: DVec2) -> f64 {
    let (width, height) = (
        f64::from(intrinsics.width_px),
        f64::from(intrinsics.height_px),
    );
    let corners = [(0.0, 0.0), (width, 0.0), (0.0, height), (width, height)];
    let back = matrix.inverse();
    corners
        .into_iter()
        .map(|(x, y)| (back * (DVec2::new(x, y) - principal_px)).length())
        .fold(0.0, f64::max)
}

impl OpenCv {
    /// The factor of the radius, its derivative by r2, and its denominator.
    fn factor(&self, r2: f64) -> (f64, f64, f64) {
        let [k1, k2, k3, k4, k5, k6] = self.radial;
        let numerator = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3));
        let denominator = 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6));
        let numerator_slope = k1 + r2 * (2.0 * k2 + r2 * 3.0 * k3);
        let denominator_slope = k4 + r2 * (2.0 * k5 + r2 * 3.0 * k6);
        let factor = numerator / denominator;
        (
            factor,
            (numerator_slope - factor * denominator_slope) / denominator,
            denominator,
        )
    }

    /// Derivative of the distorted radius by the radius, without tangential terms and thin prism.
    fn radial_slope(&self, radius: f64) -> f64 {
        let r2 = radius * radius;
        let (factor, slope, _) = self.factor(r2);
        factor + 2.0 * r2 * slope
    }

    /// The distorted point and its derivatives by x and by y.
    fn with_jacobian(&self, p: DVec2) -> (DVec2, DMat2, f64) {
        let [p1, p2] = self.tangential;
        let [s1, s2, s3, s4] = self.thin_prism;
        let (x, y) = (p.x, p.y);
        let r2 = p.length_squared();
        let (factor, slope, denominator) = self.factor(r2);
        let point = DVec2::new(
            x * factor + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2),
            y * factor + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4),
        );
        let prism = DVec2::new(s1 + 2.0 * r2 * s2, s3 + 2.0 * r2 * s4);
        let by_x = DVec2::new(
            factor + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x,
            2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
        ) + 2.0 * x * prism;
        let by_y = DVec2::new(
            2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y,
            factor + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x,
        ) + 2.0 * y * prism;
        (point, DMat2::from_cols(by_x, by_y), denominator)
    }

    /// The distorted point, by what factor areas about it grow, and the denominator of its radial
    /// factor.
    pub(super) fn distorted(&self, p: DVec2) -> (DVec2, f64, f64) {
        let (point, jacobian, denominator) = self.with_jacobian(p);
        (point, jacobian.determinant(), denominator)
    }

    /// The point that is distorted to `v`, if one at most `end` from the center is.
    fn undistorted(&self, v: DVec2, end: f64) -> Option<DVec2> {
        // Along the radius first, which brings Newton's method near enough.
        let (mut low, mut high) = (0.0, end);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if middle * self.factor(middle * middle).0 < v.length() {
                low = middle;
            } else {
                high = middle;
            }
        }
        let mut p = v.normalize_or_zero() * (0.5 * (low + high));
        for _ in 0..40 {
            let (point, jacobian, _) = self.with_jacobian(p);
            let step = jacobian.inverse() * (point - v);
            if !step.is_finite() {
                return None;
            }
            // Where the way is bent, large steps lead astray.
            let step = step.clamp_length_max(0.25 * (1.0 + p.length()));
            p -= step;
            if step.length() <= 4.0 * f64::EPSILON * (1.0 + p.length()) {
                break;
            }
        }
        ((self.with_jacobian(p).0 - v).length() <= 1e-10 * (1.0 + v.length())).then_some(p)
    }
}
