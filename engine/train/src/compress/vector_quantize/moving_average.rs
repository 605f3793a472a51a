//! Moving averages of what each entry stands for.

use super::codebook::{Nearest, Vectors};

/// Share of the past that an iteration keeps.
const DECAY: f64 = 0.99;

/// Laplace's smoothing of the counts, as a share of the mean count: keeps entries of few vectors
/// from dividing by nothing.
const SMOOTHING: f64 = 1e-5;

/// An entry is dead when its count is below this share of the mean count.
const DEAD_SHARE: f64 = 0.1;

/// The sum of some vectors by weight.
#[derive(Clone, Debug)]
pub(super) struct WeightedSum {
    pub values: Vec<f64>,
    pub weight: f64,
}

/// The sums of the vectors nearest to each of `entries` entries, made in the order of the vectors.
pub(super) fn sums(
    vectors: Vectors<'_>,
    weights: &[f32],
    nearest: &[Nearest],
    entries: usize,
) -> Vec<WeightedSum> {
    let mut sums = vec![
        WeightedSum {
            values: vec![0.0; vectors.dimension],
            weight: 0.0
        };
        entries
    ];
    for (index, (nearest, &weight)) in nearest.iter().zip(weights).enumerate() {
        let sum = &mut sums[nearest.entry];
        sum.weight += f64::from(weight);
        for (total, &value) in sum.values.iter_mut().zip(vectors.get(index)) {
            *total += f64::from(weight) * f64::from(value);
        }
    }
    sums
}

/// Counts N and sums m of every entry.
pub(super) struct MovingAverage {
    sums: Vec<WeightedSum>,
    /// True if a batch has been followed: until then counts are of no unit.
    begun: bool,
}

impl MovingAverage {
    /// Starts as if every entry stood for the same weight of vectors equal to it.
    pub(super) fn new(entries: &[f32], dimension: usize) -> Self {
        let sum = |entry: &[f32]| WeightedSum {
            values: entry.iter().map(|&value| f64::from(value)).collect(),
            weight: 1.0,
        };
        Self {
            sums: entries.chunks_exact(dimension).map(sum).collect(),
            begun: false,
        }
    }

    /// Follows one batch.
    pub(super) fn follow(&mut self, batch: Vectors<'_>, weights: &[f32], nearest: &[Nearest]) {
        let found = sums(batch, weights, nearest, self.sums.len());
        if !self.begun {
            // Counts in the unit of the batches' weights.
            let mean = found.iter().map(|sum| sum.weight).sum::<f64>() / found.len() as f64;
            self.sums.iter_mut().for_each(|sum| scale(sum, mean));
            self.begun = true;
        }
        for (sum, found) in self.sums.iter_mut().zip(&found) {
            sum.weight = DECAY * sum.weight + (1.0 - DECAY) * found.weight;
            for (value, found) in sum.values.iter_mut().zip(&found.values) {
                *value = DECAY * *value + (1.0 - DECAY) * found;
            }
        }
    }

    fn mean_weight(&self) -> f64 {
        self.sums.iter().map(|sum| sum.weight).sum::<f64>() / self.sums.len() as f64
    }

    /// Entries that next to nothing uses.
    pub(super) fn dead(&self) -> Vec<usize> {
        let least = DEAD_SHARE * self.mean_weight();
        (0..self.sums.len())
            .filter(|&entry| self.sums[entry].weight < least)
            .collect()
    }

    /// Lets an entry stand for `vector` with a mean count.
    pub(super) fn begin_again(&mut self, entry: usize, vector: &[f32]) {
        let weight = self.mean_weight();
        self.sums[entry] = WeightedSum {
            values: vector
                .iter()
                .map(|&value| f64::from(value) * weight)
                .collect(),
            weight,
        };
    }

    /// Writes m / N, N smoothed: `(N + e) / (sum N + K e) * sum N` for K entries.
    pub(super) fn write_entries(&self, entries: &mut [f32]) {
        let mean = self.mean_weight();
        if mean <= 0.0 {
            return;
        }
        let dimension = entries.len() / self.sums.len();
        for (entry, sum) in entries.chunks_exact_mut(dimension).zip(&self.sums) {
            let smoothed = (sum.weight + SMOOTHING * mean) / (1.0 + SMOOTHING);
            entry
                .iter_mut()
                .zip(&sum.values)
                .for_each(|(value, sum)| *value = (sum / smoothed) as f32);
        }
    }
}

fn scale(sum: &mut WeightedSum, factor: f64) {
    sum.weight *= factor;
    sum.values.iter_mut().for_each(|value| *value *= factor);
}
