//! One track and its lanes: from the log to a planar motion.

use decouplegs_scene::{LaneMap, Track};
use glam::DVec2;

use super::RegisterOptions;
use super::dtw::{Band, align};
use super::fit::{LinePair, PlanarFit, fit};
use super::lane_change::{LaneChange, changes, measured};
use super::procrustes::{WeightedPair, procrustes};
use super::route::{self, Leg, Waypoint};
use super::smooth::{Smoothed, median, smooth};
use crate::lane_index::LaneIndex;
use crate::planar::PlanarTransform;
use crate::polyline::{Foot, wrapped};

/// Between waypoints, metres: closer ones tell nothing more of a lane.
const WAYPOINT_M: f64 = 1.0;
/// Steps of the warping along a lane, metres.
const STEP_M: f64 = 0.5;
/// Times that lanes are chosen, each after the first by the track as it was moved.
const ROUTES: usize = 2;
/// Times that points are matched and the motion found.
const MATCHES: usize = 6;
/// Matching ends when the motion changes by less, metres and (times a hundred metres) radians.
const SETTLED: f64 = 1e-5;
/// Lanes without a change of lanes are believed where a track lies on them by so much, as a deviation in metres.
const ONE_LANE_RESIDUAL_M: f64 = 0.35;
/// Waypoints that a motion needs outside lane changes.
const PAIRS_MIN: usize = 4;

/// A track, smoothed, and the points of it that lanes are chosen by.
pub struct Prepared<'a> {
    pub track: &'a Track,
    pub smoothed: Smoothed,
    pub waypoints: Vec<Waypoint>,
    /// Metres between its waypoints, added up.
    pub travelled_m: f64,
}

impl<'a> Prepared<'a> {
    pub fn new(options: &RegisterOptions) -> impl Fn(&'a Track) -> Result<Self, String> {
        let options = *options;
        move |track| {
            track.check()?;
            let smoothed = smooth(track, options.noise_m);
            let half_height = 0.5 * track.dims_m.unwrap_or(options.dims_m)[2];
            let mut waypoints: Vec<Waypoint> = Vec::new();
            for (index, &position) in smoothed.positions.iter().enumerate() {
                let far = waypoints.last().is_none_or(|last| last.position.distance(position) >= WAYPOINT_M);
                if far && !smoothed.outliers[index] {
                    let ground_z_m = track.points[index].z_m.map(|z_m| z_m - half_height);
                    waypoints.push(Waypoint { index, position, heading_rad: 0.0, ground_z_m });
                }
            }
            let positions: Vec<DVec2> = waypoints.iter().map(|waypoint| waypoint.position).collect();
            let last = positions.len().saturating_sub(1);
            for (at, waypoint) in waypoints.iter_mut().enumerate() {
                // Over four steps where there are so many: two neighbours a metre apart point anywhere.
                let way = positions[(at + 2).min(last)] - positions[at.saturating_sub(2)];
                waypoint.heading_rad = way.to_angle();
            }
            let travelled_m = positions.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
            Ok(Self { track, smoothed, waypoints, travelled_m })
        }
    }

    fn moved(&self, motion: &PlanarTransform) -> Vec<Waypoint> {
        let moved = |waypoint: &Waypoint| Waypoint {
            position: motion.apply(waypoint.position),
            heading_rad: waypoint.heading_rad + motion.yaw_rad,
            ..*waypoint
        };
        self.waypoints.iter().map(moved).collect()
    }

    /// The middle of its waypoints.
    fn middle(&self) -> DVec2 {
        let first = self.waypoints.first().map_or(DVec2::ZERO, |waypoint| waypoint.position);
        let sum: DVec2 = self.waypoints.iter().map(|waypoint| waypoint.position - first).sum();
        first + sum / self.waypoints.len().max(1) as f64
    }

    fn times_s(&self) -> Vec<f64> {
        self.waypoints.iter().map(|waypoint| self.track.points[waypoint.index].time_s).collect()
    }
}

/// A track with its motion and its lanes.
pub struct Aligned {
    pub fit: PlanarFit,
    pub by_shared: bool,
    pub legs: Vec<Leg>,
    pub lane_changes: Vec<LaneChange>,
    /// For each waypoint its leg and the place on that leg's line.
    pub feet: Vec<Option<(usize, Foot)>>,
    /// For each leg whether all its lanes have heights.
    pub has_height: Vec<bool>,
}

impl Aligned {
    /// A track that follows no lane, moved as the others.
    pub fn by_shared(shared: &PlanarFit) -> Self {
        Self {
            fit: *shared,
            by_shared: true,
            legs: Vec::new(),
            lane_changes: Vec::new(),
            feet: Vec::new(),
            has_height: Vec::new(),
        }
    }
}

/// What tracks are registered to, and how.
pub struct Register<'a> {
    pub map: &'a LaneMap,
    pub index: &'a LaneIndex,
    pub options: &'a RegisterOptions,
}

/// A track on lanes that were chosen.
struct Routed<'a, 'b> {
    prepared: &'b Prepared<'a>,
    legs: Vec<Leg>,
    lane_changes: Vec<LaneChange>,
    times_s: Vec<f64>,
}

impl Register<'_> {
    /// The track's own motion: without a change of lanes where the track lies on its lanes so, and with one otherwise.
    pub fn align(&self, prepared: &Prepared) -> Result<Aligned, String> {
        let straight = self.align_on(prepared, false);
        let plain = |aligned: &Aligned| {
            let shape = aligned.legs.len() == 1 && self.mean_distance(prepared, aligned) < ONE_LANE_RESIDUAL_M;
            shape && self.doubt(&aligned.fit).is_none()
        };
        let aligned = match straight {
            Ok(aligned) if plain(&aligned) => aligned,
            _ => self.align_on(prepared, true)?,
        };
        self.doubt(&aligned.fit).map_or(Ok(aligned), Err)
    }

    /// Mean distance of the moved waypoints from their lanes, metres.
    fn mean_distance(&self, prepared: &Prepared, aligned: &Aligned) -> f64 {
        let moved = prepared.moved(&aligned.fit.motion);
        let laterals = moved.iter().zip(&aligned.feet).filter_map(|(_, foot)| foot.map(|(_, foot)| foot.lateral_m.abs()));
        let (sum, count) = laterals.fold((0.0, 0), |(sum, count), lateral| (sum + lateral, count + 1));
        if count == 0 { f64::INFINITY } else { sum / f64::from(count) }
    }

    fn align_on(&self, prepared: &Prepared, lane_changes: bool) -> Result<Aligned, String> {
        let mut motion = self.turned(prepared, lane_changes)?;
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

    /// A first turn by headings alone: at the ends of a long track a turn of two degrees looks like another lane, but the median of
    /// its headings against those of any lanes along it does not.
    fn turned(&self, prepared: &Prepared, lane_changes: bool) -> Result<PlanarTransform, String> {
        let motion = PlanarTransform::identity(prepared.middle());
        let routed = self.route(prepared, &motion, lane_changes)?;
        let feet = self.feet(&routed, &motion);
        let turn = |(waypoint, foot): (&Waypoint, &Option<(usize, Foot)>)| {
            let (_, foot) = (*foot)?;
            Some(wrapped(foot.heading_rad - waypoint.heading_rad))
        };
        let mut turns: Vec<f64> = prepared.waypoints.iter().zip(&feet).filter_map(turn).collect();
        if turns.is_empty() {
            return Err("no place of it was matched to a lane".into());
        }
        let turned = PlanarTransform { yaw_rad: median(&mut turns), ..motion };
        Ok(if self.believed(&turned) { turned } else { motion })
    }

    fn route<'a, 'b>(
        &self,
        prepared: &'b Prepared<'a>,
        motion: &PlanarTransform,
        changes_allowed: bool,
    ) -> Result<Routed<'a, 'b>, String> {
        let class = &prepared.track.class;
        let legs = route::find(self.map, self.index, &prepared.moved(motion), class, changes_allowed, self.options)?;
        let times_s = prepared.times_s();
        let lane_changes = changes(&legs, &times_s);
        Ok(Routed { prepared, legs, lane_changes, times_s })
    }

    /// Matches and moves in turn until nothing changes.
    fn settle(&self, routed: &mut Routed, start: PlanarTransform) -> Result<PlanarFit, String> {
        let pairs = self.pairs(routed, &start);
        if pairs.len() < PAIRS_MIN {
            return Err(format!("{} places on lanes outside lane changes; a motion needs {PAIRS_MIN}", pairs.len()));
        }
        let weighted = pairs.iter().map(|pair| WeightedPair { from: pair.from, to: pair.on_line, weight: 1.0 });
        let first = procrustes(&weighted.collect::<Vec<_>>())?.about(start.pivot_m);
        let first = if self.believed(&first) { first } else { start };
        let mut found = fit(&pairs, &first, &self.options.prior);
        for _ in 1..MATCHES {
            let before = found.motion;
            let laterals = self.laterals(routed, &found.motion);
            routed.lane_changes = measured(&routed.lane_changes, &laterals, found.residual_m);
            found = fit(&self.pairs(routed, &before), &before, &self.options.prior);
            let turned = 100.0 * (found.motion.yaw_rad - before.yaw_rad).abs();
            if turned < SETTLED && found.motion.shift_m.distance(before.shift_m) < SETTLED {
                break;
            }
        }
        Ok(found)
    }

    fn finish(&self, routed: Routed, fit: PlanarFit) -> Aligned {
        let feet = self.feet(&routed, &fit.motion);
        let has_height = |leg: &Leg| leg.lanes.iter().all(|&lane| self.map.lanes[lane].has_height);
        let has_height = routed.legs.iter().map(has_height).collect();
        Aligned { fit, by_shared: false, has_height, feet, legs: routed.legs, lane_changes: routed.lane_changes }
    }

    /// The motion of all `guides` together, where any lanes are found.
    pub fn shared<'a, 'b>(&self, guides: &[&'b Prepared<'a>]) -> Option<PlanarFit> {
        let count = guides.len().max(1) as f64;
        let first = guides.first()?.middle();
        let pivot_m = first + guides.iter().map(|guide| guide.middle() - first).sum::<DVec2>() / count;
        let mut motion = PlanarTransform::identity(pivot_m);
        let mut found = None;
        for _ in 0..ROUTES {
            // A track that does not follow lanes shows nothing of the log's drift.
            let follows = |guide: &&'b Prepared<'a>| {
                let own = self.align(guide).is_ok();
                own.then(|| self.route(guide, &motion, true).ok()).flatten()
            };
            let mut routed: Vec<Routed> = guides.iter().filter_map(follows).collect();
            for _ in 0..MATCHES {
                let pairs: Vec<LinePair> = routed.iter().flat_map(|routed| self.pairs(routed, &motion)).collect();
                if pairs.len() < PAIRS_MIN {
                    return None;
                }
                let fitted = fit(&pairs, &motion, &self.options.prior);
                motion = fitted.motion;
                for one in &mut routed {
                    let laterals = self.laterals(one, &motion);
                    one.lane_changes = measured(&one.lane_changes, &laterals, fitted.residual_m);
                }
                found = Some(fitted);
            }
        }
        found.filter(|found| self.doubt(found).is_none())
    }

    /// The track on its lanes under a motion that is given.
    pub fn with_motion(&self, prepared: &Prepared, shared: &PlanarFit) -> Result<Aligned, String> {
        let mut routed = self.route(prepared, &shared.motion, true)?;
        let laterals = self.laterals(&routed, &shared.motion);
        routed.lane_changes = measured(&routed.lane_changes, &laterals, shared.residual_m);
        Ok(self.finish(routed, *shared))
    }

    fn believed(&self, motion: &PlanarTransform) -> bool {
        motion.shift_m.length() <= self.options.shift_max_m && wrapped(motion.yaw_rad).abs() <= self.options.yaw_max_rad
    }

    /// Why a motion is not believed.
    fn doubt(&self, fit: &PlanarFit) -> Option<String> {
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
        (!follows).then(|| format!("does not follow its lanes: {residual_m:.2} m about them (at most {most_m} m)"))
    }

    /// Each waypoint's place on its leg's line, by warping.
    fn feet(&self, routed: &Routed, motion: &PlanarTransform) -> Vec<Option<(usize, Foot)>> {
        let moved = routed.prepared.moved(motion);
        let mut feet = vec![None; moved.len()];
        for (number, leg) in routed.legs.iter().enumerate() {
            let steps = (leg.line.length_m() / STEP_M).floor() as usize + 1;
            let samples: Vec<(DVec2, f64)> = (0..steps)
                .map(|step| STEP_M * step as f64)
                .map(|arc| (leg.line.at(arc).truncate(), leg.line.heading_at(arc)))
                .collect();
            let middles: Vec<f64> = leg.arcs_m.iter().map(|arc| arc / STEP_M).collect();
            let band = Band::around(&middles, (self.options.band_m / STEP_M).ceil() as usize, steps);
            let cost = |point: usize, step: usize| {
                let waypoint = &moved[leg.waypoints[point]];
                let (place, heading_rad) = samples[step];
                let turned = waypoint.heading_rad - heading_rad;
                place.distance(waypoint.position) + self.options.heading_weight * (1.0 - turned.cos())
            };
            for (point, step) in align(&band, cost).into_iter().flatten().enumerate() {
                let arc_m = STEP_M * step as f64;
                let waypoint = leg.waypoints[point];
                let foot = leg.line.project_within(moved[waypoint].position, arc_m - 2.0 * STEP_M, arc_m + 2.0 * STEP_M);
                feet[waypoint] = Some((number, foot));
            }
        }
        feet
    }

    fn pairs(&self, routed: &Routed, motion: &PlanarTransform) -> Vec<LinePair> {
        let feet = self.feet(routed, motion);
        let pair = |(at, foot): (usize, &Option<(usize, Foot)>)| {
            let (_, foot) = (*foot)?;
            let changing = routed.lane_changes.iter().any(|change| change.contains(routed.times_s[at]));
            let from = routed.prepared.waypoints[at].position;
            let pair = LinePair { from, on_line: foot.point.truncate(), heading_rad: foot.heading_rad };
            (!changing).then_some(pair)
        };
        feet.iter().enumerate().filter_map(pair).collect()
    }

    fn laterals(&self, routed: &Routed, motion: &PlanarTransform) -> Vec<(f64, f64)> {
        let feet = self.feet(routed, motion);
        feet.iter().zip(&routed.times_s).filter_map(|(foot, time_s)| Some((*time_s, foot.as_ref()?.1.lateral_m))).collect()
    }
}
