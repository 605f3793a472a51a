//! Extent of a cloud as its splats have it, far ones and lonely ones apart: for `inspect`.

use std::collections::HashMap;

use decouplegs_scene::SplatCloud;
use glam::{Quat, Vec3};
use serde::Serialize;

use crate::SummaryBounds;

/// Share of the splats beyond each end of the middle.
const TAIL: f64 = 0.01;
/// Widths of the middle from its center, beyond which a splat is far.
const FAR_WIDTHS: f32 = 3.0;
/// Cells along the diagonal of the middle, in which lonely splats are looked for.
const CELLS: f32 = 128.0;
/// Splats in a cell and the 26 around it, up to which they are lonely.
const LONELY_MAX: u32 = 3;
/// A splat is flat if its second axis is this many times the least.
const FLATNESS_MIN: f32 = 3.0;
/// Cosine of the largest angle between a flat splat's normal and an axis that it lies across.
const ACROSS_COSINE: f32 = 0.94;
/// Weight of flat splats across the axis that is up, over that across the next, at least.
const UP_RATIO_MIN: f64 = 1.3;

/// Extent of a cloud.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplatExtent {
    /// The box that holds 98 % of the finite means along each axis.
    pub middle: SummaryBounds,
    /// Splats more than three widths of that box from its center: a sky, or splats astray.
    pub far: u64,
    /// Opaque splats of the middle with next to no neighbors, in cells of a 128th of its diagonal:
    /// floaters.
    pub lonely: u64,
    /// Direction that is up, by the side on which flat splats that lie across an axis have the
    /// others above them: `z`, `-y`. None where no axis stands out.
    pub up: Option<&'static str>,
}

impl SplatExtent {
    /// Extent of `cloud`; `None` without a finite mean.
    #[must_use]
    pub fn new(cloud: &SplatCloud) -> Option<Self> {
        let is_finite = |mean: &&[f32; 3]| mean.iter().all(|value| value.is_finite());
        let finite: Vec<Vec3> = cloud
            .means
            .iter()
            .filter(is_finite)
            .map(|mean| Vec3::from_array(*mean))
            .collect();
        if finite.is_empty() {
            return None;
        }
        let ends = [0, 1, 2].map(|axis| {
            let mut values: Vec<f32> = finite.iter().map(|mean| mean[axis]).collect();
            [TAIL, 1.0 - TAIL].map(|share| quantile(&mut values, share))
        });
        let middle = SummaryBounds {
            min: ends.map(|[low, _]| low),
            max: ends.map(|[_, high]| high),
        };
        let (low, high) = (Vec3::from_array(middle.min), Vec3::from_array(middle.max));
        let (center, size) = (0.5 * low + 0.5 * high, high - low);
        let reach = FAR_WIDTHS * size.max(Vec3::splat(f32::MIN_POSITIVE));
        let is_far = |mean: &&Vec3| (**mean - center).abs().cmpgt(reach).any();
        Some(Self {
            middle,
            far: finite.iter().filter(is_far).count() as u64,
            lonely: lonely(cloud, low, high),
            up: up(cloud, low, high),
        })
    }
}

/// The value that `share` of `values` do not exceed.
fn quantile(values: &mut [f32], share: f64) -> f32 {
    let at = (share * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Opaque splats between `low` and `high` with next to no others around them.
fn lonely(cloud: &SplatCloud, low: Vec3, high: Vec3) -> u64 {
    let cell = ((high - low).length() / CELLS).max(f32::MIN_POSITIVE);
    let inside = |mean: Vec3| mean.cmpge(low).all() && mean.cmple(high).all();
    let means = cloud.means.iter().zip(&cloud.opacities);
    let opaque = means.filter(|(_, opacity)| **opacity >= 0.5);
    let opaque: Vec<[i16; 3]> = opaque
        .map(|(mean, _)| Vec3::from_array(*mean))
        .filter(|mean| inside(*mean))
        .map(|mean| ((mean - low) / cell).to_array().map(|value| value as i16))
        .collect();
    let mut counts: HashMap<[i16; 3], u32> = HashMap::new();
    for mean in &cloud.means {
        let mean = Vec3::from_array(*mean);
        if inside(mean) {
            let at = ((mean - low) / cell).to_array().map(|value| value as i16);
            *counts.entry(at).or_default() += 1;
        }
    }
    let mut known: HashMap<[i16; 3], bool> = HashMap::new();
    let mut is_lonely = |at: [i16; 3]| {
        *known.entry(at).or_insert_with(|| {
            let mut around = 0;
            for step in 0..27 {
                let beside = [step % 3, step / 3 % 3, step / 9].map(|value| value - 1);
                let beside = [0, 1, 2].map(|axis| at[axis] + beside[axis]);
                around += counts.get(&beside).copied().unwrap_or(0);
            }
            around <= LONELY_MAX
        })
    };
    opaque.into_iter().filter(|at| is_lonely(*at)).count() as u64
}

/// Names of the directions along and against each axis.
const DIRECTIONS: [[&str; 2]; 3] = [["x", "-x"], ["y", "-y"], ["z", "-z"]];

/// The direction that is up, by the flat splats between `low` and `high`.
fn up(cloud: &SplatCloud, low: Vec3, high: Vec3) -> Option<&'static str> {
    let mut across: [Vec<(f32, f64)>; 3] = Default::default();
    for index in 0..cloud.len() {
        let mean = Vec3::from_array(cloud.means[index]);
        let inside = mean.cmpge(low).all() && mean.cmple(high).all();
        let Some((normal, area)) = flat(cloud, index).filter(|_| inside) else {
            continue;
        };
        let weight = f64::from(area.sqrt() * cloud.opacities[index]);
        if let Some(axis) = (0..3).find(|axis| normal[*axis].abs() >= ACROSS_COSINE) {
            across[axis].push((mean[axis], weight));
        }
    }
    let weights: [f64; 3] =
        [0, 1, 2].map(|axis: usize| across[axis].iter().map(|(_, weight)| weight).sum());
    let axis = (0..3).max_by(|a, b| weights[*a].total_cmp(&weights[*b]))?;
    let next = (0..3)
        .filter(|other| *other != axis)
        .map(|other| weights[other]);
    if weights[axis] <= 0.0 || weights[axis] < UP_RATIO_MIN * next.fold(0.0, f64::max) {
        return None;
    }
    // The others stand on most of them: the road is at the end that has less beyond it.
    let flat = &mut across[axis];
    flat.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut sum = 0.0;
    let half = 0.5 * weights[axis];
    let road = flat.iter().find(|(_, weight)| {
        sum += weight;
        sum >= half
    });
    let road = road.map_or(0.0, |(at, _)| *at);
    let is_along = high[axis] - road >= road - low[axis];
    Some(DIRECTIONS[axis][usize::from(!is_along)])
}

/// Normal and area of splat `index`, in its cloud's unit, if it is flat.
fn flat(cloud: &SplatCloud, index: usize) -> Option<(Vec3, f32)> {
    let scales = cloud.scales[index];
    let least = (0..3).min_by(|a, b| scales[*a].total_cmp(&scales[*b]))?;
    let [first, second] = [scales[(least + 1) % 3], scales[(least + 2) % 3]];
    let [w, x, y, z] = cloud.rotations[index];
    let rotation = Quat::from_xyzw(x, y, z, w);
    let is_flat = first.min(second) >= FLATNESS_MIN * scales[least] && (first * second).is_finite();
    (is_flat && rotation.length_squared() > 0.0)
        .then(|| (rotation.normalize() * Vec3::AXES[least], first * second))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor at height 0 that lies across `axis`, and a box of small splats above it, with `sign`
    /// for up.
    fn room(axis: usize, sign: f32) -> SplatCloud {
        let mut cloud = SplatCloud::default();
        let mut add = |mean: Vec3, scales: Vec3| {
            let turned = |value: Vec3| {
                let [a, b, c] = value.to_array();
                let mut of_axes = [0.0; 3];
                (
                    of_axes[axis],
                    of_axes[(axis + 1) % 3],
                    of_axes[(axis + 2) % 3],
                ) = (c, a, b);
                of_axes
            };
            cloud.means.push(turned(mean * Vec3::new(1.0, 1.0, sign)));
            cloud.scales.push(turned(scales));
            cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
            cloud.opacities.push(0.9);
            cloud.sh_dc.push([0.0; 3]);
        };
        for step in 0..1600 {
            let at = Vec3::new((step % 40) as f32 * 0.5, (step / 40) as f32 * 0.5, 0.0);
            add(at, Vec3::new(0.3, 0.3, 0.01));
        }
        for step in 0..600 {
            let at = Vec3::new(
                (step % 7) as f32,
                (step % 11) as f32,
                (step % 13) as f32 * 0.4,
            );
            add(at, Vec3::splat(0.2));
        }
        cloud
    }

    #[test]
    fn up_is_where_the_floor_has_the_rest_above_it() {
        for (axis, names) in DIRECTIONS.iter().enumerate() {
            for (sign, name) in [1.0, -1.0].into_iter().zip(names) {
                let extent = SplatExtent::new(&room(axis, sign)).unwrap();
                assert_eq!(extent.up, Some(*name));
            }
        }
        // Balls have no normal.
        let mut balls = room(2, 1.0);
        balls.scales.fill([0.2; 3]);
        assert_eq!(SplatExtent::new(&balls).unwrap().up, None);
    }

    #[test]
    fn far_and_lonely_splats_are_counted_and_do_not_widen_the_middle() {
        let mut cloud = room(2, 1.0);
        let before = SplatExtent::new(&cloud).unwrap();
        assert_eq!((before.far, before.lonely), (0, 0));
        for mean in [[4000.0, 0.0, 9000.0], [10.0, 10.0, 4.7], [f32::NAN; 3]] {
            cloud.means.push(mean);
            cloud.scales.push([0.1; 3]);
            cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
            cloud.opacities.push(0.9);
            cloud.sh_dc.push([0.0; 3]);
        }
        let after = SplatExtent::new(&cloud).unwrap();
        assert_eq!((after.far, after.lonely), (1, 1));
        assert!(after.middle.max[2] < 6.0, "{after:?}");
        assert_eq!(SplatExtent::new(&SplatCloud::default()), None);
    }
}
