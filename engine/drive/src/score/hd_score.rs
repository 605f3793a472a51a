//! HD-Scores from the record of an episode: HUGSIM's own ([`HdScore::from_plans`], in
//! `plan_hd_score`), and the same terms taken from what was driven ([`HdScore::from_driven`]).
//!
//! At each moment, with terms of 0 or 1: `NC * DAC * (5 TTC + 2 C) / 7`. The score of an episode is
//! its route completion times the mean over all moments (Zhou et al., "HUGSIM: A Real-Time,
//! Photo-Realistic and Closed-Loop Simulator for Autonomous Driving", 2024). Terms are those of
//! NAVSIM's PDM score (Dauner et al., "NAVSIM: Data-Driven Non-Reactive Autonomous Vehicle
//! Simulation and Benchmarking", 2024).

use decouplegs_scene::VehicleState;
use decouplegs_scene::episode::{Episode, EpisodeEnd, EpisodeTick};
use glam::DVec2;

use super::progress::route_completion;
use crate::oriented_box::OrientedBox;
use crate::polyline::wrapped;

/// Weights of the time to collision and of comfort.
const WEIGHTS: [f64; 2] = [5.0, 2.0];
/// Moments at which the boxes of the ego and of others are compared, seconds from now.
pub(super) const AHEAD_S: [f64; 2] = [0.5, 1.0];
/// An ego slower than this is on no course for a collision, meters per second.
pub(super) const STANDING_MPS: f64 = 0.005;
/// Time over which rates are differences, half of it before and half of it after a moment, seconds.
const WINDOW_S: f64 = 0.5;
/// Bounds of comfort (nuPlan): acceleration ahead, m/s^2.
pub(super) const AHEAD_MPS2: [f64; 2] = [-4.05, 2.40];
/// Greatest acceleration across, m/s^2.
const ACROSS_MPS2: f64 = 4.89;
/// Greatest jerk ahead, m/s^3.
const AHEAD_MPS3: f64 = 4.13;
/// Greatest jerk, m/s^3.
const JERK_MPS3: f64 = 8.37;
/// Greatest yaw rate, rad/s.
pub(super) const YAW_RADPS: f64 = 0.95;
/// Greatest yaw acceleration, rad/s^2.
pub(super) const YAW_RADPS2: f64 = 1.93;

/// HD-Score of an episode, with the means of its terms; all from 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HdScore {
    /// Share of the route that was driven.
    pub route_completion: f64,
    /// Share of moments without a collision.
    pub no_collision: f64,
    /// Share of moments with all of the ego on the road.
    pub drivable_area: f64,
    /// Share of moments without a collision within a second at present velocities.
    pub time_to_collision: f64,
    /// Share of moments within the bounds of comfort.
    pub comfort: f64,
    /// Route completion times the mean of the product of all terms.
    pub hd_score: f64,
}

impl HdScore {
    /// The score of `episode` in the manner of HUGSIM, from what was driven, at all its moments.
    #[must_use]
    pub fn from_driven(episode: &Episode) -> Self {
        let ticks: Vec<&EpisodeTick> = episode.instants().collect();
        let comfort = comfortable(&ticks);
        let hits_obstacle = matches!(episode.end, EpisodeEnd::Obstacle { .. });
        let mut sums = TermSums::default();
        for (index, tick) in ticks.iter().enumerate() {
            let is_last = index + 1 == ticks.len();
            let collides = touches(episode, tick, 0.0) || hits_obstacle && is_last;
            let is_off_course = tick.ego.speed_mps < STANDING_MPS
                || !AHEAD_S
                    .iter()
                    .any(|ahead_s| touches(episode, tick, *ahead_s));
            sums.add([!collides, tick.on_road, is_off_course, comfort[index]]);
        }
        sums.score(route_completion(episode))
    }
}

/// Sums of the terms over moments or frames, and of their product.
#[derive(Default)]
pub(super) struct TermSums {
    sums: [f64; 5],
    count: f64,
}

impl TermSums {
    /// Adds a moment: no collision, drivable area, time to collision, comfort.
    pub(super) fn add(&mut self, terms: [bool; 4]) {
        let [nc, dac, ttc, c] = terms.map(f64::from);
        let mean = (WEIGHTS[0] * ttc + WEIGHTS[1] * c) / (WEIGHTS[0] + WEIGHTS[1]);
        for (sum, term) in self.sums.iter_mut().zip([nc, dac, ttc, c, nc * dac * mean]) {
            *sum += term;
        }
        self.count += 1.0;
    }

    /// True if no moment was added.
    pub(super) fn is_empty(&self) -> bool {
        self.count == 0.0
    }

    /// The score of an episode with these means.
    pub(super) fn score(&self, route_completion: f64) -> HdScore {
        let [
            no_collision,
            drivable_area,
            time_to_collision,
            comfort,
            mean,
        ] = self.sums.map(|sum| sum / self.count);
        HdScore {
            route_completion,
            no_collision,
            drivable_area,
            time_to_collision,
            comfort,
            hd_score: route_completion * mean,
        }
    }
}

/// True if the box of the ego overlaps that of an agent `ahead_s` after `tick`, all moving on at
/// their velocities.
fn touches(episode: &Episode, tick: &EpisodeTick, ahead_s: f64) -> bool {
    touches_any(episode, tick, ahead_s, |_| true)
}

/// [`touches`] for agents whose middle is not behind the ego's rear.
pub(super) fn touches_ahead(episode: &Episode, tick: &EpisodeTick, ahead_s: f64) -> bool {
    let ego = OrientedBox::for_vehicle(&tick.ego, &episode.head.scenario.ego.size);
    touches_any(episode, tick, ahead_s, |agent| {
        ego.to_local(agent.position_m).x > -ego.half_length_m
    })
}

fn touches_any(
    episode: &Episode,
    tick: &EpisodeTick,
    ahead_s: f64,
    counts: impl Fn(&VehicleState) -> bool,
) -> bool {
    let moved = |outline: OrientedBox, velocity_mps: DVec2| OrientedBox {
        center_m: outline.center_m + velocity_mps * ahead_s,
        ..outline
    };
    let ego = OrientedBox::for_vehicle(&tick.ego, &episode.head.scenario.ego.size);
    let ego = moved(ego, tick.ego.velocity());
    let agents = tick.agents.iter().zip(&episode.head.agent_sizes);
    agents
        .filter_map(|(state, size)| Some((state.as_ref()?, size)))
        .filter(|(state, _)| counts(state))
        .any(|(state, size)| {
            moved(OrientedBox::for_vehicle(state, size), state.velocity()).overlaps(&ego)
        })
}

/// True for each of `ticks` at which the ego is within the bounds of comfort.
pub(super) fn comfortable(ticks: &[&EpisodeTick]) -> Vec<bool> {
    let times_s: Vec<f64> = ticks.iter().map(|tick| tick.time_s).collect();
    let speeds: Vec<f64> = ticks.iter().map(|tick| tick.ego.speed_mps).collect();
    let mut yaw_rad = 0.0;
    let mut yaws = vec![0.0; ticks.len()];
    for (yaw, pair) in yaws.iter_mut().skip(1).zip(ticks.windows(2)) {
        yaw_rad += wrapped(pair[1].ego.yaw_rad - pair[0].ego.yaw_rad);
        *yaw = yaw_rad;
    }
    let ahead = rates(&times_s, &speeds);
    let yaw_rates = rates(&times_s, &yaws);
    let across: Vec<f64> = speeds.iter().zip(&yaw_rates).map(|(v, w)| v * w).collect();
    let jerk_ahead = rates(&times_s, &ahead);
    let jerk_across = rates(&times_s, &across);
    let yaw_accelerations = rates(&times_s, &yaw_rates);
    let is_within = |i: usize| {
        (AHEAD_MPS2[0]..=AHEAD_MPS2[1]).contains(&ahead[i])
            && across[i].abs() <= ACROSS_MPS2
            && jerk_ahead[i].abs() <= AHEAD_MPS3
            && jerk_ahead[i].hypot(jerk_across[i]) <= JERK_MPS3
            && yaw_rates[i].abs() <= YAW_RADPS
            && yaw_accelerations[i].abs() <= YAW_RADPS2
    };
    (0..ticks.len()).map(is_within).collect()
}

/// Rates of `values` at `times_s`: differences over [`WINDOW_S`], one-sided at the ends.
fn rates(times_s: &[f64], values: &[f64]) -> Vec<f64> {
    let reach_s = 0.5 * WINDOW_S + 1e-9;
    let rate = |&time_s: &f64| {
        let first = times_s.partition_point(|&other| other < time_s - reach_s);
        let last = times_s.partition_point(|&other| other <= time_s + reach_s) - 1;
        // Moments farther apart than the window have their neighbors.
        let (first, last) = match first == last {
            true => (first.saturating_sub(1), (last + 1).min(times_s.len() - 1)),
            false => (first, last),
        };
        let span_s = times_s[last] - times_s[first];
        if span_s > 0.0 {
            (values[last] - values[first]) / span_s
        } else {
            0.0
        }
    };
    times_s.iter().map(rate).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_those_of_a_parabola_within() {
        let times_s: Vec<f64> = (0..21).map(|index| 0.1 * f64::from(index)).collect();
        let values: Vec<f64> = times_s.iter().map(|t| t * t).collect();
        let found = rates(&times_s, &values);
        for (time_s, rate) in times_s.iter().zip(&found).skip(3).take(15) {
            assert!((rate - 2.0 * time_s).abs() < 1e-9, "{rate} at {time_s}");
        }
        assert_eq!(rates(&[0.0], &[1.0]), [0.0]);
        assert_eq!(
            rates(&[0.0, 5.0, 10.0], &[0.0, 10.0, 0.0]),
            [2.0, 0.0, -2.0]
        );
    }
}
