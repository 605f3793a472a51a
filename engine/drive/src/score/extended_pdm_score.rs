//! Extended PDM score of an episode, in the terms of NAVSIM v2.
//!
//! Followed is autonomousvision/navsim at 0a380a9: `docs/metrics.md` for the formula and its
//! weights, `pdm_scorer.py` and `pdm_comfort_metrics.py` for the terms and their bounds. NAVSIM
//! judges plans of 4 s; this score judges a whole drive, of which the past is part. So HC is the
//! comfort of all that was driven, and EC the share of pairs of plans, 0.5 s apart, that agree.

use decouplegs_scene::VehicleState;
use decouplegs_scene::episode::{Episode, EpisodeTick};
use glam::DVec2;

use super::hd_score::{STANDING_MPS, comfortable};
use super::infractions::against_m_max;
use super::{
    EpisodeScore, InfractionKind, PdmScore, ReferenceProgress, WRONG_WAY_FAR_M, WRONG_WAY_M,
};
use crate::oriented_box::OrientedBox;
use crate::polyline::{Polyline, wrapped};

/// Weights of EP, TTC, LK, HC and EC (NAVSIM).
const WEIGHTS: [f64; 5] = [5.0, 5.0, 2.0, 2.0, 2.0];
/// Moments at which the ego, moving on at its velocity, is compared with where others are then,
/// seconds from now (NAVSIM).
const AHEAD_S: [f64; 4] = [0.0, 0.3, 0.6, 0.9];
/// Distance of the rear axle behind the middle of the ego, as a share of its length: that of
/// NAVSIM's vehicle.
const REAR_AXLE_SHARE: f64 = 0.28;
/// Angles to the heading within which another is ahead, and beyond which it is behind, as cosines:
/// 30 and 150 degrees (nuPlan).
const AHEAD_COS: f64 = 0.866_025_403_784_438_6;
/// Distance from the route beyond which, and time for which, the lane is not kept, meters and
/// seconds (NAVSIM).
const DEVIATION_M: f64 = 0.5;
const DEVIATION_S: f64 = 2.0;
/// Interval of two plans that are compared, and of their poses, seconds (NAVSIM's frames).
const INTERVAL_S: f64 = 0.5;
/// Greatest root mean squares of the differences of two plans in acceleration, jerk, yaw rate and
/// yaw acceleration: m/s^2, m/s^3, rad/s, rad/s^2 (NAVSIM).
const AGREEMENT: [f64; 4] = [0.7, 0.5, 0.1, 0.1];

/// Extended PDM score (EPDMS) and its terms, all from 0 to 1:
/// `NC * DAC * DDC * TLC * (5 EP + 5 TTC + 2 LK + 2 HC + 2 EC) / 16` (NAVSIM v2). A term that is
/// not known is left out of the mean, with its weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExtendedPdmScore {
    /// NC: 0 after a collision at fault with a road user, 0.5 with something static, otherwise 1.
    pub no_collision: f64,
    /// DAC: 0 if the ego ever left the road.
    pub drivable_area: f64,
    /// DDC: 0.5 after 2 m, 0 after 6 m against the lanes within a second, outside of junctions.
    pub driving_direction: f64,
    /// TLC: 0 if the ego ran a red light.
    pub traffic_lights: f64,
    /// EP: progress against the reference at the same time.
    pub progress: f64,
    /// TTC: 0 if the ego, moving on at its velocity, would have met another within 0.9 s.
    pub time_to_collision: f64,
    /// LK: 0 if the ego was more than 0.5 m from its route for 2 s, junctions apart; `None` in logs
    /// before version 4, which do not tell junctions.
    pub lane_keeping: Option<f64>,
    /// HC: 0 if the ego ever left the bounds of comfort.
    pub history_comfort: f64,
    /// EC: share of pairs of plans that agree; `None` where no two plans overlap for long enough.
    pub extended_comfort: Option<f64>,
    /// EPDMS, the score of all terms.
    pub score: f64,
}

impl ExtendedPdmScore {
    /// The score of `episode`, of which the other scores are known.
    #[must_use]
    pub fn new(
        episode: &Episode,
        score: &EpisodeScore,
        pdm: &PdmScore,
        reference: &ReferenceProgress,
    ) -> Self {
        let ticks: Vec<&EpisodeTick> = episode.instants().collect();
        let against_m = against_m_max(&ticks, |tick| !tick.road.is_some_and(|r| r.in_junction));
        let is_red = |kind: &InfractionKind| matches!(kind, InfractionKind::RedLight { .. });
        let has_red = score.infractions.iter().any(|found| is_red(&found.kind));
        let found = Self {
            no_collision: pdm.no_collision,
            drivable_area: pdm.drivable_area,
            driving_direction: match against_m {
                _ if against_m < WRONG_WAY_M => 1.0,
                _ if against_m < WRONG_WAY_FAR_M => 0.5,
                _ => 0.0,
            },
            traffic_lights: f64::from(u8::from(!has_red)),
            progress: reference.share,
            time_to_collision: f64::from(u8::from(keeps_distance(episode, &ticks))),
            lane_keeping: lane_keeping(episode, &ticks),
            history_comfort: f64::from(u8::from(comfortable(&ticks).into_iter().all(|is| is))),
            extended_comfort: extended_comfort(episode),
            score: 0.0,
        };
        found.combined()
    }

    /// The score with NAVSIM's filter: each term in which `human`, a person on the same way, has 0
    /// is 1.
    #[must_use]
    pub fn filtered(self, human: &Self) -> Self {
        let filter = |own: f64, human: f64| if human == 0.0 { 1.0 } else { own };
        let known = |own: Option<f64>, human: Option<f64>| {
            own.map(|own| human.map_or(own, |human| filter(own, human)))
        };
        let found = Self {
            no_collision: filter(self.no_collision, human.no_collision),
            drivable_area: filter(self.drivable_area, human.drivable_area),
            driving_direction: filter(self.driving_direction, human.driving_direction),
            traffic_lights: filter(self.traffic_lights, human.traffic_lights),
            progress: filter(self.progress, human.progress),
            time_to_collision: filter(self.time_to_collision, human.time_to_collision),
            lane_keeping: known(self.lane_keeping, human.lane_keeping),
            history_comfort: filter(self.history_comfort, human.history_comfort),
            extended_comfort: known(self.extended_comfort, human.extended_comfort),
            score: 0.0,
        };
        found.combined()
    }

    /// The same terms with their score.
    fn combined(self) -> Self {
        let factors = [
            self.no_collision,
            self.drivable_area,
            self.driving_direction,
            self.traffic_lights,
        ];
        let terms = [
            Some(self.progress),
            Some(self.time_to_collision),
            self.lane_keeping,
            Some(self.history_comfort),
            self.extended_comfort,
        ];
        let known = || {
            WEIGHTS
                .iter()
                .zip(terms)
                .filter_map(|(w, term)| Some((w, term?)))
        };
        let weighted: f64 = known().map(|(weight, term)| weight * term).sum();
        let weights: f64 = known().map(|(weight, _)| weight).sum();
        let product: f64 = factors.iter().product();
        Self {
            score: product * weighted / weights,
            ..self
        }
    }
}

/// False if the ego, while it moves, would meet another on its way on. Others are where they were
/// recorded. Beside the ego they count where it is not within one lane; one that was met otherwise
/// does not count any more.
fn keeps_distance(episode: &Episode, ticks: &[&EpisodeTick]) -> bool {
    let size = &episode.head.scenario.ego.size;
    let mut is_out = vec![false; episode.head.agent_sizes.len()];
    for tick in ticks {
        if tick.ego.speed_mps < STANDING_MPS {
            continue;
        }
        for ahead_s in AHEAD_S {
            let then_s = tick.time_s + ahead_s - 1e-6;
            let next = ticks.partition_point(|other| other.time_s < then_s);
            let Some(then) = ticks.get(next) else { break };
            let here = OrientedBox::for_vehicle(&tick.ego, size);
            let moved = OrientedBox {
                center_m: here.center_m + tick.ego.velocity() * ahead_s,
                ..here
            };
            let others = then.agents.iter().zip(&episode.head.agent_sizes);
            for (agent, (state, other)) in others.enumerate() {
                let Some(state) = state.as_ref().filter(|_| !is_out[agent]) else {
                    continue;
                };
                if !moved.overlaps(&OrientedBox::for_vehicle(state, other)) {
                    continue;
                }
                if is_concern(tick, state, size.length_m, size.width_m) {
                    return false;
                }
                is_out[agent] = true;
            }
        }
    }
    true
}

/// True if the ego has to mind another: one ahead, or beside it where it is not within one lane.
fn is_concern(tick: &EpisodeTick, other: &VehicleState, length_m: f64, width_m: f64) -> bool {
    let rear_m = tick.ego.position_m - tick.ego.ahead() * (REAR_AXLE_SHARE * length_m);
    let towards = (other.position_m - rear_m).normalize_or_zero();
    let cos = towards.dot(tick.ego.ahead());
    let over_edge = |tick: &EpisodeTick| {
        let road = tick.road?;
        let over = road
            .lane
            .is_some_and(|lane| lane.lateral_m.abs() + 0.5 * width_m > lane.half_width_m);
        Some(over || road.in_junction)
    };
    let is_between = over_edge(tick).unwrap_or(false) || !tick.on_road;
    cos > AHEAD_COS || is_between && cos > -AHEAD_COS
}

/// LK of an episode.
fn lane_keeping(episode: &Episode, ticks: &[&EpisodeTick]) -> Option<f64> {
    let route = episode.head.route_m.iter().map(|point| point.extend(0.0));
    let line = Polyline::new(route)?;
    let mut away_s = 0.0;
    let mut worst_s = 0.0_f64;
    let mut before_s = episode.start.time_s;
    for tick in ticks {
        let step_s = tick.time_s - std::mem::replace(&mut before_s, tick.time_s);
        // A junction does not end it, as there.
        if tick.road?.in_junction {
            continue;
        }
        let is_away = line.project(tick.ego.position_m).distance_m > DEVIATION_M;
        away_s = if is_away { away_s + step_s } else { 0.0 };
        worst_s = worst_s.max(away_s);
    }
    Some(f64::from(u8::from(worst_s < DEVIATION_S - 1e-9)))
}

/// EC of an episode: plans are compared at the same times, from poses [`INTERVAL_S`] apart.
fn extended_comfort(episode: &Episode) -> Option<f64> {
    let begins: Vec<(f64, &VehicleState)> = std::iter::once(&episode.start)
        .chain(episode.steps.iter().filter_map(|step| step.instants.last()))
        .map(|tick| (tick.time_s, &tick.ego))
        .collect();
    let plans: Vec<_> = episode.steps.iter().zip(&begins).collect();
    let position = |index: usize, time_s: f64| {
        let (step, (begin_s, ego)) = plans[index];
        let local = step.plan.at(time_s - begin_s);
        ego.position_m + DVec2::from_angle(ego.yaw_rad).rotate(local)
    };
    let end_s = |index: usize| {
        let (step, (begin_s, _)) = plans[index];
        let points = step.plan.points();
        begin_s + points[points.len() - 1].time_s
    };
    let (mut pairs, mut agree) = (0_u32, 0_u32);
    for first in 0..plans.len() {
        let later_s = plans[first].1.0 + INTERVAL_S - 1e-6;
        let second = plans.partition_point(|(_, (begin_s, _))| *begin_s < later_s);
        if second >= plans.len() || plans[first].0.warm_up || plans[second].0.warm_up {
            continue;
        }
        let from_s = plans[second].1.0;
        let span_s = end_s(first).min(end_s(second)) - from_s;
        let count = (span_s / INTERVAL_S + 1e-6).floor() as usize + 1;
        // Jerk needs four poses.
        if count < 4 {
            continue;
        }
        let of = |index: usize| {
            let at = |pose: usize| position(index, from_s + INTERVAL_S * pose as f64);
            features(&(0..count).map(at).collect::<Vec<_>>())
        };
        let (a, b) = (of(first), of(second));
        pairs += 1;
        let within = a.iter().zip(&b).zip(AGREEMENT).all(|((a, b), most)| {
            let squares = a.iter().zip(b).map(|(a, b)| (a - b) * (a - b));
            (squares.sum::<f64>() / a.len() as f64).sqrt() <= most
        });
        agree += u32::from(within);
    }
    (pairs > 0).then(|| f64::from(agree) / f64::from(pairs))
}

/// Acceleration, jerk, yaw rate and yaw acceleration of poses [`INTERVAL_S`] apart.
fn features(positions_m: &[DVec2]) -> [Vec<f64>; 4] {
    let differences = |values: &[f64]| -> Vec<f64> {
        let pairs = values.windows(2);
        pairs.map(|pair| (pair[1] - pair[0]) / INTERVAL_S).collect()
    };
    let moves: Vec<DVec2> = positions_m
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .collect();
    let velocities: Vec<DVec2> = moves.iter().map(|way| *way / INTERVAL_S).collect();
    let accelerations: Vec<f64> = velocities
        .windows(2)
        .map(|pair| (pair[1] - pair[0]).length() / INTERVAL_S)
        .collect();
    // What stands has the heading that it had.
    let mut heading_rad = 0.0;
    let mut known = false;
    let headings: Vec<f64> = moves
        .iter()
        .map(|way| {
            if way.length() > 0.05 {
                let new_rad = way.y.atan2(way.x);
                heading_rad = match std::mem::replace(&mut known, true) {
                    true => heading_rad + wrapped(new_rad - heading_rad),
                    false => new_rad,
                };
            }
            heading_rad
        })
        .collect();
    let yaw_rates = differences(&headings);
    let jerks = differences(&accelerations);
    let yaw_accelerations = differences(&yaw_rates);
    [accelerations, jerks, yaw_rates, yaw_accelerations]
}
