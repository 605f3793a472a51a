//! Quantities of an episode over time, for plots.

use decouplegs::drive::polyline::wrapped;
use decouplegs::scene::VehicleState;
use decouplegs::scene::episode::{Episode, EpisodeTick};
use serde_json::{Value, json};

/// All quantities of `episode` as JSON: name, unit, and a value for each instant, null where there
/// is none.
pub fn facts(episode: &Episode) -> Value {
    let ticks: Vec<&EpisodeTick> = episode.instants().collect();
    let each = |value: fn(&EpisodeTick) -> Option<f64>| -> Vec<Option<f64>> {
        ticks.iter().map(|tick| value(tick)).collect()
    };
    let yaw_rates = rates(&ticks, |tick| tick.ego.yaw_rad, wrapped);
    let jerks = rates(&ticks, |tick| tick.ego.acceleration_mps2, |change| change);
    let degrees = |values: &[Option<f64>]| -> Vec<Option<f64>> {
        values
            .iter()
            .map(|value| value.map(f64::to_degrees))
            .collect()
    };
    let sideways: Vec<Option<f64>> = (ticks.iter().zip(&yaw_rates))
        .map(|(tick, rate)| rate.map(|rate| rate * tick.ego.speed_mps))
        .collect();
    let km_per_h = |mps: f64| 3.6 * mps;
    let all = [
        (
            "Acceleration",
            "m/s²",
            each(|tick| Some(tick.ego.acceleration_mps2)),
        ),
        ("Acceleration to the left", "m/s²", sideways),
        ("Jerk", "m/s³", jerks),
        (
            "Angle of the wheels",
            "°",
            degrees(&each(|tick| Some(tick.steer_rad))),
        ),
        ("Turning to the left", "°/s", degrees(&yaw_rates)),
        ("Distance to the nearest agent", "m", each(nearest_m)),
        (
            "Speed limit",
            "km/h",
            each(|tick| tick.lanes?.limit_mps)
                .into_iter()
                .map(|limit| limit.map(km_per_h))
                .collect(),
        ),
        (
            "Speed against the lane",
            "km/h",
            each(|tick| Some(tick.lanes?.against_mps))
                .into_iter()
                .map(|speed| speed.map(km_per_h))
                .collect(),
        ),
        (
            "On the road",
            "",
            each(|tick| Some(f64::from(u8::from(tick.on_road)))),
        ),
    ];
    let known = all
        .into_iter()
        .filter(|(_, _, values)| values.iter().any(Option::is_some));
    let known =
        known.map(|(name, unit, values)| json!({"name": name, "unit": unit, "values": values}));
    known.collect()
}

/// Change of `value` per second from each tick to the next, and 0 at the first; `turned` makes a
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
