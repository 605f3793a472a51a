//! Times to collision over an episode.

use decouplegs_scene::Episode;
use decouplegs_scene::episode::EpisodeTick;

use crate::oriented_box::{OrientedBox, time_to_collision};

/// Collisions farther ahead are none, seconds.
pub const TTC_HORIZON_S: f64 = 10.0;
/// A time to collision below this is a close call, seconds (the bound that surrogate safety studies
/// use: van der Horst and Hogema, "Time-to-collision and collision avoidance systems", 1993).
pub const TTC_SHORT_S: f64 = 1.5;

/// Moment with the shortest time to collision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Closest {
    /// Time until the boxes would have touched at the velocities of that moment, seconds: 0 where
    /// they touch.
    pub ttc_s: f64,
    /// Time of that moment, seconds since the start.
    pub time_s: f64,
    /// Index of the other agent in the scenario.
    pub agent: usize,
}

/// Smallest time to collision of the ego with any agent at each moment, the first of equals, with
/// the time of the moment, seconds.
#[must_use]
pub fn times_to_collision(episode: &Episode) -> Vec<(f64, Option<Closest>)> {
    let least = |instant: &EpisodeTick| {
        let ego = OrientedBox::for_vehicle(&instant.ego, &episode.head.scenario.ego.size);
        let agents = instant.agents.iter().zip(&episode.head.agent_sizes);
        let times = agents.enumerate().filter_map(|(agent, (state, size))| {
            let state = state.as_ref()?;
            let ttc_s = time_to_collision(
                &ego,
                instant.ego.velocity(),
                &OrientedBox::for_vehicle(state, size),
                state.velocity(),
                TTC_HORIZON_S,
            )?;
            Some(Closest {
                ttc_s,
                time_s: instant.time_s,
                agent,
            })
        });
        times.reduce(|least, next| {
            if next.ttc_s < least.ttc_s {
                next
            } else {
                least
            }
        })
    };
    episode
        .instants()
        .map(|instant| (instant.time_s, least(instant)))
        .collect()
}

/// The smallest time to collision of an episode, the first of equals, and the share of moments
/// below [`TTC_SHORT_S`].
pub(super) fn closest(episode: &Episode) -> (Option<Closest>, f64) {
    let times = times_to_collision(episode);
    let closest = || times.iter().filter_map(|(_, closest)| *closest);
    let short = closest().filter(|closest| closest.ttc_s < TTC_SHORT_S);
    let share = short.count() as f64 / times.len() as f64;
    let least = closest().reduce(|least, next| {
        if next.ttc_s < least.ttc_s {
            next
        } else {
            least
        }
    });
    (least, share)
}
