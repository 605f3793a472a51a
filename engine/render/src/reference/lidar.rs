//! The definition of a LiDAR's range: every beam by brute force in f64.
//!
//! A beam meets a Gaussian where the Gaussian is largest along the beam. Each beam has the poses of
//! its own time of firing, of the sensor and of all splats. There are no tiles, no early stop and
//! no approximation of motion. The exact ray in the Gaussian's own metric is that of Yu et al.,
//! Gaussian Opacity Fields, 2024.

use decouplegs_scene::lidar::{Beam, ECHO_SEPARATION_M, ECHO_WEIGHT_MIN};
use decouplegs_scene::light::LUMA;
use decouplegs_scene::{Lidar, Motion, Pose, Rules, SplatCloud, rules, sh};
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// Standard deviation of a splat along the direction to its mean, at least, as a share of its
/// distance: flat splats have an inverse.
pub const THICKNESS_MIN: f64 = 1e-6;

/// Splats that move together.
#[derive(Clone, Copy, Debug)]
pub struct SplatGroup<'a> {
    /// The splats of the group.
    pub splats: &'a SplatCloud,
    /// Instance of each splat; an empty slice where all have [`SplatGroup::instance`].
    pub instances: &'a [u16],
    /// Instance of all splats.
    pub instance: u16,
    /// Pose at the start of the sweep, world coordinates.
    pub world_from_splats: Pose,
    /// Motion during the sweep.
    pub motion: Motion,
}

/// Splats of a beam that follow one another within [`ECHO_SEPARATION_M`] of their mean range.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Echo64 {
    /// Share of the beam that they take.
    pub weight: f64,
    /// Mean range by weight, meters.
    pub range_m: f64,
    /// Mean luma by weight.
    pub intensity: f64,
    /// Instance of the splat with the largest weight.
    pub instance: u16,
}

/// Result of one beam.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct BeamHit64 {
    /// Share of the beam that no splat took.
    pub transmittance: f64,
    /// Range of the splat at which transmittance falls to 1/2 or below, and its instance.
    pub median: Option<(f64, u16)>,
    /// Range of the splat with the largest weight, and its instance.
    pub strongest: Option<(f64, u16)>,
    /// Mean range by weight, meters; 0 where nothing was met.
    pub expected_m: f64,
    /// Mean luma of the splats by weight; 0 where nothing was met.
    pub intensity: f64,
    /// Echoes of at least [`ECHO_WEIGHT_MIN`], front to back.
    pub echoes: Vec<Echo64>,
}

impl BeamHit64 {
    /// The strongest echo, and the last unless it is the same.
    #[must_use]
    pub fn dual(&self) -> [Option<Echo64>; 2] {
        let mut strongest: Option<usize> = None;
        for (index, echo) in self.echoes.iter().enumerate() {
            let is_stronger = |best: usize| echo.weight > self.echoes[best].weight;
            if strongest.is_none_or(is_stronger) {
                strongest = Some(index);
            }
        }
        let last = self.echoes.len().checked_sub(1);
        let last = last.filter(|last| strongest != Some(*last));
        [strongest, last].map(|index| index.map(|index| self.echoes[index]))
    }
}

/// Contribution of a splat to a beam.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contribution64 {
    /// Distance of the splat's mean from the sensor, meters: the order.
    pub mean_range_m: f64,
    /// Index of the splat among those of all groups.
    pub splat: u32,
    /// Range at which the splat is largest along the beam, meters.
    pub range_m: f64,
    /// Opacity there.
    pub alpha: f64,
    /// Luma of its base color.
    pub luma: f64,
    /// Instance of the splat.
    pub instance: u16,
}

/// The splats of a scene as a LiDAR meets them.
#[derive(Clone, Debug)]
pub struct LidarSplats64<'a> {
    /// Groups, the background first.
    pub groups: Vec<SplatGroup<'a>>,
    /// Rules, of which the upper bound of alpha, antialiasing and the dilation of LiDARs count.
    pub rules: Rules,
}

/// A splat as the sensor has it at one time.
struct Seen {
    mean_m: DVec3,
    mean_range_m: f64,
    /// Cholesky factor of the covariance, by columns.
    factor: DMat3,
    /// Upper bound of the axes of the covariance, meters.
    longest_m: f64,
    opacity: f64,
}

impl LidarSplats64<'_> {
    /// The result of each of `beams`, which are fired by `lidar`.
    #[must_use]
    pub fn hits(&self, lidar: &Lidar, beams: &[Beam]) -> Vec<BeamHit64> {
        let contributions = self.contributions(lidar, beams);
        contributions.iter().map(|found| composite(found)).collect()
    }

    /// All splats that contribute to each of `beams`, front to back.
    #[must_use]
    pub fn contributions(&self, lidar: &Lidar, beams: &[Beam]) -> Vec<Vec<Contribution64>> {
        let together: Vec<&[Beam]> = beams.chunk_by(|a, b| a.time_s == b.time_s).collect();
        let found: Vec<Vec<Vec<Contribution64>>> = together
            .into_par_iter()
            .map(|beams| self.of_firing(lidar, beams))
            .collect();
        found.into_iter().flatten().collect()
    }

    /// Contributions to beams of one time.
    fn of_firing(&self, lidar: &Lidar, beams: &[Beam]) -> Vec<Vec<Contribution64>> {
        let time_s = beams[0].time_s;
        let sensor = lidar.pose_at(time_s);
        let least_m = lidar.model.range_m[0];
        let directions: Vec<DVec3> = beams
            .iter()
            .map(|beam| sensor.rotation * beam.direction)
            .collect();
        let mut found = vec![Vec::new(); beams.len()];
        let mut splat = 0;
        for group in &self.groups {
            let pose = group.world_from_splats.moved(&group.motion, time_s);
            for index in 0..group.splats.len() {
                splat += 1;
                let Some(seen) = self.see(group.splats, index, &pose, sensor.translation) else {
                    continue;
                };
                let [red, green, blue] =
                    group.splats.sh_dc[index].map(|dc| f64::max(0.5 + sh::Y0 * f64::from(dc), 0.0));
                let luma = LUMA[0] * red + LUMA[1] * green + LUMA[2] * blue;
                let instance = match group.instances.get(index) {
                    Some(&instance) => instance,
                    None => group.instance,
                };
                for (found, &direction) in found.iter_mut().zip(&directions) {
                    let met = seen.met(direction, self.rules.alpha_max);
                    if let Some((range_m, alpha)) = met.filter(|(range_m, _)| *range_m > least_m) {
                        found.push(Contribution64 {
                            mean_range_m: seen.mean_range_m,
                            splat: splat - 1,
                            range_m,
                            alpha,
                            luma: luma.min(1.0),
                            instance,
                        });
                    }
                }
            }
        }
        for found in &mut found {
            found.sort_by(|a, b| {
                let order = a.mean_range_m.total_cmp(&b.mean_range_m);
                order.then(a.splat.cmp(&b.splat))
            });
        }
        found
    }

    /// A splat of `splats`, which stand at `pose`, relative to a sensor at `origin`. `None` where
    /// it cannot contribute.
    fn see(&self, splats: &SplatCloud, index: usize, pose: &Pose, origin: DVec3) -> Option<Seen> {
        if splats.defect_of(index).is_some() {
            return None;
        }
        let mean_m = pose.transform(splats.mean_m(index)) - origin;
        let mean_range_m = mean_m.length();
        let toward = mean_m.try_normalize()?;
        let [w, x, y, z] = splats.rotations[index].map(f64::from);
        let rotation = pose.rotation.normalize() * DQuat::from_xyzw(x, y, z, w).normalize();
        let scales = DVec3::from_array(splats.scales[index].map(f64::from));
        let axes = DMat3::from_quat(rotation) * DMat3::from_diagonal(scales);
        let covariance = axes * axes.transpose();
        let along = DMat3::from_cols(toward * toward.x, toward * toward.y, toward * toward.z);
        let across = DMat3::IDENTITY - along;
        let width_m = self.rules.lidar_dilation_rad * mean_range_m;
        let thickness_m = THICKNESS_MIN * mean_range_m;
        let dilated = covariance + across * width_m.powi(2) + along * thickness_m.powi(2);
        let mut opacity = f64::from(splats.opacities[index]);
        if self.rules.antialias {
            let (u, v) = toward.any_orthonormal_pair();
            let area = |m: DMat3| {
                let (uv, uu, vv) = (u.dot(m * v), u.dot(m * u), v.dot(m * v));
                uu * vv - uv * uv
            };
            opacity *= (area(covariance).max(0.0) / area(dilated)).sqrt();
        }
        (opacity >= rules::ALPHA_MIN).then(|| Seen {
            mean_m,
            mean_range_m,
            factor: cholesky(dilated),
            longest_m: (scales.max_element().powi(2) + width_m.powi(2)).sqrt(),
            opacity,
        })
    }
}

impl Seen {
    /// Range and alpha at the position where the splat is largest along a beam from the origin,
    /// where alpha is at least that of [`rules::ALPHA_MIN`].
    fn met(&self, direction: DVec3, alpha_max: f64) -> Option<(f64, f64)> {
        // Farther from the ray than the outermost ellipsoid reaches: adds exactly nothing.
        let reach2 = 2.0 * (self.opacity / rules::ALPHA_MIN).ln() * self.longest_m.powi(2);
        if self.mean_m.cross(direction).length_squared() > reach2 * 1.000_001 {
            return None;
        }
        let (h, e) = (
            solve(&self.factor, self.mean_m),
            solve(&self.factor, direction),
        );
        let squared = e.length_squared();
        let exponent = h.cross(e).length_squared() / squared;
        let alpha = (self.opacity * (-0.5 * exponent).exp()).min(alpha_max);
        (alpha >= rules::ALPHA_MIN).then(|| (e.dot(h) / squared, alpha))
    }
}

/// The lower triangular L with L Lᵀ = `matrix`.
fn cholesky(matrix: DMat3) -> DMat3 {
    let [a, b, c] = [matrix.x_axis, matrix.y_axis, matrix.z_axis];
    let xx = a.x.sqrt();
    let (yx, zx) = (a.y / xx, a.z / xx);
    let yy = (b.y - yx * yx).max(0.0).sqrt();
    let zy = (b.z - zx * yx) / yy;
    let zz = (c.z - zx * zx - zy * zy).max(0.0).sqrt();
    DMat3::from_cols(
        DVec3::new(xx, yx, zx),
        DVec3::new(0.0, yy, zy),
        DVec3::new(0.0, 0.0, zz),
    )
}

/// The solution x of `factor` x = `right`, for a lower triangular factor.
fn solve(factor: &DMat3, right: DVec3) -> DVec3 {
    let x = right.x / factor.x_axis.x;
    let y = (right.y - factor.x_axis.y * x) / factor.y_axis.y;
    let z = (right.z - factor.x_axis.z * x - factor.y_axis.z * y) / factor.z_axis.z;
    DVec3::new(x, y, z)
}

/// Echoes of the contributions of one beam.
fn echoes(found: &[Contribution64]) -> Vec<Echo64> {
    let mut groups: Vec<Vec<(f64, &Contribution64)>> = Vec::new();
    let mut transmittance = 1.0;
    for met in found {
        let weight = transmittance * met.alpha;
        transmittance *= 1.0 - met.alpha;
        let joins = groups.last().is_some_and(|group| {
            let total: f64 = group.iter().map(|(weight, _)| weight).sum();
            let sum_m: f64 = group.iter().map(|(weight, met)| weight * met.range_m).sum();
            (met.range_m - sum_m / total).abs() <= ECHO_SEPARATION_M
        });
        match groups.last_mut().filter(|_| joins) {
            Some(group) => group.push((weight, met)),
            None => groups.push(vec![(weight, met)]),
        }
    }
    let echo = |group: &Vec<(f64, &Contribution64)>| {
        let sum = |of: &dyn Fn(&Contribution64) -> f64| -> f64 {
            group.iter().map(|(weight, met)| weight * of(met)).sum()
        };
        let weight = sum(&|_| 1.0);
        let strongest = group.iter().rev().max_by(|(a, _), (b, _)| a.total_cmp(b));
        Echo64 {
            weight,
            range_m: sum(&|met| met.range_m) / weight,
            intensity: sum(&|met| met.luma) / weight,
            instance: strongest.map_or(0, |(_, met)| met.instance),
        }
    };
    let all = groups.iter().map(echo);
    all.filter(|echo| echo.weight >= ECHO_WEIGHT_MIN).collect()
}

/// Alpha compositing of the contributions of one beam, front to back.
fn composite(found: &[Contribution64]) -> BeamHit64 {
    let mut hit = BeamHit64 {
        transmittance: 1.0,
        ..BeamHit64::default()
    };
    let mut largest = 0.0;
    for met in found {
        let weight = hit.transmittance * met.alpha;
        hit.transmittance *= 1.0 - met.alpha;
        hit.expected_m += weight * met.range_m;
        hit.intensity += weight * met.luma;
        if hit.median.is_none() && hit.transmittance <= 0.5 {
            hit.median = Some((met.range_m, met.instance));
        }
        if weight > largest {
            largest = weight;
            hit.strongest = Some((met.range_m, met.instance));
        }
    }
    hit.echoes = echoes(found);
    let total = 1.0 - hit.transmittance;
    if total > 0.0 {
        hit.expected_m /= total;
        hit.intensity /= total;
    }
    hit
}
