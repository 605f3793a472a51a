//! Windshields: the bending of rays before a lens.

use glam::{DVec2, DVec3};

use crate::Invalid;

/// Highest order of a polynomial.
pub const WINDSHIELD_ORDER: usize = 5;

/// Coefficients of the powers of two angles: `[j][i]` belongs to `phi^i theta^j`, with i + j at
/// most [`WINDSHIELD_ORDER`].
pub type AnglePolynomial = [[f64; 6]; 6];

/// Direction of the calibrated polynomials.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WindshieldDirection {
    /// Polynomials map rays in the world to rays that reach the lens.
    Forward,
    /// Polynomials map rays that reach the lens to rays in the world.
    Backward,
}

/// A windshield that bends rays before they reach the lens: NCore's bivariate windshield model
/// (NVIDIA, `docs/data/sensor_models.rst`).
///
/// With the angles `phi = asin(x)` and `theta = asin(y)` of a ray of unit length, the bent ray has
/// the angles `P_h(phi, theta)` and `P_v(phi, theta)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Windshield {
    /// Direction of the polynomials.
    pub direction: WindshieldDirection,
    /// P_h, radians.
    pub horizontal: AnglePolynomial,
    /// P_v, radians.
    pub vertical: AnglePolynomial,
}

/// Polynomial of a list of coefficients, grouped by the power of theta: all powers of phi of
/// `theta^0`, then those of `theta^1`, and so on; a polynomial of order N has (N + 1) (N + 2) / 2.
///
/// # Errors
/// A sentence if the list has another length or the order is above [`WINDSHIELD_ORDER`].
pub fn angle_polynomial(coefficients: &[f64]) -> Result<AnglePolynomial, Invalid> {
    let count_of = |order: usize| (order + 1) * (order + 2) / 2;
    let mut orders = 1..=WINDSHIELD_ORDER;
    let Some(order) = orders.find(|&order| count_of(order) == coefficients.len()) else {
        return Err(Invalid::new(format!(
            "windshield: {} coefficients; expected 3, 6, 10, 15 or 21",
            coefficients.len()
        )));
    };
    let mut polynomial = AnglePolynomial::default();
    let mut next = coefficients.iter();
    for (j, row) in polynomial.iter_mut().enumerate().take(order + 1) {
        for (cell, &coefficient) in row[..=order - j].iter_mut().zip(&mut next) {
            *cell = coefficient;
        }
    }
    Ok(polynomial)
}

/// The coefficients of `polynomial` as [`angle_polynomial`] takes them, of the highest order.
#[must_use]
pub fn angle_coefficients(polynomial: &AnglePolynomial) -> Vec<f64> {
    let rows = polynomial.iter().enumerate();
    rows.flat_map(|(j, row)| row[..=WINDSHIELD_ORDER - j].to_vec())
        .collect()
}

fn value_at(polynomial: &AnglePolynomial, angles: DVec2) -> f64 {
    let row = |row: &[f64; 6]| row.iter().rev().fold(0.0, |sum, c| sum * angles.x + c);
    polynomial
        .iter()
        .rev()
        .fold(0.0, |sum, of| sum * angles.y + row(of))
}

impl Windshield {
    /// The windshield that bends nothing.
    #[must_use]
    pub fn straight() -> Self {
        let [mut horizontal, mut vertical] = [AnglePolynomial::default(); 2];
        (horizontal[0][1], vertical[1][0]) = (1.0, 1.0);
        Self {
            direction: WindshieldDirection::Forward,
            horizontal,
            vertical,
        }
    }

    /// Checks that all coefficients are finite.
    ///
    /// # Errors
    /// A sentence naming the value at fault.
    pub fn check(&self) -> Result<(), Invalid> {
        let all = self.horizontal.iter().chain(&self.vertical).flatten();
        match all.into_iter().find(|number| !number.is_finite()) {
            Some(number) => Err(Invalid::new(format!(
                "windshield: a coefficient of {number}; expected finite numbers"
            ))),
            None => Ok(()),
        }
    }

    fn angles(&self, angles: DVec2) -> DVec2 {
        DVec2::new(
            value_at(&self.horizontal, angles),
            value_at(&self.vertical, angles),
        )
    }

    /// Sines of the angles of the bent ray, of those of the ray in the world.
    #[must_use]
    pub fn bent_sines(&self, sines: DVec2) -> DVec2 {
        let angles = DVec2::new(
            sines.x.clamp(-1.0, 1.0).asin(),
            sines.y.clamp(-1.0, 1.0).asin(),
        );
        let bent = match self.direction {
            WindshieldDirection::Forward => self.angles(angles),
            WindshieldDirection::Backward => solved(angles, |bent| self.angles(bent)),
        };
        DVec2::new(bent.x.sin(), bent.y.sin())
    }
}

/// The value that `map`, which is near the identity, takes to `target`.
pub(super) fn solved(target: DVec2, map: impl Fn(DVec2) -> DVec2) -> DVec2 {
    const STEPS: usize = 100;
    let mut value = target;
    for _ in 0..STEPS {
        let miss = map(value) - target;
        value -= miss;
        if miss.is_nan() || miss.length_squared() <= 1e-32 {
            break;
        }
    }
    value
}

/// A windshield as a lens meets it: followed for rays that reach the image and a little beyond,
/// and continued there with the bending at the edge. It fades out for rays at right angles to the
/// axis.
#[derive(Clone, Copy, Debug)]
pub struct Bending {
    windshield: Windshield,
    /// Largest sines along x and y at which the polynomials are followed.
    limit: DVec2,
}

/// Rays whose z is below this, of a unit length, are bent less: none at 0.
pub const BENDING_FADE_Z: f64 = 0.05;

/// Factor on the sines of the image's edges up to which the polynomials are followed.
const LIMIT_MARGIN: f64 = 1.1;

impl Bending {
    /// The bending of a windshield before a lens whose image has rays with sines up to `edge`.
    #[must_use]
    pub fn new(windshield: Windshield, edge: DVec2) -> Self {
        let limit = (LIMIT_MARGIN * edge).clamp(DVec2::splat(1e-3), DVec2::splat(0.98));
        Self { windshield, limit }
    }

    /// Largest sines along x and y at which the polynomials are followed.
    #[must_use]
    pub fn limit(&self) -> DVec2 {
        self.limit
    }

    /// Change of the sines of a ray.
    #[must_use]
    pub fn change(&self, sines: DVec2) -> DVec2 {
        let held = sines.clamp(-self.limit, self.limit);
        self.windshield.bent_sines(held) - held
    }

    /// The bent ray, of unit length, of a ray of any length.
    #[must_use]
    pub fn bent(&self, ray: DVec3) -> DVec3 {
        let ray = ray.normalize_or_zero();
        let fade = (ray.z / BENDING_FADE_Z).clamp(0.0, 1.0);
        if fade == 0.0 {
            return ray;
        }
        let sines = ray.truncate() + fade * self.change(ray.truncate());
        sines.extend((1.0 - sines.length_squared()).max(0.0).sqrt())
    }

    /// The ray in the world of a bent ray of unit length; `None` if there is none.
    #[must_use]
    pub fn unbent(&self, bent: DVec3) -> Option<DVec3> {
        let ray_of = |sines: DVec2| sines.extend((1.0 - sines.length_squared()).max(0.0).sqrt());
        let sines = solved(bent.truncate(), |sines| self.bent(ray_of(sines)).truncate());
        let ray = ray_of(sines);
        let miss = (self.bent(ray).truncate() - bent.truncate()).length();
        (miss < 1e-10 && bent.z > 0.0).then_some(ray)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;
    use crate::lens::{Fisheye, Lens, RayMap};

    /// A windshield that bends by up to 2 degrees.
    fn some(direction: WindshieldDirection) -> Windshield {
        let mut windshield = Windshield {
            direction,
            ..Windshield::straight()
        };
        windshield.horizontal[0] = [0.003, 1.01, -0.004, 0.005, 0.001, -0.002];
        windshield.horizontal[1] = [0.002, 0.006, 0.0, -0.003, 0.001, 0.0];
        windshield.vertical[0] = [-0.005, 0.004, 0.008, 0.0, 0.0, 0.001];
        windshield.vertical[1] = [0.985, -0.006, 0.002, 0.0, 0.0, 0.0];
        windshield.vertical[2] = [0.003, 0.0, -0.003, 0.0, 0.0, 0.0];
        windshield
    }

    #[test]
    fn coefficients_are_grouped_by_the_power_of_theta() {
        // 1 + 2 phi + 3 phi^2 + theta (4 + 5 phi) + 6 theta^2.
        let polynomial = angle_polynomial(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).unwrap();
        let (phi, theta): (f64, f64) = (0.3, -0.7);
        let expected =
            1.0 + 2.0 * phi + 3.0 * phi * phi + theta * (4.0 + 5.0 * phi) + 6.0 * theta * theta;
        assert!((value_at(&polynomial, DVec2::new(phi, theta)) - expected).abs() < 1e-15);
        let coefficients = angle_coefficients(&polynomial);
        assert_eq!(coefficients.len(), 21);
        assert_eq!(angle_polynomial(&coefficients).unwrap(), polynomial);
        let refused = angle_polynomial(&[1.0; 4]).unwrap_err();
        assert!(refused.to_string().contains("4 coefficients"), "{refused}");
    }

    #[test]
    fn bent_rays_have_the_angles_of_the_polynomials() {
        let windshield = some(WindshieldDirection::Forward);
        // By hand: the polynomials at phi = 0.2 and theta = -0.1.
        let (x, y) = (0.2f64, -0.1f64);
        let horizontal =
            0.003 + 1.01 * x - 0.004 * x.powi(2) + 0.005 * x.powi(3) + 0.001 * x.powi(4)
                - 0.002 * x.powi(5)
                + y * (0.002 + 0.006 * x - 0.003 * x.powi(3) + 0.001 * x.powi(4));
        let vertical = -0.005
            + 0.004 * x
            + 0.008 * x.powi(2)
            + 0.001 * x.powi(5)
            + y * (0.985 - 0.006 * x + 0.002 * x.powi(2))
            + y.powi(2) * (0.003 - 0.003 * x.powi(2));
        let sines = windshield.bent_sines(DVec2::new(x.sin(), y.sin()));
        assert!((sines - DVec2::new(horizontal.sin(), vertical.sin())).length() < 1e-15);
        // Backward polynomials take the bent ray back.
        let backward = some(WindshieldDirection::Backward);
        let back = windshield.bent_sines(backward.bent_sines(DVec2::new(0.3, 0.2)));
        assert!((back - DVec2::new(0.3, 0.2)).length() < 1e-13, "{back}");
    }

    #[test]
    fn rays_come_back_through_the_windshield_and_the_lens() {
        let lenses = [
            Lens::Pinhole,
            Lens::Fisheye(Fisheye {
                radial: [-0.02, 0.004, -0.002, 0.0003],
                max_angle_rad: 1.3,
            }),
        ];
        for direction in [WindshieldDirection::Forward, WindshieldDirection::Backward] {
            for lens in lenses {
                let intrinsics = Intrinsics {
                    lens,
                    windshield: Some(some(direction)),
                    ..Intrinsics::from_horizontal_fov(1600, 900, 1.2)
                };
                intrinsics.check().unwrap();
                assert!(!intrinsics.is_pinhole());
                let map = RayMap::new(&intrinsics);
                let plain = RayMap::new(&Intrinsics {
                    windshield: None,
                    ..intrinsics
                });
                let mut moved = 0;
                for position in 0..300 {
                    let pixel = DVec2::new(
                        f64::from(position % 20) * 84.0,
                        f64::from(position / 20) * 64.0,
                    );
                    let Some(ray) = map.unproject(pixel) else {
                        continue;
                    };
                    let back = map.project(ray).unwrap();
                    assert!((back - pixel).length() < 1e-7, "{pixel}: {back}");
                    let there = plain.project(ray);
                    moved += u32::from(there.is_none_or(|there| (there - pixel).length() > 1.0));
                }
                assert!(moved > 150, "the windshield moves {moved} pixels");
                // Far beside and behind, nothing is lost and nothing jumps.
                let mut last: Option<DVec2> = None;
                for step in 0..2000 {
                    let angle = 3.1 * f64::from(step) / 2000.0;
                    let ray = DVec3::new(angle.sin(), 0.1 * angle.sin(), angle.cos());
                    let position = map.project_extended(ray);
                    assert!(position.is_finite());
                    if let Some(last) = last {
                        assert!((position - last).length() < 40.0, "a jump at {angle}");
                    }
                    last = Some(position);
                }
            }
        }
    }
}
