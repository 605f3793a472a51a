//! Reference drive: a comfortable drive along the route without other traffic.

use decouplegs_scene::{LightColor, TrafficLight};

use super::ego_start::EgoStart;
use super::roads::Roads;
use crate::route::Route;

/// Acceleration, braking and acceleration across, m/s^2: comfortable ones.
const COMFORT_MPS2: f64 = 1.5;
const LATERAL_MPS2: f64 = 2.0;
/// Curvature is examined in steps of this, meters.
const STRIDE_M: f64 = 1.0;
/// Time from green to the first motion, seconds.
const START_S: f64 = 1.0;
/// Speed at a line where the ego waits, m/s.
const WAITING_MPS: f64 = 0.5;

/// Duration of the drive from half of the cruise speed, without lights, seconds.
pub(super) fn free_s(route: &Route, cruise_mps: f64) -> f64 {
    last(&times(allowed(route, cruise_mps), cruise_mps, &[]))
}

/// Duration of the drive with traffic lights that the ego obeys, seconds.
pub(super) fn with_lights(roads: &Roads, start: &EgoStart, lights: &[TrafficLight]) -> f64 {
    let cruise_mps = start.task.cruise_mps;
    let mut allowed = allowed(&start.route, cruise_mps);
    let mut waits: Vec<(usize, f64)> = Vec::new();
    for (at_m, light) in lines(roads, start, lights) {
        let at = ((at_m / STRIDE_M) as usize).min(allowed.len() - 1);
        let arrival_s = times(allowed.clone(), cruise_mps, &waits)[at];
        let (color, mut rest_s) = light.phase_at(arrival_s);
        if color == LightColor::Green {
            continue;
        }
        let mut green_s = arrival_s + rest_s;
        for _ in &light.phases {
            let (color, more_s) = light.phase_at(green_s + 1e-6);
            if color == LightColor::Green {
                break;
            }
            rest_s = more_s;
            green_s += rest_s;
        }
        allowed[at] = WAITING_MPS;
        waits.push((at, green_s + START_S));
    }
    last(&times(allowed, cruise_mps, &waits))
}

/// Stop lines of traffic lights on the ego's route, meters along it, in order.
fn lines<'a>(
    roads: &Roads,
    start: &EgoStart,
    lights: &'a [TrafficLight],
) -> Vec<(f64, &'a TrafficLight)> {
    let mut lines = Vec::new();
    let mut begin_m = -start.task.start_m;
    for (at, &lane) in start.lanes.iter().enumerate() {
        let id = &roads.map.lanes[lane].id;
        let onward = start.lanes.get(at + 1);
        let onward = onward.map(|&next| roads.map.lanes[next].id.as_str());
        for light in lights {
            let lines_here = light.stop_lines.iter();
            let on_lane = lines_here.filter(|line| line.lane == *id && line.binds(onward));
            lines.extend(on_lane.map(|line| (begin_m + line.at_m, light)));
        }
        begin_m += roads.length_m(lane);
    }
    let length_m = start.route.length_m();
    lines.retain(|(at_m, _)| (0.0..length_m).contains(at_m));
    lines.sort_by(|a, b| a.0.total_cmp(&b.0));
    lines
}

/// Speed that curvature allows at each stride of a route, m/s.
fn allowed(route: &Route, cruise_mps: f64) -> Vec<f64> {
    let count = (route.length_m() / STRIDE_M).ceil() as usize + 1;
    let heading = |at: usize| route.line().heading_at(at as f64 * STRIDE_M);
    let allowed = |at: usize| {
        let curvature = (heading(at + 2) - heading(at.saturating_sub(2))).abs() / (4.0 * STRIDE_M);
        (LATERAL_MPS2 / curvature.max(1e-6)).sqrt().min(cruise_mps)
    };
    (0..count).map(allowed).collect()
}

/// Times at which the strides are reached, seconds. `waits` are strides that are not left before a
/// time.
fn times(mut speeds: Vec<f64>, cruise_mps: f64, waits: &[(usize, f64)]) -> Vec<f64> {
    let reached = |from_mps: f64| (from_mps * from_mps + 2.0 * COMFORT_MPS2 * STRIDE_M).sqrt();
    for at in (1..speeds.len()).rev() {
        speeds[at - 1] = speeds[at - 1].min(reached(speeds[at]));
    }
    speeds[0] = speeds[0].min(0.5 * cruise_mps);
    for at in 1..speeds.len() {
        speeds[at] = speeds[at].min(reached(speeds[at - 1]));
    }
    let mut times = vec![0.0_f64];
    for (at, pair) in speeds.windows(2).enumerate() {
        let waited = waits.iter().find(|(stride, _)| *stride == at);
        let left_s = waited.map_or(times[at], |(_, until_s)| times[at].max(*until_s));
        times.push(left_s + 2.0 * STRIDE_M / (pair[0] + pair[1]));
    }
    times
}

fn last(times: &[f64]) -> f64 {
    times[times.len() - 1]
}
