//! Occluders of light.

use glam::{Quat, Vec2, Vec3};

use super::random::smoothstep;

/// Something that light does not pass, or not wholly.
#[derive(Clone, Copy, Debug)]
pub(super) enum Occluder {
    /// A house.
    Box { min: Vec3, max: Vec3 },
    /// A car that stands along an axis of the world: a box that also darkens the ground about it.
    Car { min: Vec3, max: Vec3 },
    /// The crown of a tree, through which some light comes.
    Crown { center: Vec3, radii: Vec3 },
    /// A box about `center` with half sizes `half`, turned by `yaw_rad` about z; where `grounded`,
    /// it darkens as a car does.
    Turned {
        center: Vec3,
        half: Vec3,
        yaw_rad: f32,
        grounded: bool,
    },
}

impl Occluder {
    /// Corners of the upright box about it.
    pub(super) fn bounds(&self) -> (Vec3, Vec3) {
        match *self {
            Self::Box { min, max } | Self::Car { min, max } => (min, max),
            Self::Crown { center, radii } => (center - radii, center + radii),
            Self::Turned {
                center,
                half,
                yaw_rad,
                ..
            } => {
                let (sin, cos) = yaw_rad.sin_cos();
                let (sin, cos) = (sin.abs(), cos.abs());
                let half_size = Vec3::new(
                    cos * half.x + sin * half.y,
                    sin * half.x + cos * half.y,
                    half.z,
                );
                (center - half_size, center + half_size)
            }
        }
    }

    /// Share of the light that passes it on the first `length` lengths of `direction`.
    pub(super) fn transmittance(&self, from: Vec3, direction: Vec3, length: f32) -> f32 {
        match *self {
            Self::Box { min, max } | Self::Car { min, max } => {
                blocked(slab(min - from, max - from, direction), length)
            }
            Self::Turned {
                center,
                half,
                yaw_rad,
                ..
            } => {
                let upright = Quat::from_rotation_z(-yaw_rad);
                let offset = upright * (from - center);
                blocked(
                    slab(-half - offset, half - offset, upright * direction),
                    length,
                )
            }
            Self::Crown { center, radii } => {
                let (offset, ray) = ((from - center) / radii, direction / radii);
                let (a, b, c) = (
                    ray.length_squared(),
                    offset.dot(ray),
                    offset.length_squared() - 1.0,
                );
                let discriminant = b * b - a * c;
                if discriminant <= 0.0 {
                    return 1.0;
                }
                let root = discriminant.sqrt();
                let inside_m =
                    ((-b + root) / a).max(0.0).min(length) - ((-b - root) / a).max(0.0).min(length);
                (-0.85 * inside_m).exp()
            }
        }
    }

    /// Share of the sky that it leaves to a point on the ground.
    pub(super) fn open_sky(&self, position: Vec3) -> f32 {
        let outside = match *self {
            Self::Car { min, max } => (min - position).max(position - max).truncate(),
            Self::Turned {
                center,
                half,
                yaw_rad,
                grounded: true,
            } => {
                let local = Vec2::from_angle(-yaw_rad).rotate((position - center).truncate());
                local.abs() - half.truncate()
            }
            _ => return 1.0,
        };
        let distance_m = outside.max(Vec2::ZERO).length() + outside.max_element().min(0.0);
        0.22 + 0.78 * smoothstep(-0.35, 0.75, distance_m)
    }
}

/// Distances at which a ray from the origin enters and leaves the box.
fn slab(min: Vec3, max: Vec3, direction: Vec3) -> (f32, f32) {
    let inverse = direction.recip();
    let (a, b) = (min * inverse, max * inverse);
    (a.min(b).max_element(), a.max(b).min_element())
}

fn blocked((near, far): (f32, f32), length: f32) -> f32 {
    if far > near.max(0.0) && near < length {
        0.0
    } else {
        1.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAR: Occluder = Occluder::Turned {
        center: Vec3::new(10.0, -4.0, 0.75),
        half: Vec3::new(2.0, 1.0, 0.6),
        yaw_rad: std::f32::consts::FRAC_PI_4,
        grounded: true,
    };

    #[test]
    fn a_turned_box_blocks_along_its_own_axes() {
        let nose = Vec3::new(1.0, 1.0, 0.0).normalize();
        let center = Vec3::new(10.0, -4.0, 0.75);
        let up =
            |offset: Vec3| CAR.transmittance(center + offset - Vec3::Z, Vec3::Z, f32::INFINITY);
        assert_eq!((up(1.9 * nose), up(2.1 * nose)), (0.0, 1.0));
        let side = Vec3::Z.cross(nose);
        assert_eq!((up(0.9 * side), up(1.1 * side)), (0.0, 1.0));
        assert_eq!(
            CAR.transmittance(center - Vec3::Z, Vec3::Z, 0.3),
            1.0,
            "a lamp that hangs before it"
        );
        let (min, max) = CAR.bounds();
        assert!(
            (max.x - min.x - 2.0 * 3.0 * 0.5f32.sqrt()).abs() < 1e-5
                && (max.z - min.z - 1.2).abs() < 1e-6
        );
    }

    #[test]
    fn a_car_along_the_axes_darkens_like_a_turned_one() {
        let (center, half) = (Vec3::new(10.0, -4.0, 0.75), Vec3::new(2.0, 1.0, 0.6));
        let upright = Occluder::Car {
            min: center - half,
            max: center + half,
        };
        let turned = Occluder::Turned {
            center,
            half,
            yaw_rad: 0.0,
            grounded: true,
        };
        for step in 0..40 {
            let at = Vec3::new(7.0 + 0.15 * step as f32, -5.4 + 0.07 * step as f32, 0.0);
            assert!((upright.open_sky(at) - turned.open_sky(at)).abs() < 1e-5);
        }
        assert!(turned.open_sky(center.with_z(0.0)) < 0.25);
    }
}
