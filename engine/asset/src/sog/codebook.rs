//! A codebook of 256 numbers for many.

use super::meta::CODES;

/// Rounds of moving each entry to the mean of what is nearest to it.
const ROUNDS: usize = 12;
/// Largest number of values that are examined; of more, an even sample.
const SAMPLES_MAX: usize = 1 << 20;

/// Rising numbers, at most 256, near to `values`: themselves if they are so few.
pub(super) fn fit(values: impl ExactSizeIterator<Item = f32>) -> Vec<f32> {
    let every = values.len().div_ceil(SAMPLES_MAX).max(1);
    let mut sorted: Vec<f32> = values.step_by(every).collect();
    sorted.sort_unstable_by(f32::total_cmp);
    let mut distinct = sorted.clone();
    distinct.dedup();
    if distinct.len() <= CODES {
        // One entry at least: a codebook of none says nothing of splats that come later.
        return if distinct.is_empty() {
            vec![0.0]
        } else {
            distinct
        };
    }
    let mut sums = Vec::with_capacity(sorted.len() + 1);
    sums.push(0.0);
    for &value in &sorted {
        sums.push(sums[sums.len() - 1] + f64::from(value));
    }
    let mut codebook = start(&sorted);
    for _ in 0..ROUNDS {
        let mut first = 0;
        for entry in 0..codebook.len() {
            let last = match codebook.get(entry + 1) {
                Some(next) => {
                    let border = 0.5 * (codebook[entry] + next);
                    sorted.partition_point(|&value| value < border)
                }
                None => sorted.len(),
            };
            if last > first {
                codebook[entry] = ((sums[last] - sums[first]) / (last - first) as f64) as f32;
            }
            first = first.max(last);
        }
        codebook.sort_unstable_by(f32::total_cmp);
    }
    codebook
}

/// Half of the entries where values are many, half evenly over their range, so that rare ones are
/// not far from any.
fn start(sorted: &[f32]) -> Vec<f32> {
    let half = CODES / 2;
    let last = sorted.len() - 1;
    let crowded = (0..half).map(|i| sorted[last * i / (half - 1)]);
    let (min, max) = (sorted[0], sorted[last]);
    let even = (0..half).map(|i| min + (max - min) * (i as f32 + 0.5) / half as f32);
    let mut codebook: Vec<f32> = crowded.chain(even).collect();
    codebook.sort_unstable_by(f32::total_cmp);
    codebook
}

/// The index of the entry of a rising `codebook` that is nearest to `value`.
pub(super) fn nearest(codebook: &[f32], value: f32) -> u8 {
    let above = codebook
        .partition_point(|&entry| entry < value)
        .min(codebook.len() - 1);
    let below = above.saturating_sub(1);
    let index = if (value - codebook[below]).abs() <= (codebook[above] - value).abs() {
        below
    } else {
        above
    };
    index as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_numbers_are_kept_and_many_are_near_to_an_entry() {
        assert_eq!(fit([3.0, 1.0, 3.0].into_iter()), [1.0, 3.0]);
        assert_eq!(
            fit(std::iter::empty::<f32>().collect::<Vec<_>>().into_iter()),
            [0.0]
        );
        let many: Vec<f32> = (0..20_000)
            .map(|i| (i as f32 * 0.001).sin() * 4.0)
            .collect();
        let codebook = fit(many.iter().copied());
        assert!(codebook.len() == CODES && codebook.is_sorted());
        let worst = many
            .iter()
            .map(|&x| (codebook[usize::from(nearest(&codebook, x))] - x).abs())
            .fold(0.0, f32::max);
        // 8 over 256, and half of the entries wherever they are wanted.
        assert!(worst < 8.0 / 128.0, "{worst}");
    }

    #[test]
    fn the_nearest_entry_is_found_at_and_beyond_the_ends() {
        let codebook = [-1.0, 0.0, 4.0];
        assert_eq!(
            [-9.0, -0.6, -0.4, 1.9, 2.1, 9.0].map(|x| nearest(&codebook, x)),
            [0, 0, 1, 1, 2, 2]
        );
    }
}
