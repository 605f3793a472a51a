//! PDM score of an episode, in the terms of NAVSIM.

use decouplegs_scene::episode::{Episode, EpisodeTick};

use super::hd_score::{AHEAD_S, STANDING_MPS, comfortable, touches_ahead};
use super::{EpisodeScore, InfractionKind};

/// NC after a collision with something static (NAVSIM).
const OBSTACLE_TERM: f64 = 0.5;
/// Weights of progress, of the time to collision and of comfort (NAVSIM).
const WEIGHTS: [f64; 3] = [5.0, 5.0, 2.0];

/// PDM score (PDMS) and its terms, all from 0 to 1: `NC * DAC * (5 EP + 5 TTC + 2 C) / 12` (Dauner
/// et al., "NAVSIM: Data-Driven Non-Reactive Autonomous Vehicle Simulation and Benchmarking",
/// 2024). NAVSIM judges plans of 4 s against a planner that knows the future; this one judges what
/// was driven against the route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PdmScore {
    /// NC: 0 after a collision at fault with a road user, 0.5 with something static, otherwise 1.
    pub no_collision: f64,
    /// DAC: 0 if the ego ever left the road.
    pub drivable_area: f64,
    /// EP: share of the route that counts.
    pub progress: f64,
    /// TTC: 0 if the ego, while it moved, would ever have met a vehicle that is not behind it
    /// within a second.
    pub time_to_collision: f64,
    /// C: 0 if the ego ever left the bounds of comfort.
    pub comfort: f64,
    /// PDMS, the score of all terms.
    pub pdm_score: f64,
}

impl PdmScore {
    /// The score of `episode`, whose `score` is known.
    #[must_use]
    pub fn new(episode: &Episode, score: &EpisodeScore) -> Self {
        let ticks: Vec<&EpisodeTick> = episode.instants().collect();
        let faults = score.infractions.iter().filter(|found| found.at_fault());
        let no_collision = faults.map(|infraction| match infraction.kind {
            InfractionKind::Collision { .. } => 0.0,
            InfractionKind::Obstacle { .. } => OBSTACLE_TERM,
            _ => 1.0,
        });
        let no_collision = no_collision.fold(1.0, f64::min);
        let drivable_area = f64::from(u8::from(score.layout_infractions() == 0));
        let meets = |tick: &EpisodeTick| {
            tick.ego.speed_mps >= STANDING_MPS
                && AHEAD_S
                    .iter()
                    .any(|&ahead_s| touches_ahead(episode, tick, ahead_s))
        };
        let time_to_collision = f64::from(u8::from(!ticks.iter().copied().any(meets)));
        let comfort = f64::from(u8::from(comfortable(&ticks).into_iter().all(|is| is)));
        let progress = score.counted_completion;
        let [ep, ttc, c] = WEIGHTS;
        let mean = (ep * progress + ttc * time_to_collision + c * comfort) / (ep + ttc + c);
        Self {
            no_collision,
            drivable_area,
            progress,
            time_to_collision,
            comfort,
            pdm_score: no_collision * drivable_area * mean,
        }
    }
}
