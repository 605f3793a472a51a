//! Gaps between a recording and a scene: one number each, and its interval.

use decouplegs::drive::score::Moments;
use serde_json::{Value, json};

/// Quantile of the normal distribution at 97.5 %.
const NORMAL_QUANTILE: f64 = 1.96;

/// Figure that stands for many values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Statistic {
    Mean,
    /// Share of the values that are 1.
    Share,
    Median,
    /// The value that 95 % do not exceed.
    P95,
    /// Root of the mean square.
    Rms,
    /// Number of things; it has no interval.
    Count,
}

impl Statistic {
    const fn name(self) -> &'static str {
        match self {
            Self::Mean => "mean",
            Self::Share => "share",
            Self::Median => "median",
            Self::P95 => "p95",
            Self::Rms => "rms",
            Self::Count => "count",
        }
    }
}

/// A gap: its name with its unit, its figure, and the interval of 95 % confidence.
#[derive(Clone, Debug, PartialEq)]
pub struct Gap {
    pub name: String,
    statistic: Statistic,
    /// `None` where nothing was there to measure.
    figure: Option<f64>,
    interval: Option<[f64; 2]>,
    /// Values that the figure stands for.
    count: usize,
    digits: usize,
}

impl Gap {
    /// A figure of `values`, printed with `digits` decimals.
    pub fn new(
        name: impl Into<String>,
        statistic: Statistic,
        values: &[f64],
        digits: usize,
    ) -> Self {
        let moments = Moments::from_values(values);
        let (figure, interval) = match statistic {
            Statistic::Mean => (
                moments.map(|moments| moments.mean),
                moments.and_then(|moments| moments.interval()),
            ),
            Statistic::Share => (
                moments.map(|moments| moments.mean),
                moments.map(|moments| moments.share_interval()),
            ),
            Statistic::Median => of_order(values, 0.5),
            Statistic::P95 => of_order(values, 0.95),
            Statistic::Rms => {
                let squares: Vec<f64> = values.iter().map(|value| value * value).collect();
                let moments = Moments::from_values(&squares);
                let root = |square: f64| square.max(0.0).sqrt();
                let interval = moments.and_then(|moments| moments.interval());
                (
                    moments.map(|moments| root(moments.mean)),
                    interval.map(|ends| ends.map(root)),
                )
            }
            Statistic::Count => (Some(values.len() as f64), None),
        };
        Self {
            name: name.into(),
            statistic,
            figure,
            interval,
            count: values.len(),
            digits,
        }
    }

    /// The number of `count` things.
    pub fn count(name: impl Into<String>, count: usize) -> Self {
        Self {
            figure: Some(count as f64),
            count,
            ..Self::new(name, Statistic::Count, &[], 0)
        }
    }

    /// The gap with an interval that ends at `low` and `high` at most.
    pub fn within(mut self, low: f64, high: f64) -> Self {
        self.interval = self
            .interval
            .map(|ends| ends.map(|end| end.clamp(low, high)));
        self
    }

    /// The figure and its interval, or a dash.
    pub fn text(&self) -> String {
        let digits = self.digits;
        match (self.figure, self.interval) {
            (None, _) => "-".into(),
            (Some(figure), None) => format!("{figure:.digits$}"),
            (Some(figure), Some([low, high])) => {
                format!("{figure:.digits$} [{low:.digits$}, {high:.digits$}]")
            }
        }
    }

    pub fn to_json(&self) -> Value {
        json!({
            "name": self.name,
            "statistic": self.statistic.name(),
            "value": self.figure,
            "interval_95": self.interval,
            "count": self.count,
        })
    }
}

/// The value that a share of `values` does not exceed, and its interval: the values whose ranks are
/// as far from it as those of a binomial distribution.
fn of_order(values: &[f64], share: f64) -> (Option<f64>, Option<[f64; 2]>) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else {
        return (None, None);
    };
    let at = |rank: f64| sorted[(rank.round().max(0.0) as usize).min(last)];
    let count = sorted.len() as f64;
    let (middle, half) = (
        share * last as f64,
        NORMAL_QUANTILE * (count * share * (1.0 - share)).sqrt(),
    );
    let interval = (last > 0).then(|| [at((middle - half).floor()), at((middle + half).ceil())]);
    (Some(at(middle)), interval)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_have_intervals() {
        let values: Vec<f64> = (0..=100).map(f64::from).collect();
        let median = Gap::new("m", Statistic::Median, &values, 1);
        assert_eq!(median.text(), "50.0 [40.0, 60.0]");
        let p95 = Gap::new("m", Statistic::P95, &values, 0);
        assert_eq!(p95.text(), "95 [90, 100]");
        let rms = Gap::new("m", Statistic::Rms, &[3.0, 4.0], 3);
        assert!(rms.text().starts_with("3.536 [0.000, "), "{}", rms.text());
        let share = Gap::new("m", Statistic::Share, &[1.0, 0.0, 1.0, 1.0], 2);
        assert_eq!(share.text(), "0.75 [0.30, 0.95]");
        assert_eq!(Gap::count("m", 3).text(), "3");
        assert_eq!(Gap::new("m", Statistic::Mean, &[2.0], 1).text(), "2.0");
        for statistic in [Statistic::Mean, Statistic::Median, Statistic::Share] {
            assert_eq!(Gap::new("m", statistic, &[], 1).text(), "-");
        }
        let bounded = Gap::new("m", Statistic::Mean, &[0.0, 1.0], 1).within(0.0, 1.0);
        assert_eq!(bounded.text(), "0.5 [0.0, 1.0]");
    }
}
