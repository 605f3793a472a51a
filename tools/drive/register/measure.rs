//! Effect of registration on each track, in figures.

use decouplegs::drive::alignment::{
    TruthError, ade_to_lanes, against_truth, against_truth_along, clearances,
};
use decouplegs::drive::register::Registered;
use decouplegs::drive::register::fit::PlanarFit;
use decouplegs::drive::register::route::may_use;
use decouplegs::drive::{Foot, Ground, LaneIndex, LanePoint, Outcome, Registration, Treatment};
use decouplegs::scene::{LaneMap, Track};
use glam::DVec2;

/// Figures of all tracks.
pub struct Measured {
    pub tracks: Vec<MeasuredTrack>,
    /// Corners that are deeper below the ground have penetrated it, meters.
    pub tolerance_m: f64,
    /// True if a ground truth was given.
    pub has_truth: bool,
    /// True if there is a ground to measure clearances against.
    pub has_ground: bool,
}

/// Figures of a track; poses within lane changes do not count for distances to lanes.
pub struct MeasuredTrack {
    pub id: String,
    pub class: String,
    /// Reason why it was left out.
    pub refused: Option<String>,
    /// Motion and treatment of the track.
    pub fit: Option<(PlanarFit, Treatment)>,
    /// Mean distance to the nearest centerline, meters.
    pub to_lane_m: BeforeAfter<Option<f64>>,
    pub to_truth: BeforeAfter<Option<TruthError>>,
    /// Clearance of each bottom corner of each pose, meters.
    pub clearances_m: Vec<f64>,
    pub lane_changes: usize,
    /// Names of flags, and how many poses have them.
    pub flags: Vec<(&'static str, usize)>,
    /// Time in seconds and signed distance from the centerline of its lane, meters; empty where it
    /// follows none.
    pub offsets_m: BeforeAfter<Vec<(f64, f64)>>,
}

/// Values as logged, and as registered.
#[derive(Clone, Debug, Default)]
pub struct BeforeAfter<T> {
    pub before: T,
    pub after: T,
}

impl Measured {
    pub fn new(
        map: &LaneMap,
        tracks: &[Track],
        registration: &Registration,
        truth: Option<&[Track]>,
        ground: Option<&Ground>,
        tolerance_m: f64,
    ) -> Self {
        let index = LaneIndex::new(map);
        let measure = |(at, track): (usize, &Track)| {
            let truth = truth.and_then(|truth| truth.iter().find(|truth| truth.id == track.id));
            let usable = |point: &LanePoint| may_use(&track.class, map.lanes[point.lane].kind);
            References {
                index: &index,
                truth,
                ground,
            }
            .measure(track, &registration.tracks[at].outcome, &usable)
        };
        let tracks = tracks.iter().enumerate().map(measure).collect();
        Self {
            tracks,
            tolerance_m,
            has_truth: truth.is_some(),
            has_ground: ground.is_some(),
        }
    }

    /// Clearances of all tracks.
    pub fn clearances_m(&self) -> Vec<f64> {
        self.tracks
            .iter()
            .flat_map(|track| track.clearances_m.iter().copied())
            .collect()
    }

    /// Mean over the tracks that have both, each counting the same.
    pub fn mean(
        &self,
        of: impl Fn(&MeasuredTrack) -> BeforeAfter<Option<f64>>,
    ) -> Option<BeforeAfter<f64>> {
        let both = self.tracks.iter().filter_map(|track| {
            let BeforeAfter { before, after } = of(track);
            Some((before?, after?))
        });
        let (before, after, count) = both.fold((0.0, 0.0, 0), |(b, a, n), (before, after)| {
            (b + before, a + after, n + 1)
        });
        (count > 0).then(|| BeforeAfter {
            before: before / f64::from(count),
            after: after / f64::from(count),
        })
    }
}

/// Names of the flags of a track's poses, each with the number of poses that have it.
fn flags_of(registered: &Registered) -> Vec<(&'static str, usize)> {
    const NAMES: [&str; 7] = [
        "no-support",
        "no-height",
        "uneven",
        "lane-change",
        "outlier",
        "parked",
        "lane-unsure",
    ];
    let found: Vec<&str> = registered
        .poses
        .iter()
        .flat_map(|pose| pose.flags.names())
        .collect();
    let counted = NAMES.map(|name| (name, found.iter().filter(|flag| **flag == name).count()));
    counted
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .collect()
}

/// Time and distance to the left of the lane, meters, of each of `positions` whose pose follows
/// one.
fn lane_offsets(registered: &Registered, positions: &[(f64, DVec2)]) -> Vec<(f64, f64)> {
    let lanes = registered.poses.iter().map(|pose| pose.lane);
    let offset = |(&(time_s, at), lane): (&(f64, DVec2), Option<Foot>)| {
        let lane = lane?;
        let left = DVec2::from_angle(lane.heading_rad).perp_dot(at - lane.point.truncate());
        Some((time_s, left))
    };
    positions.iter().zip(lanes).filter_map(offset).collect()
}

/// References for the measurement of a track.
struct References<'a> {
    index: &'a LaneIndex,
    truth: Option<&'a Track>,
    ground: Option<&'a Ground>,
}

impl References<'_> {
    fn measure(
        &self,
        track: &Track,
        outcome: &Outcome,
        usable: &dyn Fn(&LanePoint) -> bool,
    ) -> MeasuredTrack {
        let logged: Vec<(f64, DVec2)> = track
            .points
            .iter()
            .map(|point| (point.time_s, point.position_m))
            .collect();
        let mut measured = MeasuredTrack {
            id: track.id.clone(),
            class: track.class.clone(),
            refused: None,
            fit: None,
            to_lane_m: BeforeAfter::default(),
            to_truth: BeforeAfter {
                before: self
                    .truth
                    .and_then(|truth| against_truth(logged.iter().copied(), truth)),
                after: None,
            },
            clearances_m: Vec::new(),
            lane_changes: 0,
            flags: Vec::new(),
            offsets_m: BeforeAfter::default(),
        };
        let registered = match outcome {
            Outcome::Refused { reason } => {
                measured.refused = Some(reason.clone());
                return measured;
            }
            Outcome::Registered(registered) => registered,
        };
        let placed: Vec<(f64, DVec2)> = registered
            .poses
            .iter()
            .map(|pose| (pose.time_s, pose.pose.translation.truncate()))
            .collect();
        let on_lane = |positions: &[(f64, DVec2)]| {
            let counted = positions
                .iter()
                .zip(&registered.poses)
                .filter(|(_, pose)| !pose.flags.lane_change);
            ade_to_lanes(self.index, counted.map(|((_, at), _)| *at), usable)
        };
        // Who follows no lane, as a parked car, is not meant to be on its middle.
        if !registered.treatment.is_parked() {
            measured.to_lane_m = BeforeAfter {
                before: on_lane(&logged),
                after: on_lane(&placed),
            };
        }
        // Before and after, across and along mean those of the lane that the track was found to
        // follow.
        let truth_of = |positions: &[(f64, DVec2)]| {
            let lanes = registered
                .poses
                .iter()
                .map(|pose| pose.lane.map(|lane| lane.heading_rad));
            against_truth_along(
                positions
                    .iter()
                    .zip(lanes)
                    .map(|(&(time_s, at), heading_rad)| (time_s, at, heading_rad)),
                self.truth?,
            )
        };
        measured.to_truth = BeforeAfter {
            before: truth_of(&logged),
            after: truth_of(&placed),
        };
        measured.offsets_m = BeforeAfter {
            before: lane_offsets(registered, &logged),
            after: lane_offsets(registered, &placed),
        };
        measured.fit = Some((registered.fit, registered.treatment));
        measured.lane_changes = registered.lane_changes.len();
        measured.flags = flags_of(registered);
        if let Some(ground) = self.ground {
            let dims_m = track
                .dims_m
                .unwrap_or(decouplegs::drive::RegisterOptions::default().dims_m);
            let near =
                |at: DVec2, z_m: f64| ground.height_at(at, Some(z_m)).map(|height| height.z_m);
            measured.clearances_m =
                clearances(registered.poses.iter().map(|pose| pose.pose), dims_m, near);
        }
        measured
    }
}
