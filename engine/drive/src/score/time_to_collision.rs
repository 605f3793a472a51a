//! Times to collision over an episode.

use decouplegs_scene::Episode;

use crate::oriented_box::{OrientedBox, time_to_collision};

/// Collisions farther ahead are none, seconds.
pub const TTC_HORIZON_S: f64 = 10.0;
/// A time to collision below this is a close call, seconds (the bound that surrogate safety studies
/// use: van der Horst and Hogema, "Time-to-collision and collision avoidance systems", 1993).
pub const TTC_SHORT_S: f64 = 1.5;

/// Moment with the shortest time to collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Until the boxes would have touched at the velocities of that moment: 0 where they do.
    pub ttc_s: f64,
    /// Time of that moment, seconds since the start.
    pub time_s: f64,
    /// With whom: the agent's place in the scenario.
    pub agent: usize,
}

/// The smallest time to collision of the ego with any agent, the first of equals, and the share of
/// moments below [`TTC_SHORT_S`].
pub(super) fn closest(episode: &Episode) -> (Option<Closest>, f64) {
    let (mut closest, mut short, mut count): (Option<Closest>, usize, usize) = (None, 0, 0);
    for instant in episode.instants() {
        let ego = OrientedBox::of(&instant.ego, &episode.head.scenario.ego.size);
        let mut least_s = f64::INFINITY;
        for (agent, (state, size)) in instant
            .agents
            .iter()
            .zip(&episode.head.agent_sizes)
            .enumerate()
        {
            let Some(state) = state else { continue };
            let other = OrientedBox::of(state, size);
            let ttc_s = time_to_collision(
                &ego,
                instant.ego.velocity(),
                &other,
                state.velocity(),
                TTC_HORIZON_S,
            );
            let Some(ttc_s) = ttc_s else { continue };
            least_s = least_s.min(ttc_s);
            if closest.is_none_or(|closest| ttc_s < closest.ttc_s) {
                closest = Some(Closest {
                    ttc_s,
                    time_s: instant.time_s,
                    agent,
                });
            }
        }
        short += usize::from(least_s < TTC_SHORT_S);
        count += 1;
    }
    (closest, short as f64 / count as f64)
}
