//! Placement of cars by drifting tracks, before and after registration, and its distance from the
//! ground truth.

use std::f64::consts::TAU;

use anyhow::Result;
use decouplegs::drive::alignment::{
    ade_to_lanes, against_truth, clearances, penetration_rate, size_quantile,
};
use decouplegs::drive::{Ground, GroundOptions, LaneIndex, Outcome, RegisterOptions, register};
use decouplegs::scene::{LaneMap, Pose, Track, TrackPoint, Trajectory, random};
use glam::DVec2;
use serde_json::{Value, json};

use super::reinsertion_street::{ReinsertionStreet, trajectory};

/// Rate at which tracks tell where a car is, Hz.
const RATE_HZ: f64 = 10.0;
/// Corners deeper than this below the ground have penetrated it, meters.
pub const TOLERANCE_M: f64 = 0.02;

/// Drift of tracks from the ground truth.
#[derive(Clone, Copy, Debug)]
pub struct Drift {
    /// Shift of each track, meters, in a direction of its own.
    pub shift_m: f64,
    /// Turn of each track about its middle, to either side, radians.
    pub turn_rad: f64,
    /// Standard deviation of each position of a track along each axis, meters.
    pub noise_m: f64,
    /// Seed of all randomness.
    pub seed: u64,
}

/// Placement errors of cars, means over tracks.
#[derive(Clone, Copy, Debug)]
pub struct Placing {
    /// Mean distance to the true position at the same moment, meters.
    pub ade_truth_m: f64,
    /// Mean distance across the true way, meters.
    pub across_m: f64,
    /// Mean distance along the true way, meters.
    pub along_m: f64,
    /// Mean distance to the nearest centerline; true ways are on one.
    pub ade_lane_m: f64,
    /// Share of bottom corners more than [`TOLERANCE_M`] below the true ground, which is level.
    pub penetration_rate: f64,
    /// Distance that 95 of 100 corners keep from the true ground, either way.
    pub clearance_p95_m: f64,
    /// Tracks in all.
    pub tracks: usize,
    /// Tracks that were refused, and drive as logged.
    pub refused: usize,
}

impl Placing {
    pub fn to_json(self) -> Value {
        json!({
            "ade_truth_m": self.ade_truth_m,
            "across_m": self.across_m,
            "along_m": self.along_m,
            "ade_lane_m": self.ade_lane_m,
            "penetration_rate": self.penetration_rate,
            "clearance_p95_m": self.clearance_p95_m,
            "tracks": self.tracks,
            "refused": self.refused,
        })
    }
}

/// The ways of all agents.
pub struct Placed {
    /// Trajectories in the order of the agents.
    pub ways: Vec<Trajectory>,
    pub placing: Placing,
}

/// Logged and registered.
pub struct Tracks {
    pub logged: Placed,
    pub registered: Placed,
}

impl Tracks {
    /// The ways of `stage`'s agents as a log that drifts tells them, and as they come out of
    /// registration.
    pub fn register(stage: &ReinsertionStreet, drift: &Drift) -> Result<Self> {
        let truth: Vec<Track> = (0..stage.loaded.agents.len())
            .map(|agent| true_track(stage, agent))
            .collect();
        let mut random = Random(drift.seed);
        let logged: Vec<Track> = truth
            .iter()
            .map(|track| drifted(track, drift, &mut random))
            .collect();
        let ground = Ground::new(
            &stage.loaded.splat_scene.splats,
            stage.loaded.splat_scene.origin,
            &GroundOptions::default(),
        );
        // Each track drifts on its own, from the middle of its lane.
        let options = RegisterOptions {
            keeping_m: 0.0,
            ..RegisterOptions::default()
        };
        let registration = register(&stage.street.lanes, &logged, Some(&ground), &options)?;
        let (mut ways, mut refused) = (Vec::new(), 0);
        for (track, outcome) in logged.iter().zip(&registration.tracks) {
            match &outcome.outcome {
                Outcome::Registered(found) => {
                    ways.push(trajectory(
                        found.poses.iter().map(|pose| (pose.time_s, pose.pose)),
                    )?);
                }
                Outcome::Refused { .. } => {
                    refused += 1;
                    ways.push(as_logged(track)?);
                }
            }
        }
        let as_logged = logged.iter().map(as_logged).collect::<Result<Vec<_>>>()?;
        let lanes = &stage.street.lanes;
        Ok(Self {
            logged: Placed {
                placing: placing(lanes, &truth, &as_logged, 0),
                ways: as_logged,
            },
            registered: Placed {
                placing: placing(lanes, &truth, &ways, refused),
                ways,
            },
        })
    }
}

fn true_track(stage: &ReinsertionStreet, agent: usize) -> Track {
    let placed = &stage.loaded.agents[agent];
    let (start_s, end_s) = (placed.trajectory.start_s(), placed.trajectory.end_s());
    let count = ((end_s - start_s) * RATE_HZ).round() as u32;
    let point = |step: u32| {
        let time_s = start_s + f64::from(step) / RATE_HZ;
        let pose = placed.trajectory.at(time_s);
        TrackPoint {
            time_s,
            position_m: pose.translation.truncate(),
            z_m: Some(pose.translation.z),
            yaw_rad: Some(pose.heading_rad()),
        }
    };
    Track {
        id: placed.name.clone(),
        class: "car".into(),
        dims_m: Some(stage.street.asset_dims_m[placed.asset].map(f64::from)),
        points: (0..=count).map(point).collect(),
    }
}

/// `track` shifted, turned and noisy. Heights and headings get no noise.
fn drifted(track: &Track, drift: &Drift, random: &mut Random) -> Track {
    let shift = DVec2::from_angle(TAU * random.unit()) * drift.shift_m;
    let turn_rad = if random.unit() < 0.5 {
        drift.turn_rad
    } else {
        -drift.turn_rad
    };
    let middle = track
        .points
        .iter()
        .map(|point| point.position_m)
        .sum::<DVec2>()
        / track.points.len() as f64;
    let moved = |point: &TrackPoint| {
        let noise = random.normal_pair() * drift.noise_m;
        TrackPoint {
            position_m: middle
                + DVec2::from_angle(turn_rad).rotate(point.position_m - middle)
                + shift
                + noise,
            yaw_rad: point.yaw_rad.map(|yaw_rad| yaw_rad + turn_rad),
            ..*point
        }
    };
    Track {
        points: track.points.iter().map(moved).collect(),
        ..track.clone()
    }
}

fn as_logged(track: &Track) -> Result<Trajectory> {
    trajectory(track.points.iter().map(|point| {
        (
            point.time_s,
            Pose::from_yaw(point.yaw_rad.unwrap_or(0.0), point.position()),
        )
    }))
}

fn placing(lanes: &LaneMap, truth: &[Track], ways: &[Trajectory], refused: usize) -> Placing {
    let index = LaneIndex::new(lanes);
    let (mut sums, mut lane_sum, mut heights_m) = (glam::DVec3::ZERO, 0.0, Vec::new());
    for (track, way) in truth.iter().zip(ways) {
        let positions = || {
            way.poses()
                .iter()
                .map(|timed| (timed.time_s, timed.pose.translation.truncate()))
        };
        if let Some(error) = against_truth(positions(), track) {
            sums += glam::DVec3::new(error.ade_m, error.lateral_m, error.longitudinal_m);
        }
        lane_sum += ade_to_lanes(&index, positions().map(|(_, position)| position), |_| true)
            .unwrap_or(0.0);
        let dims_m = track.dims_m.unwrap_or_default();
        heights_m.extend(clearances(
            way.poses().iter().map(|timed| timed.pose),
            dims_m,
            |_, _| Some(0.0),
        ));
    }
    let count = truth.len().max(1) as f64;
    Placing {
        ade_truth_m: sums.x / count,
        across_m: sums.y / count,
        along_m: sums.z / count,
        ade_lane_m: lane_sum / count,
        penetration_rate: penetration_rate(&heights_m, TOLERANCE_M).unwrap_or(0.0),
        clearance_p95_m: size_quantile(&heights_m, 0.95).unwrap_or(0.0),
        tracks: truth.len(),
        refused,
    }
}

/// Stream of random numbers.
struct Random(u64);

impl Random {
    /// Next number, uniform in [0, 1).
    fn unit(&mut self) -> f64 {
        (random::next(&mut self.0) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Two numbers of the normal distribution (Box and Muller, 1958).
    fn normal_pair(&mut self) -> DVec2 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        DVec2::from_angle(TAU * self.unit()) * radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight() -> Track {
        let point = |step: u32| TrackPoint {
            time_s: 0.1 * f64::from(step),
            position_m: DVec2::new(f64::from(step), 2.0),
            z_m: Some(0.75),
            yaw_rad: Some(0.0),
        };
        Track {
            dims_m: Some([4.0, 2.0, 1.5]),
            points: (0..101).map(point).collect(),
            ..Track::default()
        }
    }

    #[test]
    fn drift_is_as_large_as_asked_for() {
        let truth = straight();
        let off = |shift_m: f64, turn_rad: f64, noise_m: f64| -> Vec<f64> {
            let drift = Drift {
                shift_m,
                turn_rad,
                noise_m,
                seed: 4,
            };
            let moved = drifted(&truth, &drift, &mut Random(drift.seed));
            moved
                .points
                .iter()
                .zip(&truth.points)
                .map(|(a, b)| a.position_m.distance(b.position_m))
                .collect()
        };
        assert!(
            off(0.5, 0.0, 0.0)
                .iter()
                .all(|off_m| (off_m - 0.5).abs() < 1e-9)
        );
        let turned = off(0.0, 0.1, 0.0);
        assert!(
            turned[50] < 1e-9 && (turned[0] - 5.0).abs() < 0.01,
            "the middle stays"
        );
        // The mean of a Rayleigh distribution.
        let noisy = off(0.0, 0.0, 0.2).iter().sum::<f64>() / 101.0;
        assert!((noisy - 0.2 * (TAU / 4.0).sqrt()).abs() < 0.04, "{noisy}");
        assert!(off(0.0, 0.0, 0.0).iter().all(|off_m| *off_m < 1e-12));
    }

    #[test]
    fn boxes_on_level_ground_neither_sink_nor_float() {
        let way = as_logged(&straight()).unwrap();
        let found = placing(&LaneMap::default(), &[straight()], &[way], 0);
        assert!(
            found.ade_truth_m < 1e-9
                && found.clearance_p95_m < 1e-9
                && found.penetration_rate == 0.0,
            "{found:?}"
        );
        let sunk = Track {
            points: straight()
                .points
                .iter()
                .map(|p| TrackPoint {
                    z_m: Some(0.5),
                    ..*p
                })
                .collect(),
            ..straight()
        };
        let found = placing(
            &LaneMap::default(),
            &[straight()],
            &[as_logged(&sunk).unwrap()],
            0,
        );
        assert!(
            found.penetration_rate == 1.0 && (found.clearance_p95_m - 0.25).abs() < 1e-9,
            "{found:?}"
        );
    }
}
