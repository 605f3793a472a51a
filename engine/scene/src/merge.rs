//! Merging of splats: clusters that are small in place and color, and one splat of the same moments
//! in place of each.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;

use crate::symmetric::OwnAxes;
use crate::{SplatCloud, sh};

/// Most that a merged splat is widened.
const WIDENING_MAX: f64 = 2.0;

/// Exponent of Thomsen's approximation to the surface of an ellipsoid (error below 1.1 %).
const THOMSEN: f64 = 1.6075;

/// `cloud` with one splat for each cluster, whose members count by `weights`.
#[must_use]
pub fn merged(cloud: &SplatCloud, weights: &[f64], clusters: &[Vec<u32>]) -> SplatCloud {
    let splats: Vec<SplatCloud> = clusters
        .par_iter()
        .map(|members| moment_match(cloud, weights, members))
        .collect();
    let mut merged = SplatCloud::with_degree(cloud.sh_degree);
    splats.iter().for_each(|splat| merged.append(splat));
    merged
}

/// The area that a splat covers in an image, over all directions, but for a constant factor: a
/// quarter of its ellipsoid's surface (Cauchy), after Thomsen. Square meters. Of splats without any
/// size it is tiny, not zero, so that they keep a say.
#[must_use]
pub fn mean_projected_area_m2(scales: &[f32; 3]) -> f64 {
    let [a, b, c] = scales.map(f64::from);
    let mean = ((a * b).powf(THOMSEN) + (a * c).powf(THOMSEN) + (b * c).powf(THOMSEN)) / 3.0;
    mean.powf(1.0 / THOMSEN).max(1e-60)
}

/// One splat for `members` (at least one): the mean, covariance and color of them all, each by its
/// weight; its opacity is such that opacity times area is the sum of theirs. Where that asks for
/// more than 1, the splat is opaque and wider, up to [`WIDENING_MAX`]; what is beyond was overlap.
fn moment_match(cloud: &SplatCloud, weights: &[f64], members: &[u32]) -> SplatCloud {
    let weights: Vec<f64> = members
        .iter()
        .map(|&splat| weights[splat as usize])
        .collect();
    let total: f64 = weights.iter().sum();
    let mean_of = |value: &dyn Fn(usize) -> f64| {
        members
            .iter()
            .zip(&weights)
            .map(|(&splat, weight)| weight * value(splat as usize))
            .sum::<f64>()
            / total
    };
    let mean = DVec3::from_array(std::array::from_fn(|axis| {
        mean_of(&|splat| f64::from(cloud.means[splat][axis]))
    }));
    let mut covariance = DMat3::ZERO;
    for (&splat, weight) in members.iter().zip(&weights) {
        let off = DVec3::from_array(cloud.means[splat as usize].map(f64::from)) - mean;
        let spread = DMat3::from_cols(off * off.x, off * off.y, off * off.z);
        covariance += (covariance_of(cloud, splat as usize) + spread) * (weight / total);
    }
    let own = OwnAxes::from_matrix(&covariance);
    let scales = own.values.max(DVec3::ZERO).map(f64::sqrt);
    let covered: f64 = members
        .iter()
        .map(|&splat| covered_m2(cloud, splat as usize))
        .sum();
    let wanted = covered / mean_projected_area_m2(&scales.as_vec3().to_array());
    let widening = wanted.sqrt().clamp(1.0, WIDENING_MAX);
    let color = |of: &dyn Fn(usize) -> [f32; 3]| -> [f32; 3] {
        std::array::from_fn(|channel| mean_of(&|splat| f64::from(of(splat)[channel])) as f32)
    };
    SplatCloud {
        means: vec![mean.as_vec3().to_array()],
        scales: vec![(scales * widening).as_vec3().to_array()],
        rotations: vec![own.rotation_wxyz()],
        opacities: vec![wanted.min(1.0) as f32],
        sh_degree: cloud.sh_degree,
        sh_dc: vec![color(&|splat| cloud.sh_dc[splat])],
        sh_rest: (0..cloud.rest_stride())
            .map(|k| color(&|splat| cloud.rest_of(splat)[k]))
            .collect(),
    }
}

/// Opacity times projected area, square meters but for a constant factor.
#[must_use]
pub fn covered_m2(cloud: &SplatCloud, splat: usize) -> f64 {
    f64::from(cloud.opacities[splat]) * mean_projected_area_m2(&cloud.scales[splat])
}

fn covariance_of(cloud: &SplatCloud, splat: usize) -> DMat3 {
    let [w, x, y, z] = cloud.rotations[splat].map(f64::from);
    let scales = DVec3::from_array(cloud.scales[splat].map(f64::from));
    let scaled =
        DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()) * DMat3::from_diagonal(scales);
    scaled * scaled.transpose()
}

/// The splats of `cloud` in `count` clusters (fewer where it has fewer different ones): again and
/// again the cluster that spreads most, in place and color, is cut in two at its mean across the
/// axis of its largest spread (Wan et al., Variance-Based Color Image Quantization, 1988). A
/// difference of 1 in an RGB channel is as bad as a displacement by `color_weight` of the longest
/// side of the cloud.
#[must_use]
pub fn clusters(
    cloud: &SplatCloud,
    weights: &[f64],
    count: usize,
    color_weight: f64,
) -> Vec<Vec<u32>> {
    let bounds = cloud.bounds();
    let longest_m = bounds
        .half_extent()
        .iter()
        .fold(0.0f64, |longest, &half| longest.max(2.0 * f64::from(half)));
    let feature = |splat: usize| -> Feature {
        let color = cloud.sh_dc[splat].map(|dc| f64::from(dc) * sh::Y0 * color_weight * longest_m);
        let mean = cloud.means[splat].map(f64::from);
        Feature {
            at: [mean[0], mean[1], mean[2], color[0], color[1], color[2]],
            weight: weights[splat],
        }
    };
    let features: Vec<Feature> = (0..cloud.len()).into_par_iter().map(feature).collect();
    let mut heap = BinaryHeap::new();
    heap.push(Cluster::new((0..cloud.len() as u32).collect(), &features));
    while heap.len() < count {
        // Nothing to cut is left when the widest cluster is a point.
        if heap.peek().is_none_or(|widest| widest.spread <= 0.0) {
            break;
        }
        let Some(widest) = heap.pop() else { break };
        let (low, high) = widest.cut(&features);
        heap.push(Cluster::new(low, &features));
        heap.push(Cluster::new(high, &features));
    }
    let mut clusters: Vec<Vec<u32>> = heap.into_iter().map(|cluster| cluster.members).collect();
    clusters.sort_unstable();
    clusters
}

/// A splat as clusters see it: position and color in one space.
struct Feature {
    at: [f64; 6],
    weight: f64,
}

/// Splats in rising order, and how they spread.
struct Cluster {
    members: Vec<u32>,
    /// Weighted sum of squared distances to the mean, along the axis where it is largest.
    spread: f64,
    axis: usize,
    mean: f64,
}

impl Cluster {
    fn new(members: Vec<u32>, features: &[Feature]) -> Self {
        let (mut weight, mut sums) = (0.0, [0.0; 6]);
        for &splat in &members {
            let feature = &features[splat as usize];
            weight += feature.weight;
            (0..6).for_each(|axis| sums[axis] += feature.weight * feature.at[axis]);
        }
        let means = sums.map(|sum| sum / weight);
        let mut squares = [0.0; 6];
        for &splat in &members {
            let feature = &features[splat as usize];
            (0..6).for_each(|axis| {
                squares[axis] += feature.weight * (feature.at[axis] - means[axis]).powi(2);
            });
        }
        let axis = (0..6)
            .max_by(|&a, &b| squares[a].total_cmp(&squares[b]).then(b.cmp(&a)))
            .unwrap_or(0);
        // A mean that rounding moved to one side of all members would cut nothing off.
        let low = members
            .iter()
            .filter(|&&splat| features[splat as usize].at[axis] <= means[axis])
            .count();
        let cuts = low > 0 && low < members.len();
        Self {
            spread: if cuts { squares[axis] } else { 0.0 },
            axis,
            mean: means[axis],
            members,
        }
    }

    fn cut(self, features: &[Feature]) -> (Vec<u32>, Vec<u32>) {
        let Self {
            members,
            axis,
            mean,
            ..
        } = self;
        members
            .into_iter()
            .partition(|&splat| features[splat as usize].at[axis] <= mean)
    }
}

impl PartialEq for Cluster {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cluster {}

impl PartialOrd for Cluster {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Cluster {
    /// Compares spreads; of equal ones the one with the earliest splat is the greater. Clusters
    /// share no splats.
    fn cmp(&self, other: &Self) -> Ordering {
        self.spread
            .total_cmp(&other.spread)
            .then_with(|| other.members.first().cmp(&self.members.first()))
    }
}
