//! Parameters of the kinds of drivers.

use decouplegs_scene::RoadUser;
use decouplegs_scene::scenario::DriverKind;

use super::idm::IdmParameters;
use super::mobil::MobilParameters;

/// Parameters of a driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Driver {
    /// Following; its free speed is the lane's limit times [`Driver::speed_share`].
    pub idm: IdmParameters,
    /// Changing lanes.
    pub mobil: MobilParameters,
    /// Share of the allowed speed.
    pub speed_share: f64,
    /// Upper limit of the speed, m/s.
    pub speed_mps_max: f64,
    /// True if it keeps to the right edge of its lane.
    pub keeps_right: bool,
    /// Time gap that must remain between leaving a conflict and the arrival of a vehicle with
    /// priority, seconds.
    pub gap_s: f64,
    /// Share of the acceleration from standing that a standing driver must find room for, so as to
    /// start: 0 creeps up to any gap.
    pub start_share: f64,
}

impl From<DriverKind> for Driver {
    /// | kind       | speed | T, s | a | b | s0, m | politeness | threshold | safe braking | gap, s |
    /// |------------|-------|------|---|---|-------|------------|-----------|--------------|--------|
    /// | calm       | 0.9   | 2.2  | 0.8 | 2 | 2.5 | 0.5        | 0.5       | 3            | 2.5    |
    /// | normal     | 1.0   | 1.8  | 1   | 3 | 2   | 0.25       | 0.2       | 4            | 1.5    |
    /// | hurried    | 1.1   | 1.2  | 1.5 | 3 | 1.5 | 0.1        | 0.1       | 4            | 1.0    |
    /// | aggressive | 1.2   | 0.8  | 2   | 4 | 1   | 0          | 0.05      | 6            | 0.5    |
    ///
    /// The row of the normal driver is Treiber's; the others are chosen around it.
    fn from(kind: DriverKind) -> Self {
        let (
            [
                speed_share,
                headway_s,
                acceleration_mps2,
                braking_mps2,
                standstill_gap_m,
            ],
            mobil,
        ) = match kind {
            DriverKind::Calm => ([0.9, 2.2, 0.8, 2.0, 2.5], [0.5, 0.5, 3.0, 2.5]),
            DriverKind::Normal => ([1.0, 1.8, 1.0, 3.0, 2.0], [0.25, 0.2, 4.0, 1.5]),
            DriverKind::Hurried => ([1.1, 1.2, 1.5, 3.0, 1.5], [0.1, 0.1, 4.0, 1.0]),
            DriverKind::Aggressive => ([1.2, 0.8, 2.0, 4.0, 1.0], [0.0, 0.05, 6.0, 0.5]),
        };
        let [politeness, threshold_mps2, safe_braking_mps2, gap_s] = mobil;
        Self {
            idm: IdmParameters {
                headway_s,
                acceleration_mps2,
                braking_mps2,
                standstill_gap_m,
                ..IdmParameters::default()
            },
            mobil: MobilParameters {
                politeness,
                threshold_mps2,
                safe_braking_mps2,
                ..MobilParameters::default()
            },
            speed_share,
            speed_mps_max: f64::INFINITY,
            keeps_right: false,
            gap_s,
            start_share: 0.0,
        }
    }
}

impl Driver {
    /// Driver of a kind of vehicle. Those of cars are as [`Driver::from`] has them; others differ:
    ///
    /// | vehicle | top speed, km/h | T, s | a, m/s^2 | b, m/s^2 |
    /// |---------|-----------------|------|----------|----------|
    /// | truck   | 80              | +0.4 | x 0.6    | x 0.8    |
    /// | bus     | 80              | +0.4 | x 0.7    | x 0.7    |
    /// | cyclist | 20              | -0.4 | 0.8      | 2.5      |
    ///
    /// The numbers are chosen: trucks start slower, buses have standing passengers, and a cyclist
    /// rides at the right edge of the lane.
    #[must_use]
    pub fn new(kind: RoadUser, driver: DriverKind) -> Self {
        Self::from(driver).on(kind)
    }

    /// The same driver on another kind of vehicle than a car.
    pub(super) fn on(mut self, kind: RoadUser) -> Self {
        let idm = &mut self.idm;
        match kind {
            RoadUser::Car | RoadUser::Pedestrian => {}
            RoadUser::Truck => {
                self.speed_mps_max = 80.0 / 3.6;
                idm.headway_s += 0.4;
                idm.acceleration_mps2 *= 0.6;
                idm.braking_mps2 *= 0.8;
            }
            RoadUser::Bus => {
                self.speed_mps_max = 80.0 / 3.6;
                idm.headway_s += 0.4;
                idm.acceleration_mps2 *= 0.7;
                idm.braking_mps2 *= 0.7;
            }
            RoadUser::Cyclist => {
                self.speed_mps_max = 20.0 / 3.6;
                self.keeps_right = true;
                idm.headway_s = (idm.headway_s - 0.4).max(0.5);
                idm.acceleration_mps2 = 0.8;
                idm.braking_mps2 = 2.5;
            }
        }
        self
    }
}
