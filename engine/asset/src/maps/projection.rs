//! Latitude and longitude as meters: UTM on WGS 84.
//!
//! The transverse Mercator projection by Krüger's series to the fourth order of the third
//! flattening (L. Krüger, "Konforme Abbildung des Erdellipsoids in der Ebene", 1912; the form of C.
//! F. F. Karney, "Transverse Mercator with an accuracy of a few nanometers", J. Geodesy 85, 2011,
//! equations 7 to 12 and 35), below a micrometer within 15 degrees of the central meridian.

use decouplegs_scene::Invalid;
use glam::DVec2;

/// Equatorial radius of WGS 84, meters.
const EQUATOR_M: f64 = 6_378_137.0;
/// Flattening of WGS 84.
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Scale on the central meridian.
const SCALE: f64 = 0.9996;
/// East of the central meridian, so that coordinates are positive, meters.
const FALSE_EASTING_M: f64 = 500_000.0;
/// North of the equator on the southern hemisphere, meters.
const FALSE_NORTHING_M: f64 = 10_000_000.0;
/// UTM is not defined nearer to the poles, degrees.
const LATITUDE_MAX_DEG: f64 = 84.5;
/// Largest distance from the central meridian, degrees: farther away the series is not exact.
const FROM_MERIDIAN_MAX_DEG: f64 = 15.0;

/// A zone of UTM, 6 degrees wide; the exceptions of Norway and Svalbard are not made.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UtmZone {
    /// 1 to 60 from 180 degrees west.
    pub number: u8,
    /// True if northings count from the equator, as they do on the northern hemisphere; else from
    /// 10,000 km south of it.
    pub is_north: bool,
}

impl UtmZone {
    /// The zone of a position, its longitude of -180 to 180 degrees.
    #[must_use]
    pub fn for_position(latitude_deg: f64, longitude_deg: f64) -> Self {
        let number = ((longitude_deg + 180.0) / 6.0).floor().clamp(0.0, 59.0) as u8 + 1;
        Self {
            number,
            is_north: latitude_deg >= 0.0,
        }
    }

    /// Degrees east of Greenwich.
    fn central_meridian_deg(self) -> f64 {
        6.0 * f64::from(self.number) - 183.0
    }

    /// Easting and northing of a position, meters.
    ///
    /// # Errors
    /// A sentence where UTM is not defined there or the position is far from the zone.
    pub fn project(self, latitude_deg: f64, longitude_deg: f64) -> Result<DVec2, Invalid> {
        let position = || {
            Invalid::new(format!(
                "latitude {latitude_deg}, longitude {longitude_deg}"
            ))
        };
        if !(latitude_deg.abs() <= LATITUDE_MAX_DEG && longitude_deg.abs() <= 360.0) {
            return Err(Invalid::new(format!(
                "{}: UTM reaches latitudes of {LATITUDE_MAX_DEG} degrees",
                position()
            )));
        }
        let east_deg =
            (longitude_deg - self.central_meridian_deg() + 540.0).rem_euclid(360.0) - 180.0;
        if east_deg.abs() > FROM_MERIDIAN_MAX_DEG {
            let zone = self.number;
            return Err(Invalid::new(format!(
                "{}: more than {FROM_MERIDIAN_MAX_DEG} degrees from the middle of UTM zone {zone}",
                position()
            )));
        }
        let north_m = if self.is_north { 0.0 } else { FALSE_NORTHING_M };
        let plane = transverse_mercator(latitude_deg.to_radians(), east_deg.to_radians());
        Ok(DVec2::new(FALSE_EASTING_M + plane.x, north_m + plane.y))
    }
}

/// East of the central meridian and north of the equator, meters.
fn transverse_mercator(latitude_rad: f64, east_rad: f64) -> DVec2 {
    let n = FLATTENING / (2.0 - FLATTENING);
    let (n2, n3, n4) = (n * n, n.powi(3), n.powi(4));
    let rectifying_m = EQUATOR_M / (1.0 + n) * (1.0 + n2 / 4.0 + n4 / 64.0);
    let series = [
        n / 2.0 - n2 * 2.0 / 3.0 + n3 * 5.0 / 16.0 + n4 * 41.0 / 180.0,
        n2 * 13.0 / 48.0 - n3 * 3.0 / 5.0 + n4 * 557.0 / 1440.0,
        n3 * 61.0 / 240.0 - n4 * 103.0 / 140.0,
        n4 * 49561.0 / 161_280.0,
    ];
    let eccentricity = 2.0 * n.sqrt() / (1.0 + n);
    let sine = latitude_rad.sin();
    let conformal_tan = (sine.atanh() - eccentricity * (eccentricity * sine).atanh()).sinh();
    let xi = conformal_tan.atan2(east_rad.cos());
    let eta = (east_rad.sin() / conformal_tan.hypot(east_rad.cos())).asinh();
    let (mut east, mut north) = (eta, xi);
    for (order, factor) in (1..).map(|order| 2.0 * f64::from(order)).zip(series) {
        east += factor * (order * xi).cos() * (order * eta).sinh();
        north += factor * (order * xi).sin() * (order * eta).cosh();
    }
    SCALE * rectifying_m * DVec2::new(east, north)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Meridian arc from the equator by numerical integration, meters: what the projection must
    /// give on the central meridian.
    fn meridian_arc_m(latitude_rad: f64) -> f64 {
        const STEPS: i32 = 20_000;
        let square = FLATTENING * (2.0 - FLATTENING);
        let radius_m =
            |at: f64| EQUATOR_M * (1.0 - square) / (1.0 - square * at.sin().powi(2)).powf(1.5);
        let step = latitude_rad / f64::from(STEPS);
        (0..STEPS)
            .map(|i| radius_m((f64::from(i) + 0.5) * step) * step)
            .sum()
    }

    #[test]
    fn the_central_meridian_is_as_long_as_the_meridian() {
        let zone = UtmZone {
            number: 32,
            is_north: true,
        };
        for latitude_deg in [1.0_f64, 30.0, 49.0, 84.0] {
            let found = zone.project(latitude_deg, 9.0).unwrap();
            let expected_m = SCALE * meridian_arc_m(latitude_deg.to_radians());
            assert!(
                (found.x - 500_000.0).abs() < 1e-9 && (found.y - expected_m).abs() < 1e-3,
                "{latitude_deg}: {found}"
            );
        }
    }

    #[test]
    fn the_projection_is_conformal() {
        // A small step east and one north are turned and scaled alike, so their images are at right
        // angles and as long.
        let zone = UtmZone::for_position(49.0, 8.424);
        assert_eq!(
            zone,
            UtmZone {
                number: 32,
                is_north: true
            }
        );
        let (latitude_rad, step_deg) = (49.0_f64.to_radians(), 1e-5);
        let square = FLATTENING * (2.0 - FLATTENING);
        let root = (1.0 - square * latitude_rad.sin().powi(2)).sqrt();
        let metres_per_degree_east = EQUATOR_M / root * latitude_rad.cos().to_radians();
        let metres_per_degree_north =
            EQUATOR_M * (1.0 - square) / root.powi(3) * 1.0_f64.to_radians();
        let at = |latitude_deg, longitude_deg| zone.project(latitude_deg, longitude_deg).unwrap();
        let east = (at(49.0, 8.424 + step_deg) - at(49.0, 8.424 - step_deg))
            / (2.0 * step_deg * metres_per_degree_east);
        let north = (at(49.0 + step_deg, 8.424) - at(49.0 - step_deg, 8.424))
            / (2.0 * step_deg * metres_per_degree_north);
        assert!((east.perp() - north).length() < 1e-6, "{east} {north}");
        assert!(
            (east.length() - SCALE).abs() < 1e-4,
            "near the meridian the scale is nearly {SCALE}: {}",
            east.length()
        );
    }

    #[test]
    fn hemispheres_mirror_and_what_is_far_is_refused() {
        let (north, south) = (
            UtmZone {
                number: 56,
                is_north: true,
            },
            UtmZone::for_position(-33.9, 151.2),
        );
        assert_eq!(
            south,
            UtmZone {
                number: 56,
                is_north: false
            }
        );
        let (a, b) = (
            north.project(33.9, 151.2).unwrap(),
            south.project(-33.9, 151.2).unwrap(),
        );
        assert!((a.x - b.x).abs() < 1e-6 && (a.y + b.y - FALSE_NORTHING_M).abs() < 1e-6);
        for (latitude_deg, longitude_deg) in [
            (89.0, 151.0),
            (0.0, 0.0),
            (f64::NAN, 151.0),
            (0.0, f64::INFINITY),
        ] {
            assert!(north.project(latitude_deg, longitude_deg).is_err());
        }
        // Across the date line, zone 60 continues in the east.
        assert!(
            UtmZone::for_position(0.0, 179.9)
                .project(0.0, -179.9)
                .is_ok()
        );
    }
}
