//! The realism meta-metric of the Waymo Open Sim Agents Challenge (N. Montali et al., NeurIPS
//! 2023), with features, bins and weights of 2025: the likelihood of what was recorded under what
//! was simulated.
//!
//! For each vehicle, the values of all its simulations at all moments make a histogram, to each bin
//! of which 0.1 is added. The likelihood of a feature is the exponential of the mean logarithm over
//! recorded values of the share of their bin; values beyond the bins count in the last ones.
//! Collisions, leaving the road and passing red lights are histograms of two bins (never, or at
//! least once), to which 0.001 is added. The meta-metric is the sum of the likelihoods by their
//! weights, which make 1.
//!
//! Differences to the challenge: distances are those of boxes on the plane, the edge of the road
//! is that of the driving lanes of the map, a vehicle is scored at the moments at which it is on
//! the map in the recording, and the number of simulations and the time are those of the command
//! (there 32 and 8 s).

use serde_json::{Map, Value, json};

use super::features::{Features, Quantity, Series};

/// Added to each bin.
const SMOOTHING: f64 = 0.1;
/// Added to each of the two bins of what is or is not.
const SMOOTHING_OF_TWO: f64 = 0.001;

/// Feature of values, its range, number of bins and weight.
struct Feature {
    name: &'static str,
    quantity: Quantity,
    range: [f64; 2],
    bins: usize,
    weight: f64,
}

const fn feature(
    name: &'static str,
    quantity: Quantity,
    range: [f64; 2],
    bins: usize,
    weight: f64,
) -> Feature {
    Feature {
        name,
        quantity,
        range,
        bins,
        weight,
    }
}

#[expect(
    clippy::approx_constant,
    reason = "bins of the challenge end at 3.14, not at pi"
)]
const FEATURES: [Feature; 7] = [
    feature("linear_speed", Quantity::Speed, [0.0, 25.0], 10, 0.05),
    feature(
        "linear_acceleration",
        Quantity::Acceleration,
        [-12.0, 12.0],
        11,
        0.05,
    ),
    feature(
        "angular_speed",
        Quantity::YawRate,
        [-0.628, 0.628],
        11,
        0.05,
    ),
    feature(
        "angular_acceleration",
        Quantity::YawAcceleration,
        [-3.14, 3.14],
        11,
        0.05,
    ),
    feature(
        "distance_to_nearest_object",
        Quantity::Nearest,
        [-5.0, 40.0],
        10,
        0.1,
    ),
    feature(
        "time_to_collision",
        Quantity::TimeToCollision,
        [0.0, 5.0],
        10,
        0.1,
    ),
    feature(
        "distance_to_road_edge",
        Quantity::Edge,
        [-20.0, 40.0],
        10,
        0.05,
    ),
];

/// Names and weights of what is or is not.
const EVENTS: [(&str, f64); 3] = [
    ("collision_indication", 0.25),
    ("offroad_indication", 0.25),
    ("traffic_light_violation", 0.05),
];

/// Sums of logarithms, by feature, over parts of recordings.
#[derive(Clone, Debug, Default)]
pub struct Likelihood {
    /// Sum and count of each feature, and of what is or is not after them.
    sums: [(f64, usize); FEATURES.len() + EVENTS.len()],
}

impl Likelihood {
    /// Adds a part: those at `vehicles`, recorded and in each simulation.
    pub fn add(&mut self, recorded: &Features, simulated: &[Features], vehicles: &[usize]) {
        for &at in vehicles {
            for (feature, sum) in FEATURES.iter().zip(&mut self.sums) {
                let of = |features: &Features| values(features.of_quantity(feature.quantity), at);
                let all: Vec<f64> = simulated.iter().flat_map(of).collect();
                let shares = histogram(&all, feature.range, feature.bins, SMOOTHING);
                for value in of(recorded) {
                    sum.0 += shares[bin(value, feature.range, feature.bins)].ln();
                    sum.1 += 1;
                }
            }
            let sums = &mut self.sums[FEATURES.len()..];
            for (event, sum) in sums.iter_mut().enumerate() {
                let is_so = |features: &Features| happens(features, recorded, event, at);
                let so = simulated.iter().filter(|one| is_so(one)).count() as f64;
                let not = simulated.len() as f64 - so;
                let kept = if is_so(recorded) { so } else { not };
                let all = simulated.len() as f64 + 2.0 * SMOOTHING_OF_TWO;
                sum.0 += ((kept + SMOOTHING_OF_TWO) / all).ln();
                sum.1 += 1;
            }
        }
    }

    /// Names, weights and likelihoods, from 0 to 1; a feature without any value has none.
    pub fn features(&self) -> impl Iterator<Item = (&'static str, f64, Option<f64>)> {
        let names = FEATURES
            .iter()
            .map(|feature| (feature.name, feature.weight));
        let all = names.chain(EVENTS).zip(&self.sums);
        all.map(|((name, weight), (sum, count))| {
            let likelihood = (*count > 0).then(|| (sum / *count as f64).exp());
            (name, weight, likelihood)
        })
    }

    /// The meta-metric, from 0 to 1; `None` if a feature has no value.
    pub fn meta(&self) -> Option<f64> {
        self.features()
            .map(|(_, weight, likelihood)| Some(weight * likelihood?))
            .sum()
    }

    pub fn to_json(&self) -> Value {
        let features = self.features();
        let named: Map<String, Value> = features
            .map(|(name, _, likelihood)| (name.to_owned(), json!(likelihood)))
            .collect();
        json!({"meta_metric": self.meta(), "likelihoods": named})
    }
}

fn values(series: &Series, at: usize) -> Vec<f64> {
    series[at].iter().copied().flatten().collect()
}

/// True if a vehicle ever touches another, leaves the road or passes a red light, while it is
/// recorded.
fn happens(features: &Features, recorded: &Features, event: usize, at: usize) -> bool {
    let edge = |features: &Features, step: usize| features.of_quantity(Quantity::Edge)[at][step];
    let steps = 0..features.touches[at].len();
    let mut steps = steps.filter(|&step| edge(recorded, step).is_some());
    steps.any(|step| match event {
        0 => features.touches[at][step],
        1 => edge(features, step).is_some_and(|beyond_m| beyond_m > 0.0),
        _ => features.red[at][step],
    })
}

/// Index of the bin of a value.
fn bin(value: f64, [from, to]: [f64; 2], bins: usize) -> usize {
    let place = (value.clamp(from, to) - from) / (to - from) * bins as f64;
    (place as usize).min(bins - 1)
}

/// Share of each bin.
fn histogram(values: &[f64], range: [f64; 2], bins: usize, smoothing: f64) -> Vec<f64> {
    let mut counts = vec![smoothing; bins];
    for value in values {
        counts[bin(*value, range, bins)] += 1.0;
    }
    let all = values.len() as f64 + smoothing * bins as f64;
    counts.into_iter().map(|count| count / all).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_make_one_and_values_beyond_the_bins_count_in_the_last() {
        let weights = Likelihood::default();
        let sum: f64 = weights.features().map(|(_, weight, _)| weight).sum();
        assert!((sum - 1.0).abs() < 1e-12);
        assert_eq!(weights.meta(), None);
        let range = [0.0, 25.0];
        assert_eq!(
            [-1.0, 0.0, 2.5, 24.9, 25.0, 99.0].map(|value| bin(value, range, 10)),
            [0, 0, 1, 9, 9, 9]
        );
        // Two values of one bin of ten: (2 + 0.1) / (2 + 1).
        let shares = histogram(&[1.0, 2.0], range, 10, SMOOTHING);
        assert!((shares[0] - 0.7).abs() < 1e-12 && (shares[5] - 0.1 / 3.0).abs() < 1e-12);
    }
}
