//! Difficulty of scenarios, measured: planners of three styles that know everything drive them.

use std::collections::BTreeSet;
use std::sync::Arc;

use decouplegs_drive::score::{EpisodeScore, times_to_collision};
use decouplegs_scene::{Episode, Scenario};

use crate::episode::{EpisodeError, Site, drive_egos};
use crate::planner::{DrivingStyle, LaneFollow, Planner};

/// Share of a scenario's time that a reference planner must have to spare to win it.
pub const MARGIN: f64 = 0.1;
/// A road user with whom the ego was on course for a collision within this time was met, seconds.
pub const MET_S: f64 = 3.0;

/// Difficulty of a scenario, as the reference planners met it: `lane-follow` in each of its styles,
/// each alone, among the traffic of the scenario.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredDifficulty {
    /// True for each reference planner that won, in the order of [`DrivingStyle::ALL`]: it brought
    /// every ego to the end of its route without a fault, with [`MARGIN`] of the time to spare.
    pub won: [bool; DrivingStyle::ALL.len()],
    /// Least time to react, seconds: the smallest time to collision in the drives that were won.
    /// `None` where nobody was on course for a collision.
    pub reaction_s: Option<f64>,
    /// Number of road users that were met ([`MET_S`]), mean over the drives that were won; 0 where
    /// none was.
    pub interactions: f64,
}

impl MeasuredDifficulty {
    /// Difficulty of `scenario` in `site`.
    ///
    /// # Errors
    /// Returns an error if `scenario` does not fit `site`.
    pub fn new(scenario: &Scenario, site: &Arc<Site>) -> Result<Self, EpisodeError> {
        let hurried = hurried(scenario);
        let (mut won, mut drives) = ([false; DrivingStyle::ALL.len()], Vec::new());
        for (won, style) in won.iter_mut().zip(DrivingStyle::ALL) {
            let episode = driven(&hurried, site, style)?;
            *won = is_won(&episode);
            if *won {
                drives.push(episode);
            }
        }
        let egos = || drives.iter().flat_map(Episode::egos);
        let closest = egos().filter_map(|ego| EpisodeScore::new(ego).closest);
        let met: usize = egos().map(met).sum();
        Ok(Self {
            won,
            reaction_s: closest.map(|closest| closest.ttc_s).min_by(f64::total_cmp),
            interactions: met as f64 / drives.len().max(1) as f64,
        })
    }

    /// Share of the reference planners that lost, 0 to 1.
    #[must_use]
    pub fn lost_share(&self) -> f64 {
        let lost = self.won.iter().filter(|won| !**won);
        lost.count() as f64 / self.won.len() as f64
    }
}

/// True if the planner `lane-follow` wins `scenario` with [`MARGIN`] of the time to spare.
///
/// # Errors
/// Returns an error if `scenario` does not fit `site`.
pub fn is_winnable(scenario: &Scenario, site: &Arc<Site>) -> Result<bool, EpisodeError> {
    let episode = driven(&hurried(scenario), site, DrivingStyle::Normal)?;
    Ok(is_won(&episode))
}

/// `scenario` with less time, so that the rest is to spare.
fn hurried(scenario: &Scenario) -> Scenario {
    let steps = (1.0 - MARGIN) * f64::from(scenario.steps());
    Scenario {
        duration_s: scenario.step_s * steps.floor().max(1.0),
        ..scenario.clone()
    }
}

/// True if every ego came to the end of its route without a fault.
fn is_won(episode: &Episode) -> bool {
    episode.egos().all(|ego| EpisodeScore::new(ego).success)
}

/// The episode in which a planner of `style` drives all egos of `scenario`.
fn driven(
    scenario: &Scenario,
    site: &Arc<Site>,
    style: DrivingStyle,
) -> Result<Episode, EpisodeError> {
    let mut planners = vec![LaneFollow::new(style); scenario.egos.count()];
    let planners = planners
        .iter_mut()
        .map(|planner| planner as &mut dyn Planner);
    let mut planners: Vec<&mut dyn Planner> = planners.collect();
    let drivers = (planners.as_mut_slice(), None);
    Ok(drive_egos(scenario, site, None, drivers, &mut ())?.episode)
}

/// Number of road users that the ego of `episode` met.
fn met(episode: &Episode) -> usize {
    let times = times_to_collision(episode).into_iter();
    let near = times.filter_map(|(_, closest)| closest.filter(|closest| closest.ttc_s < MET_S));
    near.map(|closest| closest.agent)
        .collect::<BTreeSet<_>>()
        .len()
}
