//! Initialization of codebook entries by k-means++ (Arthur and Vassilvitskii, 2007).

use rayon::prelude::*;

use super::codebook::{SearchBook, Vectors};
use decouplegs_scene::random::Random;

/// Vectors that one task compares with a new entry.
const TASK_VECTORS: usize = 1024;

/// Up to `count` of `candidates` (indices into `vectors`), each drawn with a probability in
/// proportion to its weight times its squared distance to what was drawn before, or to `known`
/// entries where there are some.
///
/// Fewer are drawn when no other candidate differs from those.
pub(super) fn draw(
    vectors: Vectors<'_>,
    weights: &[f32],
    candidates: &[usize],
    known: Option<&SearchBook>,
    count: usize,
    random: &mut Random,
) -> Vec<usize> {
    let mut drawn = Vec::new();
    let mut squares: Vec<f32> = match known {
        Some(book) => candidates
            .par_iter()
            .map(|&index| book.nearest(vectors.get(index)).square)
            .collect(),
        None => vec![1.0; candidates.len()],
    };
    while drawn.len() < count {
        let Some(next) = pick(&squares, candidates, weights, random) else {
            break;
        };
        let entry = vectors.get(candidates[next]);
        // The first entry of all is drawn by weight alone; from then on distances count.
        let first = known.is_none() && drawn.is_empty();
        drawn.push(candidates[next]);
        squares
            .par_chunks_mut(TASK_VECTORS)
            .zip(candidates.par_chunks(TASK_VECTORS))
            .for_each(|(squares, candidates)| {
                for (square, &index) in squares.iter_mut().zip(candidates) {
                    let distance = vectors
                        .get(index)
                        .iter()
                        .zip(entry)
                        .map(|(a, b)| (a - b) * (a - b))
                        .sum::<f32>();
                    *square = if first {
                        distance
                    } else {
                        square.min(distance)
                    };
                }
            });
    }
    drawn
}

/// An index drawn in proportion to weight times square, or `None` where all of these are zero.
fn pick(
    squares: &[f32],
    candidates: &[usize],
    weights: &[f32],
    random: &mut Random,
) -> Option<usize> {
    let share = |index: usize| f64::from(squares[index]) * f64::from(weights[candidates[index]]);
    let total: f64 = (0..squares.len()).map(share).sum();
    if total <= 0.0 || !total.is_finite() {
        return None;
    }
    let mut left = random.unit() * total;
    let mut last = None;
    for index in 0..squares.len() {
        if share(index) > 0.0 {
            last = Some(index);
            left -= share(index);
            if left < 0.0 {
                break;
            }
        }
    }
    last
}
