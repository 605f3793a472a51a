//! Times at which an agent is in a scene.

use crate::Invalid;

/// Intervals of time, seconds: rising, apart from each other, both ends included. None of them
/// stands for all times.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Presence {
    intervals_s: Vec<[f64; 2]>,
}

impl Presence {
    /// All times.
    pub const ALWAYS: Self = Self {
        intervals_s: Vec::new(),
    };

    /// The times in `intervals_s`, pairs of a first and a last moment.
    ///
    /// # Errors
    /// Returns an error if a moment is not finite, an interval ends before it begins, or does not
    /// begin after the end of the one before.
    pub fn new(intervals_s: Vec<[f64; 2]>) -> Result<Self, Invalid> {
        let mut before_s = f64::NEG_INFINITY;
        for (index, &[first_s, last_s]) in intervals_s.iter().enumerate() {
            if !(first_s.is_finite() && last_s.is_finite() && first_s <= last_s) {
                return Err(Invalid::new(format!(
                    "interval {index} is [{first_s}, {last_s}]; expected two finite times in seconds, the first not after the last"
                )));
            }
            if first_s <= before_s {
                return Err(Invalid::new(format!(
                    "interval {index} begins at {first_s} s; expected a time after {before_s} s, where the interval before ends"
                )));
            }
            before_s = last_s;
        }
        Ok(Self { intervals_s })
    }

    /// The intervals, seconds; none for all times.
    #[must_use]
    pub fn intervals_s(&self) -> &[[f64; 2]] {
        &self.intervals_s
    }

    /// True if `time_s` is in one of the intervals. A time that is not a number is in none.
    #[must_use]
    pub fn includes(&self, time_s: f64) -> bool {
        let begun = self
            .intervals_s
            .partition_point(|[first_s, _]| *first_s <= time_s);
        match begun.checked_sub(1) {
            Some(last) => time_s <= self.intervals_s[last][1],
            None => self.intervals_s.is_empty(),
        }
    }

    /// First and last moment of all intervals, seconds; `None` for all times.
    #[must_use]
    pub fn span_s(&self) -> Option<(f64, f64)> {
        let (first, last) = (self.intervals_s.first()?, self.intervals_s.last()?);
        Some((first[0], last[1]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_ends_are_included_and_gaps_are_not() {
        let presence = Presence::new(vec![[1.0, 2.0], [3.0, 3.0], [5.0, 8.0]]).unwrap();
        let at = |time_s| presence.includes(time_s);
        assert!([1.0, 1.5, 2.0, 3.0, 5.0, 8.0].into_iter().all(at));
        assert!(
            ![-1.0, 0.999, 2.001, 2.999, 3.001, 4.0, 8.001, f64::NAN]
                .into_iter()
                .any(at)
        );
        assert_eq!(presence.span_s(), Some((1.0, 8.0)));
        assert!(Presence::ALWAYS.includes(-1e9) && Presence::ALWAYS.span_s().is_none());
    }

    #[test]
    fn intervals_that_make_no_sense_are_refused_with_their_index() {
        for (intervals_s, index) in [
            (vec![[2.0, 1.0]], 0),
            (vec![[0.0, f64::NAN]], 0),
            (vec![[f64::NEG_INFINITY, 0.0]], 0),
            (vec![[0.0, 1.0], [1.0, 2.0]], 1),
            (vec![[4.0, 5.0], [0.0, 1.0]], 1),
        ] {
            let error = Presence::new(intervals_s).unwrap_err();
            let expected = format!("interval {index} ");
            assert!(error.reason().starts_with(&expected), "{error}");
        }
    }
}
