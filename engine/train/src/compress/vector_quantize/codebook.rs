//! Entries laid out for the search of the nearest.

use rayon::prelude::*;

/// Entries compared side by side: four registers of four lanes, which every 64-bit processor has.
const LANES: usize = 16;

/// Components between two looks at whether a block can still hold the nearest entry.
const STRETCH: usize = 12;

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

/// Entries transposed in blocks of [`LANES`]: `[block][component][lane]`, the last block filled up
/// with infinities.
pub struct SearchBook {
    blocks: Vec<[f32; LANES]>,
    dimension: usize,
}

impl SearchBook {
    /// The book of `entries`, at least one.
    #[must_use]
    pub fn new(entries: Vectors<'_>) -> Self {
        let dimension = entries.dimension;
        let mut blocks = vec![[f32::INFINITY; LANES]; entries.len().div_ceil(LANES) * dimension];
        for entry in 0..entries.len() {
            for (component, &value) in entries.get(entry).iter().enumerate() {
                blocks[entry / LANES * dimension + component][entry % LANES] = value;
            }
        }
        Self { blocks, dimension }
    }

    /// The nearest entry to `vector` in L2. Differences are squared as they are: `|x|^2 - 2xy +
    /// |y|^2` would cancel.
    #[must_use]
    pub fn nearest(&self, vector: &[f32]) -> Nearest {
        let mut best = Nearest {
            entry: 0,
            square: f32::INFINITY,
        };
        for (block, rows) in self.blocks.chunks_exact(self.dimension).enumerate() {
            let mut squares = [0.0f32; LANES];
            for (rows, values) in rows.chunks(STRETCH).zip(vector.chunks(STRETCH)) {
                for (row, &value) in rows.iter().zip(values) {
                    for (square, entry) in squares.iter_mut().zip(row) {
                        let difference = value - entry;
                        *square += difference * difference;
                    }
                }
                // Sums only grow: a block in which all are beyond the best has nothing to say any
                // more.
                if squares.iter().all(|&square| square >= best.square) {
                    break;
                }
            }
            for (lane, &square) in squares.iter().enumerate() {
                if square < best.square {
                    best = Nearest {
                        entry: block * LANES + lane,
                        square,
                    };
                }
            }
        }
        best
    }

    /// The nearest entries to all `vectors`.
    #[must_use]
    pub fn nearest_of_all(&self, vectors: Vectors<'_>) -> Vec<Nearest> {
        vectors
            .values
            .par_chunks_exact(self.dimension)
            .map(|vector| self.nearest(vector))
            .collect()
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
