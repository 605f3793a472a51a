//! Extent of a cloud as its splats have it, far ones and lonely ones apart: for `inspect`.

use decouplegs_scene::SplatCloud;
use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::SummaryBounds;

/// Share of the splats beyond each end of the middle.
const TAIL: f64 = 0.01;
/// Widths of the middle from its center, beyond which a splat is far.
const FAR_WIDTHS: f32 = 3.0;
/// Cells along the diagonal of the middle, in which lonely splats are searched: the first number
/// with which most splats have company.
const CELLS: [f32; 5] = [256.0, 128.0, 64.0, 32.0, 16.0];
/// Splats in a cell and the 26 around it that most have, at least.
const COMPANY_MIN: u32 = 16;
/// Splats in a cell and the 26 around it, up to which they are lonely.
const LONELY_MAX: u32 = 1;

/// Extent of a cloud.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplatExtent {
    /// The box that holds 98 % of the finite means along each axis.
    pub middle: SummaryBounds,
    /// Splats more than three widths of that box from its center: a sky, or splats astray.
    pub far: u64,
    /// Opaque splats of the middle with next to no neighbors, where most have 16: floaters.
    pub lonely: u64,
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
        let ends = [0, 1, 2].into_par_iter().map(|axis| {
            let mut values: Vec<f32> = finite.iter().map(|mean| mean[axis]).collect();
            [TAIL, 1.0 - TAIL].map(|share| quantile(&mut values, share))
        });
        let ends: Vec<[f32; 2]> = ends.collect();
        let ends = [ends[0], ends[1], ends[2]];
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
        })
    }
}

/// The value that `share` of `values` do not exceed.
fn quantile(values: &mut [f32], share: f64) -> f32 {
    let at = (share * (values.len() - 1) as f64).round() as usize;
    *values.select_nth_unstable_by(at, f32::total_cmp).1
}

/// Splats by cell of a grid, whose rows along x lie behind each other, and so do its planes.
struct Cells {
    sizes: [usize; 3],
    counts: Vec<u32>,
}

impl Cells {
    /// Place of the cell `at`.
    fn index(&self, at: [usize; 3]) -> usize {
        (at[2] * self.sizes[1] + at[1]) * self.sizes[0] + at[0]
    }

    /// Splats in each cell and the 26 around it.
    fn around(&self) -> Vec<u32> {
        let sums = (0..self.counts.len()).into_par_iter().map(|index| {
            let (row, plane) = (self.sizes[0], self.sizes[0] * self.sizes[1]);
            let at = [index % row, index / row % self.sizes[1], index / plane];
            let beside =
                |axis: usize| at[axis].saturating_sub(1)..=(at[axis] + 1).min(self.sizes[axis] - 1);
            let mut sum = 0;
            for z in beside(2) {
                for y in beside(1) {
                    for x in beside(0) {
                        sum += self.counts[self.index([x, y, z])];
                    }
                }
            }
            sum
        });
        sums.collect()
    }
}

/// Opaque splats between `low` and `high` with next to no others around them.
fn lonely(cloud: &SplatCloud, low: Vec3, high: Vec3) -> u64 {
    let inside = |mean: &[f32; 3]| {
        let mean = Vec3::from_array(*mean);
        mean.cmpge(low).all() && mean.cmple(high).all()
    };
    let diagonal = (high - low).length().max(f32::MIN_POSITIVE);
    for cells in CELLS {
        let place = |mean: Vec3| {
            // A diagonal whose square is too small for an f32 makes places as large as that.
            let along = (mean - low) * (cells / diagonal);
            along.to_array().map(|value| value.min(CELLS[0]) as usize)
        };
        // A diagonal of 256 cells makes 3.3 million of them at most, and one whose square is too
        // small for an f32 makes 17 million.
        let sizes = place(high).map(|last| last + 1);
        let mut by_cell = Cells {
            sizes,
            counts: vec![0; sizes.into_iter().product()],
        };
        let cell_of = |mean: &[f32; 3]| by_cell.index(place(Vec3::from_array(*mean)));
        let splats: Vec<(usize, f32)> = (cloud.means.par_iter().zip(&cloud.opacities))
            .filter(|(mean, _)| inside(mean))
            .map(|(mean, opacity)| (cell_of(mean), *opacity))
            .collect();
        for (cell, _) in &splats {
            by_cell.counts[*cell] += 1;
        }
        let around = by_cell.around();
        let have_company = (splats.iter()).filter(|(cell, _)| around[*cell] >= COMPANY_MIN);
        if have_company.count() <= splats.len() / 2 {
            continue;
        }
        let alone = splats
            .iter()
            .filter(|(cell, opacity)| *opacity >= 0.5 && around[*cell] <= LONELY_MAX);
        return alone.count() as u64;
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor at height 0, and a box of small splats above it.
    fn room() -> SplatCloud {
        let mut cloud = SplatCloud::default();
        let mut add = |mean: [f32; 3]| {
            cloud.means.push(mean);
            cloud.scales.push([0.1; 3]);
            cloud.rotations.push([1.0, 0.0, 0.0, 0.0]);
            cloud.opacities.push(0.9);
            cloud.sh_dc.push([0.0; 3]);
        };
        for step in 0..1600 {
            add([(step % 40) as f32 * 0.5, (step / 40) as f32 * 0.5, 0.0]);
        }
        for step in 0..600 {
            add([
                (step % 7) as f32,
                (step % 11) as f32,
                (step % 13) as f32 * 0.4,
            ]);
        }
        cloud
    }

    #[test]
    fn far_and_lonely_splats_are_counted_and_do_not_widen_the_middle() {
        let mut cloud = room();
        let before = SplatExtent::new(&cloud).unwrap();
        assert_eq!((before.far, before.lonely), (0, 0));
        for mean in [[4000.0, 0.0, 9000.0], [16.0, 16.0, 4.7], [f32::NAN; 3]] {
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
        // So close together that the square of the diagonal is 0.
        for (step, mean) in cloud.means.iter_mut().enumerate() {
            *mean = [1e-30 * (step % 3) as f32; 3];
        }
        assert_eq!(SplatExtent::new(&cloud).unwrap().lonely, 0);
        // Splats that all have the same place, and one alone.
        cloud.means.fill([1.0; 3]);
        assert_eq!(SplatExtent::new(&cloud).unwrap().lonely, 0);
    }
}
