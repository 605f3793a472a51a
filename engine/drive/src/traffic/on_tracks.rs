//! Road users on recorded tracks, among the rest of the traffic.

use decouplegs_scene::episode::HandoverRecord;
use decouplegs_scene::{VehicleSize, VehicleState};

use super::tracked::Followers;
use super::{EgoBox, Traffic};
use crate::story::Stage;

/// Road users on no track, each at its own place of the list; `None` while one is not there.
pub(super) type Others = Vec<Option<(VehicleState, VehicleSize)>>;

impl Traffic {
    /// Takes the handovers of recorded road users since this was asked last.
    pub fn take_handovers(&mut self) -> Vec<HandoverRecord> {
        let actors = self.stage.iter().flat_map(Stage::states).count();
        let first = self.agents.len() + self.pedestrians.len() + actors;
        let tracked = self.tracked.as_mut();
        tracked.map_or_else(Vec::new, |tracked| tracked.take_handovers(first))
    }

    /// Boxes of those that are on no lane and no path: actors and those on tracks.
    pub(super) fn scripted(&self) -> impl Iterator<Item = (VehicleState, VehicleSize)> {
        let actors = self.stage.iter().flat_map(Stage::shown);
        actors.chain(self.tracked.iter().flat_map(Followers::shown))
    }

    /// Road users as recorded vehicles see them at the beginning of a step; empty if no vehicle
    /// is on a track.
    pub(super) fn seen_from_tracks(&self, egos: &[EgoBox]) -> Others {
        if self.tracked.is_none() {
            return Vec::new();
        }
        let (first, others) = egos.split_at(egos.len().min(1));
        let agents = self.agents.iter().map(|agent| agent.size);
        let walkers = self.pedestrians.iter().map(|walker| walker.size());
        let on_ways = self.states.iter().zip(agents.chain(walkers));
        let on_ways = on_ways.map(|(state, size)| Some(((*state)?, size)));
        let actors = self.stage.iter().flat_map(Stage::all);
        let first = first.iter().copied();
        first
            .chain(on_ways)
            .chain(actors)
            .chain(others.iter().copied())
            .collect()
    }

    /// Advances those on tracks by `dt_s` seconds.
    pub(super) fn step_tracked(&mut self, dt_s: f64, others: &Others) {
        let Some(tracked) = &mut self.tracked else {
            return;
        };
        tracked.step(self.time_s, dt_s, others);
        let first = self.states.len() - tracked.states().count();
        for (state, moved) in self.states[first..].iter_mut().zip(tracked.states()) {
            *state = moved;
        }
    }
}
