//! Lenses that turn angles into image radii.

use super::{ANGLE_LIMIT_RAD, FTheta, FThetaReference, Fisheye};

/// Image radius by angle, up to the angle where it ends.
#[derive(Clone, Copy, Debug)]
pub(super) enum Radial {
    Fisheye(Fisheye),
    FTheta(FTheta),
}

/// A value and its derivative.
pub(super) type Slope = (f64, f64);

impl Radial {
    pub fn max_angle_rad(&self) -> f64 {
        let max_angle_rad = match self {
            Self::Fisheye(lens) => lens.max_angle_rad,
            Self::FTheta(lens) => lens.max_angle_rad,
        };
        max_angle_rad.min(ANGLE_LIMIT_RAD)
    }

    /// True if the polynomial maps radii to angles.
    pub fn is_backward(&self) -> bool {
        matches!(self, Self::FTheta(lens) if lens.reference == FThetaReference::PixelDistanceToAngle)
    }

    /// The polynomial, of an angle or, if it is backward, of a radius.
    pub fn polynomial(&self, at: f64) -> Slope {
        match self {
            Self::Fisheye(lens) => {
                let [k1, k2, k3, k4] = lens.radial;
                let s = at * at;
                let value = at * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))));
                (
                    value,
                    1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4))),
                )
            }
            Self::FTheta(lens) => {
                let [_, c1, c2, c3, c4, c5] = *lens.followed();
                let value = at * (c1 + at * (c2 + at * (c3 + at * (c4 + at * c5))));
                (
                    value,
                    c1 + at * (2.0 * c2 + at * (3.0 * c3 + at * (4.0 * c4 + at * 5.0 * c5))),
                )
            }
        }
    }

    /// Argument at which the polynomial, which rises from 0 to `end`, has `value`.
    pub fn solved(&self, value: f64, end: f64) -> f64 {
        let (mut low, mut high) = (0.0, end);
        let mut at = (value / self.polynomial(end).0).clamp(0.0, 1.0) * end;
        for _ in 0..80 {
            let (here, slope) = self.polynomial(at);
            if here > value {
                high = at;
            } else {
                low = at;
            }
            let newton = at - (here - value) / slope;
            // Newton's step where it stays between the bounds, half of what is between them where
            // it does not.
            let next = if newton > low && newton < high {
                newton
            } else {
                0.5 * (low + high)
            };
            if (next - at).abs() <= f64::EPSILON * end {
                return next;
            }
            at = next;
        }
        at
    }
}
