//! Samples of a quantity, and how far two samples are apart.

use serde_json::{Value, json};

/// Shares of a sample that are told.
const SHARES: [f64; 5] = [0.05, 0.25, 0.5, 0.75, 0.95];
/// Points of a drawn distribution, at most.
const DRAWN_MAX: usize = 200;

/// Values of a quantity, in rising order once it is finished.
#[derive(Clone, Debug, Default)]
pub struct Sample {
    values: Vec<f64>,
}

impl Sample {
    pub fn add(&mut self, value: f64) {
        self.values.push(value);
    }

    pub fn len(&self) -> usize {
        self.values.len()
    }

    /// Sample in rising order.
    pub fn sorted(mut self) -> Self {
        self.values.sort_by(f64::total_cmp);
        self
    }

    /// Value below which a share of a sorted sample lies; `None` of nothing.
    pub fn quantile(&self, share: f64) -> Option<f64> {
        let last = self.values.len().checked_sub(1)?;
        let place = share * last as f64;
        let (low, high) = (place.floor() as usize, place.ceil() as usize);
        let (low, high) = (self.values[low], self.values[high.min(last)]);
        Some(low + (place - place.floor()) * (high - low))
    }

    pub fn mean(&self) -> Option<f64> {
        let count = self.values.len();
        (count > 0).then(|| self.values.iter().sum::<f64>() / count as f64)
    }

    /// Quantiles as text: 5, 25, 50, 75 and 95 %.
    pub fn to_text(&self) -> String {
        let quantiles = SHARES.map(|share| self.quantile(share));
        let text = quantiles.map(|value| value.map_or("-".into(), |value| format!("{value:.2}")));
        text.join(", ")
    }

    pub fn to_json(&self) -> Value {
        let [p5, p25, p50, p75, p95] = SHARES.map(|share| self.quantile(share));
        json!({
            "count": self.len(),
            "p5": p5,
            "p25": p25,
            "p50": p50,
            "p75": p75,
            "p95": p95,
        })
    }

    /// Points of the share of values up to a value, for a plot.
    pub fn curve(&self) -> Vec<(f64, f64)> {
        let count = DRAWN_MAX.min(self.values.len());
        let share = |at: usize| at as f64 / (count - 1).max(1) as f64;
        let points = (0..count).map(|at| Some((self.quantile(share(at))?, share(at))));
        points.flatten().collect()
    }
}

/// Kolmogorov-Smirnov distance of two sorted samples: the largest difference of the shares up to a
/// value, from 0 to 1; `None` where one is empty.
pub fn distance(a: &Sample, b: &Sample) -> Option<f64> {
    if a.values.is_empty() || b.values.is_empty() {
        return None;
    }
    let (mut in_a, mut in_b, mut largest) = (0, 0, 0.0_f64);
    while in_a < a.values.len() && in_b < b.values.len() {
        let value = a.values[in_a].min(b.values[in_b]);
        // Equal values count on both sides before shares are compared.
        while in_a < a.values.len() && a.values[in_a] <= value {
            in_a += 1;
        }
        while in_b < b.values.len() && b.values[in_b] <= value {
            in_b += 1;
        }
        let share = |count: usize, all: usize| count as f64 / all as f64;
        let apart = share(in_a, a.values.len()) - share(in_b, b.values.len());
        largest = largest.max(apart.abs());
    }
    Some(largest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(values: &[f64]) -> Sample {
        let mut sample = Sample::default();
        values.iter().for_each(|value| sample.add(*value));
        sample.sorted()
    }

    #[test]
    fn equal_samples_are_not_apart_and_others_are() {
        let one = sample(&[3.0, 1.0, 2.0, 2.0]);
        assert_eq!(distance(&one, &one), Some(0.0));
        // The same distribution, twice as many values.
        let twice = sample(&[1.0, 1.0, 2.0, 2.0, 2.0, 2.0, 3.0, 3.0]);
        assert_eq!(distance(&one, &twice), Some(0.0));
        assert_eq!(distance(&one, &sample(&[4.0])), Some(1.0));
        assert_eq!(distance(&sample(&[0.0, 1.0]), &sample(&[0.5])), Some(0.5));
        assert_eq!(distance(&one, &sample(&[])), None);
        assert_eq!(one.quantile(0.5), Some(2.0));
        assert_eq!(sample(&[0.0, 1.0]).quantile(0.25), Some(0.25));
    }
}
