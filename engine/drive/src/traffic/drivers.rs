//! Drivers of a scenario whose parameters are drawn.

use std::sync::Arc;

use decouplegs_scene::scenario::{Drivers, TrafficAgent};

use super::Traffic;
use super::driver::Driver;
use super::following::each_ahead;
use super::free_speed::classes;
use super::relaxation::Accepted;
use super::signals::STANDING_MPS;

/// Farthest vehicle whose gap is accepted at the start, meters.
const BEHIND_M: f64 = 120.0;
/// Largest share of the allowed speed that a driver is given because the vehicle starts so fast.
const SPEED_SHARE_MAX: f64 = 1.5;

impl Traffic {
    /// The same traffic with drivers from another source. `agents` are those that the traffic was
    /// made of. Comes before [`Traffic::with_story`].
    ///
    /// Drawn drivers accept the gaps that they start with for a while, and want at least the speed
    /// that they start with. Where the free speed is that of a class of road, they accept their
    /// speeds too.
    ///
    /// # Panics
    /// Panics if `agents` are not as many as the traffic has.
    #[must_use]
    pub fn with_drivers(mut self, drivers: Drivers, agents: &[TrafficAgent]) -> Self {
        assert_eq!(agents.len(), self.agents.len(), "agents of other traffic");
        self.drivers = drivers;
        if drivers == Drivers::Kinds {
            return self;
        }
        self.classes = Arc::new(classes(&self.graph));
        for (number, asked) in agents.iter().enumerate() {
            let mut driver = Driver::drawn(asked.kind, asked.driver, self.seed, number);
            let agent = &self.agents[number];
            let limit_mps = self.limit_mps(agent.lane()).max(0.1);
            if agent.cruise_mps.is_none() {
                let share = (agent.speed_mps / limit_mps).min(SPEED_SHARE_MAX);
                driver.speed_share = driver.speed_share.max(share);
            }
            // The map does not tell why all drive as they do: for a while they go on so.
            let is_assumed = agent.cruise_mps.is_none() && self.classes[agent.lane()].is_assumed;
            let free_mps = is_assumed.then_some(limit_mps * driver.speed_share);
            let mut gap_m = None;
            each_ahead(
                &self.graph,
                &self.order,
                agent.path_position(),
                BEHIND_M,
                |seen| {
                    gap_m = Some(seen.rear_m - agent.front_m());
                    false
                },
            );
            let accepted = Accepted::new(&driver, agent.speed_mps, free_mps, gap_m);
            let agent = &mut self.agents[number];
            agent.accepted = accepted;
            agent.driver = driver;
            agent.stands_since_start = agent.speed_mps < STANDING_MPS;
        }
        self
    }

    /// Speed on a lane before drivers take their share, m/s: the limit, or what the class of road
    /// has in place of a limit that the map does not tell.
    pub(super) fn limit_mps(&self, lane: usize) -> f64 {
        let class = self.classes.get(lane);
        class.map_or_else(
            || self.graph.road(lane).speed_limit_mps,
            |class| class.speed_mps,
        )
    }

    /// Speed that a bend allows at `arc_m` of a lane, m/s.
    pub(super) fn curve_mps(&self, lane: usize, arc_m: f64) -> f64 {
        match self.classes.get(lane) {
            Some(class) if class.is_motorway => f64::INFINITY,
            _ => self.graph.cells().curve_mps(lane, arc_m),
        }
    }
}
