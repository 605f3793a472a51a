//! Planner that repeats a recorded drive.

use decouplegs_scene::episode::Episode;
use decouplegs_scene::plan::Plan;
use decouplegs_scene::{Pose, TimedPose, Trajectory};

use super::cadence::plan_through;
use super::{
    Cameras, EpisodeInfo, Observation, ObservationRequest, Planner, PlannerError, state_needed,
};

/// Follows a recorded motion in place and time, regardless of what is in the way; beyond its end it
/// stands where the record ends.
///
/// It has to be told where the ego is, as the record is in world coordinates: an ego that has come
/// off the record is led back.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Seconds since the episode's start, world coordinates.
    path: Trajectory,
}

impl Replay {
    /// Planner that drives along `path`, its times in seconds since the episode's start.
    #[must_use]
    pub fn along(path: Trajectory) -> Self {
        Self { path }
    }

    /// Replays the ego's path of `episode`.
    ///
    /// # Errors
    /// Returns an error if the episode's times do not increase or a position is not finite.
    pub fn of_episode(episode: &Episode) -> Result<Self, PlannerError> {
        let stand = |instant: &decouplegs_scene::episode::EpisodeTick| TimedPose {
            time_s: instant.time_s,
            pose: Pose::from_yaw(instant.ego.yaw_rad, instant.ego.position_m.extend(0.0)),
        };
        let path = Trajectory::new(episode.instants().map(stand).collect());
        let scenario = &episode.head.scenario.name;
        Ok(Self {
            path: path.map_err(|fault| {
                PlannerError(format!("the recorded episode {scenario}: {fault}"))
            })?,
        })
    }
}

impl Planner for Replay {
    fn name(&self) -> String {
        "replay".into()
    }

    fn sees(&self) -> ObservationRequest {
        ObservationRequest {
            cameras: Cameras::None,
            privileged: true,
            ..ObservationRequest::default()
        }
    }

    fn uses_readings(&self) -> bool {
        false
    }

    fn begin(&mut self, _: &EpisodeInfo) -> Result<(), PlannerError> {
        Ok(())
    }

    fn plan(&mut self, observation: &Observation) -> Result<Plan, PlannerError> {
        let ego = state_needed(observation, "replay")?.ego;
        plan_through(|time_s| {
            ego.to_local(
                self.path
                    .at(observation.time_s + time_s)
                    .translation
                    .truncate(),
            )
        })
    }
}
