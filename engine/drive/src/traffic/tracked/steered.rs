//! Recorded vehicles that another program drives from some moment on.

use decouplegs_scene::episode::AgentCommand;
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::super::body::Body;
use super::super::steered::{DrivenBy, SteerableAgent, bend_of, steerable_agent};
use super::super::way_ahead::SeenUser;
use super::driving::{Ahead, Driving};
use super::way::Way;
use super::{Followers, Mode};

/// Part of the line within which the vehicle is looked for, meters behind and ahead.
const SEARCH_M: f64 = 10.0;

/// A vehicle that takes commands.
#[derive(Clone, Debug)]
pub(super) struct Steered {
    pub body: Body,
    /// Command of the present step.
    pub command: Option<AgentCommand>,
    /// The driver model in steps without one, and the place on the recorded line.
    pub driving: Driving,
}

impl Steered {
    /// Moves by its command for `dt_s`, or by the model behind those `ahead`. True if the command
    /// was more than a vehicle can do.
    pub(super) fn advance(&mut self, way: &Way, ahead: &[Ahead], dt_s: f64) -> bool {
        let target_m = way.pose_at(self.driving.arc_m + self.body.look_ahead_m()).0;
        let keeps_per_m = self.body.curvature_to(target_m);
        let is_limited = match &self.command {
            Some(command) => self.body.obey(command, keeps_per_m, dt_s),
            None => {
                self.driving.advance(way, ahead, dt_s);
                let wished_mps2 = self.driving.acceleration_mps2();
                self.body.advance(wished_mps2, keeps_per_m, dt_s);
                false
            }
        };
        let state = &self.body.state;
        let near_m = self.driving.arc_m;
        let arc_m = way.arc_near(state.position_m, near_m - SEARCH_M, near_m + SEARCH_M);
        self.driving.moved_to(arc_m, state);
        is_limited
    }
}

impl Followers {
    /// States and boxes of all, in their order; `None` for those who are not there.
    pub(in crate::traffic) fn all(
        &self,
    ) -> impl Iterator<Item = Option<(VehicleState, VehicleSize)>> {
        let all = self.states.iter().zip(&self.followers);
        all.map(|(state, one)| Some(((*state)?, one.size)))
    }

    /// True if the road user at `at` of the list is a vehicle.
    pub(in crate::traffic) fn takes_commands(&self, at: usize) -> bool {
        self.followers[at].is_vehicle()
    }

    /// Place on its line of a vehicle that is there, meters, and who drives it.
    fn driven_at(&self, at: usize, time_s: f64) -> Option<(f64, DrivenBy)> {
        let one = &self.followers[at];
        match &one.mode {
            Mode::Waiting | Mode::Gone => None,
            Mode::Recorded => Some((one.way.arc_at(time_s), DrivenBy::Track)),
            Mode::Driving(driving) => Some((driving.arc_m, DrivenBy::Model)),
            Mode::Steered(steered) => Some((steered.driving.arc_m, DrivenBy::Commands)),
        }
    }

    /// Vehicles that take commands. Agents count from `first`.
    pub(in crate::traffic) fn steerable(
        &self,
        time_s: f64,
        first: usize,
        others: &[SeenUser],
    ) -> Vec<SteerableAgent> {
        let all = self.followers.iter().zip(&self.states).enumerate();
        let there = all.filter_map(|(at, (one, state))| {
            let (arc_m, driven_by) = self.driven_at(at, time_s)?;
            let state = (*state).filter(|_| one.is_vehicle())?;
            let place = |ahead_m: f64| place_on(&one.way, arc_m + ahead_m);
            let who = (first + at, &state, &one.size, driven_by);
            Some(steerable_agent(who, place, others))
        });
        there.collect()
    }

    /// Takes back the commands of all.
    pub(in crate::traffic) fn clear_commands(&mut self) {
        for one in &mut self.followers {
            if let Mode::Steered(steered) = &mut one.mode {
                steered.command = None;
            }
        }
    }

    /// Sets the command of the vehicle at `at` of the list. From the first one on it has left its
    /// track.
    pub(in crate::traffic) fn steer(&mut self, at: usize, command: AgentCommand, time_s: f64) {
        let Some(state) = self.states[at] else {
            return;
        };
        if let Mode::Steered(steered) = &mut self.followers[at].mode {
            steered.command = Some(command);
            return;
        }
        let one = &self.followers[at];
        let driving = match &one.mode {
            Mode::Driving(driving) => driving.clone(),
            _ => {
                self.handed.push((at, time_s));
                self.driving(at, time_s, None)
            }
        };
        let bend_per_m = bend_of(|ahead_m| place_on(&one.way, driving.arc_m + ahead_m));
        let body = Body::new(state, &one.size, bend_per_m);
        self.followers[at].mode = Mode::Steered(Box::new(Steered {
            body,
            command: Some(command),
            driving,
        }));
    }

    /// Takes the list of those with commands that were more than a vehicle can do.
    pub(in crate::traffic) fn take_limited(&mut self) -> Vec<usize> {
        std::mem::take(&mut self.limited)
    }
}

/// Position and heading on the line, before its start straight back.
fn place_on(way: &Way, arc_m: f64) -> (DVec2, f64) {
    let within_m = arc_m.clamp(0.0, way.length_m());
    let (point_m, yaw_rad) = way.pose_at(within_m);
    (
        point_m + (arc_m - within_m) * DVec2::from_angle(yaw_rad),
        yaw_rad,
    )
}
