//! Dynamic time warping: which position of a lane each point of a track belongs to, in order.

use std::ops::Range;

/// Steps along the lane within which each point may be matched: the Sakoe-Chiba band.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// For each point the steps that it may be matched to; neither end ever falls.
    ranges: Vec<Range<usize>>,
}

impl Band {
    /// Band within `half` steps of `middles` on a lane of `steps` steps, of which there must be
    /// one.
    ///
    /// Middles that fall are lifted to the one before: a path through the band must exist.
    #[must_use]
    pub fn around(middles: &[f64], half: usize, steps: usize) -> Self {
        let mut last = 0;
        let ranges = middles.iter().map(|middle| {
            let middle = (middle.round().max(0.0) as usize)
                .min(steps.saturating_sub(1))
                .max(last);
            last = middle;
            middle.saturating_sub(half)..middle.saturating_add(half + 1).min(steps)
        });
        Self {
            ranges: ranges.collect(),
        }
    }
}

/// The matches of least summed cost, one step for each point of the track and never falling;
/// `cost(point, step)`.
///
/// The step pattern is the asymmetric one without a limit of slope: every point is matched once and
/// any number of steps may be passed over, so a lane's sampling does not weigh on the result.
/// `None` without points, or where the band holds no step for one.
#[must_use]
pub fn align(band: &Band, cost: impl Fn(usize, usize) -> f64) -> Option<Vec<usize>> {
    let first = band.ranges.first()?;
    if band.ranges.iter().any(Range::is_empty) {
        return None;
    }
    let mut sums: Vec<f64> = first.clone().map(|step| cost(0, step)).collect();
    // For each point and step, where the point before it was matched, counted from the start of
    // that point's range.
    let mut from: Vec<Vec<u32>> = vec![Vec::new()];
    for (point, pair) in band.ranges.windows(2).enumerate() {
        let (before, own) = (&pair[0], &pair[1]);
        let (mut best, mut looked) = (0, 0);
        let (mut next, mut came) = (Vec::with_capacity(own.len()), Vec::with_capacity(own.len()));
        for step in own.clone() {
            while looked < before.len() && before.start + looked <= step {
                if sums[looked] < sums[best] {
                    best = looked;
                }
                looked += 1;
            }
            next.push(sums[best] + cost(point + 1, step));
            came.push(best as u32);
        }
        sums = next;
        from.push(came);
    }
    let mut at = (0..sums.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b]))?;
    let mut matches = vec![0; band.ranges.len()];
    for point in (0..band.ranges.len()).rev() {
        matches[point] = band.ranges[point].start + at;
        if point > 0 {
            at = from[point][at] as usize;
        }
    }
    Some(matches)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The least cost of every match that never falls, by trying all.
    fn least(costs: &[Vec<f64>], point: usize, from: usize) -> f64 {
        let Some(row) = costs.get(point) else {
            return 0.0;
        };
        (from..row.len())
            .map(|step| row[step] + least(costs, point + 1, step))
            .fold(f64::INFINITY, f64::min)
    }

    proptest! {
        #[test]
        fn it_finds_the_least_cost(costs in prop::collection::vec(prop::collection::vec(0.0f64..10.0, 6), 1..6)) {
            let band = Band::around(&vec![3.0; costs.len()], 10, 6);
            let matches = align(&band, |point, step| costs[point][step]).unwrap();
            prop_assert!(matches.windows(2).all(|pair| pair[0] <= pair[1]), "{matches:?}");
            let sum: f64 = matches.iter().enumerate().map(|(point, &step)| costs[point][step]).sum();
            prop_assert!((sum - least(&costs, 0, 0)).abs() < 1e-9);
        }
    }

    #[test]
    fn the_band_holds_and_crossings_are_passed_in_order() {
        // A figure of eight: the lane comes by the same position at steps 2 and 8.
        let lane = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 4.0, 3.0, 2.0, 1.0, 0.0];
        let track = [0.1, 2.1, 4.1, 4.1, 2.0, 0.1];
        let middles = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0];
        let cost = |point: usize, step: usize| f64::abs(track[point] - lane[step]);
        assert_eq!(
            align(&Band::around(&middles, 2, 11), cost).unwrap(),
            [0, 2, 4, 4, 8, 10]
        );
        let narrow = align(&Band::around(&[5.0; 6], 1, 11), cost).unwrap();
        assert!(
            narrow.iter().all(|step| (4..=6).contains(step)),
            "{narrow:?}"
        );
        assert_eq!(align(&Band::around(&[], 2, 11), cost), None);
        assert_eq!(align(&Band::around(&[0.0], 2, 0), |_, _| 0.0), None);
        // Middles that fall, and such that are no numbers, still leave a way.
        assert!(
            align(
                &Band::around(&[9.0, 1.0, f64::NAN, 1e300], 1, 11),
                |_, _| 0.0
            )
            .is_some()
        );
    }
}
