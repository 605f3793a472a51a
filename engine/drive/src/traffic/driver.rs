//! Parameters of the kinds of drivers.

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
    /// Time gap that must remain between leaving a conflict and the arrival of a vehicle with
    /// priority, seconds.
    pub gap_s: f64,
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
            gap_s,
        }
    }
}
