//! A recorded vehicle after its handover: the intelligent driver model on its recorded line.

use decouplegs_scene::VehicleState;
use glam::DVec2;

use super::super::driver::Driver;
use super::super::idm::{BRAKING_MPS2, IdmParameters, Leader, advance};
use super::super::relaxation::Accepted;
use super::super::signals::STANDING_MPS;
use super::way::Way;
use crate::polyline::wrapped;

/// Time headway of drivers on tracks is shorter by this than that of the normal driver, seconds:
/// 1.4 s for cars, about the median of the motorway US 101 (NGSIM).
const HEADWAY_LESS_S: f64 = 0.4;
/// Least headway and gap that a driver accepts because it was recorded so, seconds and meters.
const HEADWAY_MIN_S: f64 = 0.3;
const GAP_MIN_M: f64 = 0.5;
/// Time in which an accepted headway comes nearer to the driver's own by the factor e, seconds.
const RELAX_S: f64 = 10.0;
/// Change of acceleration in normal driving, m/s^3, and the braking beyond which it does not count,
/// m/s^2.
const JERK_MPS3: f64 = 10.0;
const EMERGENCY_MPS2: f64 = 4.0;
/// Gap that is left after hard braking, meters.
const STOP_GAP_M: f64 = 0.5;
/// Way over which a vehicle comes from where it was recorded to its line, meters.
const SETTLE_M: f64 = 10.0;
/// Speed that is too much for the road is lost in about this time, seconds.
const SLOWING_S: f64 = 0.5;

/// Road user ahead, for the model.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ahead {
    pub gap_m: f64,
    pub speed_mps: f64,
    /// False for one that is only expected in the lane: others do not brake hard for it.
    pub is_in_way: bool,
}

/// Motion of a vehicle after its handover.
#[derive(Clone, Debug)]
pub(super) struct Driving {
    pub arc_m: f64,
    pub speed_mps: f64,
    acceleration_mps2: f64,
    idm: IdmParameters,
    /// Headway that is accepted at the handover, seconds, and the time since, seconds.
    accepted_s: f64,
    since_s: f64,
    /// Gap that a drawn driver accepts in its place.
    accepted: Accepted,
    /// Acceleration that it must find room for, so as to start, m/s^2.
    starts_mps2: f64,
    /// Place of the handover, and where the vehicle was beside the line there: meters along and to
    /// the left, and its turn in radians.
    from_m: f64,
    beside_m: DVec2,
    turn_rad: f64,
}

impl Driving {
    /// A vehicle of `driver` that leaves its track at `time_s`, behind `ahead` if there is one. Its
    /// free speed is at least `free_mps`.
    pub(super) fn new(
        way: &Way,
        driver: &Driver,
        time_s: f64,
        ahead: Option<Ahead>,
        free_mps: f64,
    ) -> Self {
        let state = way.state_at(time_s);
        let arc_m = way.arc_at(time_s);
        let (point_m, yaw_rad) = way.pose_at(arc_m);
        let mut idm = driver.idm;
        idm.headway_s -= HEADWAY_LESS_S;
        idm.speed_mps = way.top_mps.max(free_mps);
        let mut accepted_s = idm.headway_s;
        if let Some(ahead) = ahead.filter(|ahead| ahead.is_in_way) {
            idm.standstill_gap_m = idm.standstill_gap_m.min(ahead.gap_m.max(GAP_MIN_M));
            let headway_s = (ahead.gap_m - idm.standstill_gap_m) / state.speed_mps.max(0.1);
            accepted_s = headway_s.clamp(HEADWAY_MIN_S, idm.headway_s);
        }
        Self {
            arc_m,
            speed_mps: state.speed_mps,
            acceleration_mps2: state.acceleration_mps2.clamp(-BRAKING_MPS2, EMERGENCY_MPS2),
            idm,
            accepted_s,
            since_s: 0.0,
            accepted: Accepted::default(),
            starts_mps2: 0.0,
            from_m: arc_m,
            beside_m: DVec2::from_angle(-yaw_rad).rotate(state.position_m - point_m),
            turn_rad: wrapped(state.yaw_rad - yaw_rad),
        }
    }

    /// A vehicle of a drawn `driver` that leaves its track at `time_s`, behind `ahead` if there is
    /// one. Its free speed is the driver's share of `free_mps`, at least that at the handover.
    pub(super) fn drawn(
        way: &Way,
        driver: &Driver,
        time_s: f64,
        ahead: Option<Ahead>,
        free_mps: f64,
    ) -> Self {
        let mut made = Self::new(way, driver, time_s, None, free_mps);
        made.idm = driver.idm;
        made.idm.speed_mps = made.speed_mps.max(driver.speed_share * free_mps);
        made.accepted_s = made.idm.headway_s;
        made.starts_mps2 = driver.start_share * driver.idm.acceleration_mps2;
        let gap_m = ahead
            .filter(|ahead| ahead.is_in_way)
            .map(|ahead| ahead.gap_m);
        made.accepted = Accepted::new(driver, made.speed_mps, None, gap_m);
        made
    }

    /// State of its box.
    pub(super) fn state(&self, way: &Way) -> VehicleState {
        let (point_m, yaw_rad) = way.pose_at(self.arc_m);
        let share = ((self.arc_m - self.from_m) / SETTLE_M).clamp(0.0, 1.0);
        let rest = 1.0 - share * share * (3.0 - 2.0 * share);
        VehicleState {
            position_m: point_m + DVec2::from_angle(yaw_rad).rotate(rest * self.beside_m),
            yaw_rad: wrapped(yaw_rad + rest * self.turn_rad),
            speed_mps: self.speed_mps,
            acceleration_mps2: self.acceleration_mps2,
        }
    }

    /// Acceleration of the last step, m/s^2.
    pub(super) fn acceleration_mps2(&self) -> f64 {
        self.acceleration_mps2
    }

    /// Takes over where the vehicle is, `arc_m` along its line, in a state that others made.
    pub(super) fn moved_to(&mut self, arc_m: f64, state: &VehicleState) {
        self.arc_m = arc_m;
        self.speed_mps = state.speed_mps;
        self.acceleration_mps2 = state.acceleration_mps2.clamp(-BRAKING_MPS2, EMERGENCY_MPS2);
    }

    /// Advances by `dt_s` behind those `ahead`.
    pub(super) fn advance(&mut self, way: &Way, ahead: &[Ahead], dt_s: f64) {
        let own_s = self.idm.headway_s;
        let idm = IdmParameters {
            headway_s: own_s - (own_s - self.accepted_s) * (-self.since_s / RELAX_S).exp()
                + self.accepted.headway_s,
            standstill_gap_m: self.idm.standstill_gap_m + self.accepted.standstill_gap_m,
            ..self.idm
        };
        let bend_mps = way.bend_mps(self.arc_m, self.speed_mps, idm.braking_mps2);
        let free = IdmParameters {
            speed_mps: self.accepted.free_speed(idm.speed_mps).min(bend_mps),
            ..idm
        };
        let mut wished_mps2 = free.free_acceleration(self.speed_mps);
        let too_fast_mps = self.speed_mps - free.speed_mps;
        if too_fast_mps > 0.0 {
            let slows_mps2 = (too_fast_mps / SLOWING_S).min(idm.braking_mps2);
            wished_mps2 = wished_mps2.min(-slows_mps2);
        }
        let mut urgent_mps2 = f64::INFINITY;
        for other in ahead {
            let leader = Leader {
                gap_m: other.gap_m,
                speed_mps: other.speed_mps,
            };
            let mut follows_mps2 = idm.acceleration(self.speed_mps, Some(leader));
            // What must be lost before the gap is gone.
            let closing_mps = (self.speed_mps - other.speed_mps).max(0.0);
            let room_m = other.gap_m - STOP_GAP_M;
            let needed_mps2 = closing_mps * closing_mps / (2.0 * room_m.max(0.01));
            if needed_mps2 > EMERGENCY_MPS2 && (other.is_in_way || room_m > 0.0) {
                urgent_mps2 = urgent_mps2.min(-needed_mps2);
            } else if !other.is_in_way {
                follows_mps2 = follows_mps2.max(-idm.braking_mps2);
            }
            wished_mps2 = wished_mps2.min(follows_mps2);
        }
        if self.speed_mps < STANDING_MPS && wished_mps2 < self.starts_mps2 {
            wished_mps2 = wished_mps2.min(0.0);
        }
        let step_mps2 = JERK_MPS3 * dt_s;
        let last_mps2 = self.acceleration_mps2;
        let gentle_mps2 = wished_mps2.clamp(last_mps2 - step_mps2, last_mps2 + step_mps2);
        let acceleration_mps2 = gentle_mps2.min(urgent_mps2).max(-BRAKING_MPS2);
        let (moved_m, after_mps) = advance(self.speed_mps, acceleration_mps2, dt_s);
        self.acceleration_mps2 = (after_mps - self.speed_mps) / dt_s;
        self.speed_mps = after_mps;
        self.arc_m += moved_m;
        self.since_s += dt_s;
        self.accepted.fade(dt_s);
    }
}
