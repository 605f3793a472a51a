//! Drivers whose parameters are drawn from distributions.
//!
//! Each parameter is lognormal: its median times `exp(sigma z)`, within a range, `z` normal. All
//! follow from the seed of the scenario and the place of the driver in it, whatever the order.

use decouplegs_scene::RoadUser;
use decouplegs_scene::random::mix;
use decouplegs_scene::scenario::DriverKind;

use super::driver::Driver;
use super::idm::Interaction;
use super::random;

/// Uniform numbers whose sum is a normal one, nearly: no tails beyond six deviations.
const UNIFORM_COUNT: u32 = 12;

/// Distribution of a parameter.
struct Spread {
    median: f64,
    sigma: f64,
    range: [f64; 2],
}

const fn spread(median: f64, sigma: f64, range: [f64; 2]) -> Spread {
    Spread {
        median,
        sigma,
        range,
    }
}

// Headways and gaps at rest are fitted to the public NGSIM parts of CommonRoad on US 101 (28 files,
// 610 followers: median (gap - 2 m) / speed of 1.23 s, sigma of the logarithm 0.52) and Lankershim
// Boulevard (17 files, 216 followers: 1.16 s, 0.46; gaps at rest of 481 vehicles: 2.9 m), without
// USA_US101-9 and USA_Lanker-1_17, on which traffic is judged. Accelerations lie between what is
// seen there (1.9 and 2.5 m/s^2 at the 80th percentile of each driver) and Treiber's 1 m/s^2.
// Speeds and politeness are chosen: free drivers are too rare in these files to be fitted.
const HEADWAY_S: Spread = spread(1.2, 0.5, [0.5, 3.0]);
const STANDSTILL_GAP_M: Spread = spread(2.5, 0.3, [1.0, 5.0]);
const ACCELERATION_MPS2: Spread = spread(1.6, 0.25, [0.8, 3.0]);
const BRAKING_MPS2: Spread = spread(2.2, 0.25, [1.2, 4.0]);
const SPEED_SHARE: Spread = spread(1.0, 0.1, [0.75, 1.3]);
const POLITENESS: Spread = spread(0.25, 0.5, [0.05, 0.8]);

/// A queue does not close up: with this share a standing driver starts at 1.6 times the gap at
/// rest.
const START_SHARE: f64 = 0.6;

impl Spread {
    /// Value of driver `number`; `place` is that of the parameter in the table.
    fn draw(&self, seed: u64, number: usize, place: u32) -> f64 {
        let from = place * UNIFORM_COUNT;
        let all = from..from + UNIFORM_COUNT;
        let sum: f64 = all.map(|choice| random::unit(seed, number, choice)).sum();
        let normal = sum - 0.5 * f64::from(UNIFORM_COUNT);
        let [least, most] = self.range;
        (self.median * (self.sigma * normal).exp()).clamp(least, most)
    }
}

impl Driver {
    /// Driver of a kind of vehicle, drawn as number `number` of a scenario with this seed.
    ///
    /// Drawn values are multiplied by the ratio of the type's parameters to the normal driver's
    /// ([`Driver::from`]), and vehicles differ as [`Driver::new`] says. The model of following is
    /// [`Interaction::Least`].
    #[must_use]
    pub fn drawn(kind: RoadUser, driver: DriverKind, seed: u64, number: usize) -> Self {
        let seed = mix(seed ^ 0x6472_6976);
        let normal = Self::from(DriverKind::Normal);
        let mut made = Self::from(driver);
        let draw = |spread: &Spread, place: u32| spread.draw(seed, number, place);
        made.idm.interaction = Interaction::Least;
        made.start_share = START_SHARE;
        made.idm.headway_s *= draw(&HEADWAY_S, 0) / normal.idm.headway_s;
        made.idm.standstill_gap_m *= draw(&STANDSTILL_GAP_M, 1) / normal.idm.standstill_gap_m;
        made.idm.acceleration_mps2 *= draw(&ACCELERATION_MPS2, 2) / normal.idm.acceleration_mps2;
        made.idm.braking_mps2 *= draw(&BRAKING_MPS2, 3) / normal.idm.braking_mps2;
        made.speed_share *= draw(&SPEED_SHARE, 4);
        made.mobil.politeness *= draw(&POLITENESS, 5) / normal.mobil.politeness;
        made.on(kind)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn median(value: impl Fn(&Driver) -> f64) -> f64 {
        let drivers =
            (0..4001).map(|number| Driver::drawn(RoadUser::Car, DriverKind::Normal, 7, number));
        let mut all: Vec<f64> = drivers.map(|driver| value(&driver)).collect();
        all.sort_by(f64::total_cmp);
        all[2000]
    }

    #[test]
    fn drivers_have_the_medians_and_ranges_of_the_table() {
        let near = |found: f64, spread: &Spread| {
            (found / spread.median - 1.0).abs() < 4.0 * spread.sigma * 1.25 / 4001_f64.sqrt()
        };
        assert!(near(median(|one| one.idm.headway_s), &HEADWAY_S));
        assert!(near(
            median(|one| one.idm.standstill_gap_m),
            &STANDSTILL_GAP_M
        ));
        assert!(near(
            median(|one| one.idm.acceleration_mps2),
            &ACCELERATION_MPS2
        ));
        assert!(near(median(|one| one.idm.braking_mps2), &BRAKING_MPS2));
        assert!(near(median(|one| one.speed_share), &SPEED_SHARE));
        assert!(near(median(|one| one.mobil.politeness), &POLITENESS));
        assert!(!near(1.1 * median(|one| one.idm.headway_s), &HEADWAY_S));
        for number in 0..4000 {
            let one = Driver::drawn(RoadUser::Car, DriverKind::Normal, 3, number);
            let [least, most] = HEADWAY_S.range;
            assert!((least..=most).contains(&one.idm.headway_s));
        }
    }

    #[test]
    fn a_driver_follows_from_seed_and_number_alone() {
        let one = |seed, number| Driver::drawn(RoadUser::Car, DriverKind::Normal, seed, number);
        assert_eq!(one(1, 5), one(1, 5));
        assert_ne!(one(1, 5), one(1, 6));
        assert_ne!(one(1, 5), one(2, 5));
        let calm = Driver::drawn(RoadUser::Car, DriverKind::Calm, 1, 5);
        assert!((calm.idm.headway_s / one(1, 5).idm.headway_s - 2.2 / 1.8).abs() < 1e-12);
    }
}
