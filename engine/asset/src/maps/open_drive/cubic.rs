//! Cubic polynomials of the way along a road, each from a position on: widths, heights, offsets.

use crate::DecodeError;
use crate::xml::Element;

/// `a + b d + c d² + d d³` of the way `d` from where it starts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Cubic {
    /// Start along the road, meters.
    pub(super) start_m: f64,
    /// Factors from the constant up.
    pub(super) factors: [f64; 4],
}

impl Cubic {
    /// The attributes a, b, c and d of `element` from `start_m` on.
    pub(super) fn read(element: Element, start_m: f64) -> Result<Self, DecodeError> {
        let factor = |name| element.number_or(name, 0.0);
        Ok(Self {
            start_m,
            factors: [factor("a")?, factor("b")?, factor("c")?, factor("d")?],
        })
    }

    /// Value at `s_m` along the road.
    pub(super) fn at(&self, s_m: f64) -> f64 {
        value(&self.factors, s_m - self.start_m)
    }
}

/// A polynomial, its factors from the constant up.
pub(super) fn value(factors: &[f64; 4], at: f64) -> f64 {
    factors
        .iter()
        .rev()
        .fold(0.0, |sum, factor| sum * at + factor)
}

/// The derivative of a polynomial.
pub(super) fn slope(factors: &[f64; 4], at: f64) -> f64 {
    factors[1] + at * (2.0 * factors[2] + at * 3.0 * factors[3])
}

/// Polynomials one behind the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Profile(Vec<Cubic>);

impl Profile {
    pub(super) fn new(mut cubics: Vec<Cubic>) -> Self {
        cubics.sort_by(|a, b| a.start_m.total_cmp(&b.start_m));
        Self(cubics)
    }

    /// The elements `name` in `parent`, their starts in the attribute `start`, counted from
    /// `from_m` along the road.
    pub(super) fn read(
        parent: Option<Element>,
        name: &str,
        start: &str,
        from_m: f64,
    ) -> Result<Self, DecodeError> {
        let elements = parent.into_iter().flat_map(|parent| parent.all(name));
        let cubics =
            elements.map(|element| Cubic::read(element, from_m + element.number_or(start, 0.0)?));
        cubics.collect::<Result<_, _>>().map(Self::new)
    }

    /// True if its first polynomial starts after `from_m`: before, it is continued backwards.
    pub(super) fn begins_after(&self, from_m: f64) -> bool {
        const ROUNDING_M: f64 = 0.01;
        self.0
            .first()
            .is_some_and(|first| first.start_m > from_m + ROUNDING_M)
    }

    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The polynomial that holds at `s_m`: the last to start there or before, else the first; zero
    /// where there is none.
    pub(super) fn piece(&self, s_m: f64) -> Cubic {
        let after = self.0.partition_point(|cubic| cubic.start_m <= s_m);
        self.0
            .get(after.saturating_sub(1))
            .copied()
            .unwrap_or_default()
    }

    /// Starts of polynomials between two positions.
    pub(super) fn starts_within(&self, from_m: f64, to_m: f64) -> impl Iterator<Item = f64> {
        let first = self.0.partition_point(|cubic| cubic.start_m <= from_m);
        self.0[first..]
            .iter()
            .map(|cubic| cubic.start_m)
            .take_while(move |start_m| *start_m < to_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_piece_that_started_holds() {
        let cubic = |start_m, a| Cubic {
            start_m,
            factors: [a, 1.0, 0.5, 0.25],
        };
        let profile = Profile::new(vec![cubic(10.0, 7.0), cubic(0.0, 3.0)]);
        assert_eq!(profile.piece(2.0).at(2.0), 3.0 + 2.0 + 2.0 + 2.0);
        assert_eq!(profile.piece(10.0).at(10.0), 7.0);
        assert_eq!(profile.piece(-1.0), cubic(0.0, 3.0));
        assert_eq!(profile.starts_within(0.0, 20.0).collect::<Vec<_>>(), [10.0]);
        assert_eq!(profile.starts_within(0.0, 10.0).count(), 0);
        assert!(!profile.begins_after(0.0) && profile.begins_after(-1.0));
        assert_eq!(Profile::default().piece(3.0).at(3.0), 0.0);
        assert_eq!(slope(&[9.0, 1.0, 0.5, 0.25], 2.0), 1.0 + 2.0 + 3.0);
    }
}
