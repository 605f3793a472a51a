//! Random numbers addressed by what they are for: one more draw for one thing changes no other.

use decouplegs_scene::random::{GOLDEN, mix, next, unit};

/// A sequence of random numbers.
#[derive(Clone, Debug)]
pub(super) struct Stream {
    state: u64,
}

impl Stream {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self {
            state: mix(seed.wrapping_add(GOLDEN)),
        }
    }

    /// Child sequence with the number `what`. It depends on where this one began and on
    /// `what` alone if nothing is drawn before.
    pub fn split(&self, what: u64) -> Self {
        Self {
            state: mix(mix(self.state).wrapping_add(what.wrapping_add(1).wrapping_mul(GOLDEN))),
        }
    }

    pub fn bits(&mut self) -> u64 {
        next(&mut self.state)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        unit(self.bits())
    }

    /// Uniform between two numbers.
    pub fn between(&mut self, (low, high): (f64, f64)) -> f64 {
        low + (high - low) * self.unit()
    }

    /// A whole number from `low` to `high`, both among them.
    pub fn whole(&mut self, (low, high): (usize, usize)) -> usize {
        low + (self.unit() * (high - low + 1) as f64) as usize
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }

    /// One of `choices`; none of none.
    pub fn pick<'a, T>(&mut self, choices: &'a [T]) -> Option<&'a T> {
        choices.get((self.unit() * choices.len() as f64) as usize)
    }

    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.whole((0, last)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_filled_and_neighboring_addresses_share_nothing() {
        let mut stream = Stream::new(5);
        let mut counts = [0_u32; 4];
        (0..40_000).for_each(|_| counts[stream.whole((0, 3))] += 1);
        // Five deviations of a binomial with 40,000 draws are 433.
        assert!(
            counts.iter().all(|count| count.abs_diff(10_000) < 433),
            "{counts:?}"
        );
        let first = |stream: Stream| stream.clone().bits();
        let base = Stream::new(5);
        let others = [
            Stream::new(6),
            base.split(0),
            base.split(1),
            base.split(0).split(1),
            base.split(1).split(0),
        ]
        .map(first);
        assert!(
            others
                .iter()
                .enumerate()
                .all(|(at, bits)| *bits != first(base.clone()) && !others[..at].contains(bits))
        );
        assert_eq!(first(base.split(7)), first(Stream::new(5).split(7)));
    }

    #[test]
    fn shuffling_keeps_what_there_is() {
        let mut items: Vec<u32> = (0..100).collect();
        Stream::new(1).shuffle(&mut items);
        assert_ne!(items, (0..100).collect::<Vec<_>>());
        items.sort_unstable();
        assert_eq!(items, (0..100).collect::<Vec<_>>());
        assert_eq!(Stream::new(1).pick::<u32>(&[]), None);
    }
}
