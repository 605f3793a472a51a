//! A sequence of random numbers: all of them follow from its seed, and none is drawn by a thread of
//! its own.

use super::{GOLDEN, next};

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

impl Random {
    /// The sequence of `seed`.
    pub fn new(seed: u64) -> Self {
        Self {
            state: seed.wrapping_mul(GOLDEN) ^ 0x5bf0_3635,
        }
    }

    fn bits(&mut self) -> u64 {
        next(&mut self.state)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / 9_007_199_254_740_992.0
    }

    /// Uniform in 0 to `count` - 1, which must not be empty.
    pub fn index(&mut self, count: usize) -> usize {
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// `picked` distinct numbers below `count` in increasing order, all of them when there are no
    /// more (Knuth, The Art of Computer Programming 2, algorithm S).
    pub fn subset(&mut self, count: usize, picked: usize) -> Vec<usize> {
        let mut wanted = picked.min(count);
        let mut subset = Vec::with_capacity(wanted);
        for index in 0..count {
            if self.unit() * ((count - index) as f64) < wanted as f64 {
                subset.push(index);
                wanted -= 1;
            }
        }
        subset
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_subset_is_distinct_and_complete() {
        let mut random = Random::new(3);
        for (count, picked) in [(10, 4), (5, 9), (1, 1), (0, 3), (1000, 999)] {
            let subset = random.subset(count, picked);
            assert_eq!(subset.len(), picked.min(count));
            assert!(
                subset.windows(2).all(|pair| pair[0] < pair[1])
                    && subset.iter().all(|&index| index < count)
            );
        }
    }

    #[test]
    fn numbers_fill_their_range_and_follow_from_the_seed() {
        let mut random = Random::new(7);
        let mut bins = [0; 10];
        (0..10_000).for_each(|_| bins[random.index(10)] += 1);
        assert!(
            bins.iter().all(|&count| (850..1150).contains(&count)),
            "{bins:?}"
        );
        let mean = (0..10_000).map(|_| random.unit()).sum::<f64>() / 1e4;
        assert!((mean - 0.5).abs() < 0.02);
        assert_eq!(Random::new(5).unit(), Random::new(5).unit());
        assert_ne!(Random::new(5).unit(), Random::new(6).unit());
    }
}
