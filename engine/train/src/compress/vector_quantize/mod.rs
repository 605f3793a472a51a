//! Codebooks: the entries that stand best for many vectors.
//!
//! Entries begin by k-means++, then follow moving averages over mini-batches as in van den Oord et
//! al., Neural Discrete Representation Learning, 2017, appendix A.1: `N <- g N + (1 - g) n`, `m <-
//! g m + (1 - g) sum x`, entry `m / N` with N smoothed after Laplace. Entries that nothing uses
//! begin again by k-means++ over a random subset. A few iterations of Lloyd's algorithm over all
//! vectors finish the book. The same seed gives the same bits on any number of threads: distances
//! are found in parallel, sums are made in order.

mod codebook;
mod moving_average;
mod seeding;
#[cfg(test)]
mod tests;

pub use codebook::{Nearest, SearchBook, Vectors};

use decouplegs_scene::random::Random;
use moving_average::MovingAverage;

/// Vectors among which entries begin: more find no better beginning, only a slower one.
const SEEDING_VECTORS: usize = 16_384;

/// Vectors of a mini-batch: two for each entry of the largest book.
const BATCH_VECTORS: usize = 2048;

/// Iterations over which distortion is averaged to see whether it stands still: one batch says
/// little.
const WINDOW_ITERATIONS: usize = 25;

/// Distortion stands still when a window is not better than the best before it by this share.
const IMPROVEMENT_MIN: f64 = 5e-3;

/// Windows without improvement after which the batches end.
const PATIENCE_WINDOWS: usize = 2;

/// Training options of a codebook.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QuantizeOptions {
    /// Most entries, 1 to 65,536.
    pub entries: usize,
    /// Most mini-batches.
    pub iterations_max: usize,
    /// Most iterations over all vectors after them.
    pub final_iterations_max: usize,
    /// Seed of all randomness.
    pub seed: u64,
}

/// Vectors by the entries of a book.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantized {
    /// `[entry][component]`.
    pub entries: Vec<f32>,
    /// The entry nearest to each vector.
    pub assignment: Vec<u16>,
    /// Weighted mean squared distance of the vectors to their entries, by iteration: of the
    /// batches, then of all vectors.
    pub distortion: Vec<f64>,
    /// Number of values of [`Quantized::distortion`] that are of batches.
    pub batches: usize,
    /// Entries that began again because nothing used them.
    pub reseeded: usize,
}

/// The book of `vectors` that count by `weights` (finite, not negative, not all zero), one each.
///
/// There are fewer entries than asked for when there are fewer different vectors. `progress` is
/// told the iterations done.
///
/// # Panics
/// Panics if there is no vector, or as many weights as vectors are not given.
pub fn vector_quantize(
    vectors: Vectors<'_>,
    weights: &[f32],
    options: &QuantizeOptions,
    progress: &(dyn Fn(usize) + Sync),
) -> Quantized {
    assert!(
        !vectors.is_empty() && vectors.len() == weights.len(),
        "{} weights for {} vectors",
        weights.len(),
        vectors.len()
    );
    let mut random = Random::new(options.seed);
    let candidates = random.subset(vectors.len(), SEEDING_VECTORS);
    let mut seeds = seeding::draw(
        vectors,
        weights,
        &candidates,
        None,
        options.entries,
        &mut random,
    );
    if seeds.is_empty() {
        seeds.push(candidates[0]);
    }
    let mut state = Training {
        vectors,
        weights,
        entries: seeds
            .iter()
            .flat_map(|&seed| vectors.get(seed))
            .copied()
            .collect(),
        distortion: Vec::new(),
        reseeded: 0,
        random,
    };
    // With an entry for every different vector there is nothing to learn.
    if seeds.len() == options.entries {
        state.follow_batches(options.iterations_max, progress);
    }
    let batches = state.distortion.len();
    let assignment = state.finish(options.final_iterations_max, progress);
    let Training {
        entries,
        distortion,
        reseeded,
        ..
    } = state;
    Quantized {
        entries,
        assignment,
        distortion,
        batches,
        reseeded,
    }
}

/// A book being made.
struct Training<'a> {
    vectors: Vectors<'a>,
    weights: &'a [f32],
    entries: Vec<f32>,
    distortion: Vec<f64>,
    reseeded: usize,
    random: Random,
}

impl Training<'_> {
    fn book(&self) -> SearchBook {
        SearchBook::new(Vectors {
            values: &self.entries,
            dimension: self.vectors.dimension,
        })
    }

    /// Mini-batches until the distortion stands still.
    fn follow_batches(&mut self, iterations_max: usize, progress: &(dyn Fn(usize) + Sync)) {
        let dimension = self.vectors.dimension;
        let batch_vectors = BATCH_VECTORS.min(self.vectors.len());
        let mut average = MovingAverage::new(&self.entries, dimension);
        let mut stillness = Stillness::default();
        for iteration in 0..iterations_max {
            let batch: Vec<usize> = (0..batch_vectors)
                .map(|_| self.random.index(self.vectors.len()))
                .collect();
            let values: Vec<f32> = batch
                .iter()
                .flat_map(|&index| self.vectors.get(index))
                .copied()
                .collect();
            let weights: Vec<f32> = batch.iter().map(|&index| self.weights[index]).collect();
            let nearest = self.book().nearest_of_all(Vectors {
                values: &values,
                dimension,
            });
            self.distortion.push(mean_square(&nearest, &weights));
            average.follow(
                Vectors {
                    values: &values,
                    dimension,
                },
                &weights,
                &nearest,
            );
            average.write_entries(&mut self.entries);
            if (iteration + 1).is_multiple_of(WINDOW_ITERATIONS) {
                self.revive(&mut average);
                if stillness.reached(&self.distortion[iteration + 1 - WINDOW_ITERATIONS..]) {
                    break;
                }
            }
            progress(self.distortion.len());
        }
    }

    /// Lets entries that nothing uses begin again.
    fn revive(&mut self, average: &mut MovingAverage) {
        let dead = average.dead();
        if dead.is_empty() {
            return;
        }
        let candidates = self.random.subset(self.vectors.len(), SEEDING_VECTORS / 4);
        let book = self.book();
        let seeds = seeding::draw(
            self.vectors,
            self.weights,
            &candidates,
            Some(&book),
            dead.len(),
            &mut self.random,
        );
        for (&entry, &seed) in dead.iter().zip(&seeds) {
            average.begin_again(entry, self.vectors.get(seed));
        }
        average.write_entries(&mut self.entries);
        self.reseeded += dead.len().min(seeds.len());
    }

    /// Lloyd's algorithm over all vectors, then the entry of each.
    fn finish(&mut self, iterations_max: usize, progress: &(dyn Fn(usize) + Sync)) -> Vec<u16> {
        let mut nearest = self.book().nearest_of_all(self.vectors);
        for _ in 0..iterations_max {
            self.distortion.push(mean_square(&nearest, self.weights));
            let before = self.entries.clone();
            self.move_to_means(&nearest);
            nearest = self.book().nearest_of_all(self.vectors);
            progress(self.distortion.len());
            if before == self.entries {
                break;
            }
        }
        self.distortion.push(mean_square(&nearest, self.weights));
        nearest.iter().map(|nearest| nearest.entry as u16).collect()
    }

    /// Each entry to the weighted mean of the vectors nearest to it; one that has none, to the
    /// worst represented vector left.
    fn move_to_means(&mut self, nearest: &[Nearest]) {
        let dimension = self.vectors.dimension;
        let sums = moving_average::sums(
            self.vectors,
            self.weights,
            nearest,
            self.entries.len() / dimension,
        );
        let mut by_error: Vec<usize> = Vec::new();
        for (entry, sum) in sums.iter().enumerate() {
            let values = &mut self.entries[entry * dimension..(entry + 1) * dimension];
            if sum.weight > 0.0 {
                values
                    .iter_mut()
                    .zip(&sum.values)
                    .for_each(|(value, sum_value)| *value = (sum_value / sum.weight) as f32);
                continue;
            }
            if by_error.is_empty() {
                let error = |index: usize| {
                    f64::from(nearest[index].square) * f64::from(self.weights[index])
                };
                by_error = (0..nearest.len())
                    .filter(|&index| error(index) > 0.0)
                    .collect();
                by_error.sort_by(|&a, &b| error(a).total_cmp(&error(b)).then(b.cmp(&a)));
            }
            if let Some(worst) = by_error.pop() {
                values.copy_from_slice(self.vectors.get(worst));
                self.reseeded += 1;
            }
        }
    }
}

/// Weighted mean of the squared distances.
fn mean_square(nearest: &[Nearest], weights: &[f32]) -> f64 {
    let (mut sum, mut weight_sum) = (0.0, 0.0);
    for (nearest, &weight) in nearest.iter().zip(weights) {
        sum += f64::from(nearest.square) * f64::from(weight);
        weight_sum += f64::from(weight);
    }
    if weight_sum > 0.0 {
        sum / weight_sum
    } else {
        0.0
    }
}

/// Stopping criterion: distortion no longer falls.
#[derive(Default)]
struct Stillness {
    best: Option<f64>,
    windows: usize,
}

impl Stillness {
    /// Takes the distortions of one window; whether enough of them in a row brought nothing.
    fn reached(&mut self, window: &[f64]) -> bool {
        let mean = window.iter().sum::<f64>() / window.len() as f64;
        match self.best {
            Some(best) if mean > best * (1.0 - IMPROVEMENT_MIN) => self.windows += 1,
            _ => self.windows = 0,
        }
        self.best = Some(self.best.map_or(mean, |best| best.min(mean)));
        self.windows >= PATIENCE_WINDOWS
    }
}
