//! Bodies of known shape: samples of their surface, and the triangles that block light.

use decouplegs::scene::light::to_linear;
use decouplegs::scene::{SplatCloud, sh};
use glam::{DQuat, DVec3};

use super::rays::{Solid, Triangle};

/// Number of surface samples of each body.
pub const SURFELS: usize = 1500;

/// Distance of samples above their surface, meters: splats of one surface overlap, and their
/// squares intersect.
const CLEARANCE_M: f64 = 0.02;

/// Half the side of the square that stands for an opaque splat, standard deviations.
const HALF_SIDE: f64 = 1.2;

/// A sample of a matt surface.
#[derive(Clone, Copy, Debug)]
pub struct Surfel {
    pub position: DVec3,
    /// Unit, outward.
    pub normal: DVec3,
    /// Linear RGB reflectance.
    pub albedo: [f64; 3],
}

/// A body on the ground z = 0.
pub struct Body {
    pub name: String,
    /// Samples that stand for equal areas.
    pub surfels: Vec<Surfel>,
    pub solid: Solid,
}

impl Body {
    /// A body of triangles, each with its reflectance.
    pub fn of_triangles(name: &str, triangles: Vec<Triangle>, albedos: &[[f64; 3]]) -> Self {
        let areas: Vec<f64> = triangles
            .iter()
            .map(|triangle| triangle.cross().length())
            .collect();
        let solid = Solid::new(triangles);
        let surfel = |triangle: usize, nth: usize| {
            let [a, b, c] = solid.triangles()[triangle].corners;
            let [u, v] = spread(nth);
            let (u, v) = if u + v > 1.0 {
                (1.0 - u, 1.0 - v)
            } else {
                (u, v)
            };
            let position = a + u * (b - a) + v * (c - a);
            let normal = solid.triangles()[triangle].cross().normalize();
            outward(&solid, position, normal, albedos[triangle])
        };
        Self {
            name: name.to_owned(),
            surfels: drawn(&areas, surfel),
            solid,
        }
    }

    /// A body of flat splats that stands on z = 0: their colors are what white light shows.
    pub fn of_splats(name: &str, cloud: &SplatCloud) -> Self {
        let foot_m = cloud.means.iter().map(|mean| f64::from(mean[2]));
        let foot_m = foot_m.fold(f64::INFINITY, f64::min);
        let position = |splat: usize| {
            let mean = DVec3::from_array(cloud.means[splat].map(f64::from));
            mean - foot_m * DVec3::Z
        };
        let mut triangles = Vec::new();
        for splat in (0..cloud.len()).filter(|&splat| cloud.opacities[splat] > 0.5) {
            let axes = axes_of(cloud, splat);
            let at = |u: f64, v: f64| position(splat) + HALF_SIDE * (u * axes[0] + v * axes[1]);
            let corners = [at(-1.0, -1.0), at(1.0, -1.0), at(1.0, 1.0), at(-1.0, 1.0)];
            triangles.push(Triangle::new([corners[0], corners[1], corners[2]]));
            triangles.push(Triangle::new([corners[0], corners[2], corners[3]]));
        }
        let areas: Vec<f64> = (0..cloud.len())
            .map(|splat| {
                let [_, broad_m, long_m] = cloud.sorted_scales_m(splat);
                f64::from(cloud.opacities[splat]) * broad_m * long_m
            })
            .collect();
        let solid = Solid::new(triangles);
        let surfel = |splat: usize, _| {
            let albedo =
                cloud.sh_dc[splat].map(|dc| to_linear(sh::Y0 * f64::from(dc) + 0.5).max(0.005));
            outward(&solid, position(splat), cloud.thin_axis(splat), albedo)
        };
        Self {
            name: name.to_owned(),
            surfels: drawn(&areas, surfel),
            solid,
        }
    }
}

/// The two long axes of a splat, each as long as its standard deviation.
fn axes_of(cloud: &SplatCloud, splat: usize) -> [DVec3; 2] {
    let normal = cloud.thin_axis(splat);
    let [w, x, y, z] = cloud.rotations[splat].map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w).normalize();
    let scales = cloud.scales[splat].map(f64::from);
    let axes = DVec3::AXES.map(|axis| rotation * axis);
    let mut long = (0..3).filter(|&axis| axes[axis].dot(normal).abs() < 0.5);
    let mut next = || {
        long.next()
            .map_or(DVec3::ZERO, |axis| scales[axis] * axes[axis])
    };
    [next(), next()]
}

/// The sample, its normal turned to the side from which light arrives in more directions.
fn outward(solid: &Solid, position: DVec3, normal: DVec3, albedo: [f64; 3]) -> Surfel {
    let seen = |normal: DVec3| {
        let from = position + CLEARANCE_M * normal;
        let directions = (0..64).map(|nth| {
            let [u, v] = spread(nth);
            let (sin, cos) = (std::f64::consts::TAU * u).sin_cos();
            let z = 2.0 * v - 1.0;
            let radius = (1.0 - z * z).sqrt();
            DVec3::new(radius * cos, radius * sin, z)
        });
        directions
            .filter(|direction| direction.dot(normal) > 0.0)
            .filter(|&direction| solid.open(from, direction))
            .count()
    };
    let normal = if seen(normal) >= seen(-normal) {
        normal
    } else {
        -normal
    };
    Surfel {
        position: position + CLEARANCE_M * normal,
        normal,
        albedo,
    }
}

/// Numbers 0 to 1, evenly spread in the square (Roberts, The Unreasonable Effectiveness of
/// Quasirandom Sequences, 2018).
fn spread(nth: usize) -> [f64; 2] {
    const STEP: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
    STEP.map(|step| (0.5 + step * nth as f64).fract())
}

/// [`SURFELS`] samples, drawn by area in even steps.
fn drawn(areas: &[f64], surfel: impl Fn(usize, usize) -> Surfel) -> Vec<Surfel> {
    let step = areas.iter().sum::<f64>() / SURFELS as f64;
    let (mut next, mut passed) = (0.5 * step, 0.0);
    let mut surfels = Vec::with_capacity(SURFELS);
    for (index, area) in areas.iter().enumerate() {
        passed += area;
        while next < passed && surfels.len() < SURFELS {
            surfels.push(surfel(index, surfels.len()));
            next += step;
        }
    }
    surfels
}
