//! One track and its lanes: from the log to a planar motion.

use decouplegs_scene::LaneMap;

use super::RegisterOptions;
use super::dtw::{Band, align};
use super::fit::{LinePair, PlanarFit, RESIDUAL_MIN_M, fit};
use super::lane_change::{LaneChange, changes, measured};
use super::prepared::Prepared;
use super::procrustes::{WeightedPair, procrustes};
use super::route::{self, Leg, STEP_M, Waypoint};
use crate::lane_index::LaneIndex;
use crate::planar::PlanarTransform;
use crate::polyline::{Foot, wrapped};

/// Largest number of points that count between two waypoints.
const POINTS_A_WAYPOINT: f64 = 4.0;
/// Times that lanes are chosen, each after the first by the track as it was moved.
pub(super) const ROUTES: usize = 2;
/// Times that points are matched and the motion found.
const MATCHES: usize = 12;
/// Scale of the outlier test in the first round, meters; half of that in each further round. A
/// logged track has nearly a lane's shape at a wrong position. If its curves were outliers from the
/// start, its straight parts alone would decide.
const SCALE_FIRST_M: f64 = 1.0;
/// Matching ends when the motion changes by less, meters and (times a hundred meters) radians.
const SETTLED: f64 = 1e-5;
/// Deviation of drivers from the middle of their lane, meters, and number of waypoints for which
/// they stay on one side.
const LANE_KEEPING_M: f64 = 0.2;
pub(super) const KEEPING_WAYPOINTS: f64 = 5.0;
/// Costs of a waypoint that is anywhere, of a lane change, and of a leg that does not follow the
/// one before: logarithms of how rare they are.
pub(super) const OFF_COST_MAX: f64 = 9.0;
const CHANGE_COST: f64 = 8.0;
const JUMP_COST: f64 = 40.0;
/// Waypoints that a motion needs outside lane changes.
pub(super) const PAIRS_MIN: usize = 4;
/// A track with its motion and its lanes.
pub struct Aligned {
    pub fit: PlanarFit,
    pub legs: Vec<Leg>,
    pub lane_changes: Vec<LaneChange>,
    /// For each waypoint its leg and the position on that leg's line.
    pub feet: Vec<Option<(usize, Foot)>>,
    /// For each leg whether all its lanes have heights.
    pub has_height: Vec<bool>,
}

impl Aligned {
    /// A track that follows no lane, moved by `fit`.
    pub fn without_lanes(fit: &PlanarFit) -> Self {
        Self {
            fit: *fit,
            legs: Vec::new(),
            lane_changes: Vec::new(),
            feet: Vec::new(),
            has_height: Vec::new(),
        }
    }
}

/// Registration targets and options.
pub struct Register<'a> {
    pub map: &'a LaneMap,
    pub index: &'a LaneIndex,
    pub options: &'a RegisterOptions,
}

/// The least deviation that makes an outlier, each time that points are matched.
pub(super) fn scales() -> impl Iterator<Item = f64> {
    (0..MATCHES).map(|at| (SCALE_FIRST_M * 0.5f64.powi(at as i32)).max(RESIDUAL_MIN_M))
}

/// A track on lanes that were chosen.
pub(super) struct Routed<'a, 'b> {
    prepared: &'b Prepared<'a>,
    legs: Vec<Leg>,
    /// Lane changes, their lengths guessed, and as they were measured last.
    guessed: Vec<LaneChange>,
    lane_changes: Vec<LaneChange>,
    times_s: Vec<f64>,
}

impl Register<'_> {
    /// The track's own motion: the more probable one of that without and that with changes of
    /// lanes.
    pub fn align(&self, prepared: &Prepared) -> Result<Aligned, String> {
        let believed = |aligned: Aligned| self.doubt(&aligned.fit).map_or(Ok(aligned), Err);
        let keeping = self.align_on(prepared, false).and_then(believed);
        let keeping_cost = keeping
            .as_ref()
            .map_or(f64::INFINITY, |aligned| self.cost(prepared, aligned));
        if keeping_cost <= CHANGE_COST {
            return keeping;
        }
        match self.align_on(prepared, true).and_then(believed) {
            Ok(changing) if self.cost(prepared, &changing) < keeping_cost => Ok(changing),
            Ok(_) => keeping,
            Err(reason) => keeping.map_err(|_| reason),
        }
    }

    /// Minus the logarithm of how probable `aligned` is, but for a constant: drift, distances from
    /// lanes, and changes from leg to leg.
    fn cost(&self, prepared: &Prepared, aligned: &Aligned) -> f64 {
        self.drift_cost(&aligned.fit.motion) + self.lane_cost(prepared, aligned, 0.0)
    }

    /// The part of a motion.
    pub(super) fn drift_cost(&self, motion: &PlanarTransform) -> f64 {
        let prior = &self.options.prior;
        0.5 * ((motion.shift_m / prior.shift_m).length_squared()
            + (motion.yaw_rad / prior.yaw_rad).powi(2))
    }

    /// The part of distances from lanes, of which the driver keeps `habit_m` to the left, and of
    /// changes from leg to leg.
    pub(super) fn lane_cost(&self, prepared: &Prepared, aligned: &Aligned, habit_m: f64) -> f64 {
        let usual_m = LANE_KEEPING_M.hypot(prepared.smoothed.noise_m);
        let times_s = prepared.times_s();
        let off = |(foot, time_s): (&Option<(usize, Foot)>, &f64)| {
            let changing = aligned
                .lane_changes
                .iter()
                .any(|change| change.contains(*time_s));
            let lateral_m = foot.map_or(f64::INFINITY, |(_, foot)| foot.lateral_m - habit_m);
            if changing {
                0.0
            } else {
                0.5 * (lateral_m / usual_m).powi(2).min(OFF_COST_MAX)
            }
        };
        let off: f64 = aligned.feet.iter().zip(&times_s).map(off).sum();
        let changes = aligned.lane_changes.len();
        let jumps = aligned.legs.len().saturating_sub(1 + changes);
        off / KEEPING_WAYPOINTS + CHANGE_COST * changes as f64 + JUMP_COST * jumps as f64
    }

    /// The most probable of what is found from several starts.
    fn align_on(&self, prepared: &Prepared, lane_changes: bool) -> Result<Aligned, String> {
        let (mut best, mut reason) = (None, None);
        for start in self.starts(prepared, lane_changes)? {
            match self.align_from(prepared, start, lane_changes) {
                Ok(found) => {
                    let cost = self.cost(prepared, &found);
                    if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                        best = Some((cost, found));
                    }
                }
                Err(why) => reason = Some(why),
            }
        }
        best.map(|(_, found)| found).ok_or_else(|| {
            reason.unwrap_or_else(|| "no position of it was matched to a lane".into())
        })
    }

    pub(super) fn align_from(
        &self,
        prepared: &Prepared,
        start: PlanarTransform,
        lane_changes: bool,
    ) -> Result<Aligned, String> {
        let mut motion = start;
        for route in 0..ROUTES {
            let mut routed = self.route(prepared, &motion, lane_changes)?;
            let found = self.settle(&mut routed, motion)?;
            if route + 1 == ROUTES {
                return Ok(self.finish(routed, found));
            }
            motion = found.motion;
        }
        Err("no lanes were chosen".into())
    }

    /// Motions to begin at: none, and turns by headings alone. At the ends of a long track a turn
    /// of two degrees looks like another lane, but its headings against those of any lanes along it
    /// show the turn: their median, or where the track changes lanes, which turns nearly half of
    /// them, the middle of the half that agrees best.
    fn starts(
        &self,
        prepared: &Prepared,
        lane_changes: bool,
    ) -> Result<Vec<PlanarTransform>, String> {
        let motion = PlanarTransform::identity(prepared.middle());
        let routed = self.route(prepared, &motion, lane_changes)?;
        let feet = self.feet(&routed, &motion);
        let turn = |(waypoint, foot): (&Waypoint, &Option<(usize, Foot)>)| {
            let (_, foot) = (*foot)?;
            Some(wrapped(foot.heading_rad - waypoint.heading_rad))
        };
        let mut turns: Vec<f64> = prepared
            .waypoints
            .iter()
            .zip(&feet)
            .filter_map(turn)
            .collect();
        if turns.is_empty() {
            return Err("no position of it was matched to a lane".into());
        }
        turns.sort_by(f64::total_cmp);
        let half = turns.len() / 2;
        let agreeing = turns
            .windows(half + 1)
            .min_by(|a, b| (a[half] - a[0]).total_cmp(&(b[half] - b[0])));
        let agreed = agreeing.map_or(0.0, |half_of_them| half_of_them[half / 2]);
        let turned = [agreed, turns[half]].map(|yaw_rad| PlanarTransform { yaw_rad, ..motion });
        Ok(std::iter::once(motion)
            .chain(turned.into_iter().filter(|turned| self.believed(turned)))
            .collect())
    }

    pub(super) fn route<'a, 'b>(
        &self,
        prepared: &'b Prepared<'a>,
        motion: &PlanarTransform,
        changes_allowed: bool,
    ) -> Result<Routed<'a, 'b>, String> {
        let class = &prepared.track.class;
        let legs = route::find(
            self.map,
            self.index,
            &prepared.moved(motion),
            class,
            changes_allowed,
            self.options,
        )?;
        let times_s = prepared.times_s();
        let guessed = changes(&legs, &times_s);
        Ok(Routed {
            prepared,
            legs,
            lane_changes: guessed.clone(),
            guessed,
            times_s,
        })
    }

    /// Matches and moves in turn until nothing changes.
    fn settle(&self, routed: &mut Routed, start: PlanarTransform) -> Result<PlanarFit, String> {
        let pairs = self.pairs(routed, &start);
        if pairs.len() < PAIRS_MIN {
            return Err(format!(
                "{} positions on lanes outside lane changes; a motion needs {PAIRS_MIN}",
                pairs.len()
            ));
        }
        let weighted = pairs.iter().map(|pair| WeightedPair {
            from: pair.from,
            to: pair.on_line,
            weight: pair.weight,
        });
        let first = procrustes(&weighted.collect::<Vec<_>>())?.about(start.pivot_m);
        let first = if self.believed(&first) { first } else { start };
        let mut found = fit(&pairs, &first, &self.options.prior, SCALE_FIRST_M);
        for scale_m in scales().skip(1) {
            let before = found.motion;
            self.measure_changes(routed, &found);
            found = fit(
                &self.pairs(routed, &before),
                &before,
                &self.options.prior,
                scale_m,
            );
            let turned = 100.0 * (found.motion.yaw_rad - before.yaw_rad).abs();
            let settled =
                turned < SETTLED && found.motion.shift_m.distance(before.shift_m) < SETTLED;
            if settled && scale_m <= RESIDUAL_MIN_M {
                break;
            }
        }
        Ok(found)
    }

    fn finish(&self, routed: Routed, fit: PlanarFit) -> Aligned {
        let feet = self.feet(&routed, &fit.motion);
        let has_height = |leg: &Leg| {
            leg.lanes
                .iter()
                .all(|&lane| self.map.lanes[lane].has_height)
        };
        let has_height = routed.legs.iter().map(has_height).collect();
        Aligned {
            fit,
            has_height,
            feet,
            legs: routed.legs,
            lane_changes: routed.lane_changes,
        }
    }

    /// The track on its lanes under a motion that is given.
    pub fn with_motion(&self, prepared: &Prepared, shared: &PlanarFit) -> Result<Aligned, String> {
        let mut routed = self.route(prepared, &shared.motion, true)?;
        self.measure_changes(&mut routed, shared);
        Ok(self.finish(routed, *shared))
    }

    pub(super) fn believed(&self, motion: &PlanarTransform) -> bool {
        motion.shift_m.length() <= self.options.shift_max_m
            && wrapped(motion.yaw_rad).abs() <= self.options.yaw_max_rad
    }

    /// Reason why a motion is implausible, if any.
    pub(super) fn doubt(&self, fit: &PlanarFit) -> Option<String> {
        let (shift_m, yaw_deg) = (fit.motion.shift_m.length(), fit.motion.yaw_rad.to_degrees());
        let options = self.options;
        if !self.believed(&fit.motion) {
            let (most_m, most_deg) = (options.shift_max_m, options.yaw_max_rad.to_degrees());
            return Some(format!(
                "would move by {shift_m:.2} m and {yaw_deg:.2} degrees; believed are {most_m} m and {most_deg:.1} degrees"
            ));
        }
        let (residual_m, most_m) = (fit.residual_m, options.residual_max_m);
        // A comparison that is false for what is no number.
        let follows = residual_m <= most_m;
        (!follows).then(|| {
            format!("does not follow its lanes: {residual_m:.2} m about them (at most {most_m} m)")
        })
    }

    /// Each waypoint's position on its leg's line, by warping.
    fn feet(&self, routed: &Routed, motion: &PlanarTransform) -> Vec<Option<(usize, Foot)>> {
        let moved = routed.prepared.moved(motion);
        let mut feet = vec![None; moved.len()];
        for (number, leg) in routed.legs.iter().enumerate() {
            let middles: Vec<f64> = leg.arcs_m.iter().map(|arc| arc / STEP_M).collect();
            let band = Band::around(
                &middles,
                (self.options.band_m / STEP_M).ceil() as usize,
                leg.samples.len(),
            );
            let cost = |point: usize, step: usize| {
                let waypoint = &moved[leg.waypoints[point]];
                let (position, heading_rad) = leg.samples[step];
                let turned = waypoint.heading_rad - heading_rad;
                position.distance(waypoint.position)
                    + self.options.heading_weight * (1.0 - turned.cos())
            };
            for (point, step) in align(&band, cost).into_iter().flatten().enumerate() {
                let arc_m = STEP_M * step as f64;
                let waypoint = leg.waypoints[point];
                let foot = leg.line.project_within(
                    moved[waypoint].position,
                    arc_m - 2.0 * STEP_M,
                    arc_m + 2.0 * STEP_M,
                );
                feet[waypoint] = Some((number, foot));
            }
        }
        feet
    }

    /// Points of the track as they were logged and the positions that they belong to, those left
    /// out that are between lanes.
    ///
    /// The motion is told by what was logged, not by the smoothed track: smoothing cuts corners,
    /// always to the same side.
    pub(super) fn pairs(&self, routed: &Routed, motion: &PlanarTransform) -> Vec<LinePair> {
        let feet = self.feet(routed, motion);
        let prepared = routed.prepared;
        let points = &prepared.track.points;
        let mut pairs = Vec::new();
        for (at, (waypoint, foot)) in prepared.waypoints.iter().zip(&feet).enumerate() {
            let Some((leg, foot)) = *foot else { continue };
            let next = prepared
                .waypoints
                .get(at + 1)
                .map_or(points.len(), |next| next.index);
            let usable = |&point: &usize| {
                let changing = routed
                    .lane_changes
                    .iter()
                    .any(|change| change.contains(points[point].time_s));
                !changing && !prepared.smoothed.outliers[point]
            };
            let usable: Vec<usize> = (waypoint.index..next).filter(usable).collect();
            let line = &routed.legs[leg].line;
            pairs.extend(usable.iter().map(|&point| {
                let from = points[point].position_m;
                let (moved, ahead_m) = (motion.apply(from), from.distance(waypoint.position));
                let own = line.project_within(
                    moved,
                    foot.arc_m - 2.0 * STEP_M,
                    foot.arc_m + ahead_m + 2.0 * STEP_M,
                );
                // Where it waits, a track has many points that say the same.
                let weight = (POINTS_A_WAYPOINT / usable.len() as f64).min(1.0);
                LinePair {
                    from,
                    on_line: own.point.truncate(),
                    across: line.across(&own, moved),
                    weight,
                }
            }));
        }
        pairs
    }

    /// Measures how long the lane changes last under a motion that was found; always from the
    /// guess, which an earlier motion may not shorten.
    pub(super) fn measure_changes(&self, routed: &mut Routed, found: &PlanarFit) {
        let feet = self.feet(routed, &found.motion);
        let laterals = feet
            .iter()
            .zip(&routed.times_s)
            .filter_map(|(foot, time_s)| Some((*time_s, foot.as_ref()?.1.lateral_m)));
        // Waypoints are smoothed: the noise of the log is not what they deviate by.
        let noise_m = routed.prepared.smoothed.noise_m;
        let deviation_m = (found.residual_m.powi(2) - noise_m.powi(2)).max(0.0).sqrt();
        routed.lane_changes = measured(&routed.guessed, &laterals.collect::<Vec<_>>(), deviation_m);
    }
}
