//! Infractions of an episode: collisions, excursions from the road, red lights and stop signs.

use std::collections::VecDeque;

use decouplegs_scene::episode::{EpisodeHead, EpisodeTick, StopLineRecord};
use decouplegs_scene::{Episode, EpisodeEnd, LightColor, ObstacleKind, RoadUser, SignKind};
use glam::DVec2;

use super::avoidable::is_avoidable;
use super::fault::{Fault, fault};
use super::{
    COLLISION_FACTOR, LAYOUT_FACTOR, OBSTACLE_FACTOR, PEDESTRIAN_FACTOR, RED_LIGHT_FACTOR,
    STOP_SIGN_FACTOR, WRONG_WAY_FACTOR, WRONG_WAY_FAR_FACTOR, WRONG_WAY_FAR_M, WRONG_WAY_M,
};
use crate::oriented_box::OrientedBox;

/// Time on the road after which an excursion is over, seconds: a vehicle that drives along the edge
/// leaves the road once.
const BACK_ON_ROAD_S: f64 = 1.0;
/// Two contacts with the same agent are one where the boxes were apart for less, seconds.
const APART_S: f64 = 1.0;
/// Time within which the way against the lanes is added up, seconds (nuPlan).
const WRONG_WAY_S: f64 = 1.0;
/// The ego has stood at a sign where it was slower than this, nearer than this before the line, m/s
/// and meters.
const STANDING_MPS: f64 = 0.3;
const AT_LINE_M: f64 = 4.0;

/// One thing that went wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Infraction {
    /// Start, seconds since the start of the episode.
    pub time_s: f64,
    /// Kind of the infraction.
    pub kind: InfractionKind,
}

/// Kind of an infraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InfractionKind {
    /// The ego's box touches an agent's.
    Collision {
        /// Index of the agent in the scenario.
        agent: usize,
        /// Kind of the agent.
        user: RoadUser,
        /// Fault, and the reason.
        fault: Fault,
        /// False if no braking of the ego would have helped, from the moment on at which the agent
        /// was in its way.
        is_avoidable: bool,
    },
    /// The ego's box touches something static.
    Obstacle {
        /// Kind of the obstacle.
        kind: ObstacleKind,
    },
    /// The ego leaves the road.
    Layout,
    /// The ego drives against the direction of the lanes below it.
    WrongWay {
        /// True beyond [`WRONG_WAY_FAR_M`](super::WRONG_WAY_FAR_M).
        is_far: bool,
    },
    /// The front of the ego passes the line of a stop sign without having stood before it.
    StopSign {
        /// Index of the sign in the scenario.
        sign: usize,
    },
    /// The front of the ego passes a stop line while its light is red.
    RedLight {
        /// Index of the light in the scenario.
        light: usize,
    },
}

impl Infraction {
    /// Kind of the infraction in words, in the episode of `head`.
    #[must_use]
    pub fn describe(&self, head: &EpisodeHead) -> String {
        match self.kind {
            InfractionKind::Layout => "off the road".to_owned(),
            InfractionKind::WrongWay { is_far } => {
                let way_m = if is_far { WRONG_WAY_FAR_M } else { WRONG_WAY_M };
                format!("more than {way_m} m in a second against the lane")
            }
            InfractionKind::RedLight { light } => {
                format!("red light {}", head.scenario.lights[light].name)
            }
            InfractionKind::StopSign { sign } => {
                format!("stop sign on lane {}", head.scenario.signs[sign].line.lane)
            }
            InfractionKind::Obstacle { kind } => format!("collision with a {}", kind.name()),
            InfractionKind::Collision {
                agent,
                fault,
                is_avoidable,
                ..
            } => {
                let name = head.scenario.agent(agent).0;
                let braking = if is_avoidable {
                    ""
                } else {
                    "; braking could not avoid it"
                };
                format!("collision with {name}, {}{braking}", fault.why())
            }
        }
    }

    /// True if the ego is at fault.
    #[must_use]
    pub fn at_fault(&self) -> bool {
        match self.kind {
            InfractionKind::Collision { fault, .. } => fault.at_fault(),
            InfractionKind::Obstacle { .. }
            | InfractionKind::Layout
            | InfractionKind::WrongWay { .. }
            | InfractionKind::RedLight { .. }
            | InfractionKind::StopSign { .. } => true,
        }
    }

    /// Factor on the driving score.
    #[must_use]
    pub fn factor(&self) -> f64 {
        match self.kind {
            InfractionKind::Collision { user, fault, .. } => match user {
                _ if !fault.at_fault() => 1.0,
                RoadUser::Pedestrian => PEDESTRIAN_FACTOR,
                _ => COLLISION_FACTOR,
            },
            InfractionKind::Obstacle { .. } => OBSTACLE_FACTOR,
            InfractionKind::Layout => LAYOUT_FACTOR,
            InfractionKind::WrongWay { is_far: false } => WRONG_WAY_FACTOR,
            InfractionKind::WrongWay { is_far: true } => WRONG_WAY_FAR_FACTOR,
            InfractionKind::RedLight { .. } => RED_LIGHT_FACTOR,
            InfractionKind::StopSign { .. } => STOP_SIGN_FACTOR,
        }
    }
}

/// All infractions of an episode, in time.
pub(super) fn infractions(episode: &Episode) -> Vec<Infraction> {
    let instants: Vec<&EpisodeTick> = episode.instants().collect();
    let mut infractions = excursions(&instants);
    infractions.extend(wrong_ways(&instants));
    infractions.extend(collisions(episode, &instants));
    infractions.extend(red_lights(episode, &instants));
    infractions.extend(stop_signs(episode, &instants));
    if let (EpisodeEnd::Obstacle { obstacle }, Some(last)) = (&episode.end, instants.last()) {
        let kind = InfractionKind::Obstacle {
            kind: obstacle.kind,
        };
        infractions.push(Infraction {
            time_s: last.time_s,
            kind,
        });
    }
    infractions.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    infractions
}

fn excursions(instants: &[&EpisodeTick]) -> Vec<Infraction> {
    let mut excursions = Vec::new();
    // When the ego was last off the road, while that excursion is not over.
    let mut off_s: Option<f64> = None;
    for instant in instants {
        off_s = off_s.filter(|off_s| instant.time_s - off_s < BACK_ON_ROAD_S);
        if !instant.on_road {
            if off_s.is_none() {
                excursions.push(Infraction {
                    time_s: instant.time_s,
                    kind: InfractionKind::Layout,
                });
            }
            off_s = Some(instant.time_s);
        }
    }
    excursions
}

/// Longest way against the lanes within [`WRONG_WAY_S`], meters, of the moments that `counts`.
pub(super) fn against_m_max(
    instants: &[&EpisodeTick],
    counts: impl Fn(&EpisodeTick) -> bool,
) -> f64 {
    let against = ways_against(instants, counts);
    against.into_iter().map(|way| way.1).fold(0.0, f64::max)
}

/// Way against the lanes within the [`WRONG_WAY_S`] before each moment, with its time, seconds and
/// meters.
fn ways_against(
    instants: &[&EpisodeTick],
    counts: impl Fn(&EpisodeTick) -> bool,
) -> Vec<(f64, f64)> {
    // Ways against the lanes within the last second, with the times of their ends.
    let mut ways: VecDeque<(f64, f64)> = VecDeque::new();
    let pairs = instants.windows(2).map(|pair| {
        let (from_s, to_s) = (pair[0].time_s, pair[1].time_s);
        let lanes = pair[1].lanes.filter(|_| counts(pair[1]));
        let against_mps = lanes.map_or(0.0, |lanes| lanes.against_mps);
        ways.push_back((to_s, against_mps * (to_s - from_s)));
        while ways
            .front()
            .is_some_and(|way| way.0 <= to_s - WRONG_WAY_S + 1e-9)
        {
            ways.pop_front();
        }
        (to_s, ways.iter().map(|way| way.1).sum())
    });
    pairs.collect()
}

/// Drives against the lanes, each once: it is over when the ego has not driven against them for
/// [`WRONG_WAY_S`]. Nothing is known of logs before version 3.
fn wrong_ways(instants: &[&EpisodeTick]) -> Vec<Infraction> {
    let mut found: Vec<Infraction> = Vec::new();
    let mut is_over = true;
    for (to_s, way_m) in ways_against(instants, |_| true) {
        let is_far = way_m > WRONG_WAY_FAR_M;
        let kind = InfractionKind::WrongWay { is_far };
        if way_m > WRONG_WAY_M && is_over {
            found.push(Infraction { time_s: to_s, kind });
        } else if let Some(last) = found.last_mut().filter(|_| is_far) {
            last.kind = kind;
        }
        is_over = way_m == 0.0 || is_over && way_m <= WRONG_WAY_M;
    }
    found
}

/// Passage of the middle of the ego's front over a line in driving direction, between two states.
struct Passage {
    /// Index of the state before it.
    at: usize,
    /// Time, interpolated.
    time_s: f64,
}

fn passages(episode: &Episode, instants: &[&EpisodeTick], line: &StopLineRecord) -> Vec<Passage> {
    let pairs = instants.windows(2).enumerate();
    let passages = pairs.filter_map(|(at, pair)| {
        let (from_m, to_m) = (front_m(episode, pair[0]), front_m(episode, pair[1]));
        let (before_m, after_m) = (line.locate(from_m).0, line.locate(to_m).0);
        if before_m >= 0.0 || after_m < 0.0 {
            return None;
        }
        let share = before_m / (before_m - after_m);
        let time_s = pair[0].time_s + share * (pair[1].time_s - pair[0].time_s);
        let is_over = line.locate(from_m.lerp(to_m, share)).1;
        is_over.then_some(Passage { at, time_s })
    });
    passages.collect()
}

/// Middle of the ego's front.
fn front_m(episode: &Episode, instant: &EpisodeTick) -> DVec2 {
    let half_m = 0.5 * episode.head.scenario.ego.size.length_m;
    instant.ego.position_m + instant.ego.ahead() * half_m
}

/// Adds an infraction, unless it is known: lanes beside each other have a line each.
fn add(passed: &mut Vec<Infraction>, kind: InfractionKind, time_s: f64) {
    let is_same =
        |other: &Infraction| other.kind == kind && (other.time_s - time_s).abs() < APART_S;
    if !passed.iter().any(is_same) {
        passed.push(Infraction { time_s, kind });
    }
}

/// Stop lines that the ego passes at red.
fn red_lights(episode: &Episode, instants: &[&EpisodeTick]) -> Vec<Infraction> {
    let head = &episode.head;
    let mut passed = Vec::new();
    for line in &head.stop_lines {
        for Passage { time_s, .. } in passages(episode, instants, line) {
            let light = line.index;
            if head.scenario.lights[light].color_at(time_s) == LightColor::Red {
                add(&mut passed, InfractionKind::RedLight { light }, time_s);
            }
        }
    }
    passed
}

/// Stop signs that the ego passes without having stood before their lines.
fn stop_signs(episode: &Episode, instants: &[&EpisodeTick]) -> Vec<Infraction> {
    let head = &episode.head;
    let mut passed = Vec::new();
    let is_stop = |line: &&StopLineRecord| head.scenario.signs[line.index].kind == SignKind::Stop;
    for line in head.sign_lines.iter().filter(is_stop) {
        for Passage { at, time_s } in passages(episode, instants, line) {
            let stands = |instant: &&&EpisodeTick| {
                let (along_m, is_before) = line.locate(front_m(episode, instant));
                instant.ego.speed_mps < STANDING_MPS
                    && is_before
                    && (-AT_LINE_M..=0.0).contains(&along_m)
            };
            if !instants[..=at].iter().any(|instant| stands(&instant)) {
                let sign = line.index;
                add(&mut passed, InfractionKind::StopSign { sign }, time_s);
            }
        }
    }
    passed
}

fn collisions(episode: &Episode, instants: &[&EpisodeTick]) -> Vec<Infraction> {
    let mut collisions = Vec::new();
    for (agent, size) in episode.head.agent_sizes.iter().enumerate() {
        let mut touched_s: Option<f64> = None;
        for (at, instant) in instants.iter().enumerate() {
            let Some(Some(state)) = instant.agents.get(agent) else {
                continue;
            };
            touched_s = touched_s.filter(|touched_s| instant.time_s - touched_s < APART_S);
            // The record's own word counts, too: it may have looked between its moments.
            let message =
                at + 1 == instants.len() && episode.end == EpisodeEnd::Collision { agent };
            let ego = OrientedBox::for_vehicle(&instant.ego, &episode.head.scenario.ego.size);
            if message || ego.overlaps(&OrientedBox::for_vehicle(state, size)) {
                if touched_s.is_none() {
                    let kind = InfractionKind::Collision {
                        agent,
                        user: episode.head.scenario.agent(agent).1,
                        fault: fault(episode, instants, at, agent),
                        is_avoidable: is_avoidable(
                            instants,
                            at,
                            agent,
                            [&episode.head.scenario.ego.size, size],
                        ),
                    };
                    collisions.push(Infraction {
                        time_s: instant.time_s,
                        kind,
                    });
                }
                touched_s = Some(instant.time_s);
            }
        }
    }
    collisions
}
