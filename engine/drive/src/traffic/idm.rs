//! The intelligent driver model (M. Treiber, A. Hennecke, D. Helbing: Congested traffic states in
//! empirical observations and microscopic simulations, Physical Review E 62, 2000).

/// Hardest braking of any vehicle, m/s^2: what tires hold on a dry road. All that is safe here
/// rests on it.
pub const BRAKING_MPS2: f64 = 8.0;

/// Way in which the wish for the free speed and that for a gap make an acceleration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Interaction {
    /// Sum of both, as in the model of 2000. Near the free speed, gaps grow beyond all bounds.
    #[default]
    Sum,
    /// Smaller one of both, as in IDM+ (W. J. Schakel, B. van Arem, B. D. Netten: Effects of
    /// cooperative adaptive cruise control on traffic flow stability, IEEE ITSC 2010): gaps are
    /// `s0 + v T` up to the free speed, so that roads carry what real ones do.
    Least,
}

/// A driver's parameters in the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IdmParameters {
    /// Speed on a free road, v0. Treiber's default is 120 km/h on a motorway, 50 km/h in a town;
    /// here the lane tells it.
    pub speed_mps: f64,
    /// Time headway, T: 1.8 s.
    pub headway_s: f64,
    /// Acceleration from standing, a: 1 m/s^2.
    pub acceleration_mps2: f64,
    /// Comfortable braking, b: 3 m/s^2.
    pub braking_mps2: f64,
    /// Gap to a standing vehicle ahead, s0: 2 m.
    pub standstill_gap_m: f64,
    /// Exponent of the free-road term, delta: 4.
    pub exponent: f64,
    /// Way in which both wishes are joined.
    pub interaction: Interaction,
}

impl Default for IdmParameters {
    /// Treiber's, in a town.
    fn default() -> Self {
        Self {
            speed_mps: 50.0 / 3.6,
            headway_s: 1.8,
            acceleration_mps2: 1.0,
            braking_mps2: 3.0,
            standstill_gap_m: 2.0,
            exponent: 4.0,
            interaction: Interaction::Sum,
        }
    }
}

/// Leader of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leader {
    /// Distance from the follower's front to the leader's rear, meters.
    pub gap_m: f64,
    /// Speed along the lane, m/s.
    pub speed_mps: f64,
}

impl IdmParameters {
    /// Acceleration on a free road, m/s^2: `a (1 - (v/v0)^delta)`, above the free speed at least
    /// `-b`, as in the improved model of Treiber and Kesting (Traffic Flow Dynamics, 2013): a speed
    /// limit that falls is no reason for hard braking. With a free speed of 0 the vehicle stops
    /// and stands.
    #[must_use]
    pub fn free_acceleration(&self, speed_mps: f64) -> f64 {
        if self.speed_mps <= 0.0 {
            return if speed_mps > 0.0 {
                -self.braking_mps2
            } else {
                0.0
            };
        }
        let share = speed_mps / self.speed_mps.max(0.1);
        // The usual exponent is four: two squarings instead of a power.
        let fades = if self.exponent == 4.0 {
            (share * share) * (share * share)
        } else {
            share.powf(self.exponent)
        };
        (self.acceleration_mps2 * (1.0 - fades)).max(-self.braking_mps2)
    }

    /// The gap that the driver wants, meters: `s0 + max(0, v T + v dv / (2 sqrt(a b)))`. It never
    /// falls below `s0`: a leader that leaves fast is no reason to brake.
    #[must_use]
    pub fn wanted_gap_m(&self, speed_mps: f64, leader_mps: f64) -> f64 {
        let comfort = 2.0 * (self.acceleration_mps2 * self.braking_mps2).sqrt();
        let dynamic_m = speed_mps * self.headway_s + speed_mps * (speed_mps - leader_mps) / comfort;
        self.standstill_gap_m + dynamic_m.max(0.0)
    }

    /// Acceleration, m/s^2, at least `-`[`BRAKING_MPS2`].
    #[must_use]
    pub fn acceleration(&self, speed_mps: f64, leader: Option<Leader>) -> f64 {
        let free = self.free_acceleration(speed_mps);
        let Some(Leader {
            gap_m,
            speed_mps: leader_mps,
        }) = leader
        else {
            return free;
        };
        let ratio = self.wanted_gap_m(speed_mps, leader_mps) / gap_m.max(0.01);
        let interaction_mps2 = self.acceleration_mps2 * ratio * ratio;
        match self.interaction {
            Interaction::Sum => free - interaction_mps2,
            Interaction::Least => free.min(self.acceleration_mps2 - interaction_mps2),
        }
        .max(-BRAKING_MPS2)
    }

    /// The gap at which a vehicle neither accelerates nor brakes behind a leader of the same speed
    /// below the free one, meters: `(s0 + v T) / sqrt(1 - (v/v0)^delta)`, or `s0 + v T` where the
    /// smaller of both wishes counts.
    #[must_use]
    pub fn equilibrium_gap_m(&self, speed_mps: f64) -> f64 {
        if self.interaction == Interaction::Least {
            return self.standstill_gap_m + speed_mps * self.headway_s;
        }
        let fades = (speed_mps / self.speed_mps).powf(self.exponent);
        (self.standstill_gap_m + speed_mps * self.headway_s) / (1.0 - fades).sqrt()
    }
}

/// Distance and final speed of a vehicle in `dt_s` at a constant acceleration. Who comes to a stand
/// stays there.
#[must_use]
pub fn advance(speed_mps: f64, acceleration_mps2: f64, dt_s: f64) -> (f64, f64) {
    let after_mps = speed_mps + acceleration_mps2 * dt_s;
    if after_mps < 0.0 {
        return (-0.5 * speed_mps * speed_mps / acceleration_mps2, 0.0);
    }
    (0.5 * (speed_mps + after_mps) * dt_s, after_mps)
}

/// Meters in which a vehicle can stop.
#[must_use]
pub fn stopping_m(speed_mps: f64) -> f64 {
    speed_mps * speed_mps / (2.0 * BRAKING_MPS2)
}

/// The most acceleration over `dt_s` after which a vehicle can still stop within `room_m` of where
/// it could before, m/s^2, at least `-`[`BRAKING_MPS2`].
///
/// Braking at that limit, the position where one would stop stays the same; so a vehicle that keeps
/// to this never needs more. It is the safe speed of S. Krauss (Microscopic modeling of traffic
/// flow, 1998) without a reaction time.
#[must_use]
pub fn safe_acceleration(speed_mps: f64, room_m: f64, dt_s: f64) -> f64 {
    // Speed v' after the step: (v + v') dt / 2 + v'^2 / 2B = room + v^2 / 2B.
    let square = 0.25 * dt_s * dt_s
        + 2.0 / BRAKING_MPS2 * (room_m.max(0.0) + stopping_m(speed_mps) - 0.5 * speed_mps * dt_s);
    let after_mps = BRAKING_MPS2 * (square.max(0.0).sqrt() - 0.5 * dt_s);
    if after_mps < 0.0 {
        return -BRAKING_MPS2;
    }
    ((after_mps - speed_mps) / dt_s).max(-BRAKING_MPS2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn free_acceleration_and_equilibrium_are_the_closed_forms() {
        let idm = IdmParameters::default();
        for share in [0.0, 0.3, 0.9, 1.0] {
            let speed_mps = share * idm.speed_mps;
            assert!(
                (idm.acceleration(speed_mps, None) - (1.0 - f64::powi(share, 4))).abs() < 1e-12
            );
        }
        assert_eq!(
            idm.acceleration(100.0, None),
            -3.0,
            "a limit far below is met by comfortable braking"
        );
        for speed_mps in [0.0, 1.0, 7.0, 13.0] {
            let leader = Leader {
                gap_m: idm.equilibrium_gap_m(speed_mps),
                speed_mps,
            };
            assert!(idm.acceleration(speed_mps, Some(leader)).abs() < 1e-12);
            assert!(
                idm.acceleration(
                    speed_mps,
                    Some(Leader {
                        gap_m: 0.9 * leader.gap_m,
                        ..leader
                    })
                ) < -1e-3
            );
        }
    }

    #[test]
    fn a_leader_that_leaves_fast_is_no_reason_to_brake() {
        let idm = IdmParameters::default();
        assert_eq!(idm.wanted_gap_m(10.0, 60.0), idm.standstill_gap_m);
        assert!(
            idm.acceleration(
                10.0,
                Some(Leader {
                    gap_m: 10.0,
                    speed_mps: 60.0
                })
            ) > 0.5
        );
    }

    #[test]
    fn whoever_keeps_the_safe_acceleration_stops_where_he_could_before() {
        for speed_mps in [0.0_f64, 0.05, 0.5, 3.0, 14.0, 40.0] {
            for room_m in [0.0_f64, 1e-3, 0.5, 4.0, 100.0] {
                let acceleration = safe_acceleration(speed_mps, room_m, 0.1);
                let (moved_m, after_mps) = advance(speed_mps, acceleration, 0.1);
                let used_m = moved_m + stopping_m(after_mps) - stopping_m(speed_mps);
                assert!(
                    used_m <= room_m + 1e-9,
                    "{speed_mps} m/s, {room_m} m: {used_m}"
                );
                // It is the most, wherever it does not end in a stand.
                if after_mps > 0.0 {
                    let (moved_m, after_mps) = advance(speed_mps, acceleration + 0.01, 0.1);
                    assert!(moved_m + stopping_m(after_mps) - stopping_m(speed_mps) > room_m);
                }
            }
        }
    }
}
