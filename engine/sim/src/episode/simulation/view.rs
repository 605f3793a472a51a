//! The world as one ego knows it: its motion, its route, and all others as agents.

use decouplegs_drive::{Ego, Route};
use decouplegs_scene::episode::{EpisodeEnd, EpisodeTick, StopLineRecord};
use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{Motion, Pose, VehicleSize};
use decouplegs_session::{SessionError, World};
use glam::DVec2;

use super::Simulation;
use super::driven_ego::{DrivenEgo, line_of};

/// One of the egos of a [`Simulation`], and what it knows. The first ego has its place among the
/// agents that it sees.
#[derive(Clone, Copy)]
pub struct EgoView<'a> {
    pub(super) simulation: &'a Simulation,
    pub(super) index: usize,
}

impl<'a> EgoView<'a> {
    pub(super) fn driven(&self) -> &'a DrivenEgo {
        &self.simulation.egos[self.index]
    }

    /// Simulation that it is a part of.
    #[must_use]
    pub fn simulation(&self) -> &'a Simulation {
        self.simulation
    }

    /// Task of the ego.
    #[must_use]
    pub fn task(&self) -> &'a EgoTask {
        &self.driven().task
    }

    /// The vehicle.
    #[must_use]
    pub fn ego(&self) -> &'a Ego {
        &self.driven().ego
    }

    /// The ego's way.
    #[must_use]
    pub fn route(&self) -> &'a Route {
        &self.driven().route
    }

    /// The route as a line on the plane, meters.
    #[must_use]
    pub fn route_m(&self) -> Vec<DVec2> {
        line_of(self.route())
    }

    /// Meters along the route where the ego had come farthest.
    #[must_use]
    pub fn progress_m(&self) -> f64 {
        self.driven().progress.progress_m()
    }

    /// Reason of its end, if it has ended.
    #[must_use]
    pub fn end(&self) -> Option<&'a EpisodeEnd> {
        self.driven().end.as_ref().map(|(end, _)| end)
    }

    /// True if it is on the road: it has not ended, or just now.
    #[must_use]
    pub fn is_here(&self) -> bool {
        self.simulation.ego_state(self.index).is_some()
    }

    /// Boxes of the agents that it sees.
    #[must_use]
    pub fn agent_sizes(&self) -> Vec<VehicleSize> {
        self.simulation.sizes_for(self.index)
    }

    /// State of all vehicles now.
    #[must_use]
    pub fn instant(&self) -> EpisodeTick {
        let Simulation { site, .. } = self.simulation;
        let agents = self.simulation.agents_for(self.index);
        self.driven().tick(site, self.simulation.time_s(), agents)
    }

    /// Stop lines of the lights that are for the ego's way, among all: not those towards
    /// successors that its route does not take.
    pub fn stop_lines(&self) -> impl Iterator<Item = &'a StopLineRecord> {
        let lanes: Vec<usize> = self.route().lanes().iter().map(|&(_, lane)| lane).collect();
        let lines = self.simulation.lights().lines().iter();
        lines
            .filter(move |line| line.concerns(&lanes))
            .map(|line| &line.record)
    }

    /// Pose of the ego now, world coordinates, and its motion.
    #[must_use]
    pub fn pose(&self) -> (Pose, Motion) {
        let Simulation { egos, .. } = self.simulation;
        let driven = &egos[self.index];
        let (state, vehicle) = (driven.ego.state(), self.simulation.vehicle_of(self.index));
        let time_s = self.simulation.time_s();
        let pose = self.recorded_pose(time_s);
        let pose = pose.unwrap_or_else(|| self.simulation.pose(vehicle, &state, &driven.task.size));
        let motion = match &driven.recorded {
            None => self.simulation.motion_of(vehicle, state, &pose),
            Some(way) => way.motion_at(way.start_s() + time_s),
        };
        (pose, motion)
    }

    /// Puts the agents, the other egos, the lamps of traffic lights and the signs into `world` as
    /// they are now, and takes out all others. Returns the ego's pose, world coordinates, and its
    /// motion.
    ///
    /// # Errors
    /// Returns an error if the scene of `world` has not the assets.
    pub fn show(&self, world: &mut World) -> Result<(Pose, Motion), SessionError> {
        self.simulation.show_all(world)?;
        if let Some(instance) = self.simulation.ego_instance(self.index) {
            *world = world.without_each(&[instance]).swap_remove(0);
        }
        Ok(self.pose())
    }
}
