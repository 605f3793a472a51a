//! Quantities of an episode over time, for plots.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{Episode, VehicleState};

use super::{EpisodeScore, RouteProgress, times_to_collision};
use crate::polyline::{Polyline, wrapped};

/// A quantity of an episode over time.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// Name with its unit, for programs: `steer_rad`.
    pub key: &'static str,
    /// Name for people.
    pub name: &'static str,
    /// Unit: `m`, `s`, `m/s`, `m/s²`, `m/s³`, `rad`, `rad/s`; empty for numbers without one.
    pub unit: &'static str,
    /// Value at each moment of the episode, in the order of [`Episode::instants`]; `None` where
    /// there is none.
    pub values: Vec<Option<f64>>,
}

/// All quantities that the log of `episode`, whose score is `score`, tells at one moment or more.
#[must_use]
pub fn quantities(episode: &Episode, score: &EpisodeScore) -> Vec<Quantity> {
    let ticks: Vec<&EpisodeTick> = episode.instants().collect();
    let each = |value: fn(&EpisodeTick) -> Option<f64>| -> Vec<Option<f64>> {
        ticks.iter().map(|tick| value(tick)).collect()
    };
    let yaw_rates = rates(&ticks, |tick| tick.ego.yaw_rad, wrapped);
    let sideways = (ticks.iter().zip(&yaw_rates))
        .map(|(tick, rate)| rate.map(|rate| rate * tick.ego.speed_mps))
        .collect();
    let jerks = rates(&ticks, |tick| tick.ego.acceleration_mps2, |change| change);
    let times = times_to_collision(episode).into_iter();
    let times = times.map(|(_, closest)| closest.map(|closest| closest.ttc_s));
    let (completions, scores) = scores_so_far(episode, score);
    let quantity = |key, name, unit, values| Quantity {
        key,
        name,
        unit,
        values,
    };
    let speed = each(|tick| Some(tick.ego.speed_mps));
    let acceleration = each(|tick| Some(tick.ego.acceleration_mps2));
    let limit = each(|tick| tick.lanes?.limit_mps);
    let against = each(|tick| Some(tick.lanes?.against_mps));
    let across = each(|tick| Some(tick.road?.lane?.lateral_m));
    let on_road = each(|tick| Some(f64::from(u8::from(tick.on_road))));
    let all = [
        quantity("speed_mps", "Speed", "m/s", speed),
        quantity("acceleration_mps2", "Acceleration", "m/s²", acceleration),
        quantity(
            "lateral_acceleration_mps2",
            "Acceleration to the left",
            "m/s²",
            sideways,
        ),
        quantity("jerk_mps3", "Jerk", "m/s³", jerks),
        quantity(
            "steer_rad",
            "Angle of the wheels",
            "rad",
            each(|tick| Some(tick.steer_rad)),
        ),
        quantity(
            "yaw_rate_rad_per_s",
            "Turning to the left",
            "rad/s",
            yaw_rates,
        ),
        quantity(
            "nearest_agent_m",
            "Distance to the nearest agent",
            "m",
            each(nearest_m),
        ),
        quantity(
            "time_to_collision_s",
            "Time to collision",
            "s",
            times.collect(),
        ),
        quantity("speed_limit_mps", "Speed limit", "m/s", limit),
        quantity("against_lane_mps", "Speed against the lane", "m/s", against),
        quantity(
            "lane_offset_m",
            "Distance from the middle of the lane",
            "m",
            across,
        ),
        quantity("on_road", "On the road", "", on_road),
        quantity("route_completion", "Route completion", "", completions),
        quantity("driving_score", "Driving score", "", scores),
    ];
    let is_known = |quantity: &Quantity| quantity.values.iter().any(Option::is_some);
    all.into_iter().filter(is_known).collect()
}

/// Change of `value` per second from each moment to the next, and 0 at the first; `turned` makes a
/// change of an angle the short way round.
fn rates(
    ticks: &[&EpisodeTick],
    value: impl Fn(&EpisodeTick) -> f64,
    turned: impl Fn(f64) -> f64,
) -> Vec<Option<f64>> {
    let rate = |pair: &[&EpisodeTick]| {
        let seconds = pair[1].time_s - pair[0].time_s;
        (seconds > 0.0).then(|| turned(value(pair[1]) - value(pair[0])) / seconds)
    };
    let first = ticks.first().map(|_| Some(0.0));
    first
        .into_iter()
        .chain(ticks.windows(2).map(rate))
        .collect()
}

/// Distance from the middle of the ego to that of the nearest agent, meters.
fn nearest_m(tick: &EpisodeTick) -> Option<f64> {
    let there = tick.agents.iter().flatten();
    let far = |agent: &VehicleState| agent.position_m.distance(tick.ego.position_m);
    there.map(far).reduce(f64::min)
}

/// Share of the route behind the ego, and its product with the factors of the infractions so far,
/// moment by moment. The last are those of [`EpisodeScore`].
fn scores_so_far(episode: &Episode, score: &EpisodeScore) -> (Vec<Option<f64>>, Vec<Option<f64>>) {
    let route = &episode.head.route_m;
    let length_m = Polyline::new(route.iter().map(|point| point.extend(0.0)))
        .map_or(0.0, |route| route.length_m());
    let mut progress = RouteProgress::new(route, episode.start.ego.position_m);
    let so_far = episode.instants().map(|tick| {
        let progress = progress.as_mut()?;
        progress.advance(tick.ego.position_m);
        let completion = (progress.progress_m() / length_m).min(1.0);
        let before = score
            .infractions
            .iter()
            .filter(|one| one.time_s <= tick.time_s);
        let factor: f64 = before.map(|infraction| infraction.factor()).product();
        Some((completion, completion * factor))
    });
    let (mut completions, mut scores): (Vec<_>, Vec<_>) = so_far
        .map(|one| (one.map(|one| one.0), one.map(|one| one.1)))
        .unzip();
    if let Some(Some(last)) = completions.last_mut() {
        *last = score.route_completion;
    }
    if let Some(Some(last)) = scores.last_mut() {
        *last = score.driving_score;
    }
    (completions, scores)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec2;

    fn tick(time_s: f64, yaw_rad: f64, speed_mps: f64) -> EpisodeTick {
        let vehicle = |x_m: f64| VehicleState {
            position_m: DVec2::new(x_m, 0.0),
            yaw_rad,
            speed_mps,
            acceleration_mps2: speed_mps,
        };
        EpisodeTick {
            time_s,
            ego: vehicle(0.0),
            steer_rad: 0.0,
            on_road: true,
            lanes: None,
            road: None,
            agents: vec![None, Some(vehicle(7.0)), Some(vehicle(-5.0))],
        }
    }

    #[test]
    fn rates_go_the_short_way_round_and_are_per_second() {
        let ticks = [tick(0.0, 3.1, 1.0), tick(0.5, -3.1, 3.0)];
        let ticks: Vec<&EpisodeTick> = ticks.iter().collect();
        let turning = rates(&ticks, |tick| tick.ego.yaw_rad, wrapped);
        let expected = 2.0 * (std::f64::consts::TAU - 6.2);
        assert_eq!(turning[0], Some(0.0));
        assert!((turning[1].unwrap() - expected).abs() < 1e-9, "{turning:?}");
        let jerk = rates(&ticks, |tick| tick.ego.acceleration_mps2, |change| change);
        assert_eq!(jerk, [Some(0.0), Some(4.0)]);
        assert_eq!(nearest_m(ticks[0]), Some(5.0));
        let mut alone = tick(0.0, 0.0, 0.0);
        alone.agents = vec![None];
        assert_eq!(nearest_m(&alone), None);
    }
}
