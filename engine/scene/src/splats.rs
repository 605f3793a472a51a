//! A cloud of 3D Gaussians in the one form the engine works with.

use glam::{DQuat, DVec3};
use rayon::prelude::*;

use crate::{Bounds, Pose, sh};

/// Gaussians as arrays of equal length. The index of a splat is its place in them; equal depths are
/// ordered by it.
///
/// Scales are linear (standard deviations, meters), rotations unit quaternions w, x, y, z,
/// opacities in 0 to 1.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SplatCloud {
    /// Means, meters, relative to the origin of the world the cloud belongs to.
    pub means: Vec<[f32; 3]>,
    /// Standard deviations along the splat's own axes, meters.
    pub scales: Vec<[f32; 3]>,
    /// World from splat axes, unit quaternions w, x, y, z.
    pub rotations: Vec<[f32; 4]>,
    /// Peak alpha, 0 to 1.
    pub opacities: Vec<f32>,
    /// Degree of the spherical harmonics stored, 0 to 3.
    pub sh_degree: u8,
    /// DC coefficient per splat, RGB.
    pub sh_dc: Vec<[f32; 3]>,
    /// Coefficients after DC, `[splat][coefficient][rgb]` flattened over the first two; empty at
    /// degree 0.
    pub sh_rest: Vec<[f32; 3]>,
}

/// Reason why a splat cannot be rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum SplatDefect {
    /// A mean that is NaN or infinite.
    Mean,
    /// A scale that is NaN, infinite or negative.
    Scale,
    /// A rotation that is NaN, infinite or all zero.
    Rotation,
    /// An opacity that is NaN or outside 0 to 1.
    Opacity,
    /// A color coefficient that is NaN or infinite.
    Color,
}

impl SplatCloud {
    /// An empty cloud of the given degree.
    #[must_use]
    pub fn with_degree(sh_degree: u8) -> Self {
        Self {
            sh_degree,
            ..Self::default()
        }
    }

    /// Mean of a splat, f64 meters.
    ///
    /// # Panics
    /// Panics if there is no such splat.
    #[must_use]
    pub fn mean_m(&self, splat: usize) -> DVec3 {
        DVec3::from_array(self.means[splat].map(f64::from))
    }

    /// Standard deviations of a splat, meters, from the smallest.
    ///
    /// # Panics
    /// Panics if there is no such splat.
    #[must_use]
    pub fn sorted_scales_m(&self, splat: usize) -> [f64; 3] {
        let mut scales_m = self.scales[splat].map(f64::from);
        scales_m.sort_by(f64::total_cmp);
        scales_m
    }

    /// Axis along which a splat is thinnest, a unit vector of either sign: the normal of a flat
    /// one. Vertical if its rotation has no length.
    ///
    /// # Panics
    /// Panics if there is no such splat.
    #[must_use]
    pub fn thin_axis(&self, splat: usize) -> DVec3 {
        let scales = self.scales[splat];
        let shortest = (0..3)
            .min_by(|&a, &b| scales[a].total_cmp(&scales[b]))
            .unwrap_or(2);
        let [w, x, y, z] = self.rotations[splat].map(f64::from);
        (DQuat::from_xyzw(x, y, z, w).normalize() * DVec3::AXES[shortest]).normalize_or(DVec3::Z)
    }

    /// Splats in the cloud.
    #[must_use]
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// Coefficients after DC that each splat has.
    #[must_use]
    pub fn rest_stride(&self) -> usize {
        sh::coefficient_count(self.sh_degree) - 1
    }

    /// The coefficients after DC of one splat.
    #[must_use]
    pub fn rest_of(&self, splat: usize) -> &[[f32; 3]] {
        let stride = self.rest_stride();
        &self.sh_rest[splat * stride..(splat + 1) * stride]
    }

    /// The box around the means.
    #[must_use]
    pub fn bounds(&self) -> Bounds {
        Bounds::from_points(&self.means)
    }

    /// First defect of a splat, if any. Unit length of the rotation is not asked for here.
    #[must_use]
    pub fn defect_of(&self, splat: usize) -> Option<SplatDefect> {
        let finite = |values: &[f32]| values.iter().all(|value| value.is_finite());
        if !finite(&self.means[splat]) {
            Some(SplatDefect::Mean)
        } else if !finite(&self.scales[splat])
            || self.scales[splat].iter().any(|&scale| scale < 0.0)
        {
            Some(SplatDefect::Scale)
        } else if !finite(&self.rotations[splat])
            || self.rotations[splat].iter().map(|q| q * q).sum::<f32>() < 1e-30
        {
            Some(SplatDefect::Rotation)
        } else if !(0.0..=1.0).contains(&self.opacities[splat]) {
            Some(SplatDefect::Opacity)
        } else if !finite(&self.sh_dc[splat]) || !self.rest_of(splat).iter().all(|c| finite(c)) {
            Some(SplatDefect::Color)
        } else {
            None
        }
    }

    /// The splats at `order`, in that order.
    #[must_use]
    pub fn select(&self, order: &[u32]) -> Self {
        let stride = self.rest_stride();
        let mut sh_rest = vec![[0.0; 3]; order.len() * stride];
        if stride > 0 {
            sh_rest
                .par_chunks_mut(stride)
                .zip(order)
                .for_each(|(to, &from)| to.copy_from_slice(self.rest_of(from as usize)));
        }
        Self {
            means: gather(&self.means, order),
            scales: gather(&self.scales, order),
            rotations: gather(&self.rotations, order),
            opacities: gather(&self.opacities, order),
            sh_degree: self.sh_degree,
            sh_dc: gather(&self.sh_dc, order),
            sh_rest,
        }
    }

    /// Reserves memory for `splats` more of the same degree, and no more than that.
    pub fn reserve(&mut self, splats: usize) {
        let stride = self.rest_stride();
        self.means.reserve_exact(splats);
        self.scales.reserve_exact(splats);
        self.rotations.reserve_exact(splats);
        self.opacities.reserve_exact(splats);
        self.sh_dc.reserve_exact(splats);
        self.sh_rest.reserve_exact(splats * stride);
    }

    /// Adds the splats of `other` behind these. The result has the higher degree of the two;
    /// missing bands are zero.
    pub fn append(&mut self, other: &Self) {
        let degree = self.sh_degree.max(other.sh_degree);
        self.set_degree(degree);
        self.means.extend_from_slice(&other.means);
        self.scales.extend_from_slice(&other.scales);
        self.rotations.extend_from_slice(&other.rotations);
        self.opacities.extend_from_slice(&other.opacities);
        self.sh_dc.extend_from_slice(&other.sh_dc);
        if other.sh_degree == degree {
            self.sh_rest.extend_from_slice(&other.sh_rest);
        } else {
            let stride = self.rest_stride();
            for splat in 0..other.len() {
                let rest = other.rest_of(splat);
                self.sh_rest.extend_from_slice(rest);
                self.sh_rest
                    .resize(self.sh_rest.len() + stride - rest.len(), [0.0; 3]);
            }
        }
    }

    /// Drops the bands above `degree`, or adds bands of zeros up to it.
    pub fn set_degree(&mut self, degree: u8) {
        if degree == self.sh_degree {
            return;
        }
        let (from, to) = (self.rest_stride(), sh::coefficient_count(degree) - 1);
        let mut sh_rest = vec![[0.0; 3]; self.len() * to];
        let kept = from.min(to);
        for splat in 0..self.len() {
            sh_rest[splat * to..splat * to + kept]
                .copy_from_slice(&self.sh_rest[splat * from..splat * from + kept]);
        }
        self.sh_rest = sh_rest;
        self.sh_degree = degree;
    }

    /// The cloud moved rigidly by `pose`. Its colors turn with it if `turn_sh`; scenes trained in
    /// place must not be turned.
    #[must_use]
    pub fn placed(mut self, pose: &Pose, turn_sh: bool) -> Self {
        self.means.par_iter_mut().for_each(|mean| {
            *mean = pose
                .transform(glam::Vec3::from_array(*mean).as_dvec3())
                .as_vec3()
                .to_array();
        });
        self.rotations.par_iter_mut().for_each(|rotation| {
            let [w, x, y, z] = rotation.map(f64::from);
            let turned = (pose.rotation * DQuat::from_xyzw(x, y, z, w)).normalize();
            *rotation = [
                turned.w as f32,
                turned.x as f32,
                turned.y as f32,
                turned.z as f32,
            ];
        });
        let stride = self.rest_stride();
        if turn_sh && stride > 0 {
            let turn = sh::ShRotation::new(pose.rotation);
            self.sh_rest
                .par_chunks_mut(stride)
                .for_each(|rest| turn.rotate(rest));
        }
        self
    }

    /// The order of a space-filling (Morton) curve over the means, ties by index.
    ///
    /// Neighbors in it are neighbors in space, so runs of it make tight boxes for culling. Means
    /// that are not finite come last.
    #[must_use]
    pub fn spatial_order(&self) -> Vec<u32> {
        let bounds = Bounds::from_points(
            self.means
                .iter()
                .filter(|mean| mean.iter().all(|x| x.is_finite())),
        );
        let codes: Vec<u64> = self
            .means
            .par_iter()
            .map(|mean| morton_code(mean, &bounds))
            .collect();
        let mut order: Vec<u32> = (0..self.len() as u32).collect();
        order.par_sort_unstable_by_key(|&splat| (codes[splat as usize], splat));
        order
    }

    /// The same splats in their [spatial order](Self::spatial_order).
    #[must_use]
    pub fn in_spatial_order(&self) -> Self {
        self.select(&self.spatial_order())
    }
}

fn gather<T: Copy + Send + Sync>(values: &[T], order: &[u32]) -> Vec<T> {
    order
        .par_iter()
        .map(|&index| values[index as usize])
        .collect()
}

/// 21 bits per axis, interleaved. The grid is cubic cells over the longest axis so that chunks are
/// compact.
fn morton_code(mean: &[f32; 3], bounds: &Bounds) -> u64 {
    if !mean.iter().all(|x| x.is_finite()) {
        return u64::MAX;
    }
    let longest = (0..3)
        .map(|axis| f64::from(bounds.max[axis]) - f64::from(bounds.min[axis]))
        .fold(f64::MIN_POSITIVE, f64::max);
    let cell = |axis: usize| {
        let offset = f64::from(mean[axis]) - f64::from(bounds.min[axis]);
        (offset / longest * 2_097_151.0) as u64
    };
    spread(cell(0)) | spread(cell(1)) << 1 | spread(cell(2)) << 2
}

/// Moves bit `i` of the low 21 bits to bit `3 i`.
fn spread(value: u64) -> u64 {
    let mut x = value & 0x1f_ffff;
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DQuat, DVec3};

    fn cloud(count: usize, degree: u8) -> SplatCloud {
        let stride = sh::coefficient_count(degree) - 1;
        SplatCloud {
            means: (0..count)
                .map(|i| {
                    [
                        (i as f32 * 0.37).sin() * 10.0,
                        (i as f32 * 0.91).cos() * 10.0,
                        i as f32 * 0.01,
                    ]
                })
                .collect(),
            scales: vec![[0.1, 0.2, 0.3]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.5; count],
            sh_degree: degree,
            sh_dc: (0..count).map(|i| [i as f32; 3]).collect(),
            sh_rest: (0..count * stride)
                .map(|i| [i as f32 * 0.01, 0.0, 1.0])
                .collect(),
        }
    }

    #[test]
    fn spatial_order_is_a_permutation_that_brings_neighbors_together() {
        let cloud = cloud(1000, 1);
        let order = cloud.spatial_order();
        let mut seen = order.clone();
        seen.sort_unstable();
        assert!(seen.iter().enumerate().all(|(i, &s)| i as u32 == s));
        let sorted = cloud.select(&order);
        let step = |c: &SplatCloud| -> f32 {
            c.means
                .windows(2)
                .map(|w| (w[0][0] - w[1][0]).abs() + (w[0][1] - w[1][1]).abs())
                .sum()
        };
        assert!(step(&sorted) < 0.5 * step(&cloud));
        assert_eq!(sorted.rest_of(7), cloud.rest_of(order[7] as usize));
    }

    #[test]
    fn appending_raises_the_degree_and_keeps_the_colors() {
        let mut a = cloud(3, 0);
        let b = cloud(2, 2);
        a.append(&b);
        assert_eq!((a.len(), a.sh_degree, a.sh_rest.len()), (5, 2, 40));
        assert!(a.rest_of(1).iter().all(|c| *c == [0.0; 3]));
        assert_eq!(a.rest_of(4), b.rest_of(1));
        a.set_degree(0);
        assert!(a.sh_rest.is_empty());
    }

    #[test]
    fn placing_there_and_back_is_the_identity() {
        let original = cloud(20, 3);
        let pose = Pose::new(DQuat::from_rotation_y(0.4), DVec3::new(3.0, -2.0, 1.0));
        let back = original
            .clone()
            .placed(&pose, true)
            .placed(&pose.inverse(), true);
        for i in 0..original.len() {
            for axis in 0..3 {
                assert!((original.means[i][axis] - back.means[i][axis]).abs() < 1e-5);
            }
            for (a, b) in original.rest_of(i).iter().zip(back.rest_of(i)) {
                assert!((a[0] - b[0]).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn every_defect_is_named() {
        let good = cloud(1, 1);
        assert_eq!(good.defect_of(0), None);
        let broken = |change: fn(&mut SplatCloud)| {
            let mut cloud = good.clone();
            change(&mut cloud);
            cloud.defect_of(0)
        };
        assert_eq!(
            broken(|c| c.means[0][1] = f32::NAN),
            Some(SplatDefect::Mean)
        );
        assert_eq!(broken(|c| c.scales[0][2] = -1.0), Some(SplatDefect::Scale));
        assert_eq!(
            broken(|c| c.rotations[0] = [0.0; 4]),
            Some(SplatDefect::Rotation)
        );
        assert_eq!(broken(|c| c.opacities[0] = 1.5), Some(SplatDefect::Opacity));
        assert_eq!(
            broken(|c| c.sh_rest[2][0] = f32::INFINITY),
            Some(SplatDefect::Color)
        );
    }
}
