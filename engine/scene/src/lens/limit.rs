//! Limit of a lens: its maximum angle, or the angle at which it stops being one to one.

use glam::DVec2;

use super::radial::Radial;
use super::{ANGLE_LIMIT_RAD, OpenCv};

/// Limit of a lens.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limit {
    /// The last angle.
    pub angle_rad: f64,
    /// The image radius there, the smallest over all directions.
    pub radius: f64,
    /// True if it would fold the image beyond.
    pub turns: bool,
}

/// Steps along the way from the center to the end.
const STEPS: u32 = 400;

/// Directions in which a lens that is not the same all around is examined.
const DIRECTIONS: u32 = 8;

/// Factor on the distance of the image's farthest corner up to which a lens without a maximum angle
/// is evaluated.
pub(super) const MARGIN: f64 = 1.3;

/// Unit vectors all around.
pub(super) fn directions() -> impl Iterator<Item = DVec2> {
    (0..DIRECTIONS).map(|i| {
        DVec2::from_angle((f64::from(i) + 0.25) * std::f64::consts::TAU / f64::from(DIRECTIONS))
    })
}

/// Limit of a distorted pinhole whose image's farthest corner is `corner` from the principal point,
/// in focal lengths.
pub(super) fn of_open_cv(lens: &OpenCv, corner: f64) -> Limit {
    let mut limit = Limit {
        angle_rad: 0.0,
        radius: 0.0,
        turns: false,
    };
    for step in 1..=STEPS {
        let angle_rad = ANGLE_LIMIT_RAD * f64::from(step) / f64::from(STEPS + 1);
        let mut radius = f64::INFINITY;
        for direction in directions() {
            let (point, determinant, denominator) = lens.distorted(direction * angle_rad.tan());
            if !(determinant > 1e-9 && denominator > 1e-6 && point.is_finite()) {
                return Limit {
                    turns: true,
                    ..limit
                };
            }
            radius = radius.min(point.length());
        }
        // One to one in small, and not yet in the large.
        if radius <= limit.radius {
            return Limit {
                turns: true,
                ..limit
            };
        }
        limit = Limit {
            angle_rad,
            radius,
            turns: false,
        };
        if radius > MARGIN * corner {
            break;
        }
    }
    limit
}

/// Limit of a lens by angles whose image's farthest corner is `corner` from the principal point, in
/// its units.
pub(super) fn of_radial(lens: &Radial, corner: f64) -> Limit {
    let backward = lens.is_backward();
    let max_angle_rad = lens.max_angle_rad();
    let end = if backward {
        4.0 * corner.max(1.0)
    } else {
        max_angle_rad
    };
    let (mut at, mut turns) = (0.0, false);
    for step in 1..=STEPS {
        let next = end * f64::from(step) / f64::from(STEPS);
        let (value, slope) = lens.polynomial(next);
        // The least slope for which neighboring rays are still told apart.
        if !(value.is_finite()
            && slope > 1e-4 * lens.polynomial(0.0).1
            && value > lens.polynomial(at).0)
        {
            turns = true;
            break;
        }
        at = next;
        if backward && value >= max_angle_rad {
            at = lens.solved(max_angle_rad, next);
            break;
        }
    }
    let value = lens.polynomial(at).0;
    let (angle_rad, radius) = if backward { (value, at) } else { (at, value) };
    Limit {
        angle_rad,
        radius,
        turns,
    }
}
