//! Entries laid out for the search of the nearest.

use rayon::prelude::*;

/// Entries compared side by side: four registers of four lanes, which every 64-bit processor has.
const LANES: usize = 16;

/// Components between two looks at whether a block can still hold the nearest entry.
const STRETCH: usize = 12;

/// Vectors that one task searches for.
const TASK_VECTORS: usize = 256;

/// Vectors of one dimension, one after the other.
#[derive(Clone, Copy, Debug)]
pub struct Vectors<'a> {
    /// `[vector][component]`.
    pub values: &'a [f32],
    /// Components of each, at least 1.
    pub dimension: usize,
}

impl<'a> Vectors<'a> {
    /// Number of entries.
    #[must_use]
    pub fn len(&self) -> usize {
        self.values.len() / self.dimension
    }

    /// True if there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.values.is_empty()
    }

    /// One of them.
    #[must_use]
    pub fn get(&self, index: usize) -> &'a [f32] {
        &self.values[index * self.dimension..(index + 1) * self.dimension]
    }
}

/// The nearest entry to a vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Index of the entry; the first of equals.
    pub entry: usize,
    /// Squared distance to it.
    pub square: f32,
}

/// Entries in the order of one component, in blocks of 16: one component of a difference,
/// squared, is a lower bound of the squared distance, so the search begins at the block around the
/// vector and ends where the next block is too far.
pub struct SearchBook {
    /// Components `[block][component][lane]`, the last block filled up with infinities.
    rows: Vec<[f32; LANES]>,
    blocks: Vec<Block>,
    dimension: usize,
    /// Component that orders the entries: the one of the largest variance.
    key: usize,
}

struct Block {
    /// Index of the entry in each lane.
    entries: [u32; LANES],
    /// Least and largest key.
    keys: [f32; 2],
}

/// The component of the largest variance.
fn widest_component(entries: Vectors<'_>) -> usize {
    let variance = |component: usize| {
        let values = (0..entries.len()).map(|entry| f64::from(entries.get(entry)[component]));
        let count = entries.len() as f64;
        let mean = values.clone().sum::<f64>() / count;
        values.map(|value| (value - mean).powi(2)).sum::<f64>()
    };
    (0..entries.dimension)
        .map(|component| (variance(component), component))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map_or(0, |(_, component)| component)
}

impl SearchBook {
    /// The book of `entries`, at least one.
    #[must_use]
    pub fn new(entries: Vectors<'_>) -> Self {
        let dimension = entries.dimension;
        let key = widest_component(entries);
        let mut order: Vec<u32> = (0..entries.len() as u32).collect();
        let key_of = |entry: u32| entries.get(entry as usize)[key];
        order.sort_by(|&a, &b| key_of(a).total_cmp(&key_of(b)));
        let mut rows = vec![[f32::INFINITY; LANES]; order.len().div_ceil(LANES) * dimension];
        let mut blocks = Vec::with_capacity(order.len().div_ceil(LANES));
        for (block, members) in order.chunks(LANES).enumerate() {
            let mut indices = [u32::MAX; LANES];
            indices[..members.len()].copy_from_slice(members);
            blocks.push(Block {
                entries: indices,
                keys: [members[0], members[members.len() - 1]].map(key_of),
            });
            for (lane, &entry) in members.iter().enumerate() {
                for (component, &value) in entries.get(entry as usize).iter().enumerate() {
                    rows[block * dimension + component][lane] = value;
                }
            }
        }
        Self {
            rows,
            blocks,
            dimension,
            key,
        }
    }

    /// The nearest entry to `vector` in L2. Differences are squared as they are: `|x|^2 - 2xy +
    /// |y|^2` would cancel.
    #[must_use]
    #[inline(always)]
    pub fn nearest(&self, vector: &[f32]) -> Nearest {
        let key = vector[self.key];
        let mut best = Nearest {
            entry: 0,
            square: f32::INFINITY,
        };
        // Blocks from `low` to before `high` are done.
        let mut low = self.blocks.partition_point(|block| block.keys[1] < key);
        let mut high = low;
        loop {
            let below = low
                .checked_sub(1)
                .map(|block| key - self.blocks[block].keys[1]);
            let above = self.blocks.get(high).map(|block| block.keys[0] - key);
            let (gap, block) = match (below, above) {
                (Some(below), Some(above)) if below < above => (below, low - 1),
                (_, Some(above)) => (above, high),
                (Some(below), None) => (below, low - 1),
                (None, None) => break,
            };
            // A gap below zero: the key lies within the block.
            if gap > 0.0 && gap * gap > best.square {
                break;
            }
            match block < low {
                true => low = block,
                false => high = block + 1,
            }
            self.search_block(block, vector, &mut best);
        }
        best
    }

    /// Takes an entry of `block` as the best that is nearer, or as near and before it.
    #[inline(always)]
    fn search_block(&self, block: usize, vector: &[f32], best: &mut Nearest) {
        let rows = &self.rows[block * self.dimension..(block + 1) * self.dimension];
        let mut squares = [0.0f32; LANES];
        for (rows, values) in rows.chunks(STRETCH).zip(vector.chunks(STRETCH)) {
            for (row, &value) in rows.iter().zip(values) {
                for (square, entry) in squares.iter_mut().zip(row) {
                    let difference = value - entry;
                    *square += difference * difference;
                }
            }
            // Sums only grow: a block in which all are beyond the best has nothing to say any more.
            if squares.iter().all(|&square| square > best.square) {
                return;
            }
        }
        for (&square, &entry) in squares.iter().zip(&self.blocks[block].entries) {
            let entry = entry as usize;
            if square < best.square || (square == best.square && entry < best.entry) {
                *best = Nearest { entry, square };
            }
        }
    }

    /// The nearest entries to all `vectors`.
    #[must_use]
    pub fn nearest_of_all(&self, vectors: Vectors<'_>) -> Vec<Nearest> {
        // Wider registers where the processor has them: the sums are the same.
        let arch = pulp::Arch::new();
        let mut nearest = vec![
            Nearest {
                entry: 0,
                square: f32::INFINITY,
            };
            vectors.len()
        ];
        nearest
            .par_chunks_mut(TASK_VECTORS)
            .zip(vectors.values.par_chunks(TASK_VECTORS * self.dimension))
            .for_each(|(nearest, values)| {
                arch.dispatch(|| {
                    let vectors = values.chunks_exact(self.dimension);
                    for (nearest, vector) in nearest.iter_mut().zip(vectors) {
                        *nearest = self.nearest(vector);
                    }
                });
            });
        nearest
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_search_finds_what_trying_all_finds(
            dimension in 1usize..9, values in prop::collection::vec(-4i8..4, 9..400), query in prop::collection::vec(-4i8..4, 9),
        ) {
            let entries: Vec<f32> = values[..values.len() / dimension * dimension].iter().map(|&v| f32::from(v)).collect();
            let entries = Vectors { values: &entries, dimension };
            let query: Vec<f32> = query[..dimension].iter().map(|&v| f32::from(v)).collect();
            let square = |entry: usize| entries.get(entry).iter().zip(&query).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
            // Whole numbers: sums are exact in any order, and ties are real.
            let expected = (0..entries.len()).min_by(|&a, &b| square(a).total_cmp(&square(b))).unwrap();
            let found = SearchBook::new(entries).nearest(&query);
            prop_assert_eq!(found, Nearest { entry: expected, square: square(expected) });
        }
    }
}
