//! Reference drive: a comfortable drive along a line without other traffic, which obeys lights.

use decouplegs_scene::{LightColor, TrafficLight};

use crate::polyline::Polyline;

/// Acceleration, braking and acceleration across, m/s^2: comfortable ones.
const COMFORT_MPS2: f64 = 1.5;
const LATERAL_MPS2: f64 = 2.0;
/// Curvature is examined in steps of this, meters.
const STRIDE_M: f64 = 1.0;
/// Time from green to the first motion, seconds.
const START_S: f64 = 1.0;
/// Longest wait at a light, seconds: an event may hold it at red for good.
const WAIT_S_MAX: f64 = 3600.0;
/// Speed at a line where the ego waits, m/s.
const WAITING_MPS: f64 = 0.5;

/// Times of a reference drive.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ReferenceDrive {
    /// Times at which each stride of the line is reached, seconds.
    times_s: Vec<f64>,
}

impl ReferenceDrive {
    /// Drive along `line` at `cruise_mps` and less in bends, from `start_mps` at its start. It
    /// waits at `lights`, each with its place along the line in rising order, until they are green,
    /// and slows down to a stop at `stops`.
    pub(crate) fn new(
        line: &Polyline,
        [cruise_mps, start_mps]: [f64; 2],
        lights: &[(f64, &TrafficLight)],
        stops: &[f64],
    ) -> Self {
        let mut allowed = allowed(line, cruise_mps);
        let stride = |at_m: f64, count: usize| ((at_m / STRIDE_M) as usize).min(count - 1);
        for &at_m in stops {
            let at = stride(at_m, allowed.len());
            allowed[at] = WAITING_MPS;
        }
        let mut waits: Vec<(usize, f64)> = Vec::new();
        for &(at_m, light) in lights {
            let at = stride(at_m, allowed.len());
            let arrival_s = times(allowed.clone(), start_mps, &waits)[at];
            let (color, mut rest_s) = light.phase_at(arrival_s);
            if color == LightColor::Green {
                continue;
            }
            let mut green_s = arrival_s + rest_s;
            for _ in 0..(1 + light.phases.len()) * (1 + light.changes.len()) {
                let (color, more_s) = light.phase_at(green_s + 1e-6);
                if color == LightColor::Green {
                    break;
                }
                rest_s = more_s;
                green_s += rest_s;
            }
            allowed[at] = WAITING_MPS;
            waits.push((at, green_s.min(arrival_s + WAIT_S_MAX) + START_S));
        }
        Self {
            times_s: times(allowed, start_mps, &waits),
        }
    }

    /// Duration of the drive, seconds.
    pub(crate) fn duration_s(&self) -> f64 {
        self.times_s[self.times_s.len() - 1]
    }

    /// Way along the line after a time, meters: the last stride that is reached by then, and the
    /// share of the time to the next one. Waiting at a line is on the stride before it is left.
    pub(crate) fn progress_m(&self, time_s: f64) -> f64 {
        let next = self.times_s.partition_point(|&at_s| at_s <= time_s);
        let Some(&next_s) = self.times_s.get(next) else {
            return (self.times_s.len() - 1) as f64 * STRIDE_M;
        };
        let Some(before) = next.checked_sub(1) else {
            return 0.0;
        };
        let span_s = next_s - self.times_s[before];
        // A stride that takes longer than at the speed of waiting begins with the waiting.
        let moving_s = span_s.min(STRIDE_M / WAITING_MPS);
        let share = 1.0 - (next_s - time_s) / moving_s;
        (before as f64 + share.max(0.0)) * STRIDE_M
    }
}

/// Speed that curvature allows at each stride of a line, m/s.
fn allowed(line: &Polyline, cruise_mps: f64) -> Vec<f64> {
    let count = (line.length_m() / STRIDE_M).ceil() as usize + 1;
    let heading = |at: usize| line.heading_at(at as f64 * STRIDE_M);
    let allowed = |at: usize| {
        let curvature = (heading(at + 2) - heading(at.saturating_sub(2))).abs() / (4.0 * STRIDE_M);
        (LATERAL_MPS2 / curvature.max(1e-6)).sqrt().min(cruise_mps)
    };
    (0..count).map(allowed).collect()
}

/// Times at which the strides are reached, seconds. `waits` are strides that are not left before a
/// time.
fn times(mut speeds: Vec<f64>, start_mps: f64, waits: &[(usize, f64)]) -> Vec<f64> {
    let reached = |from_mps: f64| (from_mps * from_mps + 2.0 * COMFORT_MPS2 * STRIDE_M).sqrt();
    for at in (1..speeds.len()).rev() {
        speeds[at - 1] = speeds[at - 1].min(reached(speeds[at]));
    }
    speeds[0] = speeds[0].min(start_mps);
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

#[cfg(test)]
mod tests {
    use decouplegs_scene::LightPhase;
    use glam::DVec3;

    use super::*;

    #[test]
    fn a_reference_accelerates_cruises_and_waits() {
        let line = Polyline::new([DVec3::ZERO, DVec3::new(200.0, 0.0, 0.0)]).unwrap();
        let free = ReferenceDrive::new(&line, [10.0, 10.0], &[], &[]);
        assert!((free.duration_s() - 20.0).abs() < 1e-9);
        assert!((free.progress_m(5.0) - 50.0).abs() < 1e-9);
        assert_eq!((free.progress_m(0.0), free.progress_m(99.0)), (0.0, 200.0));
        // From 4 m/s: 10 m/s after 6 / 1.5 s and 28 m, which is 1.2 s behind.
        let slow = ReferenceDrive::new(&line, [10.0, 4.0], &[], &[]);
        assert!((slow.duration_s() - 21.2).abs() < 1e-9);
        // Red for 30 s at 100 m: it stands there, and leaves a second later.
        let phase = |color, duration_s| LightPhase { color, duration_s };
        let light = TrafficLight {
            phases: vec![
                phase(LightColor::Red, 30.0),
                phase(LightColor::Green, 1000.0),
            ],
            ..TrafficLight::default()
        };
        let waits = ReferenceDrive::new(&line, [10.0, 10.0], &[(100.0, &light)], &[]);
        assert!((waits.progress_m(25.0) - 100.0).abs() < 1.0);
        assert!((waits.progress_m(30.9) - 100.0).abs() < 1.0);
        assert!(waits.duration_s() > 41.0);
    }
}
