//! Evidence for drift: of the log as a whole, and of single tracks beyond the habits of their
//! drivers.

use std::f64::consts::PI;

use glam::DVec2;
use rayon::prelude::*;

use super::align::{
    Aligned, KEEPING_WAYPOINTS, OFF_COST_MAX, PAIRS_MIN, ROUTES, Register, Routed, scales,
};
use super::fit::{LinePair, PlanarFit, fit};
use super::prepared::Prepared;
use crate::planar::PlanarTransform;
use crate::polyline::{Foot, wrapped};

/// A motion of a single track is drift where it is more probable by this than a habit of its
/// driver: e^5 times.
const EVIDENCE_COST: f64 = 5.0;
/// Lanes are unsure where others are less probable by not more than this.
const RIVAL_COST: f64 = 3.0;
/// Motions that differ by more lead to other lanes, meters; the usual width of a lane.
const OTHER_LANE_M: f64 = 1.0;
const LANE_WIDTH_M: f64 = 3.5;
/// Distances from which motions of the whole log are looked for, meters.
const STARTS_M: [f64; 2] = [1.2, 2.4];
/// Turn, and shift along two axes.
const MOTION_PARAMETERS: usize = 3;
/// Tracks that can show drift of the log.
pub const LOG_TRACKS_MIN: usize = MOTION_PARAMETERS + 1;
/// Spread of the tracks' means that is assumed before any is seen, meters, and the number of tracks
/// that this counts as.
const PRIOR_HABIT_M: f64 = 0.1;
const PRIOR_TRACKS: f64 = 2.0;

/// Reason for which a track is left where it was logged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum KeptBecause {
    /// Lanes show no more than habits of drivers.
    NoEvidence,
    /// Several lanes fit the track about as well.
    LaneUnsure,
}

/// No motion, about `pivot_m`, with the uncertainty of a log that is taken as it is.
pub fn none_about(pivot_m: DVec2) -> PlanarFit {
    let motion = PlanarTransform::identity(pivot_m);
    PlanarFit {
        motion,
        residual_m: 0.0,
        along_m: 0.0,
        across_m: 0.0,
        yaw_deviation_rad: 0.0,
    }
}

/// The ratio of variances that chance exceeds once in a thousand, for three degrees of freedom over
/// `freedom`.
fn f_limit(freedom: f64) -> f64 {
    const TABLE: [(f64, f64); 15] = [
        (2.0, 999.2),
        (3.0, 141.1),
        (4.0, 56.2),
        (5.0, 33.2),
        (6.0, 23.7),
        (7.0, 18.8),
        (8.0, 15.8),
        (9.0, 13.9),
        (10.0, 12.6),
        (12.0, 10.8),
        (15.0, 9.34),
        (20.0, 8.10),
        (30.0, 7.05),
        (60.0, 6.17),
        (f64::INFINITY, 5.42),
    ];
    // The next smaller entry, which asks for more.
    TABLE
        .iter()
        .rev()
        .find(|(entry, _)| *entry <= freedom)
        .map_or(TABLE[0].1, |(_, limit)| *limit)
}

impl Register<'_> {
    /// The motion of all `guides` together that is most probable from a start, and its cost. None
    /// where no lanes are found.
    fn shared_from<'a, 'b>(
        &self,
        guides: &[&'b Prepared<'a>],
        start: PlanarTransform,
    ) -> Option<(PlanarFit, f64)> {
        let mut motion = start;
        let mut found = None;
        for _ in 0..ROUTES {
            let mut routed: Vec<Routed> = guides
                .iter()
                .filter_map(|guide| self.route(guide, &motion, true).ok())
                .collect();
            for scale_m in scales() {
                let pairs: Vec<LinePair> = routed
                    .iter()
                    .flat_map(|routed| self.pairs(routed, &motion))
                    .collect();
                if pairs.len() < PAIRS_MIN {
                    return None;
                }
                let fitted = fit(&pairs, &motion, &self.options.prior, scale_m);
                motion = fitted.motion;
                for one in &mut routed {
                    self.measure_changes(one, &fitted);
                }
                found = Some(fitted);
            }
        }
        let found = found.filter(|found| self.doubt(found).is_none())?;
        Some((found, self.log_cost(guides, &found)))
    }

    /// Minus the logarithm of how probable a motion of the whole log is, but for a constant.
    fn log_cost(&self, guides: &[&Prepared], found: &PlanarFit) -> f64 {
        let of_guide = |guide: &&Prepared| match self.with_motion(guide, found) {
            Ok(aligned) => self.lane_cost(guide, &aligned, 0.0),
            // A track that this motion takes from all lanes.
            Err(_) => OFF_COST_MAX * guide.waypoints.len() as f64 / KEEPING_WAYPOINTS,
        };
        self.drift_cost(&found.motion) + guides.par_iter().map(of_guide).sum::<f64>()
    }

    /// The motion of all `guides` together, where lanes show one and only one.
    ///
    /// A log that is off by more than half a lane looks as if it were on the next lanes: motions
    /// are looked for from several starts, and the most probable is believed only if no other is
    /// nearly as probable.
    pub fn shared(&self, guides: &[&Prepared]) -> Option<PlanarFit> {
        let count = guides.len().max(1) as f64;
        let first = guides.first()?.middle();
        let pivot_m = first
            + guides
                .iter()
                .map(|guide| guide.middle() - first)
                .sum::<DVec2>()
                / count;
        // A track that does not follow lanes shows nothing of the log's drift.
        let follows = |guide: &&&Prepared| self.align(guide).is_ok();
        let following: Vec<&Prepared> = guides.par_iter().filter(follows).copied().collect();
        let none = PlanarTransform::identity(pivot_m);
        let around = (0..8)
            .flat_map(|turn| STARTS_M.map(|m| DVec2::from_angle(0.25 * PI * f64::from(turn)) * m));
        let starts =
            std::iter::once(none).chain(around.map(|shift_m| PlanarTransform { shift_m, ..none }));
        let mut found: Vec<(PlanarFit, f64)> = starts
            .filter(|start| self.believed(start))
            .collect::<Vec<_>>()
            .par_iter()
            .filter_map(|start| self.shared_from(&following, *start))
            .collect();
        found.sort_by(|a, b| a.1.total_cmp(&b.1));
        let (best, least) = *found.first()?;
        let is_other =
            |other: &PlanarFit| other.motion.shift_m.distance(best.motion.shift_m) > OTHER_LANE_M;
        let rival = found
            .iter()
            .find(|(other, cost)| is_other(other) && cost - least < RIVAL_COST);
        rival.is_none().then_some(best)
    }

    /// Mean signed distance of a track from its lanes where it keeps to them, meters, to the left
    /// positive. None where it never does.
    pub fn habit_m(prepared: &Prepared, aligned: &Aligned) -> Option<f64> {
        let laterals = Self::laterals_m(prepared, aligned);
        (!laterals.is_empty()).then(|| laterals.iter().sum::<f64>() / laterals.len() as f64)
    }

    /// Signed distances of the waypoints from their lanes, outside lane changes.
    fn laterals_m(prepared: &Prepared, aligned: &Aligned) -> Vec<f64> {
        let keeps = |time_s: f64| {
            !aligned
                .lane_changes
                .iter()
                .any(|change| change.contains(time_s))
        };
        let of = |(foot, time_s): (&Option<(usize, Foot)>, f64)| {
            foot.filter(|_| keeps(time_s))
                .map(|(_, foot)| foot.lateral_m)
        };
        aligned
            .feet
            .iter()
            .zip(prepared.times_s())
            .filter_map(of)
            .collect()
    }

    /// Test of `own`, the motion of one track: drift, or a habit of its driver or a guess between
    /// lanes. `stay` is the track without that motion.
    ///
    /// # Errors
    /// The reason to leave the track where it was logged.
    pub fn is_drift(
        &self,
        prepared: &Prepared,
        own: &Aligned,
        stay: &Aligned,
    ) -> Result<(), KeptBecause> {
        let habit_m = Self::habit_m(prepared, stay).unwrap_or(0.0);
        let stay_cost = 0.5 * (habit_m / self.options.keeping_m).powi(2)
            + self.lane_cost(prepared, stay, habit_m);
        let relative = self.relative(prepared, &own.fit.motion, &stay.fit.motion);
        let own_cost = self.drift_cost(&relative) + self.lane_cost(prepared, own, 0.0);
        if stay_cost - own_cost < EVIDENCE_COST {
            return Err(KeptBecause::NoEvidence);
        }
        if self.has_rival(prepared, own, own_cost, &stay.fit.motion) {
            return Err(KeptBecause::LaneUnsure);
        }
        Ok(())
    }

    /// A motion seen from another one, in the middle of a track.
    fn relative(
        &self,
        prepared: &Prepared,
        motion: &PlanarTransform,
        from: &PlanarTransform,
    ) -> PlanarTransform {
        let pivot_m = prepared.middle();
        let shift_m = motion.apply(pivot_m) - from.apply(pivot_m);
        PlanarTransform {
            pivot_m,
            yaw_rad: wrapped(motion.yaw_rad - from.yaw_rad),
            shift_m,
        }
    }

    /// True if the track fits other lanes nearly as well as those of `own`.
    fn has_rival(
        &self,
        prepared: &Prepared,
        own: &Aligned,
        own_cost: f64,
        base: &PlanarTransform,
    ) -> bool {
        let way = prepared.waypoints.last().zip(prepared.waypoints.first());
        let across = way.map_or(DVec2::Y, |(last, first)| {
            (last.position - first.position)
                .perp()
                .normalize_or(DVec2::Y)
        });
        let middle = own.fit.motion.about(prepared.middle());
        [-LANE_WIDTH_M, LANE_WIDTH_M].into_iter().any(|left_m| {
            // A fit would be drawn back by the prior: the track is put beside its lanes, and then
            // onto those that it finds there.
            let aside = |left_m: f64| {
                let motion = PlanarTransform {
                    shift_m: middle.shift_m + across * left_m,
                    ..middle
                };
                let aligned = self
                    .with_motion(prepared, &PlanarFit { motion, ..own.fit })
                    .ok()?;
                let off_m = Self::habit_m(prepared, &aligned)?;
                Some((motion, aligned, off_m))
            };
            let onto = aside(left_m).and_then(|(_, _, off_m)| aside(left_m - off_m));
            let Some((motion, other, _)) = onto.filter(|(motion, ..)| self.believed(motion)) else {
                return false;
            };
            let is_other = motion.shift_m.distance(middle.shift_m) > OTHER_LANE_M;
            let cost = self.drift_cost(&self.relative(prepared, &motion, base))
                + self.lane_cost(prepared, &other, 0.0);
            is_other && cost - own_cost < RIVAL_COST
        })
    }

    /// True if `shared` moves the log by more than the habits of its drivers explain: an F test
    /// over the tracks' mean distances from their lanes. A prior for their spread makes the test
    /// stricter for few tracks.
    pub fn is_log_drift(&self, guides: &[&Prepared], shared: &PlanarFit) -> bool {
        let none = none_about(shared.motion.pivot_m);
        let habits = |guide: &&Prepared| {
            let of = |fit: &PlanarFit| Self::habit_m(guide, &self.with_motion(guide, fit).ok()?);
            Some((of(&none)?, of(shared)?))
        };
        let both: Vec<(f64, f64)> = guides.par_iter().filter_map(habits).collect();
        let (before, after) = both.iter().fold((0.0, 0.0), |(b, a), (before, after)| {
            (b + before * before, a + after * after)
        });
        let freedom = PRIOR_TRACKS + both.len().saturating_sub(MOTION_PARAMETERS) as f64;
        let spread = (after + PRIOR_TRACKS * PRIOR_HABIT_M * PRIOR_HABIT_M) / freedom;
        (before - after) / MOTION_PARAMETERS as f64 / spread > f_limit(freedom)
    }
}
