//! Scores of episodes, from their records alone: no map and no image is needed, so that a log
//! scores the same wherever it is read.
//!
//! As CARLA's leaderboard has it (leaderboard.carla.org, "Evaluation criteria"), a driving score is
//! the share of the route that was completed, times a factor for each infraction. Only collisions
//! that are the ego's fault are penalized so; one that is not ends the episode and costs the rest
//! of the route. Success is a completed route without any such infraction, so no set of episodes
//! has more success than completion, nor a driving score above its completion: [`Summary::check`].

use decouplegs_scene::{Episode, EpisodeEnd, Level, RoadUser};

mod comfort;
mod fault;
mod hd_score;
mod infractions;
mod plan_error;
mod plan_hd_score;
mod progress;
mod summary;
mod time_to_collision;

pub use comfort::{Comfort, lateral_accelerations};
pub use fault::Fault;
pub use hd_score::HdScore;
pub use infractions::{Infraction, InfractionKind};
pub use plan_error::{plan_ade_m, plan_errors};
pub use progress::RouteProgress;
pub use summary::{Moments, SetSummary, Summary};
pub use time_to_collision::{Closest, TTC_HORIZON_S, TTC_SHORT_S, times_to_collision};

/// Factor on the driving score for each collision with a vehicle that is the ego's fault.
pub const COLLISION_FACTOR: f64 = 0.60;
/// Factor on the driving score for each collision with a pedestrian, as in CARLA's leaderboard.
pub const PEDESTRIAN_FACTOR: f64 = 0.50;
/// Factor on the driving score for a collision with something static, as in CARLA's leaderboard.
pub const OBSTACLE_FACTOR: f64 = 0.65;
/// Factor on the driving score for each red light that the ego runs, as in CARLA's leaderboard.
pub const RED_LIGHT_FACTOR: f64 = 0.70;
/// Factor on the driving score for each stop sign that the ego passes without standing, as in
/// CARLA's leaderboard.
pub const STOP_SIGN_FACTOR: f64 = 0.80;
/// Factor on the driving score for each time the ego leaves the road.
pub const LAYOUT_FACTOR: f64 = 0.65;

/// Score of an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct EpisodeScore {
    /// The scenario's name.
    pub scenario: String,
    /// The scenario's level.
    pub level: Option<Level>,
    /// Share of the route that was driven, 0 to 1; 1 exactly where the episode ended with the route
    /// done.
    pub route_completion: f64,
    /// [`Self::route_completion`] times [`COLLISION_FACTOR`], [`PEDESTRIAN_FACTOR`],
    /// [`OBSTACLE_FACTOR`], [`LAYOUT_FACTOR`], [`RED_LIGHT_FACTOR`] or
    /// [`STOP_SIGN_FACTOR`] for each infraction.
    pub driving_score: f64,
    /// True if the route was completed without an infraction of the ego.
    pub success: bool,
    /// Infractions, in the order of time.
    pub infractions: Vec<Infraction>,
    /// The smallest time to collision, `None` where the ego was never on course for one within
    /// [`TTC_HORIZON_S`].
    pub closest: Option<Closest>,
    /// Share of moments with a time to collision below [`TTC_SHORT_S`].
    pub ttc_short_share: f64,
    /// Comfort of the drive.
    pub comfort: Comfort,
    /// Mean displacement between what was planned and what was driven at the same time, meters;
    /// `None` where no plan reached into what was driven.
    pub plan_ade_m: Option<f64>,
    /// Time in which the planner had no plan yet and the ego was kept on its route, seconds.
    pub warm_up_s: f64,
}

impl EpisodeScore {
    /// The score of `episode`.
    #[must_use]
    pub fn new(episode: &Episode) -> Self {
        let done = episode.end == EpisodeEnd::RouteDone;
        let route_completion = progress::route_completion(episode);
        let infractions = infractions::infractions(episode);
        let factor: f64 = infractions.iter().map(Infraction::factor).product();
        let (closest, ttc_short_share) = time_to_collision::closest(episode);
        Self {
            scenario: episode.head.scenario.name.clone(),
            level: episode.head.scenario.level,
            route_completion,
            driving_score: route_completion * factor,
            success: done && infractions.iter().all(|infraction| !infraction.at_fault()),
            infractions,
            closest,
            ttc_short_share,
            comfort: Comfort::new(episode),
            plan_ade_m: plan_error::episode_ade_m(episode),
            warm_up_s: warm_up_s(episode),
        }
    }

    /// The smallest time to collision, seconds.
    #[must_use]
    pub fn min_ttc_s(&self) -> Option<f64> {
        self.closest.map(|closest| closest.ttc_s)
    }

    /// Collisions with vehicles and pedestrians, regardless of fault.
    #[must_use]
    pub fn collisions(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::Collision { .. }))
    }

    /// Collisions with pedestrians, regardless of fault.
    #[must_use]
    pub fn pedestrian_collisions(&self) -> usize {
        let with = RoadUser::Pedestrian;
        self.count(|kind| matches!(kind, InfractionKind::Collision { user, .. } if *user == with))
    }

    /// Collisions with static obstacles: at most one, which ends the episode.
    #[must_use]
    pub fn obstacle_collisions(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::Obstacle { .. }))
    }

    /// Times that the ego left the road.
    #[must_use]
    pub fn layout_infractions(&self) -> usize {
        self.count(|kind| *kind == InfractionKind::Layout)
    }

    /// Stop signs that the ego passed without standing.
    #[must_use]
    pub fn stop_signs(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::StopSign { .. }))
    }

    /// Red lights that the ego ran.
    #[must_use]
    pub fn red_lights(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::RedLight { .. }))
    }

    fn count(&self, counts: impl Fn(&InfractionKind) -> bool) -> usize {
        let counted = |infraction: &&Infraction| counts(&infraction.kind);
        self.infractions.iter().filter(counted).count()
    }
}

fn warm_up_s(episode: &Episode) -> f64 {
    let steps = episode.steps.iter().filter(|step| step.warm_up).count();
    steps as f64 * episode.head.scenario.step_s
}
