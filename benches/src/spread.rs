//! Order statistics of measured times.

use serde_json::{Value, json};

/// Order statistics of at least one value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    pub mean: f64,
    pub median: f64,
    /// The value that 99 of 100 do not exceed.
    pub p99: f64,
    pub min: f64,
    pub max: f64,
}

impl Spread {
    pub fn from_values(values: impl IntoIterator<Item = f64>) -> Self {
        let mut values: Vec<f64> = values.into_iter().collect();
        values.sort_by(f64::total_cmp);
        let count = values.len();
        assert!(count > 0, "a spread is of at least one value");
        Self {
            mean: values.iter().sum::<f64>() / count as f64,
            median: 0.5 * (values[(count - 1) / 2] + values[count / 2]),
            p99: values[(count * 99).div_ceil(100) - 1],
            min: values[0],
            max: values[count - 1],
        }
    }

    pub fn to_json(self) -> Value {
        json!({ "mean": self.mean, "median": self.median, "p99": self.p99, "min": self.min, "max": self.max })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_of_the_sorted_values() {
        assert_eq!(
            Spread::from_values([5.0]),
            Spread {
                mean: 5.0,
                median: 5.0,
                p99: 5.0,
                min: 5.0,
                max: 5.0
            }
        );
        let hundred = Spread::from_values((0..100).rev().map(f64::from));
        assert_eq!(
            hundred,
            Spread {
                mean: 49.5,
                median: 49.5,
                p99: 98.0,
                min: 0.0,
                max: 99.0
            }
        );
    }
}
