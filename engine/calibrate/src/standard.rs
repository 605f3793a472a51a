//! Columns of a regression brought to mean 0 and variance 1, and weights on them brought back.

/// Value of the constant column. The other columns have a variance of 1, and the ridge should
/// hardly pull on constants.
const CONSTANT: f64 = 30.0;

/// A number that varies less between rows is taken as constant.
const DEVIATION_MIN: f64 = 1e-6;

/// Means and standard deviations of the columns, the constant's not among them.
#[derive(Clone, Debug)]
pub(super) struct Standard {
    means: Vec<f64>,
    deviations: Vec<f64>,
}

impl Standard {
    /// Builds the standardization of rows of equal length; at least one row.
    pub(super) fn from_rows<'a>(rows: impl Iterator<Item = &'a [f64]> + Clone) -> Self {
        let count = rows.clone().count() as f64;
        let columns = rows.clone().next().map_or(0, <[f64]>::len);
        let mean = |value: &dyn Fn(&[f64]) -> f64| rows.clone().map(value).sum::<f64>() / count;
        let means: Vec<f64> = (0..columns)
            .map(|column| mean(&|row| row[column]))
            .collect();
        let deviation = |column: usize| {
            let deviation = mean(&|row| (row[column] - means[column]).powi(2)).sqrt();
            // 1 stands for those that do not vary: standardized they are 0.
            if deviation < DEVIATION_MIN {
                1.0
            } else {
                deviation
            }
        };
        let deviations = (0..columns).map(deviation).collect();
        Self { means, deviations }
    }

    /// Means and standard deviations.
    pub(super) fn parts(&self) -> (&[f64], &[f64]) {
        (&self.means, &self.deviations)
    }

    /// A row, standardized, and the constant behind it.
    pub(super) fn row(&self, row: &[f64]) -> Vec<f64> {
        let moved = row
            .iter()
            .zip(&self.means)
            .zip(&self.deviations)
            .map(|((value, mean), deviation)| (value - mean) / deviation);
        moved.chain([CONSTANT]).collect()
    }

    /// Weights on plain columns and 1 as weights on standardized ones.
    pub(super) fn to_standardized(&self, weights: &[f64]) -> Vec<f64> {
        let columns = self.means.len();
        let at_mean: f64 = weights[columns]
            + (0..columns)
                .map(|column| weights[column] * self.means[column])
                .sum::<f64>();
        (0..columns)
            .map(|column| weights[column] * self.deviations[column])
            .chain([at_mean / CONSTANT])
            .collect()
    }

    /// Inverse of [`Self::to_standardized`].
    pub(super) fn to_plain(&self, weights: &[f64]) -> Vec<f64> {
        let columns = self.means.len();
        let plain: Vec<f64> = (0..columns)
            .map(|column| weights[column] / self.deviations[column])
            .collect();
        let at_mean: f64 = (0..columns)
            .map(|column| plain[column] * self.means[column])
            .sum();
        let constant = weights[columns] * CONSTANT - at_mean;
        plain.into_iter().chain([constant]).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_mean_the_same_on_both_sides() {
        let rows: Vec<[f64; 3]> = (0..9)
            .map(|i| [f64::from(i).sin(), 4.0 + f64::from(i * i), 7.0])
            .collect();
        let standard = Standard::from_rows(rows.iter().map(<[f64; 3]>::as_slice));
        let weights = [0.3, -2.0, 0.5, 1.5];
        let moved = standard.to_standardized(&weights);
        let value = |weights: &[f64], row: &[f64]| {
            weights
                .iter()
                .zip(row)
                .map(|(weight, value)| weight * value)
                .sum::<f64>()
        };
        for row in &rows {
            let plain = [row.as_slice(), &[1.0]].concat();
            assert!((value(&weights, &plain) - value(&moved, &standard.row(row))).abs() < 1e-12);
            assert!(standard.row(row)[2] == 0.0, "a column that does not vary");
        }
        let back = standard.to_plain(&moved);
        assert!(
            back.iter().zip(weights).all(|(a, b)| (a - b).abs() < 1e-12),
            "{back:?}"
        );
    }
}
