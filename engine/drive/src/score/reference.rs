//! Progress of an ego against a reference drive at the same time.

use decouplegs_scene::episode::{Episode, EpisodeEnd, StopLineRecord};
use decouplegs_scene::{SignKind, TrafficLight};
use glam::DVec3;

use super::EpisodeScore;
use super::progress::driven_m;
use crate::polyline::Polyline;
use crate::reference_drive::ReferenceDrive;

/// Progress of the reference up to which nothing is compared, meters (NAVSIM).
const LEAST_M: f64 = 5.0;
/// Longest route with a reference, meters. More is taken for a mistake.
const ROUTE_M_MAX: f64 = 200e3;
/// Least cruising speed of a reference, m/s.
const CRUISE_MPS_MIN: f64 = 1.0;

/// Progress against a reference that drives the same route from the same start with the scenario's
/// cruising speed, slowly through bends, without other road users, and waits at red lights and stop
/// signs. So what a red light costs the reference, too, costs nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReferenceProgress {
    /// Way along the route, meters.
    pub driven_m: f64,
    /// Way of the reference at the same time, at most to the end of the route, meters.
    pub reference_m: f64,
    /// The ego's way as a share of the reference's, 0 to 1: 1 exactly where the route was done or
    /// the reference came no farther than 5 m.
    pub share: f64,
}

impl ReferenceProgress {
    /// Progress in `episode`, whose `score` is known. The time is that of the end; where the ego
    /// itself ended it, it is the time limit, so that what was not driven is lost.
    #[must_use]
    pub fn new(episode: &Episode, score: &EpisodeScore) -> Self {
        let Some((driven_m, length_m)) = driven_m(episode) else {
            return Self {
                driven_m: 0.0,
                reference_m: 0.0,
                share: score.route_completion,
            };
        };
        let end_s = end_s(episode);
        let time_s = match episode.end {
            EpisodeEnd::Time | EpisodeEnd::Story | EpisodeEnd::RouteDone => end_s,
            _ if score.ended_by_other => end_s,
            _ => episode.head.scenario.duration_s.max(end_s),
        };
        Self::until(episode, time_s, (driven_m, length_m))
    }

    /// Progress against the reference's at `time_s`, seconds, after `driven_m` of a route of
    /// `length_m`.
    fn until(episode: &Episode, time_s: f64, (driven_m, length_m): (f64, f64)) -> Self {
        let reference = reference(episode, length_m);
        let reference_m = reference.map_or(length_m, |drive| drive.progress_m(time_s));
        let reference_m = reference_m.min(length_m);
        let share = match episode.end {
            EpisodeEnd::RouteDone => 1.0,
            _ if reference_m <= LEAST_M => 1.0,
            _ => (driven_m / reference_m).clamp(0.0, 1.0),
        };
        Self {
            driven_m,
            reference_m,
            share,
        }
    }
}

/// The ego's way as a share of the reference's, 0 to 1, where the scenario's story ended the
/// episode; `None` where something else did or the route is no line.
pub(super) fn share_of_story(episode: &Episode) -> Option<f64> {
    if episode.end != EpisodeEnd::Story {
        return None;
    }
    let ways = driven_m(episode)?;
    Some(ReferenceProgress::until(episode, end_s(episode), ways).share)
}

/// Time of the last moment of an episode, seconds.
fn end_s(episode: &Episode) -> f64 {
    episode.instants().last().map_or(0.0, |tick| tick.time_s)
}

/// The reference drive of an episode; `None` where its route is too long for one.
fn reference(episode: &Episode, length_m: f64) -> Option<ReferenceDrive> {
    let head = &episode.head;
    let route = head.route_m.iter().map(|point| point.extend(0.0));
    let line = Polyline::new(route).filter(|_| length_m <= ROUTE_M_MAX)?;
    // Vehicles stop with their front at the line; the way counts from the middle.
    let half_m = 0.5 * head.scenario.ego.size.length_m;
    let place = |record: &StopLineRecord| Some((passed_at_m(&line, record)? - half_m).max(0.0));
    let on_way = head.stop_lines.iter().filter_map(|record| {
        let light = head.scenario.lights.get(record.index)?;
        Some((place(record)?, light))
    });
    let mut lights: Vec<(f64, &TrafficLight)> = on_way.collect();
    lights.sort_by(|a, b| a.0.total_cmp(&b.0));
    let is_stop = |record: &&StopLineRecord| {
        let sign = head.scenario.signs.get(record.index);
        sign.is_some_and(|sign| sign.kind == SignKind::Stop)
    };
    let signs = head.sign_lines.iter().filter(is_stop);
    let stops: Vec<f64> = signs.filter_map(place).collect();
    let cruise_mps = head.scenario.ego.cruise_mps.max(CRUISE_MPS_MIN);
    let speeds = [cruise_mps, episode.start.ego.speed_mps.max(0.0)];
    Some(ReferenceDrive::new(&line, speeds, &lights, &stops))
}

/// Place at which a line passes a stop line in driving direction, meters along it.
fn passed_at_m(line: &Polyline, record: &StopLineRecord) -> Option<f64> {
    let points = line.points().windows(2).zip(line.arcs_m().windows(2));
    let mut passages = points.filter_map(|(pair, arcs_m)| {
        let [from, to] = [pair[0], pair[1]].map(DVec3::truncate);
        let (before_m, after_m) = (record.locate(from).0, record.locate(to).0);
        if before_m >= 0.0 || after_m < 0.0 {
            return None;
        }
        let share = before_m / (before_m - after_m);
        let is_over = record.locate(from.lerp(to, share)).1;
        is_over.then_some(arcs_m[0] + share * (arcs_m[1] - arcs_m[0]))
    });
    passages.next()
}
