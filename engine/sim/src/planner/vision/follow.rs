//! Speed along a path over time: the Intelligent Driver Model behind the vehicle ahead, slow in
//! curves.

use decouplegs_drive::idm::{IdmParameters, Leader, advance};

use super::lead::Lead;
use super::way::{RoadPath, VIEW_M};
use crate::planner::cadence::{HORIZON_S, SPACING_S};

/// Sideways acceleration that is borne in bends, meters per second squared.
const LATERAL_MPS2: f64 = 2.0;
/// Deceleration for curves, m/s^2.
const BEND_BRAKING_MPS2: f64 = 1.8;
/// Acceleration, m/s^2.
const ACCELERATION_MPS2: f64 = 1.5;
/// Comfortable deceleration, m/s^2.
const BRAKING_MPS2: f64 = 2.5;
/// Time headway, seconds.
const HEADWAY_S: f64 = 1.6;
/// Gap to a standing vehicle, meters: so far, because nearer ones hide their foot below the image.
const STANDSTILL_M: f64 = 3.8;
/// Distance between speed limits on the way, meters.
const LIMIT_STEP_M: f64 = 1.0;

/// Target positions of the ego on the path, and its speed profile.
pub(super) struct Pace<'a> {
    pub way: &'a RoadPath,
    pub lead: Option<Lead>,
    /// Length of the ego, meters.
    pub length_m: f64,
    pub speed_mps: f64,
    pub cruise_mps: f64,
}

impl Pace<'_> {
    /// Meters along the way at each moment of a plan, the first at zero seconds.
    pub(super) fn arcs_m(&self) -> Vec<f64> {
        let limits_mps = self.limits_mps();
        let driver = IdmParameters {
            speed_mps: self.cruise_mps,
            headway_s: HEADWAY_S,
            acceleration_mps2: ACCELERATION_MPS2,
            braking_mps2: BRAKING_MPS2,
            standstill_gap_m: STANDSTILL_M,
            ..IdmParameters::default()
        };
        let (mut arc_m, mut speed_mps) = (0.0, self.speed_mps);
        let mut arcs_m = vec![0.0];
        for tick in 0..(HORIZON_S / SPACING_S).round() as u32 {
            let time_s = f64::from(tick) * SPACING_S;
            let leader = self.lead.map(|lead| Leader {
                gap_m: lead.arc_m + lead.speed_mps * time_s - arc_m - 0.5 * self.length_m,
                speed_mps: lead.speed_mps,
            });
            let soon_m = arc_m + speed_mps * SPACING_S;
            let limit_mps =
                limits_mps[((soon_m / LIMIT_STEP_M) as usize).min(limits_mps.len() - 1)];
            let bend_mps2 = (limit_mps - speed_mps) / (2.0 * SPACING_S);
            let acceleration_mps2 = driver.acceleration(speed_mps, leader).min(bend_mps2);
            let (driven_m, after_mps) = advance(speed_mps, acceleration_mps2, SPACING_S);
            (arc_m, speed_mps) = (arc_m + driven_m, after_mps);
            arcs_m.push(arc_m);
        }
        arcs_m
    }

    /// The highest speed at each meter of the way from which every bend is still reached slowly
    /// enough.
    fn limits_mps(&self) -> Vec<f64> {
        let count = (VIEW_M / LIMIT_STEP_M) as usize;
        let bend = |at: usize| {
            (LATERAL_MPS2
                / self
                    .way
                    .at(at as f64 * LIMIT_STEP_M)
                    .curvature
                    .abs()
                    .max(1e-6))
            .sqrt()
        };
        let mut limits: Vec<f64> = (0..=count).map(bend).collect();
        for at in (0..count).rev() {
            limits[at] = limits[at]
                .min((limits[at + 1].powi(2) + 2.0 * BEND_BRAKING_MPS2 * LIMIT_STEP_M).sqrt());
        }
        limits
    }
}
