//! Misbehavior of agents that a model of good driving excludes: hard braking, cutting in, swerving.
//! None of it reaches another agent.

use decouplegs_scene::scenario::{After, Maneuver, Trigger};

use super::Traffic;
use super::agent::{Agent, Aside, AsideKind, Phase, SwerveShape, swerve_bend_m};
use super::following::ASIDE_MPS2;
use super::idm::BRAKING_MPS2;
use super::lane_order::Entry;
use super::outsider::nearest_ego;
use super::watch::Watch;
use crate::oriented_box::OrientedBox;

/// Least length of a swerve for each meter to the side, meters: vehicles do not slide.
const SWERVE_M_PER_M: f64 = 12.0;
/// Length of the way back from a standing start for each meter to the side, meters.
const BACK_M_PER_M: f64 = 5.0;
/// Largest offset from the centerline of the own lane, meters.
const SWERVE_M_MAX: f64 = 3.5;
/// Distance between positions at which a swerve is examined, meters, and what its box is widened
/// by.
const SWERVE_STEP_M: f64 = 1.0;
const SWERVE_MARGIN_M: f64 = 0.15;
/// Distance between a swerve's end and the next crossing, meters: cells and boxes are longer than
/// a swerve.
const CROSSING_M: f64 = 8.0;
/// Free time that vehicles beside a swerve need, seconds.
const SWERVE_REACTION_S: f64 = 2.0;
/// Shares of the amplitude that are tried until there is room.
const SWERVE_SHARES: [f64; 4] = [1.0, 0.75, 0.5, 0.25];

/// Difference within which a cruise speed is reached, m/s.
const REACHED_MPS: f64 = 0.5;

/// Time for which a maneuver without room is tried, seconds.
fn patience_s(maneuver: &Maneuver) -> f64 {
    match maneuver {
        Maneuver::Brake { .. } | Maneuver::Cruise { .. } => 0.0,
        Maneuver::CutIn | Maneuver::ChangeLane { .. } | Maneuver::Teleport { .. } => 10.0,
        Maneuver::Swerve { .. } => 3.0,
    }
}

impl Traffic {
    /// Begins what is due, goes on trying what had no room, and ends what is over.
    pub(super) fn behave(&mut self) {
        for number in 0..self.agents.len() {
            let agent = &mut self.agents[number];
            if !agent.is_here() {
                continue;
            }
            agent.brake = agent.brake.filter(|(_, until_s)| *until_s > self.time_s);
            self.give_up_swerve(number);
            for which in 0..self.behaviors[number].len() {
                let behavior = self.behaviors[number][which];
                if let Phase::Waiting(mut watch) = self.agents[number].phases[which] {
                    let is_due = self.is_due(number, behavior.trigger, &mut watch);
                    let until_s = self.time_s + patience_s(&behavior.maneuver);
                    self.agents[number].phases[which] = match is_due {
                        true => Phase::Trying { until_s },
                        false => Phase::Waiting(watch),
                    };
                }
                if let Phase::Trying { until_s } = self.agents[number].phases[which] {
                    let over = self.attempt(number, behavior.maneuver) || self.time_s >= until_s;
                    if over {
                        self.agents[number].phases[which] = Phase::Done;
                    }
                }
            }
        }
    }

    fn is_due(&self, number: usize, trigger: Trigger, watch: &mut Watch) -> bool {
        match trigger {
            Trigger::Time { time_s } => self.time_s >= time_s,
            Trigger::NearEgo { distance_m } => {
                let at_m = self.states[number].map(|state| state.position_m);
                let ego = at_m.and_then(|at_m| self.outsiders.nearest_ego(at_m));
                ego.zip(at_m)
                    .is_some_and(|(ego, at_m)| ego.position_m.distance(at_m) <= distance_m)
            }
            Trigger::Measured(measured) => self.states[number].is_some_and(|own| {
                let ego = nearest_ego(&self.egos, own.position_m);
                watch.is_due(&measured, self.time_s, &own, ego)
            }),
            Trigger::After(after) => {
                let holds = self.has_come(number, &after);
                watch.is_past(holds, (after.from_s, after.delay_s), self.time_s)
            }
        }
    }

    /// True if the behavior that another one of its agent waits for has begun, or is over.
    fn has_come(&self, number: usize, after: &After) -> bool {
        let agent = &self.agents[number];
        let (Some(phase), Some(behavior)) = (
            agent.phases.get(after.behavior),
            self.behaviors[number].get(after.behavior),
        ) else {
            return false;
        };
        if *phase != Phase::Done {
            return false;
        }
        !after.is_over
            || match behavior.maneuver {
                Maneuver::Brake { .. } => agent.brake.is_none(),
                Maneuver::Cruise { speed_mps } => {
                    (agent.speed_mps - speed_mps).abs() <= REACHED_MPS
                }
                Maneuver::Teleport { .. } => true,
                Maneuver::CutIn | Maneuver::ChangeLane { .. } | Maneuver::Swerve { .. } => {
                    agent.aside.is_none()
                }
            }
    }

    /// Begins a maneuver; whether there is nothing more to try.
    fn attempt(&mut self, number: usize, maneuver: Maneuver) -> bool {
        match maneuver {
            Maneuver::Brake {
                deceleration_mps2,
                duration_s,
            } => {
                let braking_mps2 = deceleration_mps2.clamp(0.0, BRAKING_MPS2);
                self.agents[number].brake = Some((braking_mps2, self.time_s + duration_s));
                true
            }
            Maneuver::CutIn => self.cut_in(number).unwrap_or(true),
            Maneuver::ChangeLane { side } => self.change_to(number, side).unwrap_or(true),
            Maneuver::Teleport { point_m } => self.teleport(number, point_m).unwrap_or(true),
            Maneuver::Cruise { speed_mps } => {
                self.agents[number].cruise_mps = Some(speed_mps);
                true
            }
            Maneuver::Swerve {
                amplitude_m,
                duration_s,
            } => self.swerve(number, amplitude_m, duration_s),
        }
    }

    /// True if an agent's lane has conflicts within a swerve of `length_m`. An agent that waits
    /// there would keep others in the crossing by what it takes up of other lanes, and they it.
    fn meets_crossing(&self, number: usize, length_m: f64) -> bool {
        let agent = &self.agents[number];
        let end_m = agent.front_m() + length_m + CROSSING_M;
        let (crossing, _) = self.next_crossing(agent, agent.rear_m());
        crossing.is_some_and(|crossing| crossing.from_m < end_m)
    }

    /// True if another vehicle is in a maneuver that `counts` near an agent's one of `length_m`:
    /// neither leaves the space between two lanes to the other.
    pub(super) fn meets_aside(
        &self,
        number: usize,
        length_m: f64,
        counts: impl Fn(&AsideKind) -> bool,
    ) -> bool {
        let Some(own) = self.states[number] else {
            return true;
        };
        self.agents.iter().zip(&self.states).any(|(other, state)| {
            let aside = other.aside.as_ref().filter(|aside| counts(&aside.kind));
            let (Some(aside), Some(state)) = (aside, state) else {
                return false;
            };
            let apart_m = state.position_m.distance(own.position_m);
            other.number != number && apart_m < length_m + aside.rest_m() + CROSSING_M
        })
    }

    /// Begins a swerve as wide as there is room beside all other agents; whether there was any.
    fn swerve(&mut self, number: usize, amplitude_m: f64, duration_s: f64) -> bool {
        let agent = &self.agents[number];
        if agent.aside.is_some() || !amplitude_m.is_finite() || !duration_s.is_finite() {
            return false;
        }
        for share in SWERVE_SHARES {
            let amplitude_m = share * amplitude_m.clamp(-SWERVE_M_MAX, SWERVE_M_MAX);
            // Not shorter than tires allow at its speed.
            let shortest_m = agent.speed_mps * (swerve_bend_m(amplitude_m) / ASIDE_MPS2).sqrt();
            let length_m = (agent.speed_mps * duration_s)
                .max(shortest_m)
                .clamp(SWERVE_M_PER_M * amplitude_m.abs() + 5.0, 150.0);
            let shape = SwerveShape::OutAndBack { amplitude_m };
            let kind = AsideKind::Swerve {
                shape,
                cells: Vec::new(),
            };
            let aside = Aside {
                traveled_m: 0.0,
                length_m,
                kind,
            };
            if self.meets_crossing(number, length_m) || self.meets_aside(number, length_m, |_| true)
            {
                continue;
            }
            if let Some(cells) = self.swerve_cells(number, &aside) {
                let kind = AsideKind::Swerve { shape, cells };
                self.agents[number].aside = Some(Aside { kind, ..aside });
                self.claims.claim(&self.graph, &self.agents[number]);
                return true;
            }
        }
        false
    }

    /// Turns an agent that comes to a stand in a swerve back to the middle of its lane: it takes up
    /// less of the lanes beside, for as long as it stands.
    fn give_up_swerve(&mut self, number: usize) {
        let agent = &self.agents[number];
        let Some(swerve) = agent.aside.as_ref().filter(|_| agent.speed_mps == 0.0) else {
            return;
        };
        let AsideKind::Swerve {
            shape: SwerveShape::OutAndBack { .. },
            cells: taken,
        } = &swerve.kind
        else {
            return;
        };
        let (offset_m, slope) = swerve.offset_after(0.0);
        let shape = SwerveShape::Back {
            offset_m: offset_m.y,
            slope,
        };
        let kind = |cells| AsideKind::Swerve { shape, cells };
        let back = Aside {
            traveled_m: 0.0,
            length_m: BACK_M_PER_M * offset_m.y.abs() + 5.0,
            kind: kind(Vec::new()),
        };
        let is_free = |&cell: &u32| taken.contains(&cell) || self.is_free_beside(number, cell);
        let swept = self.swept_cells(agent, &back);
        if let Some(cells) = swept.filter(|cells| cells.iter().all(is_free)) {
            self.agents[number].aside = Some(Aside {
                kind: kind(cells),
                ..back
            });
        }
    }

    /// Cells beside its path that a swerve touches, sorted; `None` where one of them, or one that
    /// conflicts with it, belongs to another.
    fn swerve_cells(&self, number: usize, aside: &Aside) -> Option<Vec<u32>> {
        let cells = self.swept_cells(&self.agents[number], aside)?;
        let is_free = |&cell: &u32| self.is_free_beside(number, cell);
        cells.iter().all(is_free).then_some(cells)
    }

    /// True if no other agent has a cell beside an agent's path, nor comes there soon: who would
    /// have to brake hard for it leaves no room either.
    fn is_free_beside(&self, number: usize, cell: u32) -> bool {
        let (lane, stretch) = self.graph.cells().stretch_of(cell as usize);
        let comes = |entry: &Entry| {
            let ahead_m = entry.front_m + SWERVE_REACTION_S * entry.speed_mps;
            entry.agent as usize != number
                && entry.rear_m < stretch.to_m
                && ahead_m > stretch.from_m
        };
        !self.claims.taken(cell as usize, number)
            && !self
                .claims
                .is_kept(number, lane, stretch.from_m, stretch.to_m)
            && !self.order.on(lane).iter().any(comes)
    }

    /// Cells beside its path that an agent's swerve touches, sorted; `None` where a static obstacle
    /// stands.
    fn swept_cells(&self, agent: &Agent, aside: &Aside) -> Option<Vec<u32>> {
        let (mut cells, mut touched) = (Vec::new(), Vec::new());
        let steps = (aside.length_m / SWERVE_STEP_M).ceil() as u32;
        for step in 0..=steps {
            let (center_m, yaw_rad) =
                agent.pose_at(&self.graph, f64::from(step) * SWERVE_STEP_M, Some(aside));
            let half_length_m = agent.half_m + 0.5 * SWERVE_STEP_M + SWERVE_MARGIN_M;
            let half_width_m = 0.5 * agent.size.width_m + SWERVE_MARGIN_M;
            let outline = OrientedBox {
                center_m,
                yaw_rad,
                half_length_m,
                half_width_m,
            };
            if self.obstacles.touched(&outline).is_some() {
                return None;
            }
            self.graph.cells().touched(&outline, &mut touched);
            cells.extend_from_slice(&touched);
        }
        cells.sort_unstable();
        cells.dedup();
        let rear = agent.here.saturating_sub(4);
        // Vehicles on a fork follow each other as on one lane.
        let own = |cell: u32| {
            let (lane, stretch) = self.graph.cells().stretch_of(cell as usize);
            agent.path[rear..].iter().any(|&path| {
                let mut forks = self.graph.road(path).forks.iter();
                path == lane || forks.any(|fork| fork.other == lane && stretch.from_m < fork.to_m)
            })
        };
        cells.retain(|&cell| !own(cell));
        Some(cells)
    }
}
