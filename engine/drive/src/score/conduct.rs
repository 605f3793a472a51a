//! Rules of the road that are scored beside the driving score, which they leave as it is: progress
//! against a reference at the same time, standing on crossings, blocking, turns from wrong lanes,
//! keeping the lane.

use decouplegs_scene::Episode;
use decouplegs_scene::episode::{EpisodeHead, EpisodeTick};

use super::time_lost::{agents, front_m, leader, waits_for_light};
use super::{EpisodeScore, Infraction, LaneKeeping, ReferenceProgress};
use crate::oriented_box::OrientedBox;

/// Time for which an ego has to stand on a crossing, or to block the road, seconds: longer than to
/// see that the road is free and to start.
pub const STANDING_S: f64 = 5.0;
/// Factor on the score of all rules for each time the ego stands on a crossing, blocks the road or
/// turns from a wrong lane. The driving score does not have it. CARLA's leaderboard has this factor
/// for an ego that holds up traffic.
pub const CONDUCT_FACTOR: f64 = 0.70;
/// Speed below which a vehicle stands, m/s.
const STANDING_MPS: f64 = 0.1;
/// Speed from which a vehicle ahead drives on, and below which one behind is held up, m/s.
const MOVING_MPS: f64 = 1.0;
/// Distance to the rear within which a vehicle is held up, meters, and the largest gap between the
/// sides of both.
const BEHIND_M: f64 = 12.0;
const ASIDE_M: f64 = 0.3;
/// Road users ahead within this distance are waited for, meters, if they move across or towards the
/// ego faster than this, m/s.
const NEAR_M: f64 = 30.0;
const COMING_MPS: f64 = 0.5;

/// Kind of a breach of these rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ConductKind {
    /// The ego stands where lanes cross or people walk, without need: nothing is ahead, or a
    /// vehicle that already stood there when the ego came onto the crossing.
    OnCrossing,
    /// The ego stands with a free road before it, and holds up a vehicle behind it.
    Blocking,
    /// The ego comes through a junction onto a lane to which the lane that it came from does not
    /// lead.
    WrongTurn,
}

impl ConductKind {
    /// All kinds.
    pub const ALL: [Self; 3] = [Self::OnCrossing, Self::Blocking, Self::WrongTurn];

    /// Sentence for reports.
    #[must_use]
    pub const fn describe(self) -> &'static str {
        match self {
            Self::OnCrossing => "stood on a crossing without need",
            Self::Blocking => "blocked the road: free ahead, traffic behind",
            Self::WrongTurn => "went through a junction from a lane that does not lead there",
        }
    }

    /// Name in files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::OnCrossing => "on_crossing",
            Self::Blocking => "blocking",
            Self::WrongTurn => "wrong_turn",
        }
    }
}

/// A breach of these rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breach {
    /// Start, seconds since the start of the episode.
    pub time_s: f64,
    /// Duration, seconds; 0 for a turn.
    pub duration_s: f64,
    /// Kind of the breach.
    pub kind: ConductKind,
}

/// Compliance with these rules in an episode.
#[derive(Clone, Debug, PartialEq)]
pub struct Conduct {
    /// Progress against the reference.
    pub reference: ReferenceProgress,
    /// Breaches, in time. Logs before version 4 tell of blocking alone.
    pub breaches: Vec<Breach>,
    /// Keeping of the lane; `None` in logs before version 4.
    pub lane_keeping: Option<LaneKeeping>,
    /// Score of all rules, 0 to 1: progress against the reference, times the factors of all
    /// infractions of the driving score, [`CONDUCT_FACTOR`] for each breach, the compliance with
    /// speed limits, and the share of time in which the lane was kept. `None` in logs before
    /// version 4.
    pub all_rules_score: Option<f64>,
}

impl Conduct {
    /// Compliance in `episode`, whose `score` is known.
    #[must_use]
    pub fn new(episode: &Episode, score: &EpisodeScore) -> Self {
        let instants: Vec<&EpisodeTick> = episode.instants().collect();
        let reference = ReferenceProgress::new(episode, score);
        let mut breaches = standing(&instants, ConductKind::OnCrossing, |at| {
            stands_on_crossing(&episode.head, &instants, at)
        });
        let blocks = |at: usize| blocks(&episode.head, instants[at]);
        breaches.extend(standing(&instants, ConductKind::Blocking, blocks));
        let is_turn = |tick: &&&EpisodeTick| tick.road.is_some_and(|road| road.wrong_turn);
        breaches.extend(instants.iter().filter(is_turn).map(|tick| Breach {
            time_s: tick.time_s,
            duration_s: 0.0,
            kind: ConductKind::WrongTurn,
        }));
        breaches.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
        let lane_keeping = LaneKeeping::new(episode);
        let factor: f64 = score.infractions.iter().map(Infraction::factor).product();
        let breached = CONDUCT_FACTOR.powi(breaches.len() as i32);
        let limits = score.speed_compliance.unwrap_or(1.0);
        let all_rules = |keeping: LaneKeeping| {
            reference.share * factor * breached * limits * keeping.kept_share()
        };
        Self {
            reference,
            breaches,
            lane_keeping,
            all_rules_score: lane_keeping.map(all_rules),
        }
    }

    /// Number of breaches of a kind.
    #[must_use]
    pub fn count(&self, kind: ConductKind) -> usize {
        self.breaches.iter().filter(|one| one.kind == kind).count()
    }
}

/// Breaches of a kind: as long as `is_so` holds at each moment, and for [`STANDING_S`] at least.
fn standing(
    instants: &[&EpisodeTick],
    kind: ConductKind,
    is_so: impl Fn(usize) -> bool,
) -> Vec<Breach> {
    let mut found = Vec::new();
    let mut start_s: Option<f64> = None;
    for at in 0..=instants.len() {
        let holds = at < instants.len() && is_so(at);
        if holds {
            start_s = start_s.or(Some(instants[at].time_s));
        } else if let Some(time_s) = start_s.take() {
            let duration_s = instants[at - 1].time_s - time_s;
            if duration_s >= STANDING_S - 1e-9 {
                found.push(Breach {
                    time_s,
                    duration_s,
                    kind,
                });
            }
        }
    }
    found
}

/// True if the ego stands on a crossing at moment `at` without need.
fn stands_on_crossing(head: &EpisodeHead, instants: &[&EpisodeTick], at: usize) -> bool {
    let now = instants[at];
    let is_on = |tick: &EpisodeTick| tick.road.is_some_and(|road| road.on_crossing);
    if now.ego.speed_mps >= STANDING_MPS || !is_on(now) {
        return false;
    }
    if waits_for_light(head, now) || waits_for_others(head, now) {
        return false;
    }
    let Some(agent) = leader(head, now) else {
        return true;
    };
    // A vehicle ahead that still moved when the ego came onto the crossing excuses the ego.
    let entry = (0..at).rev().find(|&before| !is_on(instants[before]));
    let Some(before) = entry else { return false };
    let then = instants[before + 1].agents[agent];
    then.is_some_and(|state| state.speed_mps < MOVING_MPS)
}

/// True if the ego stands at a moment with a free road ahead, and a vehicle behind it has to wait.
fn blocks(head: &EpisodeHead, now: &EpisodeTick) -> bool {
    now.ego.speed_mps < STANDING_MPS
        && leader(head, now).is_none()
        && !waits_for_light(head, now)
        && !waits_for_others(head, now)
        && holds_up(head, now)
}

/// True if a road user ahead comes towards the ego or crosses its way.
fn waits_for_others(head: &EpisodeHead, now: &EpisodeTick) -> bool {
    let (front_m, ahead) = (front_m(head, now), now.ego.ahead());
    agents(head, now).any(|(_, state, _)| {
        let velocity = state.velocity();
        let comes = velocity.dot(ahead) < -COMING_MPS;
        let crosses = ahead.perp_dot(velocity).abs() > COMING_MPS;
        let ahead_m = (state.position_m - front_m).dot(ahead);
        (comes || crosses) && ahead_m > 0.0 && state.position_m.distance(front_m) < NEAR_M
    })
}

/// True if a vehicle behind the ego stands or crawls in its way.
fn holds_up(head: &EpisodeHead, now: &EpisodeTick) -> bool {
    let ego = OrientedBox::for_vehicle(&now.ego, &head.scenario.ego.size);
    agents(head, now).any(|(_, state, size)| {
        let at = ego.to_local(state.position_m);
        let gap_m = -at.x - ego.half_length_m - 0.5 * size.length_m;
        let beside_m = at.y.abs() - ego.half_width_m - 0.5 * size.width_m;
        let same_way = (state.yaw_rad - now.ego.yaw_rad).cos() > 0.5;
        let is_near = at.x < 0.0 && gap_m < BEHIND_M && beside_m < ASIDE_M;
        is_near && same_way && state.speed_mps < MOVING_MPS
    })
}
