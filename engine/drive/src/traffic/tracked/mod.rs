//! Road users on recorded tracks, and their handover to the driver model.
//!
//! A recorded road user stands where its track says, until the ego, or a vehicle that was handed
//! over, is in the way of what was recorded (`Handover::Near`): within the next [`REACH_S`] it
//! would come nearer than [`REACH_GAP_M`] to it, or have to brake harder than [`REACH_MPS2`].
//! Expected of the ego is that it keeps its speed and turn, of vehicles that were handed over that
//! they keep their speed on their lines. From then on it drives on its own recorded line by the
//! intelligent driver model, with the gap that it had: where the driver changed lanes, it does.
//! Pedestrians keep to their tracks. Who appears where another road user is not recorded any more
//! stays away.
//!
//! All act on what was before the step: everything follows from the tracks and the motion of the
//! ego, bit by bit.

mod driving;
mod steered;
mod way;

use std::sync::Arc;

use decouplegs_scene::episode::HandoverRecord;
use decouplegs_scene::scenario::DriverKind;
use decouplegs_scene::story::{Handover, TrackedAgent, Tracks};
use decouplegs_scene::{LaneMap, RoadUser, VehicleSize, VehicleState};
use glam::DVec2;

use self::driving::{Ahead, Driving};
use self::steered::Steered;
use self::way::{Seen, Way};
use super::driver::Driver;
use crate::lane_index::LaneIndex;
use crate::oriented_box::OrientedBox;
use crate::polyline::wrapped;

/// Time for which a recorded motion is looked ahead, seconds, and the steps of it.
const REACH_S: f64 = 3.0;
const REACH_STEPS: usize = 6;
/// Gap below which another is in the way of a recorded vehicle, meters.
const REACH_GAP_M: f64 = 1.0;
/// Braking that no recorded vehicle is left to need, m/s^2: what is comfortable.
const REACH_MPS2: f64 = 2.0;
/// Farthest that a driver looks ahead, meters.
const LOOK_M: f64 = 120.0;
/// Largest distance to vehicles behind that are considered, meters: those farther back brake
/// themselves.
const BEHIND_M: f64 = 2.0;
/// Gap behind one who comes into the way, seconds of one's own way.
const CUT_IN_S: f64 = 0.5;
/// Largest yaw rate that is expected to go on, rad/s.
const YAW_RATE_RADPS: f64 = 1.0;
/// Number of the driver of the first recorded road user among those that are drawn: beyond those of
/// all agents on lanes.
const DRAWN_FROM: usize = 1 << 20;

/// State of one on a track.
#[derive(Clone, Debug)]
enum Mode {
    /// Not there yet: its first moment is to come.
    Waiting,
    Recorded,
    Driving(Driving),
    /// Another program drives it.
    Steered(Box<Steered>),
    Gone,
}

#[derive(Clone, Debug)]
struct Follower {
    kind: RoadUser,
    size: VehicleSize,
    way: Arc<Way>,
    mode: Mode,
}

/// Road user that others see.
#[derive(Clone, Copy, Debug)]
struct Party {
    state: VehicleState,
    size: VehicleSize,
    yaw_rate_radps: f64,
    /// States that are expected, [`REACH_S`] ahead in [`REACH_STEPS`] steps, from now on.
    outlook: [VehicleState; REACH_STEPS + 1],
    /// Index among those on tracks.
    follower: Option<usize>,
    is_recorded: bool,
}

/// Road users of a scenario on their tracks.
#[derive(Clone, Debug)]
pub(in crate::traffic) struct Followers {
    followers: Vec<Follower>,
    states: Vec<Option<VehicleState>>,
    handover: Handover,
    /// Seed of drivers that are drawn.
    drawn: Option<u64>,
    /// Median of the highest speeds of vehicles, m/s.
    free_mps: f64,
    /// Headings of those who are on no track, a step before.
    headings_rad: Vec<Option<f64>>,
    /// Handovers that were not yet collected: index among the recorded road users, and time.
    handed: Vec<(usize, f64)>,
    /// Vehicles with commands that were more than they can do, not yet collected.
    limited: Vec<usize>,
}

impl Followers {
    /// Road users of `tracks`, which were checked, at the start of the scenario.
    pub(in crate::traffic) fn new(tracks: &Tracks, map: &LaneMap) -> Self {
        let index = LaneIndex::new(map);
        let follower = |agent: &TrackedAgent| {
            let way = Arc::new(Way::new(agent, map, &index));
            Follower {
                kind: agent.kind,
                size: agent.size(),
                mode: match () {
                    () if way.lasts_at(0.0) => Mode::Recorded,
                    () if way.is_over_at(0.0) => Mode::Gone,
                    () => Mode::Waiting,
                },
                way,
            }
        };
        let followers: Vec<Follower> = tracks.agents.iter().map(follower).collect();
        let vehicles = followers.iter().filter(|one| one.is_vehicle());
        let mut tops_mps: Vec<f64> = vehicles.map(|one| one.way.top_mps).collect();
        tops_mps.sort_by(f64::total_cmp);
        let mut made = Self {
            free_mps: tops_mps.get(tops_mps.len() / 2).copied().unwrap_or(0.0),
            states: Vec::new(),
            handover: tracks.handover,
            drawn: None,
            headings_rad: Vec::new(),
            handed: Vec::new(),
            limited: Vec::new(),
            followers,
        };
        made.states = made.states_at(0.0);
        made
    }

    /// The same road users with drivers that are drawn by `seed`.
    pub(in crate::traffic) fn with_drawn_drivers(self, seed: u64) -> Self {
        let drawn = Some(seed);
        Self { drawn, ..self }
    }

    /// Motion of one that leaves its track at `time_s`, behind `ahead`.
    fn driving(&self, at: usize, time_s: f64, ahead: Option<Ahead>) -> Driving {
        let (one, free_mps) = (&self.followers[at], self.free_mps);
        if let Some(seed) = self.drawn {
            let number = DRAWN_FROM + at;
            let driver = Driver::drawn(one.kind, DriverKind::Normal, seed, number);
            return Driving::drawn(&one.way, &driver, time_s, ahead, free_mps);
        }
        let driver = Driver::new(one.kind, DriverKind::Normal);
        Driving::new(&one.way, &driver, time_s, ahead, free_mps)
    }

    fn states_at(&self, time_s: f64) -> Vec<Option<VehicleState>> {
        let state = |one: &Follower| match &one.mode {
            Mode::Waiting | Mode::Gone => None,
            Mode::Recorded => Some(one.way.state_at(time_s)),
            Mode::Driving(driving) => Some(driving.state(&one.way)),
            Mode::Steered(steered) => Some(steered.body.state),
        };
        self.followers.iter().map(state).collect()
    }

    /// States of all, in their order; `None` before the first moment of a track and after its last.
    pub(in crate::traffic) fn states(&self) -> impl Iterator<Item = Option<VehicleState>> {
        self.states.iter().copied()
    }

    /// Boxes of those that are there, with their states.
    pub(in crate::traffic) fn shown(&self) -> impl Iterator<Item = (VehicleState, VehicleSize)> {
        let all = self.states.iter().zip(&self.followers);
        all.filter_map(|(state, one)| Some(((*state)?, one.size)))
    }

    /// Takes the handovers since this was asked last. Agents count from `first`.
    pub(in crate::traffic) fn take_handovers(&mut self, first: usize) -> Vec<HandoverRecord> {
        let handed = std::mem::take(&mut self.handed);
        let record = |(at, time_s): (usize, f64)| HandoverRecord {
            agent: first + at,
            // Without what sums of steps add.
            time_s: (time_s * 1e9).round() / 1e9,
        };
        handed.into_iter().map(record).collect()
    }

    /// Advances from `time_s` by `dt_s` seconds. `others` are who is on no track, each at its own
    /// place of the list, as they are at the beginning.
    pub(in crate::traffic) fn step(
        &mut self,
        time_s: f64,
        dt_s: f64,
        others: &[Option<(VehicleState, VehicleSize)>],
    ) {
        let parties = self.parties(time_s, dt_s, others);
        for at in 0..self.followers.len() {
            if self.hands_over(at, time_s, &parties) {
                let one = &self.followers[at];
                let own = self.states[at].unwrap_or_default();
                let ahead = one.ahead(at, &own, one.way.arc_at(time_s), &parties);
                let nearest = ahead.into_iter().min_by(|a, b| a.gap_m.total_cmp(&b.gap_m));
                let driving = self.driving(at, time_s, nearest);
                self.followers[at].mode = Mode::Driving(driving);
                self.handed.push((at, time_s));
            }
        }
        let driven: Vec<Option<Vec<Ahead>>> = self
            .followers
            .iter()
            .enumerate()
            .map(|(at, one)| match &one.mode {
                Mode::Driving(driving) => {
                    let own = self.states[at]?;
                    Some(one.ahead(at, &own, driving.arc_m, &parties))
                }
                Mode::Steered(steered) if steered.command.is_none() => {
                    let own = &steered.body.state;
                    Some(one.ahead(at, own, steered.driving.arc_m, &parties))
                }
                _ => None,
            })
            .collect();
        let after_s = time_s + dt_s;
        let all = self.followers.iter_mut().zip(driven).enumerate();
        for (at, (one, ahead)) in all {
            match &mut one.mode {
                Mode::Driving(driving) => {
                    driving.advance(&one.way, &ahead.unwrap_or_default(), dt_s);
                    if driving.arc_m >= one.way.length_m() {
                        one.mode = Mode::Gone;
                    }
                }
                Mode::Steered(steered) => {
                    if steered.advance(&one.way, &ahead.unwrap_or_default(), dt_s) {
                        self.limited.push(at);
                    }
                    if steered.driving.arc_m >= one.way.length_m() {
                        one.mode = Mode::Gone;
                    }
                }
                Mode::Recorded if one.way.is_over_at(after_s) => one.mode = Mode::Gone,
                Mode::Waiting if one.way.lasts_at(after_s) => {
                    let state = one.way.state_at(after_s);
                    let outline = OrientedBox::for_vehicle(&state, &one.size);
                    let hinders = |party: &Party| {
                        !party.is_recorded && {
                            let moved = party.expected(dt_s);
                            OrientedBox::for_vehicle(&moved, &party.size)
                                .overlaps(&outline.extended(REACH_GAP_M))
                        }
                    };
                    let is_free = self.handover == Handover::Never || !parties.iter().any(hinders);
                    one.mode = if is_free { Mode::Recorded } else { Mode::Gone };
                }
                Mode::Waiting | Mode::Recorded | Mode::Gone => {}
            }
        }
        self.states = self.states_at(after_s);
    }

    /// All road users, those on no track first.
    fn parties(
        &mut self,
        time_s: f64,
        dt_s: f64,
        others: &[Option<(VehicleState, VehicleSize)>],
    ) -> Vec<Party> {
        let mut parties = Vec::with_capacity(others.len() + self.followers.len());
        self.headings_rad.resize(others.len(), None);
        for (other, before_rad) in others.iter().zip(&mut self.headings_rad) {
            let before_rad = std::mem::replace(before_rad, other.map(|(state, _)| state.yaw_rad));
            let Some((state, size)) = *other else {
                continue;
            };
            let rate_radps = before_rad.map_or(0.0, |rad| wrapped(state.yaw_rad - rad) / dt_s);
            parties.push(Party {
                state,
                size,
                yaw_rate_radps: rate_radps.clamp(-YAW_RATE_RADPS, YAW_RATE_RADPS),
                follower: None,
                is_recorded: false,
                outlook: [state; REACH_STEPS + 1],
            });
        }
        for (at, (state, one)) in self.states.iter().zip(&self.followers).enumerate() {
            if let Some(state) = *state {
                parties.push(Party {
                    state,
                    size: one.size,
                    yaw_rate_radps: 0.0,
                    follower: Some(at),
                    is_recorded: matches!(one.mode, Mode::Recorded),
                    outlook: [state; REACH_STEPS + 1],
                });
            }
        }
        for party in &mut parties {
            let all = std::array::from_fn(|step| self.expected(party, time_s, ahead_s(step)));
            party.outlook = all;
        }
        parties
    }

    /// State that is expected of a party after `ahead_s`.
    fn expected(&self, party: &Party, time_s: f64, ahead_s: f64) -> VehicleState {
        let Some(one) = party.follower.map(|at| &self.followers[at]) else {
            return party.expected(ahead_s);
        };
        match &one.mode {
            Mode::Driving(driving) => {
                let arc_m = driving.arc_m + ahead_s * driving.speed_mps;
                let (position_m, yaw_rad) = one.way.pose_at(arc_m);
                VehicleState {
                    position_m,
                    yaw_rad,
                    ..party.state
                }
            }
            Mode::Steered(_) => party.expected(ahead_s),
            _ => one.way.state_at(time_s + ahead_s),
        }
    }

    /// True if a recorded vehicle is to be handed over now.
    fn hands_over(&self, at: usize, time_s: f64, parties: &[Party]) -> bool {
        let one = &self.followers[at];
        let is_recorded = matches!(one.mode, Mode::Recorded) && one.is_vehicle();
        match self.handover {
            Handover::Never => false,
            Handover::All => is_recorded,
            Handover::Near => {
                is_recorded
                    && parties
                        .iter()
                        .any(|party| !party.is_recorded && self.meets(at, time_s, party))
            }
        }
    }

    /// True if `party` is in the way of what was recorded of a vehicle for the next seconds.
    fn meets(&self, at: usize, time_s: f64, party: &Party) -> bool {
        let one = &self.followers[at];
        let own = one.way.state_at(time_s);
        let lengths_m = one.size.length_m + party.size.length_m;
        let near_m = lengths_m + REACH_S * (own.speed_mps + party.state.speed_mps) + 60.0;
        if own.position_m.distance(party.state.position_m) > near_m {
            return false;
        }
        let half_m = 0.5 * one.size.length_m;
        for step in 0..=REACH_STEPS {
            let after_s = time_s + ahead_s(step);
            if !one.way.lasts_at(after_s) {
                return false;
            }
            let own_m = one.way.arc_at(after_s);
            let Some(seen) = one.sees(&party.outlook[step], &party.size, own_m) else {
                continue;
            };
            if seen.middle_m() < own_m {
                // It follows, or comes beside: its driver looks.
                if step == 0 {
                    return false;
                }
                continue;
            }
            let gap_m = seen.rear_m - own_m - half_m;
            let closing_mps = (one.way.state_at(after_s).speed_mps - seen.speed_mps).max(0.0);
            let room_m = (gap_m - REACH_GAP_M).max(0.01);
            let needed_mps2 = closing_mps * closing_mps / (2.0 * room_m);
            if gap_m < REACH_GAP_M || needed_mps2 > REACH_MPS2 {
                return true;
            }
        }
        false
    }
}

/// Time of a step of what is expected, seconds.
fn ahead_s(step: usize) -> f64 {
    REACH_S * step as f64 / REACH_STEPS as f64
}

impl Party {
    /// State after `ahead_s` with the same speed and turn.
    fn expected(&self, ahead_s: f64) -> VehicleState {
        let turn_rad = self.yaw_rate_radps * ahead_s;
        let mean = DVec2::from_angle(self.state.yaw_rad + 0.5 * turn_rad);
        VehicleState {
            position_m: self.state.position_m + self.state.speed_mps * ahead_s * mean,
            yaw_rad: wrapped(self.state.yaw_rad + turn_rad),
            ..self.state
        }
    }
}

impl Follower {
    fn is_vehicle(&self) -> bool {
        self.kind != RoadUser::Pedestrian
    }

    /// Another on its line, where it is at `own_m` itself.
    fn sees(&self, state: &VehicleState, size: &VehicleSize, own_m: f64) -> Option<Seen> {
        let outline = OrientedBox::for_vehicle(state, size);
        self.way
            .seen(&outline, state.velocity(), self.size.width_m, own_m)
    }

    /// Road users that it has to mind at `own_m` of its line, where its state is `own`: who is
    /// ahead on its line, and who is expected to come there first.
    fn ahead(&self, at: usize, own: &VehicleState, own_m: f64, parties: &[Party]) -> Vec<Ahead> {
        let half_m = 0.5 * self.size.length_m;
        let mut ahead = Vec::new();
        for party in parties.iter().filter(|party| party.follower != Some(at)) {
            let lengths_m = 0.5 * (self.size.length_m + party.size.length_m);
            let is_behind = own.to_local(party.state.position_m).x < -lengths_m - BEHIND_M;
            let apart_m = party.state.position_m.distance(own.position_m);
            if is_behind || apart_m > LOOK_M {
                continue;
            }
            if let Some(seen) = self.sees(&party.state, &party.size, own_m) {
                if seen.middle_m() > own_m {
                    ahead.push(Ahead {
                        gap_m: seen.rear_m - own_m - half_m,
                        speed_mps: seen.speed_mps,
                        is_in_way: true,
                    });
                }
                continue;
            }
            let within_m = REACH_S * (own.speed_mps + party.state.speed_mps);
            if apart_m > within_m + self.size.length_m + party.size.length_m {
                continue;
            }
            let comes = (1..=REACH_STEPS).find_map(|step| {
                let then_m = own_m + own.speed_mps * ahead_s(step);
                let seen = self.sees(&party.outlook[step], &party.size, then_m)?;
                let is_first = seen.middle_m() > then_m
                    && seen.rear_m < then_m + half_m + CUT_IN_S * own.speed_mps + REACH_GAP_M;
                is_first.then_some((seen, ahead_s(step)))
            });
            if let Some((seen, after_s)) = comes {
                ahead.push(Ahead {
                    gap_m: seen.rear_m - seen.speed_mps * after_s - own_m - half_m,
                    speed_mps: seen.speed_mps,
                    is_in_way: false,
                });
            }
        }
        ahead
    }
}
