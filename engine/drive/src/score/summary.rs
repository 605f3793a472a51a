//! Scores of many episodes, in the layout of the paper's Table 3.

use std::collections::BTreeMap;

use decouplegs_scene::{Invalid, Level};

use super::{EpisodeScore, InfractionKind};

/// Rounding that a mean may show.
const ROUNDING: f64 = 1e-9;

/// Mean and spread of a figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// Number of episodes, at least one.
    pub count: usize,
    /// Mean of the figure.
    pub mean: f64,
    /// Sample standard deviation of the figure (over count - 1); `None` of a single one.
    pub std: Option<f64>,
}

impl Moments {
    /// Statistics of `values`; `None` of none.
    #[must_use]
    pub fn from_values(values: &[f64]) -> Option<Self> {
        if values.is_empty() {
            return None;
        }
        let count = values.len();
        let mean = values.iter().sum::<f64>() / count as f64;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        Some(Self {
            count,
            mean,
            std: (count > 1).then(|| (squares / (count - 1) as f64).sqrt()),
        })
    }

    /// 95 % confidence interval of the mean, by Student's t; `None` of a single value.
    #[must_use]
    pub fn interval(&self) -> Option<[f64; 2]> {
        let half = t_quantile(self.count - 1) * self.std? / (self.count as f64).sqrt();
        Some([self.mean - half, self.mean + half])
    }

    /// 95 % confidence interval of a share, where each value is 0 or 1 (E. B. Wilson, Probable
    /// inference, the law of succession, and statistical inference, 1927).
    #[must_use]
    pub fn share_interval(&self) -> [f64; 2] {
        let (count, square) = (self.count as f64, NORMAL_QUANTILE * NORMAL_QUANTILE);
        let middle = (self.mean + 0.5 * square / count) / (1.0 + square / count);
        let spread = self.mean * (1.0 - self.mean) / count + 0.25 * square / (count * count);
        let half = NORMAL_QUANTILE / (1.0 + square / count) * spread.sqrt();
        [(middle - half).max(0.0), (middle + half).min(1.0)]
    }
}

/// Quantile of the normal distribution at 97.5 %.
const NORMAL_QUANTILE: f64 = 1.959_963_984_540_054;

/// Quantiles of Student's t distribution at 97.5 % for 1 to 10 degrees of freedom.
const FEW: [f64; 10] = [
    12.7062, 4.3027, 3.1824, 2.7764, 2.5706, 2.4469, 2.3646, 2.3060, 2.2622, 2.2281,
];

/// Quantile of Student's t distribution at 97.5 %, to a thousandth (R. A. Fisher, E. A. Cornish,
/// The percentile points of distributions having known cumulants, 1960).
fn t_quantile(degrees: usize) -> f64 {
    match FEW.get(degrees.wrapping_sub(1)) {
        Some(&quantile) => quantile,
        None => {
            let z = NORMAL_QUANTILE;
            let inverse = 1.0 / degrees as f64;
            let first = (z.powi(3) + z) / 4.0;
            let second = (5.0 * z.powi(5) + 16.0 * z.powi(3) + 3.0 * z) / 96.0;
            let third = (3.0 * z.powi(7) + 19.0 * z.powi(5) + 17.0 * z.powi(3) - 15.0 * z) / 384.0;
            z + inverse * (first + inverse * (second + inverse * third))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_and_intervals_are_those_of_tables() {
        for (degrees, expected) in [
            (1, 12.706),
            (5, 2.571),
            (11, 2.2010),
            (49, 2.010),
            (1000, 1.962),
        ] {
            let found = t_quantile(degrees);
            assert!((found - expected).abs() < 1e-3, "{degrees}: {found}");
        }
        let moments = Moments::from_values(&[1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        let [low, high] = moments.interval().unwrap();
        // 3 -+ 2.7764 sqrt(2.5 / 5).
        assert!((low - 1.0368).abs() < 1e-3 && (high - 4.9632).abs() < 1e-3);
        assert_eq!(Moments::from_values(&[1.0]).unwrap().interval(), None);
        // 8 of 10, by Wilson.
        let mut shares = [1.0; 10];
        shares[..2].fill(0.0);
        let [low, high] = Moments::from_values(&shares).unwrap().share_interval();
        assert!((low - 0.4902).abs() < 1e-3 && (high - 0.9433).abs() < 1e-3);
        let all = Moments::from_values(&[1.0; 20]).unwrap().share_interval();
        assert!(
            all[0] > 0.8 && all[0] < 0.9 && (all[1] - 1.0).abs() < 1e-9,
            "{all:?}"
        );
    }
}

/// Figures of a set of episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SetSummary {
    /// Driving score (DS), 0 to 1.
    pub driving_score: Moments,
    /// SR: its mean is the share of episodes that succeeded.
    pub success: Moments,
    /// Route completion (RC), 0 to 1.
    pub route_completion: Moments,
    /// Route completion that counts in the driving score, 0 to 1.
    pub counted_completion: Moments,
    /// minTTC in seconds, over the episodes that have one.
    pub min_ttc_s: Option<Moments>,
    /// mADE in meters, over the episodes that have one.
    pub plan_ade_m: Option<Moments>,
    /// Share of moments with a short time to collision.
    pub ttc_short_share: Moments,
    /// Collisions in all episodes.
    pub collisions: usize,
    /// Collisions that were the ego's fault.
    pub collisions_at_fault: usize,
    /// Collisions that no braking of the ego could avoid.
    pub unavoidable_collisions: usize,
    /// Collisions with pedestrians.
    pub pedestrian_collisions: usize,
    /// Collisions with static obstacles in all episodes.
    pub obstacle_collisions: usize,
    /// Episodes that ended by a collision that was not the ego's fault.
    pub ended_by_others: usize,
    /// Drives against the direction of the lanes in all episodes.
    pub wrong_ways: usize,
    /// Excursions from the road in all episodes.
    pub layout_infractions: usize,
    /// Red lights that were run in all episodes.
    pub red_lights: usize,
    /// Stop signs that were passed without standing.
    pub stop_signs: usize,
}

impl SetSummary {
    /// Mean of `scores`; `None` of none.
    #[must_use]
    pub fn from_scores(scores: &[&EpisodeScore]) -> Option<Self> {
        let moments = |figure: &dyn Fn(&EpisodeScore) -> Option<f64>| {
            let values: Vec<f64> = scores.iter().filter_map(|score| figure(score)).collect();
            Moments::from_values(&values)
        };
        let count = |counts: &dyn Fn(&EpisodeScore) -> usize| {
            scores.iter().map(|score| counts(score)).sum()
        };
        let at_fault = |score: &EpisodeScore| {
            let collided = |kind: &InfractionKind| matches!(kind, InfractionKind::Collision { fault, .. } if fault.at_fault());
            score
                .infractions
                .iter()
                .filter(|infraction| collided(&infraction.kind))
                .count()
        };
        Some(Self {
            driving_score: moments(&|score| Some(score.driving_score))?,
            success: moments(&|score| Some(f64::from(u8::from(score.success))))?,
            route_completion: moments(&|score| Some(score.route_completion))?,
            counted_completion: moments(&|score| Some(score.counted_completion))?,
            min_ttc_s: moments(&EpisodeScore::min_ttc_s),
            plan_ade_m: moments(&|score| score.plan_ade_m),
            ttc_short_share: moments(&|score| Some(score.ttc_short_share))?,
            collisions: count(&EpisodeScore::collisions),
            collisions_at_fault: count(&at_fault),
            unavoidable_collisions: count(&EpisodeScore::unavoidable_collisions),
            pedestrian_collisions: count(&EpisodeScore::pedestrian_collisions),
            obstacle_collisions: count(&EpisodeScore::obstacle_collisions),
            ended_by_others: count(&|score| usize::from(score.ended_by_other)),
            wrong_ways: count(&EpisodeScore::wrong_ways),
            layout_infractions: count(&EpisodeScore::layout_infractions),
            red_lights: count(&EpisodeScore::red_lights),
            stop_signs: count(&EpisodeScore::stop_signs),
        })
    }

    /// Episodes in the set.
    #[must_use]
    pub fn count(&self) -> usize {
        self.route_completion.count
    }

    fn check(&self, set: &str) -> Result<(), Invalid> {
        for (name, mean, completion) in [
            (
                "success rate",
                self.success.mean,
                self.counted_completion.mean,
            ),
            (
                "mean driving score",
                self.driving_score.mean,
                self.counted_completion.mean,
            ),
        ] {
            // Written so that what is no number fails.
            if !(0.0 <= mean && mean <= completion + ROUNDING && completion <= 1.0) {
                return Err(Invalid::new(format!(
                    "{set}: a {name} of {mean} with a mean route completion of {completion}; expected 0 <= {name} <= route completion <= 1"
                )));
            }
        }
        Ok(())
    }
}

/// Figures of many episodes, for each level and over all.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// Figures of each level, from easy to extreme, after those of no level.
    pub levels: BTreeMap<Option<Level>, SetSummary>,
    /// Figures of all episodes; `None` where there are none.
    pub all: Option<SetSummary>,
}

impl Summary {
    /// Summary of `scores`.
    #[must_use]
    pub fn from_scores(scores: &[EpisodeScore]) -> Self {
        let mut by_level: BTreeMap<Option<Level>, Vec<&EpisodeScore>> = BTreeMap::new();
        for score in scores {
            by_level.entry(score.level).or_default().push(score);
        }
        let levels = by_level
            .into_iter()
            .filter_map(|(level, scores)| Some((level, SetSummary::from_scores(&scores)?)))
            .collect();
        Self {
            levels,
            all: SetSummary::from_scores(&scores.iter().collect::<Vec<_>>()),
        }
    }

    /// Holds what must be true of any set of episodes: no more success than completion, no driving
    /// score above the completion that counts. Published tables break it.
    ///
    /// # Errors
    /// A sentence with the set and its figures.
    pub fn check(&self) -> Result<(), Invalid> {
        for (level, set) in &self.levels {
            set.check(level.map_or("no level", Level::name))?;
        }
        self.all
            .as_ref()
            .map_or(Ok(()), |set| set.check("all levels"))
    }
}
