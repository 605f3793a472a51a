//! Scores of episodes, from their records alone: no map and no image is needed, so that a log
//! scores the same wherever it is read.
//!
//! As CARLA's leaderboard has it (leaderboard.carla.org, "Evaluation criteria"), a driving score is
//! the share of the route that was completed, times a factor for each infraction. Only collisions
//! that are the ego's fault are penalized so. One that is not ends the episode, and the route
//! counts as completed in the driving score: what the ego could not drive is not taken from it.
//! Success is a completed route without any such infraction, so no set of episodes has more success
//! than completion, nor a driving score above the completion that counts: [`Summary::check`].

use decouplegs_scene::episode::EpisodeHead;
use decouplegs_scene::{Episode, EpisodeEnd, Level, RoadUser};

mod avoidable;
mod comfort;
mod commanded;
mod conduct;
mod extended_pdm_score;
mod fault;
mod hd_score;
mod infractions;
mod lane_keeping;
mod pdm_score;
mod plan_error;
mod plan_hd_score;
mod progress;
mod quantities;
mod reference;
mod speed_limit;
mod summary;
mod time_lost;
mod time_to_collision;

pub use comfort::{Comfort, lateral_accelerations};
pub use commanded::{AgentContact, CommandedAgents};
pub use conduct::{Breach, CONDUCT_FACTOR, Conduct, ConductKind, STANDING_S};
pub use extended_pdm_score::ExtendedPdmScore;
pub use fault::Fault;
pub use hd_score::HdScore;
pub use infractions::{Infraction, InfractionKind};
pub use lane_keeping::LaneKeeping;
pub use pdm_score::PdmScore;
pub use plan_error::{plan_ade_m, plan_errors};
pub use progress::RouteProgress;
pub use quantities::{Quantity, quantities};
pub use reference::ReferenceProgress;
pub use summary::{Moments, SetSummary, Summary};
pub use time_lost::TimeLost;
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
/// Way against the direction of the lanes within a second beyond which it is an infraction, and
/// beyond which it is a grave one, meters: nuPlan's driving direction compliance (Karnchanachari et
/// al., Towards learning-based planning: the nuPlan benchmark for real-world autonomous driving,
/// 2024).
pub const WRONG_WAY_M: f64 = 2.0;
/// See [`WRONG_WAY_M`].
pub const WRONG_WAY_FAR_M: f64 = 6.0;
/// Factor on the driving score for each time the ego drives more than [`WRONG_WAY_M`] against the
/// lanes, as in nuPlan.
pub const WRONG_WAY_FACTOR: f64 = 0.5;
/// Factor on the driving score for more than [`WRONG_WAY_FAR_M`], as in nuPlan.
pub const WRONG_WAY_FAR_FACTOR: f64 = 0.0;

/// Share of the reference's way that is all of it where the scenario's story ended an episode. Our
/// choice: the reference drives without other traffic.
pub const STORY_SHARE: f64 = 0.5;

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
    /// Share of the route that counts in the driving score: 1 where a collision ended the episode
    /// that was not the ego's fault; where the scenario's story ended it, the ego's way as a share
    /// of [`STORY_SHARE`] of the reference's until then, at most 1; otherwise
    /// [`Self::route_completion`].
    pub counted_completion: f64,
    /// True if a collision ended the episode that was not the ego's fault.
    pub ended_by_other: bool,
    /// [`Self::counted_completion`] times [`COLLISION_FACTOR`], [`PEDESTRIAN_FACTOR`],
    /// [`OBSTACLE_FACTOR`], [`LAYOUT_FACTOR`], [`WRONG_WAY_FACTOR`], [`WRONG_WAY_FAR_FACTOR`],
    /// [`RED_LIGHT_FACTOR`] or [`STOP_SIGN_FACTOR`] for each infraction.
    pub driving_score: f64,
    /// True if the route was completed without an infraction of the ego, or the scenario's story
    /// ended the episode when all of what counts was driven.
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
    /// Time that was lost, and by what.
    pub time_lost: TimeLost,
    /// Compliance with speed limits, 0 to 1, as in nuPlan; `None` where the log tells no limit.
    pub speed_compliance: Option<f64>,
}

impl EpisodeScore {
    /// The score of `episode`.
    #[must_use]
    pub fn new(episode: &Episode) -> Self {
        let of_story = reference::share_of_story(episode);
        let route_completion = progress::route_completion(episode);
        let infractions = infractions::infractions(episode);
        let factor: f64 = infractions.iter().map(Infraction::factor).product();
        let (closest, ttc_short_share) = time_to_collision::closest(episode);
        let ended_by_other = ended_by_other(episode, &infractions);
        let counted_completion = match of_story {
            _ if ended_by_other => 1.0,
            Some(share) => (share / STORY_SHARE).min(1.0),
            None => route_completion,
        };
        let done = match of_story {
            Some(share) => share >= STORY_SHARE,
            None => episode.end == EpisodeEnd::RouteDone,
        };
        Self {
            scenario: episode.head.scenario.name.clone(),
            level: episode.head.scenario.level,
            route_completion,
            counted_completion,
            ended_by_other,
            driving_score: counted_completion * factor,
            success: done && infractions.iter().all(|infraction| !infraction.at_fault()),
            infractions,
            closest,
            ttc_short_share,
            comfort: Comfort::new(episode),
            plan_ade_m: plan_error::episode_ade_m(episode),
            warm_up_s: warm_up_s(episode),
            time_lost: TimeLost::new(episode),
            speed_compliance: speed_limit::compliance(episode),
        }
    }

    /// The smallest time to collision, seconds.
    #[must_use]
    pub fn min_ttc_s(&self) -> Option<f64> {
        self.closest.map(|closest| closest.ttc_s)
    }

    /// Times in seconds, and words, of the infractions in the episode of `head`.
    #[must_use]
    pub fn described(&self, head: &EpisodeHead) -> Vec<(f64, String)> {
        let infractions = self.infractions.iter();
        infractions
            .map(|infraction| (infraction.time_s, infraction.describe(head)))
            .collect()
    }

    /// Collisions with vehicles and pedestrians, regardless of fault.
    #[must_use]
    pub fn collisions(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::Collision { .. }))
    }

    /// Collisions that no braking of the ego could avoid, regardless of fault.
    #[must_use]
    pub fn unavoidable_collisions(&self) -> usize {
        self.count(|kind| {
            matches!(
                kind,
                InfractionKind::Collision {
                    is_avoidable: false,
                    ..
                }
            )
        })
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

    /// Times that the ego drove against the direction of the lanes.
    #[must_use]
    pub fn wrong_ways(&self) -> usize {
        self.count(|kind| matches!(kind, InfractionKind::WrongWay { .. }))
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

/// True if a collision ended the episode that was not the ego's fault.
fn ended_by_other(episode: &Episode, infractions: &[Infraction]) -> bool {
    let EpisodeEnd::Collision { agent } = episode.end else {
        return false;
    };
    let ends = |infraction: &&Infraction| matches!(infraction.kind, InfractionKind::Collision { agent: other, .. } if other == agent);
    let last = infractions.iter().rev().find(ends);
    last.is_some_and(|infraction| !infraction.at_fault())
}

fn warm_up_s(episode: &Episode) -> f64 {
    let steps = episode.steps.iter().filter(|step| step.warm_up).count();
    steps as f64 * episode.head.scenario.step_s
}
