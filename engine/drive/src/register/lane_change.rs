//! Points of a track between lanes: their distance from a centerline is no drift.

use super::route::Leg;

/// First guess at half the duration of a change, seconds, around the moment at which the nearest
/// lane is another one: most changes take 3 to 6 s.
const HALF_CHANGE_S: f64 = 3.0;
/// The shortest half of a change, seconds.
const HALF_CHANGE_MIN_S: f64 = 0.5;
/// Distance to the lane at which a lane change is complete, meters; more where the track varies
/// more around its lane.
const ARRIVED_M: f64 = 0.15;
const ARRIVED_DEVIATIONS: f64 = 3.0;

/// A change from one leg to the next, and how long it takes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LaneChange {
    /// Time at which the nearer lane becomes the new one, seconds.
    pub time_s: f64,
    /// Start of the lane change, seconds.
    pub from_s: f64,
    /// End of the lane change, seconds.
    pub to_s: f64,
}

impl LaneChange {
    /// True if `time_s` is within it.
    #[must_use]
    pub fn contains(&self, time_s: f64) -> bool {
        (self.from_s..=self.to_s).contains(&time_s)
    }
}

/// The lane changes between `legs`, their lengths guessed; `times_s` are the waypoints' times.
#[must_use]
pub fn changes(legs: &[Leg], times_s: &[f64]) -> Vec<LaneChange> {
    let between = |pair: &[Leg]| {
        let (before, after) = (&pair[0].waypoints, &pair[1].waypoints);
        let time_s = 0.5 * (times_s[*before.last()?] + times_s[*after.first()?]);
        // Of each lane a third of its time is left at least.
        let third =
            |leg: &[usize]| Some((times_s[*leg.last()?] - times_s[*leg.first()?]) * 2.0 / 3.0);
        let (from, to) = (
            third(before)?.min(HALF_CHANGE_S),
            third(after)?.min(HALF_CHANGE_S),
        );
        pair[1].by_lane_change.then_some(LaneChange {
            time_s,
            from_s: time_s - from,
            to_s: time_s + to,
        })
    };
    legs.windows(2).filter_map(between).collect()
}

/// The same changes with their lengths as the track shows them: from each moment outwards while
/// `laterals_m`, pairs of time and distance from the own lane, rising in time, are beyond what is
/// usual, a deviation of `deviation_m`; and by as much more as the change is within that already
/// and still, were it a half wave of a cosine.
#[must_use]
pub fn measured(
    changes: &[LaneChange],
    laterals_m: &[(f64, f64)],
    deviation_m: f64,
) -> Vec<LaneChange> {
    let arrived_m = ARRIVED_M.max(ARRIVED_DEVIATIONS * deviation_m);
    let measure = |change: &LaneChange| {
        let middle = laterals_m.partition_point(|(time_s, _)| *time_s < change.time_s);
        let away = |(_, lateral_m): &&(f64, f64)| lateral_m.abs() > arrived_m;
        let after = laterals_m[middle..]
            .iter()
            .take_while(away)
            .last()
            .map_or(change.time_s, |last| last.0);
        let before = laterals_m[..middle]
            .iter()
            .rev()
            .take_while(away)
            .last()
            .map_or(change.time_s, |last| last.0);
        // At the middle of the change it jumps from one lane's laterals to those of the other.
        let beside = |at: Option<&(f64, f64)>| at.map_or(0.0, |(_, lateral_m)| lateral_m.abs());
        let width_m = beside(laterals_m[..middle].last()) + beside(laterals_m.get(middle));
        let hidden = (1.0 - 2.0 * (arrived_m / width_m).min(0.25)).acos() / std::f64::consts::PI;
        let margin_s = (after - before) * hidden / (1.0 - 2.0 * hidden);
        LaneChange {
            time_s: change.time_s,
            from_s: (before - margin_s).clamp(
                change.from_s,
                change.time_s - HALF_CHANGE_MIN_S.min(change.time_s - change.from_s),
            ),
            to_s: (after + margin_s).clamp(
                change.time_s + HALF_CHANGE_MIN_S.min(change.to_s - change.time_s),
                change.to_s,
            ),
        }
    };
    changes.iter().map(measure).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_lasts_while_the_track_is_between_lanes() {
        let guess = LaneChange {
            time_s: 10.0,
            from_s: 7.0,
            to_s: 13.0,
        };
        // A half wave from 8.5 to 11.5 s between lanes 3.5 m apart; another deviation far away is
        // none of it.
        let lateral = |time_s: f64| {
            let way =
                0.5 - 0.5 * (std::f64::consts::PI * ((time_s - 8.5) / 3.0).clamp(0.0, 1.0)).cos();
            let other = if time_s > 15.0 { 1.0 } else { 0.0 };
            other
                + if time_s < 10.0 {
                    3.5 * way
                } else {
                    3.5 * (way - 1.0)
                }
        };
        let laterals: Vec<(f64, f64)> = (0..200)
            .map(|at| 0.1 * f64::from(at))
            .map(|time_s| (time_s, lateral(time_s)))
            .collect();
        let found = measured(&[guess], &laterals, 0.03)[0];
        assert!(
            (found.from_s - 8.5).abs() < 0.15 && (found.to_s - 11.5).abs() < 0.15,
            "{found:?}"
        );
        assert!(found.contains(9.0) && !found.contains(12.0));
        // A track that lies about its lane by meters is not changing it.
        let wide = measured(&[guess], &laterals, 1.5)[0];
        assert_eq!((wide.from_s, wide.to_s), (9.5, 10.5));
    }
}
