//! Straight lines through points.

/// `y = offset + slope x`, by least squares.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    pub offset: f64,
    pub slope: f64,
    /// The share of the variance of y that the line explains; 1 where y does not vary.
    pub r_squared: f64,
}

impl Line {
    /// Least-squares line through `points`; `None` where they do not lie at two places at least.
    pub fn through(points: &[(f64, f64)]) -> Option<Self> {
        let count = points.len() as f64;
        let mean = |of: &dyn Fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
        let (x_mean, y_mean) = (mean(&|point| point.0), mean(&|point| point.1));
        let x_variance = mean(&|point| (point.0 - x_mean).powi(2));
        let y_variance = mean(&|point| (point.1 - y_mean).powi(2));
        if !(x_variance > 0.0 && y_variance.is_finite()) {
            return None;
        }
        let slope = mean(&|point| (point.0 - x_mean) * (point.1 - y_mean)) / x_variance;
        let offset = y_mean - slope * x_mean;
        let rest = mean(&|point| (point.1 - offset - slope * point.0).powi(2));
        Some(Self {
            offset,
            slope,
            r_squared: if y_variance > 0.0 {
                1.0 - rest / y_variance
            } else {
                1.0
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_found_again_and_noise_lowers_its_share() {
        let exact = Line::through(&[(0.0, 1.0), (2.0, 7.0), (5.0, 16.0)]).unwrap();
        assert!(
            (exact.slope - 3.0).abs() < 1e-12
                && (exact.offset - 1.0).abs() < 1e-12
                && (exact.r_squared - 1.0).abs() < 1e-12
        );
        // Slope 0.5, offset 1/3; residuals -1/3, 2/3, -1/3 of a variance of 2/3.
        let noisy = Line::through(&[(0.0, 0.0), (1.0, 1.5), (2.0, 1.0)]).unwrap();
        assert!(
            (noisy.slope - 0.5).abs() < 1e-12 && (noisy.r_squared - 3.0 / 7.0).abs() < 1e-12,
            "{noisy:?}"
        );
        assert_eq!(Line::through(&[(1.0, 1.0), (1.0, 2.0)]), None);
        assert_eq!(Line::through(&[]), None);
        assert_eq!(
            Line::through(&[(0.0, 2.0), (1.0, 2.0)]).unwrap().r_squared,
            1.0
        );
    }
}
