//! Lenses: where in the image the rays of a camera fall, beyond the pinhole.
//!
//! Parameters are those of the calibrations that are in use (OpenCV's and NVIDIA's), so that their
//! numbers can be copied. [`RayMap`] is what a lens does, made ready;
//! [`crate::Intrinsics::project`] and [`crate::Intrinsics::unproject`] are for single rays.

mod limit;
mod radial;
mod ray_map;
pub mod windshield;

#[cfg(test)]
mod tests;

pub use ray_map::RayMap;
pub use windshield::{Windshield, WindshieldDirection};

use crate::Invalid;

/// Largest angle off the axis that any lens shows, whatever its own maximum: depth is counted along
/// the axis.
pub const ANGLE_LIMIT_RAD: f64 = 1.57;

/// Lens: the mapping from rays to pixels. Angles are those between a ray and the optical axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Lens {
    /// `pixel = focal * (x / z, y / z) + principal`.
    #[default]
    Pinhole,
    /// A pinhole with distortion.
    OpenCv(OpenCv),
    /// Angles by an odd polynomial.
    Fisheye(Fisheye),
    /// Angles by a polynomial in pixels.
    FTheta(FTheta),
}

/// OpenCV's pinhole with distortion, `cv::projectPoints`: with x, y the ray divided by its z and r2
/// = x^2 + y^2, `x' = x (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3) + 2 p1 x
/// y + p2 (r2 + 2 x^2) + s1 r2 + s2 r2^2`, `y'` likewise with `p1 (r2 + 2 y^2) + 2 p2 x y + s3 r2 +
/// s4 r2^2`, and `pixel = focal * (x', y') + principal`.
///
/// It is followed as long as it is one to one: rays beyond have no pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct OpenCv {
    /// k1 to k6.
    pub radial: [f64; 6],
    /// p1 and p2.
    pub tangential: [f64; 2],
    /// s1 to s4.
    pub thin_prism: [f64; 4],
}

/// OpenCV's fisheye, `cv::fisheye::projectPoints`: at the angle a the image radius is
/// `a + k1 a^3 + k2 a^5 + k3 a^7 + k4 a^9` focal lengths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fisheye {
    /// k1 to k4.
    pub radial: [f64; 4],
    /// Rays farther off the axis have no pixel.
    pub max_angle_rad: f64,
}

impl Default for Fisheye {
    /// An equidistant lens of 180 degrees.
    fn default() -> Self {
        Self {
            radial: [0.0; 4],
            max_angle_rad: ANGLE_LIMIT_RAD,
        }
    }
}

/// Calibrated polynomial of an [`FTheta`] lens; the other one is an approximate inverse of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FThetaReference {
    /// [`FTheta::pixel_distance_to_angle`].
    PixelDistanceToAngle,
    /// [`FTheta::angle_to_pixel_distance`].
    AngleToPixelDistance,
}

/// NVIDIA's f-theta lens: at the angle a, a ray falls `v = f(a) (x, y) / |(x, y)|` pixels from the
/// principal point, at `(c v.x + d v.y, e v.x + v.y)`.
///
/// Focal lengths are not used: give those at the center of the image ([`FTheta::center_focal_px`]).
/// NVIDIA counts pixels from the center of the first one, this engine from its corner: its
/// principal point is theirs and half a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FTheta {
    /// The polynomial that is followed. Only its coefficients matter.
    pub reference: FThetaReference,
    /// The angle (radians) at a distance from the principal point (pixels), coefficients of its
    /// powers 0 to 5.
    pub pixel_distance_to_angle: [f64; 6],
    /// The distance from the principal point (pixels) at an angle (radians), coefficients of its
    /// powers 0 to 5.
    pub angle_to_pixel_distance: [f64; 6],
    /// Rays farther off the axis have no pixel.
    pub max_angle_rad: f64,
    /// c, d and e.
    pub linear_cde: [f64; 3],
}

impl FTheta {
    /// Pixels a radian at the center, along x and y.
    #[must_use]
    pub fn center_focal_px(&self) -> [f64; 2] {
        let focal_px = match self.reference {
            FThetaReference::PixelDistanceToAngle => self.pixel_distance_to_angle[1].recip(),
            FThetaReference::AngleToPixelDistance => self.angle_to_pixel_distance[1],
        };
        [focal_px * self.linear_cde[0], focal_px]
    }

    /// The coefficients that are followed.
    #[must_use]
    pub fn followed(&self) -> &[f64; 6] {
        match self.reference {
            FThetaReference::PixelDistanceToAngle => &self.pixel_distance_to_angle,
            FThetaReference::AngleToPixelDistance => &self.angle_to_pixel_distance,
        }
    }

    /// The lens of an image scaled by `sx` and `sy`.
    fn scaled(&self, sx: f64, sy: f64) -> Self {
        let [c, d, e] = self.linear_cde;
        Self {
            pixel_distance_to_angle: std::array::from_fn(|power| {
                self.pixel_distance_to_angle[power] / sy.powi(power as i32)
            }),
            angle_to_pixel_distance: self
                .angle_to_pixel_distance
                .map(|coefficient| coefficient * sy),
            linear_cde: [c * sx / sy, d * sx / sy, e],
            ..*self
        }
    }
}

impl Lens {
    /// True if it is equal to a pinhole.
    #[must_use]
    pub fn is_pinhole(&self) -> bool {
        match self {
            Self::Pinhole => true,
            Self::OpenCv(lens) => lens.coefficients().all(|coefficient| coefficient == 0.0),
            Self::Fisheye(_) | Self::FTheta(_) => false,
        }
    }

    /// The lens of an image scaled by `sx` along x and `sy` along y.
    #[must_use]
    pub fn scaled(&self, sx: f64, sy: f64) -> Self {
        match self {
            Self::FTheta(lens) => Self::FTheta(lens.scaled(sx, sy)),
            // The others count in focal lengths.
            other => *other,
        }
    }

    /// Checks the numbers of a lens, independent of the image's edges, and gives the reason if they
    /// are invalid.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let finite =
            |what: &str, values: &[f64]| match values.iter().find(|value| !value.is_finite()) {
                Some(value) => Err(Invalid::new(format!("lens: {what} {value} must be finite"))),
                None => Ok(()),
            };
        let angle = |max_angle_rad: f64| {
            if max_angle_rad.is_finite()
                && max_angle_rad > 1e-3
                && max_angle_rad <= std::f64::consts::PI
            {
                return Ok(());
            }
            Err(Invalid::new(format!(
                "lens: max angle {max_angle_rad} rad is outside 0.001 to pi"
            )))
        };
        match self {
            Self::Pinhole => Ok(()),
            Self::OpenCv(lens) => finite(
                "a distortion coefficient of",
                &lens.coefficients().collect::<Vec<_>>(),
            ),
            Self::Fisheye(lens) => {
                angle(lens.max_angle_rad).and_then(|()| finite("a coefficient of", &lens.radial))
            }
            Self::FTheta(lens) => {
                angle(lens.max_angle_rad)?;
                finite("a coefficient of", lens.followed())?;
                finite("linear c, d, e of", &lens.linear_cde)?;
                lens.check_shape()
            }
        }
    }
}

impl FTheta {
    fn check_shape(&self) -> Result<(), Invalid> {
        let [c, d, e] = self.linear_cde;
        if c - d * e <= 1e-3 {
            return Err(Invalid::new(format!(
                "lens: linear c {c}, d {d}, e {e} fold the image: c - d e must be positive"
            )));
        }
        let [constant, first, ..] = *self.followed();
        // A hundredth of a pixel at the center is what calibrations leave there.
        let constant_px = match self.reference {
            FThetaReference::PixelDistanceToAngle => constant / first,
            FThetaReference::AngleToPixelDistance => constant,
        };
        if !(first > 0.0 && first < 1e12 && constant_px.abs() <= 0.01) {
            return Err(Invalid::new(format!(
                "lens: a polynomial that begins {constant}, {first} is not 0 and rising at the center"
            )));
        }
        Ok(())
    }
}

impl OpenCv {
    fn coefficients(&self) -> impl Iterator<Item = f64> {
        let Self {
            radial,
            tangential,
            thin_prism,
        } = *self;
        radial.into_iter().chain(tangential).chain(thin_prism)
    }
}
