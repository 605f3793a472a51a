//! Time that an ego lost against its cruising speed, and by what.

use std::collections::BTreeMap;

use decouplegs_scene::episode::{EpisodeHead, EpisodeTick};
use decouplegs_scene::{Episode, LightColor, VehicleSize, VehicleState};
use glam::DVec2;

use crate::oriented_box::OrientedBox;

/// A vehicle is followed up to this gap: meters, and seconds at the ego's speed.
const GAP_M: f64 = 10.0;
const GAP_S: f64 = 2.0;
/// Largest gap between the sides of two vehicles across at which one is behind the other, meters.
const ASIDE_M: f64 = 0.3;
/// A line is waited for, or braked for, from this distance: meters, and seconds at the ego's speed.
const LINE_M: f64 = 15.0;
const LINE_S: f64 = 3.0;
/// Distance behind a line up to which the ego may stand, meters.
const PAST_LINE_M: f64 = 1.0;
/// Road users who cross are yielded to within this distance of the ego's front, meters, if they
/// move faster than this across, m/s.
const CROSSING_M: f64 = 20.0;
const CROSSING_MPS: f64 = 0.5;

/// Time that was lost against driving at the cruising speed of the scenario: `dt (1 - v / cruise)`,
/// where the ego is slower. A moment counts for the first that is found: a vehicle that the ego is
/// behind, a light that is not green, road users who cross or a sign, all else.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TimeLost {
    /// Time behind each agent, by its index in the scenario, seconds.
    pub behind_s: BTreeMap<usize, f64>,
    /// Time before lights that were red or yellow, seconds.
    pub light_s: f64,
    /// Time before signs, and for road users who crossed, seconds.
    pub yielding_s: f64,
    /// All other time: bends, starting, and what only the planner knows, seconds.
    pub other_s: f64,
}

impl TimeLost {
    /// Times of `episode`.
    #[must_use]
    pub(super) fn new(episode: &Episode) -> Self {
        let mut lost = Self::default();
        let cruise_mps = episode.head.scenario.ego.cruise_mps;
        let instants: Vec<&EpisodeTick> = episode.instants().collect();
        for pair in instants.windows(2) {
            let (step_s, now) = (pair[1].time_s - pair[0].time_s, pair[1]);
            let share = 1.0 - now.ego.speed_mps / cruise_mps;
            // A cruising speed of 0 loses nothing.
            if !(share > 0.0 && share <= 1.0) {
                continue;
            }
            let lost_s = share * step_s;
            if let Some(agent) = leader(&episode.head, now) {
                *lost.behind_s.entry(agent).or_default() += lost_s;
            } else if waits_for_light(&episode.head, now) {
                lost.light_s += lost_s;
            } else if yields(&episode.head, now) {
                lost.yielding_s += lost_s;
            } else {
                lost.other_s += lost_s;
            }
        }
        lost
    }

    /// Time behind all agents, seconds.
    #[must_use]
    pub fn behind_all_s(&self) -> f64 {
        self.behind_s.values().sum()
    }

    /// Time that was lost in all, seconds.
    #[must_use]
    pub fn sum_s(&self) -> f64 {
        self.behind_all_s() + self.light_s + self.yielding_s + self.other_s
    }

    /// The agent behind which most time was lost, and how much, seconds.
    #[must_use]
    pub fn longest_behind(&self) -> Option<(usize, f64)> {
        let agents = self.behind_s.iter();
        let longest = agents.max_by(|a, b| a.1.total_cmp(b.1))?;
        Some((*longest.0, *longest.1))
    }
}

/// Agents on the map at a moment, with their indices and sizes.
pub(super) fn agents<'a>(
    head: &'a EpisodeHead,
    now: &'a EpisodeTick,
) -> impl Iterator<Item = (usize, &'a VehicleState, &'a VehicleSize)> {
    let agents = now.agents.iter().zip(&head.agent_sizes).enumerate();
    agents.filter_map(|(agent, (state, size))| Some((agent, state.as_ref()?, size)))
}

/// The nearest agent that the ego is behind.
pub(super) fn leader(head: &EpisodeHead, now: &EpisodeTick) -> Option<usize> {
    let ego = OrientedBox::for_vehicle(&now.ego, &head.scenario.ego.size);
    let near_m = GAP_M + GAP_S * now.ego.speed_mps;
    let gaps = agents(head, now).filter_map(|(agent, state, size)| {
        let at = ego.to_local(state.position_m);
        let turned = DVec2::from_angle(state.yaw_rad - now.ego.yaw_rad);
        let gap_m = at.x - ego.half_length_m - 0.5 * size.length_m;
        let beside_m = at.y.abs() - ego.half_width_m - 0.5 * size.width_m;
        let is_before = at.x > 0.0 && gap_m < near_m && beside_m < ASIDE_M;
        (is_before && turned.x > 0.5).then_some((agent, gap_m))
    });
    gaps.min_by(|a, b| a.1.total_cmp(&b.1)).map(|gap| gap.0)
}

/// Middle of the ego's front.
pub(super) fn front_m(head: &EpisodeHead, now: &EpisodeTick) -> DVec2 {
    now.ego.position_m + now.ego.ahead() * (0.5 * head.scenario.ego.size.length_m)
}

/// True if the ego is before a line whose light is not green.
pub(super) fn waits_for_light(head: &EpisodeHead, now: &EpisodeTick) -> bool {
    let mut lines = head.stop_lines.iter();
    lines.any(|line| {
        let (along_m, is_before) = line.locate(front_m(head, now));
        let near_m = LINE_M + LINE_S * now.ego.speed_mps;
        is_before
            && (-near_m..PAST_LINE_M).contains(&along_m)
            && head.scenario.lights[line.index].color_at(now.time_s) != LightColor::Green
    })
}

/// True if the ego is before a sign, or a road user crosses before it.
fn yields(head: &EpisodeHead, now: &EpisodeTick) -> bool {
    let front_m = front_m(head, now);
    let mut lines = head.sign_lines.iter();
    let at_sign = lines.any(|line| {
        let (along_m, is_before) = line.locate(front_m);
        is_before && (-LINE_M..PAST_LINE_M).contains(&along_m)
    });
    let crosses = |state: &VehicleState| {
        let across_mps = now.ego.ahead().perp_dot(state.velocity());
        let ahead_m = (state.position_m - front_m).dot(now.ego.ahead());
        across_mps.abs() > CROSSING_MPS
            && ahead_m > 0.0
            && state.position_m.distance(front_m) < CROSSING_M
    };
    at_sign || agents(head, now).any(|(_, state, _)| crosses(state))
}
