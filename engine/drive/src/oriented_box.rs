//! Vehicles as rectangles seen from above: whether they overlap, how far apart they are and when
//! they will touch.

use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

/// A rectangle on the plane, turned by its yaw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrientedBox {
    /// Center, world coordinates, meters.
    pub center_m: DVec2,
    /// Heading of the long axis, from x towards y.
    pub yaw_rad: f64,
    /// Distance from the middle to the front, meters.
    pub half_length_m: f64,
    /// Distance from the middle to the left side, meters.
    pub half_width_m: f64,
}

/// Projections of two boxes on one direction, for the separating axis test.
struct Shadow {
    /// Distance from the middle of the first to that of the second, along the direction, meters.
    offset_m: f64,
    /// Largest distance of the centers at which the projections touch.
    half_sum_m: f64,
    /// Direction of the projection, unit vector.
    axis: DVec2,
}

impl OrientedBox {
    /// The outline of a vehicle.
    #[must_use]
    pub fn for_vehicle(state: &VehicleState, size: &VehicleSize) -> Self {
        Self {
            center_m: state.position_m,
            yaw_rad: state.yaw_rad,
            half_length_m: 0.5 * size.length_m,
            half_width_m: 0.5 * size.width_m,
        }
    }

    /// True if `point` is on the rectangle.
    #[must_use]
    pub fn contains(&self, point: DVec2) -> bool {
        let half_m = DVec2::new(self.half_length_m, self.half_width_m);
        self.to_local(point).abs().cmple(half_m).all()
    }

    /// Distance from the rectangle to `point`, meters; 0 on it.
    #[must_use]
    pub fn distance_to_m(&self, point: DVec2) -> f64 {
        let half_m = DVec2::new(self.half_length_m, self.half_width_m);
        let beyond_m = self.to_local(point).abs() - half_m;
        beyond_m.max(DVec2::ZERO).length()
    }

    /// The box with each side `margin_m` farther out.
    #[must_use]
    pub fn widened(&self, margin_m: f64) -> Self {
        Self {
            half_length_m: self.half_length_m + margin_m,
            half_width_m: self.half_width_m + margin_m,
            ..*self
        }
    }

    /// Corners: front left, rear left, rear right, front right; counter-clockwise, world
    /// coordinates, meters.
    #[must_use]
    pub fn corners(&self) -> [DVec2; 4] {
        self.offsets().map(|offset| self.center_m + offset)
    }

    /// The box with its front `ahead_m` farther ahead.
    #[must_use]
    pub fn extended(&self, ahead_m: f64) -> Self {
        Self {
            center_m: self.center_m + DVec2::from_angle(self.yaw_rad) * (0.5 * ahead_m),
            half_length_m: self.half_length_m + 0.5 * ahead_m,
            ..*self
        }
    }

    /// Corners relative to the center, in the world's axes.
    fn offsets(&self) -> [DVec2; 4] {
        let ahead = DVec2::from_angle(self.yaw_rad);
        let (length, width) = (ahead * self.half_length_m, ahead.perp() * self.half_width_m);
        [
            length + width,
            width - length,
            -length - width,
            length - width,
        ]
    }

    /// A position in the world, seen from the box: x towards its front, y to its left, meters.
    #[must_use]
    pub fn to_local(&self, world_m: DVec2) -> DVec2 {
        DVec2::from_angle(-self.yaw_rad).rotate(world_m - self.center_m)
    }

    /// True if the two share a point; touching is sharing.
    #[must_use]
    pub fn overlaps(&self, other: &Self) -> bool {
        self.shadows(other)
            .iter()
            .all(|shadow| shadow.offset_m.abs() <= shadow.half_sum_m)
    }

    /// The gap between the two, meters: 0 where they overlap.
    #[must_use]
    pub fn distance_m(&self, other: &Self) -> f64 {
        if self.overlaps(other) {
            return 0.0;
        }
        // Of two convex shapes that are apart, a corner of one is nearest to the other.
        self.nearest_corner_m(other)
            .min(other.nearest_corner_m(self))
    }

    /// Distance from this box to the nearest corner of `other`, meters.
    fn nearest_corner_m(&self, other: &Self) -> f64 {
        let (half, turn) = (
            DVec2::new(self.half_length_m, self.half_width_m),
            DVec2::from_angle(-self.yaw_rad),
        );
        // Middles are subtracted before corners are made of them: what is left is exact far from
        // the world's origin.
        let between = other.center_m - self.center_m;
        let outside = |offset: DVec2| {
            (turn.rotate(between + offset).abs() - half)
                .max(DVec2::ZERO)
                .length()
        };
        other
            .offsets()
            .into_iter()
            .map(outside)
            .fold(f64::INFINITY, f64::min)
    }

    /// The two along the sides of both: they overlap where their shadows do on all four (separating
    /// axis theorem).
    fn shadows(&self, other: &Self) -> [Shadow; 4] {
        let between = other.center_m - self.center_m;
        let (a, b) = (
            DVec2::from_angle(self.yaw_rad),
            DVec2::from_angle(other.yaw_rad),
        );
        let radius = |ahead: DVec2, half: &Self, axis: DVec2| {
            half.half_length_m * ahead.dot(axis).abs()
                + half.half_width_m * ahead.perp().dot(axis).abs()
        };
        [a, a.perp(), b, b.perp()].map(|axis| Shadow {
            offset_m: between.dot(axis),
            half_sum_m: radius(a, self, axis) + radius(b, other, axis),
            axis,
        })
    }
}

/// Time until two boxes touch, seconds, if both move on at their velocities (meters per second)
/// without turning: 0 where they overlap already, `None` where they do not touch within
/// `horizon_s`. Exact: the boxes overlap while their shadows overlap along the sides of both, and
/// along each side that is one span of time.
#[must_use]
pub fn time_to_collision(
    a: &OrientedBox,
    velocity_a_mps: DVec2,
    b: &OrientedBox,
    velocity_b_mps: DVec2,
    horizon_s: f64,
) -> Option<f64> {
    let relative_mps = velocity_b_mps - velocity_a_mps;
    let (mut first_s, mut last_s) = (0.0_f64, horizon_s);
    for Shadow {
        offset_m,
        half_sum_m,
        axis,
    } in a.shadows(b)
    {
        let along_mps = relative_mps.dot(axis);
        if along_mps == 0.0 {
            if offset_m.abs() > half_sum_m {
                return None;
            }
            continue;
        }
        let ends = [
            (-half_sum_m - offset_m) / along_mps,
            (half_sum_m - offset_m) / along_mps,
        ];
        first_s = first_s.max(ends[0].min(ends[1]));
        last_s = last_s.min(ends[0].max(ends[1]));
    }
    // What is no number makes no collision.
    let finite = a.center_m.is_finite() && b.center_m.is_finite() && relative_mps.is_finite();
    (finite && first_s <= last_s && first_s <= horizon_s).then_some(first_s)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_from_boxes_are_those_of_their_sides() {
        let tree = OrientedBox {
            center_m: DVec2::new(2.0, 1.0),
            yaw_rad: std::f64::consts::FRAC_PI_2,
            half_length_m: 2.0,
            half_width_m: 0.5,
        };
        assert_eq!(tree.distance_to_m(DVec2::new(2.2, 2.5)), 0.0);
        assert!((tree.distance_to_m(DVec2::new(3.5, 1.0)) - 1.0).abs() < 1e-12);
        assert!((tree.distance_to_m(DVec2::new(2.0, 4.0)) - 1.0).abs() < 1e-12);
        assert!(tree.contains(DVec2::new(2.4, 2.9)) && !tree.contains(DVec2::new(2.6, 2.9)));
        assert!(tree.widened(0.2).contains(DVec2::new(2.6, 2.9)));
        assert!(!tree.contains(DVec2::NAN));
    }
}
