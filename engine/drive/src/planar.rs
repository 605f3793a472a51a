//! Rigid transforms of the plane, SE(2).

use glam::DVec2;

/// A turn about a pivot, then a shift. The pivot lies in the middle of what is moved, so that the
/// shift is what a reader expects: about the origin of UTM coordinates a turn of a degree would
/// shift by kilometers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanarTransform {
    /// The point that is shifted only, world coordinates, meters.
    pub pivot_m: DVec2,
    /// Turn, radians, from x towards y.
    pub yaw_rad: f64,
    /// Translation of the pivot, meters.
    pub shift_m: DVec2,
}

impl PlanarTransform {
    /// Identity about `pivot_m`.
    #[must_use]
    pub const fn identity(pivot_m: DVec2) -> Self {
        Self {
            pivot_m,
            yaw_rad: 0.0,
            shift_m: DVec2::ZERO,
        }
    }

    /// Applies the transform to `point`.
    #[must_use]
    pub fn apply(&self, point: DVec2) -> DVec2 {
        DVec2::from_angle(self.yaw_rad).rotate(point - self.pivot_m) + self.pivot_m + self.shift_m
    }

    /// The same motion about another pivot.
    #[must_use]
    pub fn about(&self, pivot_m: DVec2) -> Self {
        Self {
            pivot_m,
            yaw_rad: self.yaw_rad,
            shift_m: self.apply(pivot_m) - pivot_m,
        }
    }

    /// Inverse of the motion.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self {
            pivot_m: self.pivot_m + self.shift_m,
            yaw_rad: -self.yaw_rad,
            shift_m: -self.shift_m,
        }
    }

    /// `self` after `first`, about the pivot of `first`.
    #[must_use]
    pub fn after(&self, first: &Self) -> Self {
        let pivot_m = first.pivot_m;
        Self {
            pivot_m,
            yaw_rad: self.yaw_rad + first.yaw_rad,
            shift_m: self.apply(first.apply(pivot_m)) - pivot_m,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motions_compose_invert_and_change_pivots() {
        let a = PlanarTransform {
            pivot_m: DVec2::new(5e5, 5e6),
            yaw_rad: 0.03,
            shift_m: DVec2::new(0.5, -1.0),
        };
        let b = PlanarTransform {
            pivot_m: DVec2::new(5e5 + 80.0, 5e6 - 30.0),
            yaw_rad: -0.4,
            shift_m: DVec2::new(2.0, 3.0),
        };
        let point = DVec2::new(5e5 + 12.0, 5e6 + 7.0);
        let close = |a: DVec2, b: DVec2| assert!(a.distance(b) < 1e-8, "{a} {b}");
        close(a.after(&b).apply(point), a.apply(b.apply(point)));
        close(a.inverse().apply(a.apply(point)), point);
        close(a.about(b.pivot_m).apply(point), a.apply(point));
    }
}
