//! Records of lenses.

use bytemuck::{Pod, Zeroable};
use decouplegs_scene::lens::windshield::Bending;
use decouplegs_scene::{Intrinsics, Lens, RayMap};
use glam::{DVec2, DVec3};

/// Intervals of the table of a lens that is the same all around.
pub const LENS_INTERVALS: usize = decouplegs_shaders::constants::LENS_INTERVALS as usize;

/// Kind of a lens's computation; `LENS_*` of `lens.glsl`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LensKind {
    /// Pinhole, as in the camera's record.
    Pinhole = 0,
    /// A function of x / z and y / z.
    Planar = 1,
    /// A function of the angle to the axis, by its table.
    Radial = 2,
}

/// `Lens` of `lens.glsl`.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
pub struct LensRecord {
    /// A [`LensKind`].
    pub kind: u32,
    /// Tangent of the angle where it ends.
    pub tan_limit: f32,
    /// Chord, `2 sin(angle / 2)`, where it ends.
    pub chord_limit: f32,
    /// Growth of the radius in the lens's plane per chord beyond the limit.
    pub slope_beyond: f32,
    /// No two rays within `STEEPEST_WITHIN_RAD` of the axis fall farther apart, by the angle
    /// between them.
    pub pixels_per_rad: f32,
    /// Intervals of the table by chord.
    pub chord_intervals: f32,
    /// Pixels from the lens's plane, by columns.
    pub matrix: [f32; 4],
    /// k1 to k6.
    pub radial: [f32; 6],
    /// p1 and p2.
    pub tangential: [f32; 2],
    /// s1 to s4.
    pub thin_prism: [f32; 4],
    /// Radius in the lens's plane, and what it grows by an interval.
    pub table: [[f32; 2]; LENS_INTERVALS + 1],
    /// Tangents of half the angles along x and y up to which a windshield is followed; 0 without
    /// one.
    pub bend_limit: [f32; 2],
    /// Change of the sines by a windshield: coefficients of `u^i v^j` at `[j][i]`, with u and v the
    /// tangents divided by their limit.
    pub bending: [[[f32; 2]; BEND_TERMS]; BEND_TERMS],
}

/// Terms of the polynomials of a windshield along each sine.
const BEND_TERMS: usize = decouplegs_shaders::constants::BEND_TERMS as usize;

/// Means lie before the camera and points of the transform a little farther round: 90 degrees and
/// twice an arc of a quarter.
pub const STEEPEST_WITHIN_RAD: f64 = 2.08;

/// Safety factor on the steepest slope found, because the search is in steps.
const STEEPEST_MARGIN: f64 = 1.1;

impl LensRecord {
    /// The lens of `intrinsics`, which must have passed [`Intrinsics::check`].
    #[must_use]
    pub fn new(intrinsics: &Intrinsics) -> Self {
        if intrinsics.is_pinhole() {
            return Self::zeroed();
        }
        let map = RayMap::new(intrinsics);
        let chord_limit = 2.0 * (0.5 * map.limit_rad()).sin();
        let mut record = Self {
            kind: LensKind::Planar as u32,
            tan_limit: map.limit_rad().tan() as f32,
            chord_limit: chord_limit as f32,
            slope_beyond: map.slope_beyond() as f32,
            pixels_per_rad: (STEEPEST_MARGIN * steepest(&map)) as f32,
            chord_intervals: (LENS_INTERVALS as f64 / chord_limit) as f32,
            matrix: map.matrix().to_cols_array().map(|value| value as f32),
            ..Self::zeroed()
        };
        if let Lens::OpenCv(lens) = &intrinsics.lens {
            record.radial = lens.radial.map(|value| value as f32);
            record.tangential = lens.tangential.map(|value| value as f32);
            record.thin_prism = lens.thin_prism.map(|value| value as f32);
        }
        if let Some(bending) = map.bending() {
            record.bend_limit = half_tangents(bending.limit()).as_vec2().to_array();
            record.bending = bending_terms(bending);
        }
        let interval = chord_limit / LENS_INTERVALS as f64;
        for (position, entry) in record.table.iter_mut().enumerate() {
            let angle_rad = (2.0 * (0.5 * interval * position as f64).asin()).min(map.limit_rad());
            let Some((radius, by_rad)) = map.radius_at(angle_rad) else {
                break;
            };
            record.kind = LensKind::Radial as u32;
            *entry = [
                radius as f32,
                (by_rad / (0.5 * angle_rad).cos() * interval) as f32,
            ];
        }
        record
    }
}

/// Tangents of half the angles whose sines are `sines`.
fn half_tangents(sines: DVec2) -> DVec2 {
    let cosines = DVec2::ONE - sines * sines;
    sines / (1.0 + DVec2::new(cosines.x.sqrt(), cosines.y.sqrt()))
}

/// The polynomials that are equal to the change by `bending` at Chebyshev's nodes. They are as
/// exact as f32 for windshields: in tangents of half the angles, the angles themselves are smooth.
fn bending_terms(bending: &Bending) -> [[[f32; 2]; BEND_TERMS]; BEND_TERMS] {
    let nodes: [f64; BEND_TERMS] = std::array::from_fn(|k| {
        (std::f64::consts::PI * (k as f64 + 0.5) / BEND_TERMS as f64).cos()
    });
    // The coefficients that give 1 at one node and 0 at the others.
    let basis = nodes.map(|node| {
        let others = nodes.iter().filter(|other| **other != node);
        let mut product = [0.0; BEND_TERMS];
        product[0] = 1.0;
        for other in others {
            // Times (u - other) / (node - other).
            let mut next = [0.0; BEND_TERMS];
            for (power, coefficient) in product.iter().enumerate() {
                let share = coefficient / (node - other);
                if power + 1 < BEND_TERMS {
                    next[power + 1] += share;
                }
                next[power] -= share * other;
            }
            product = next;
        }
        product
    });
    let limit = half_tangents(bending.limit());
    let mut terms = [[DVec2::ZERO; BEND_TERMS]; BEND_TERMS];
    for (of_v, v) in basis.iter().zip(nodes) {
        for (of_u, u) in basis.iter().zip(nodes) {
            let tangents = limit * DVec2::new(u, v);
            let change = bending.change(2.0 * tangents / (1.0 + tangents * tangents));
            for (j, by_v) in of_v.iter().enumerate() {
                for (i, by_u) in of_u.iter().enumerate() {
                    terms[j][i] += change * (by_v * by_u);
                }
            }
        }
    }
    terms.map(|row| row.map(|term| term.as_vec2().to_array()))
}

/// The most pixels a radian that the lens makes anywhere within [`STEEPEST_WITHIN_RAD`], beyond its
/// end included.
fn steepest(map: &RayMap) -> f64 {
    const STEPS: u32 = 40;
    const DIRECTIONS: u32 = 8;
    const STEP_RAD: f64 = 1e-4;
    let pixel = |angle_rad: f64, direction: DVec2| {
        map.project_extended((direction * angle_rad.sin()).extend(angle_rad.cos()))
    };
    let mut steepest = 0.0f64;
    for step in 0..=STEPS {
        let angle_rad = STEEPEST_WITHIN_RAD * (f64::from(step) + 0.01) / f64::from(STEPS);
        for around in 0..DIRECTIONS {
            let direction = DVec2::from_angle(
                (f64::from(around) + 0.3) * std::f64::consts::TAU / f64::from(DIRECTIONS),
            );
            let here = pixel(angle_rad, direction);
            let outward = (pixel(angle_rad + STEP_RAD, direction) - here) / STEP_RAD;
            let ray: DVec3 = (direction * angle_rad.sin()).extend(angle_rad.cos());
            let beside = ray + direction.perp().extend(0.0) * STEP_RAD;
            let around = (map.project_extended(beside) - here) / STEP_RAD;
            // The larger singular value of the two columns.
            let (sum, product) = (
                outward.length_squared() + around.length_squared(),
                outward.perp_dot(around),
            );
            let spread = (sum * sum - 4.0 * product * product).max(0.0).sqrt();
            steepest = steepest.max((0.5 * (sum + spread)).sqrt());
        }
    }
    steepest
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs_scene::lens::{Fisheye, Windshield, WindshieldDirection};

    #[test]
    fn a_table_has_the_radius_of_its_lens_between_its_entries() {
        let lens = Lens::Fisheye(Fisheye {
            radial: [-0.03, 0.01, -0.004, 0.0005],
            max_angle_rad: 1.5,
        });
        let intrinsics = Intrinsics {
            lens,
            ..Intrinsics::from_horizontal_fov(1600, 900, 1.5)
        };
        intrinsics.check().unwrap();
        let (record, map) = (LensRecord::new(&intrinsics), RayMap::new(&intrinsics));
        for step in 0..1000 {
            let angle_rad = map.limit_rad() * f64::from(step) / 1000.0;
            let position = 2.0 * (0.5 * angle_rad).sin() * f64::from(record.chord_intervals);
            let (interval, s) = (position as usize, position.fract());
            let [[a, da], [b, db]] =
                [interval, interval + 1].map(|at| record.table[at].map(f64::from));
            let rise = b - a;
            let found =
                a + s * (da + s * (3.0 * rise - 2.0 * da - db + s * (da + db - 2.0 * rise)));
            let error_px = (found - map.radius_at(angle_rad).unwrap().0).abs() * intrinsics.fx_px;
            assert!(error_px < 2e-4, "{error_px} px at {angle_rad}");
        }
    }

    #[test]
    fn polynomials_of_a_windshield_are_its_bending() {
        let mut windshield = Windshield::straight();
        windshield.horizontal[0] = [0.002, 1.01, -0.003, 0.004, 0.001, -0.002];
        windshield.horizontal[1][1] = 0.006;
        windshield.vertical[0][2] = 0.008;
        windshield.vertical[1][0] = 0.985;
        windshield.vertical[2][2] = -0.003;
        for direction in [WindshieldDirection::Forward, WindshieldDirection::Backward] {
            let intrinsics = Intrinsics {
                windshield: Some(Windshield {
                    direction,
                    ..windshield
                }),
                ..Intrinsics::from_horizontal_fov(1600, 900, 1.4)
            };
            intrinsics.check().unwrap();
            let (record, map) = (LensRecord::new(&intrinsics), RayMap::new(&intrinsics));
            let mut most_px = 0.0f64;
            for position in 0..400 {
                let pixel = DVec2::new(
                    f64::from(position % 20) * 84.0,
                    f64::from(position / 20) * 47.0,
                );
                let ray = map.unproject(pixel).unwrap();
                let found = crate::twins::lens::through_lens(&record, ray.as_vec3()).as_dvec2();
                let principal_px = DVec2::new(intrinsics.cx_px, intrinsics.cy_px);
                most_px = most_px.max((found + principal_px - pixel).length());
            }
            assert!(most_px < 1e-3, "{direction:?}: {most_px} px");
        }
    }

    #[test]
    fn no_two_rays_fall_farther_apart_than_the_steepest_place_says() {
        let lens = Lens::Fisheye(Fisheye {
            radial: [0.1, -0.02, 0.0, 0.0],
            max_angle_rad: 1.2,
        });
        let intrinsics = Intrinsics {
            lens,
            ..Intrinsics::from_horizontal_fov(800, 600, 1.5)
        };
        let (record, map) = (LensRecord::new(&intrinsics), RayMap::new(&intrinsics));
        let ray = |i: u32| {
            let (angle, around) = (
                STEEPEST_WITHIN_RAD * f64::from(i % 61) / 61.0,
                f64::from(i) * 0.618,
            );
            DVec3::new(
                angle.sin() * around.cos(),
                angle.sin() * around.sin(),
                angle.cos(),
            )
        };
        for i in 0..2000 {
            let (a, b) = (ray(i), ray(i * 7 + 3));
            let apart = (map.project_extended(a) - map.project_extended(b)).length();
            assert!(apart <= f64::from(record.pixels_per_rad) * a.angle_between(b) + 1e-6);
        }
    }
}
