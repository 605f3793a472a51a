//! An episode driven again from its log.

use std::sync::Arc;

use decouplegs_scene::episode::{Episode, EpisodeEnd, LOG_VERSION, REPLAY_VERSION};
use decouplegs_scene::{Plan, Scenario};

use super::{
    EgosObserver, EgosRenderer, EpisodeError, EpisodeObserver, ObservationRenderer, Site,
    drive_among, drive_egos,
};
use crate::planner::agents::{AgentDriver, LoggedCommands};
use crate::planner::{EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError};

/// Result of driving an episode again.
pub struct Replayed {
    /// New episode. Its head is that of the log, except for the renderer.
    pub episode: Episode,
    /// The first difference in what moved, a sentence; `None` where all is the same to the last
    /// bit.
    pub moved_differently: Option<String>,
    /// Readings that there are both times.
    pub readings: usize,
    /// Number of readings whose bits differ.
    pub readings_different: usize,
}

/// Answers what the log says.
struct Logged<'a> {
    episode: &'a Episode,
    warm_up: bool,
}

impl Planner for Logged<'_> {
    fn name(&self) -> String {
        self.episode.head.planner.name.clone()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            localization: self.episode.head.planner.localization,
            privileged: self.episode.head.planner.privileged,
            ..ObservationRequest::default()
        }
    }

    fn uses_readings(&self) -> bool {
        false
    }

    fn begin(&mut self, _info: &EpisodeInfo) -> Result<(), PlannerError> {
        match (&self.episode.end, self.episode.steps.is_empty()) {
            (EpisodeEnd::Planner { reason }, true) => Err(PlannerError(reason.clone())),
            _ => Ok(()),
        }
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let step = self.episode.steps.get(observation.step as usize);
        self.warm_up = step.is_some_and(|step| step.warm_up);
        step.map(|step| step.plan.clone())
            .ok_or_else(|| match &self.episode.end {
                EpisodeEnd::Planner { reason } => PlannerError(reason.clone()),
                _ => PlannerError(format!("the log ends before step {}", observation.step)),
            })
    }

    fn is_warming_up(&self) -> bool {
        self.warm_up
    }
}

/// Drives the plans of `episode` again in `site`, drawn by `renderer`, and compares.
///
/// # Errors
/// Returns the errors of [`super::drive`].
pub fn replay(
    episode: &Episode,
    site: &Arc<Site>,
    renderer: Option<&mut ObservationRenderer>,
    observer: &mut dyn EpisodeObserver,
) -> Result<Replayed, EpisodeError> {
    let scenario: &Scenario = &episode.head.scenario;
    check_version(episode)?;
    let mut logged = Logged {
        episode,
        warm_up: false,
    };
    let mut commands = LoggedCommands::of_episode(episode);
    let agents = commands
        .as_mut()
        .map(|logged| logged as &mut dyn AgentDriver);
    let drivers = (&mut logged as &mut dyn Planner, agents);
    let driven = drive_among(scenario, site, renderer, drivers, observer)?.episode;
    Ok(compared(episode, driven))
}

/// Drives the plans of all egos of `episode` again in `site`, drawn by `renderer`, and compares.
///
/// # Errors
/// Returns the errors of [`super::drive_egos`].
pub fn replay_egos(
    episode: &Episode,
    site: &Arc<Site>,
    renderer: Option<&mut EgosRenderer>,
    observer: &mut dyn EgosObserver,
) -> Result<Replayed, EpisodeError> {
    check_version(episode)?;
    let logged = episode.egos().map(|episode| Logged {
        episode,
        warm_up: false,
    });
    let mut logged: Vec<Logged> = logged.collect();
    let planners = logged.iter_mut().map(|logged| logged as &mut dyn Planner);
    let mut planners: Vec<&mut dyn Planner> = planners.collect();
    let longest = episode.egos().max_by_key(|ego| ego.steps.len());
    let mut commands = longest.and_then(LoggedCommands::of_episode);
    let agents = commands
        .as_mut()
        .map(|logged| logged as &mut dyn AgentDriver);
    let scenario = &episode.head.scenario;
    let drivers = (planners.as_mut_slice(), agents);
    let driven = drive_egos(scenario, site, renderer, drivers, observer)?.episode;
    Ok(compared(episode, driven))
}

/// Compares `driven`, the plans of `episode` driven again.
fn compared(episode: &Episode, driven: Episode) -> Replayed {
    let again = driven.in_version(episode.head.log_version);
    let readings = |episode: &Episode| {
        let steps = episode.egos().flat_map(|ego| &ego.steps);
        let readings = steps.flat_map(|step| step.readings.clone());
        readings.collect::<Vec<_>>()
    };
    let (before, after) = (readings(episode), readings(&again));
    let same_frames = before.len() == after.len();
    let moved_differently = (episode.egos().zip(again.egos()))
        .find_map(|(before, after)| first_difference(before, after));
    Replayed {
        moved_differently,
        readings: if same_frames { after.len() } else { 0 },
        readings_different: if same_frames {
            before.iter().zip(&after).filter(|(a, b)| a != b).count()
        } else {
            0
        },
        episode: again,
    }
}

/// Checks that traffic still moves by the rules of the log of `episode`.
///
/// # Errors
/// [`EpisodeError::Unfit`] where it does not.
pub(super) fn check_version(episode: &Episode) -> Result<(), EpisodeError> {
    let version = episode.head.log_version;
    if !(REPLAY_VERSION..=LOG_VERSION).contains(&version) {
        return Err(EpisodeError::Unfit {
            scenario: episode.head.scenario.name.clone(),
            reason: format!(
                "its log is of version {version}, and traffic has moved by other rules since version \
                 {REPLAY_VERSION}: score it, or drive it again with the program that wrote it, {}",
                episode.head.version
            ),
        });
    }
    Ok(())
}

/// First difference between two episodes, images apart.
fn first_difference(a: &Episode, b: &Episode) -> Option<String> {
    if a.head.route_m != b.head.route_m
        || a.head.agent_sizes != b.head.agent_sizes
        || a.start != b.start
    {
        return Some("the start is another: its map, its assets or the program has changed".into());
    }
    for (a, b) in a.steps.iter().zip(&b.steps) {
        if let Some((a, _)) = a.instants.iter().zip(&b.instants).find(|(a, b)| a != b) {
            return Some(format!("a vehicle moves differently at {} s", a.time_s));
        }
        if a.handovers != b.handovers {
            return Some(format!(
                "other recorded agents are handed over in step {}",
                a.step
            ));
        }
        if a.lights != b.lights {
            return Some(format!(
                "traffic lights change differently in step {}",
                a.step
            ));
        }
        if a.commands != b.commands {
            return Some(format!(
                "commands to agents are carried out differently in step {}",
                a.step
            ));
        }
        if a.instants.len() != b.instants.len() {
            return Some(format!(
                "step {} has {} moments instead of {}",
                a.step,
                b.instants.len(),
                a.instants.len()
            ));
        }
    }
    if a.steps.len() != b.steps.len() || a.end != b.end {
        return Some(format!(
            "it ends after {} steps instead of {}",
            b.steps.len(),
            a.steps.len()
        ));
    }
    None
}
