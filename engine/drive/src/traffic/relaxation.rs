//! Gaps and speeds that drivers accept at the start, and how they return to their own.
//!
//! Real gaps are shorter and longer than what a driver settles for in the end: after merging, in
//! dense traffic, while others change lanes. A drawn driver begins with the gap that is there and
//! comes back to the own headway by the factor e in [`RELAX_S`] (J. A. Laval, L. Leclercq:
//! Microscopic modeling of the relaxation phenomenon using a macroscopic lane-changing model,
//! Transportation Research Part B 42, 2008, has 15 to 20 s). So do speeds, where it is not known
//! why all drive as they do.

use super::driver::Driver;

/// Time in which an accepted gap comes nearer to the driver's own by the factor e, seconds.
const RELAX_S: f64 = 15.0;
/// Headways that are accepted: shorter ones are opened, longer ones are not those of a follower.
const HEADWAY_S_MIN: f64 = 0.2;
const HEADWAY_S_MAX: f64 = 4.0;
/// Speed below which a gap is one of a queue, m/s.
const QUEUE_MPS: f64 = 2.0;
/// Least gap to a vehicle ahead that a driver accepts, meters.
const GAP_M_MIN: f64 = 0.5;

/// Differences of what a driver accepts to the driver's own wishes, which fade; zero for all
/// others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Accepted {
    pub headway_s: f64,
    pub standstill_gap_m: f64,
    /// Difference of the free speed, at most zero.
    pub free_mps: f64,
}

impl Accepted {
    /// Gaps and speed that `driver` accepts at `speed_mps`, `gap_m` behind another if there is
    /// one. `free_mps` is a free speed that the driver comes to only by and by, m/s.
    pub(super) fn new(
        driver: &Driver,
        speed_mps: f64,
        free_mps: Option<f64>,
        gap_m: Option<f64>,
    ) -> Self {
        let (own_s, own_m) = (driver.idm.headway_s, driver.idm.standstill_gap_m);
        let moves = speed_mps >= QUEUE_MPS;
        let mut accepted = Self {
            free_mps: match free_mps {
                Some(free_mps) if moves => (speed_mps - free_mps).min(0.0),
                _ => 0.0,
            },
            ..Self::default()
        };
        let Some(gap_m) = gap_m else {
            return accepted;
        };
        let least_m = if moves {
            gap_m - HEADWAY_S_MIN * speed_mps
        } else {
            gap_m
        };
        let accepted_m = least_m.clamp(GAP_M_MIN.min(own_m), own_m);
        let accepted_s = (gap_m - accepted_m) / speed_mps.max(QUEUE_MPS);
        if accepted_s <= HEADWAY_S_MAX {
            accepted.standstill_gap_m = accepted_m - own_m;
            if moves {
                accepted.headway_s = accepted_s.max(0.5 * HEADWAY_S_MIN) - own_s;
            }
        }
        accepted
    }

    /// Free speed for now of a driver whose own one is `own_mps`: at least half of it, m/s.
    pub(super) fn free_speed(&self, own_mps: f64) -> f64 {
        (own_mps + self.free_mps).max(0.5 * own_mps)
    }

    /// Lets the differences fade for `dt_s` seconds.
    pub(super) fn fade(&mut self, dt_s: f64) {
        if *self != Self::default() {
            let left = (1.0 - dt_s / RELAX_S).max(0.0);
            self.headway_s *= left;
            self.standstill_gap_m *= left;
            self.free_mps *= left;
        }
    }
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::scenario::DriverKind;

    use super::*;

    #[test]
    fn gaps_and_speeds_of_the_start_are_accepted_and_fade() {
        let driver = Driver::from(DriverKind::Normal);
        let own = driver.idm;
        let accepted = |speed_mps, gap_m| Accepted::new(&driver, speed_mps, Some(20.0), gap_m);
        // Closer than its own 1.8 s, farther, and beyond what is followed.
        for (gap_m, headway_s) in [(8.0, 0.6), (32.0, 3.0)] {
            let found = accepted(10.0, Some(gap_m));
            assert!((own.headway_s + found.headway_s - headway_s).abs() < 1e-12);
            assert_eq!((found.standstill_gap_m, found.free_mps), (0.0, -10.0));
        }
        assert_eq!(accepted(10.0, Some(60.0)).headway_s, 0.0);
        // In a queue.
        let found = accepted(0.0, Some(1.0));
        assert_eq!((found.headway_s, found.standstill_gap_m), (0.0, -1.0));
        assert_eq!(accepted(0.0, Some(5.0)), Accepted::default());
        assert_eq!(accepted(25.0, None), Accepted::default());
        let mut fading = accepted(10.0, Some(8.0));
        (0..150).for_each(|_| fading.fade(0.1));
        let left = fading.free_mps / -10.0;
        assert!((0.3..0.4).contains(&left), "{left}");
    }
}
