//! Floaters: small groups of splats in empty space.

use std::collections::HashMap;

use rayon::prelude::*;

use crate::SplatCloud;

/// Cell of a cubic grid.
type Cell = [i64; 3];

/// Half of all splats share their cell with at least this number less one.
const CELL_SPLATS: usize = 8;
/// The size of a cloud is that of this share of its splats, on each axis: floaters do not count.
const CORE: f64 = 0.98;
/// Most halvings of the core's longest side.
const HALVINGS_MAX: i32 = 16;
/// Cells beyond are one: what is there is far from everything.
const CELL_MAX: f64 = 1e12;

impl SplatCloud {
    /// Marks the floaters: `[splat]`, true for one.
    ///
    /// Space is cut into cubic cells, as fine as half of all splats still lie in cells of eight.
    /// Splats in cells that touch, by a face, an edge or a corner, are a group. Groups of fewer
    /// than `share` of all splats are floaters, but for the largest group. So are splats whose mean
    /// is not finite. `share` is from 0 to 1.
    #[must_use]
    pub fn floaters(&self, share: f64) -> Vec<bool> {
        let is_placed = |mean: &[f32; 3]| mean.iter().all(|x| x.is_finite());
        let placed: Vec<usize> = (0..self.len())
            .filter(|&splat| is_placed(&self.means[splat]))
            .collect();
        let mut marks = vec![true; self.len()];
        let edge_m = self.cell_edge_m(&placed);
        let cells: Vec<Cell> = placed
            .par_iter()
            .map(|&splat| cell_of(&self.means[splat], edge_m))
            .collect();
        let groups = Groups::new(&cells);
        let fewest = share * self.len() as f64;
        for (&splat, cell) in placed.iter().zip(&cells) {
            let (size, is_largest) = groups.size_of(cell);
            marks[splat] = !is_largest && (size as f64) < fewest;
        }
        marks
    }

    /// Edge of the cells, meters; infinite where there is one cell.
    fn cell_edge_m(&self, placed: &[usize]) -> f64 {
        let Some(last) = placed.len().checked_sub(1) else {
            return f64::INFINITY;
        };
        let longest_m = (0..3)
            .map(|axis| {
                let mut along: Vec<f32> = placed
                    .iter()
                    .map(|&splat| self.means[splat][axis])
                    .collect();
                along.par_sort_unstable_by(f32::total_cmp);
                let at = |share: f64| f64::from(along[(share * last as f64).round() as usize]);
                at(0.5 + 0.5 * CORE) - at(0.5 - 0.5 * CORE)
            })
            .fold(0.0, f64::max);
        if longest_m <= 0.0 {
            return f64::INFINITY;
        }
        let is_filled = |edge_m: f64| {
            let mut cells: Vec<Cell> = placed
                .par_iter()
                .map(|&splat| cell_of(&self.means[splat], edge_m))
                .collect();
            cells.par_sort_unstable();
            let full = cells.chunk_by(|a, b| a == b).map(<[Cell]>::len);
            let full: usize = full.filter(|&splats| splats >= CELL_SPLATS).sum();
            2 * full >= placed.len()
        };
        let edges_m = (1..=HALVINGS_MAX).map(|halvings| longest_m * 0.5_f64.powi(halvings));
        edges_m
            .take_while(|&edge_m| is_filled(edge_m))
            .last()
            .unwrap_or(longest_m)
    }
}

fn cell_of(mean: &[f32; 3], edge_m: f64) -> Cell {
    mean.map(|x| (f64::from(x) / edge_m).floor().clamp(-CELL_MAX, CELL_MAX) as i64)
}

/// Groups of cells that touch.
struct Groups {
    /// Group of each cell that holds splats.
    group_of: HashMap<Cell, usize>,
    /// Splats of each group.
    sizes: Vec<usize>,
    largest: usize,
}

impl Groups {
    fn new(cells: &[Cell]) -> Self {
        let mut splats_in: HashMap<Cell, usize> = HashMap::new();
        for cell in cells {
            *splats_in.entry(*cell).or_default() += 1;
        }
        let mut group_of: HashMap<Cell, usize> = HashMap::with_capacity(splats_in.len());
        let (mut sizes, mut open) = (Vec::new(), Vec::new());
        for first in cells {
            if group_of.contains_key(first) {
                continue;
            }
            let (group, mut size) = (sizes.len(), 0);
            group_of.insert(*first, group);
            open.push(*first);
            while let Some(cell) = open.pop() {
                size += splats_in[&cell];
                for step in 0..27_i64 {
                    let aside = [step % 3 - 1, step / 3 % 3 - 1, step / 9 - 1];
                    let next: Cell = std::array::from_fn(|axis| cell[axis] + aside[axis]);
                    if splats_in.contains_key(&next) && !group_of.contains_key(&next) {
                        group_of.insert(next, group);
                        open.push(next);
                    }
                }
            }
            sizes.push(size);
        }
        let largest = (0..sizes.len()).max_by_key(|&group| (sizes[group], usize::MAX - group));
        Self {
            group_of,
            sizes,
            largest: largest.unwrap_or(0),
        }
    }

    /// Splats of the group of a cell that holds some, and whether it is the largest group.
    fn size_of(&self, cell: &Cell) -> (usize, bool) {
        let group = self.group_of[cell];
        (self.sizes[group], group == self.largest)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A solid cube of 20 splats a side, an edge of 2 m, and `strays` beside it.
    fn cube(strays: &[[f32; 3]]) -> SplatCloud {
        let at = |i: usize| i as f32 * 0.1;
        let solid = (0..8000).map(|i| [at(i % 20), at(i / 20 % 20), at(i / 400)]);
        let means: Vec<[f32; 3]> = solid.chain(strays.iter().copied()).collect();
        let count = means.len();
        SplatCloud {
            means,
            scales: vec![[0.1; 3]; count],
            rotations: vec![[1.0, 0.0, 0.0, 0.0]; count],
            opacities: vec![0.9; count],
            sh_degree: 0,
            sh_dc: vec![[0.0; 3]; count],
            sh_rest: vec![],
        }
    }

    #[test]
    fn small_groups_far_from_the_rest_float() {
        let cloud = cube(&[
            [9.0; 3],
            [9.1; 3],
            [-50.0, 0.0, 1e30],
            [2.1, 1.0, 1.0],
            [f32::NAN; 3],
        ]);
        let marks = cloud.floaters(0.001);
        assert!(marks[..8000].iter().all(|floats| !floats));
        // The last but one lies against the cube.
        assert_eq!(marks[8000..], [true, true, true, false, true]);
        // A share of nothing leaves all that lie somewhere.
        assert_eq!(
            cloud.floaters(0.0).iter().filter(|floats| **floats).count(),
            1
        );
        // The largest group stays, whatever the share.
        assert!(!cloud.floaters(1.0)[0]);
    }

    #[test]
    fn clouds_of_nothing_one_and_one_place_do_not_float() {
        assert!(SplatCloud::default().floaters(0.001).is_empty());
        let mut cloud = cube(&[]);
        cloud.means.fill([1.0, 2.0, 3.0]);
        assert!(cloud.floaters(0.5).iter().all(|floats| !floats));
        let one = cube(&[]).select(&[5]);
        assert_eq!(one.floaters(1.0), [false]);
    }
}
