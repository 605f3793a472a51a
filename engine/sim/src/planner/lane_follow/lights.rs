//! Traffic lights as the lane-following planner obeys them.

use decouplegs_scene::episode::StopLineRecord;
use decouplegs_scene::{LightColor, VehicleState};
use glam::DVec2;

use super::super::Privileged;
use super::corridor::Corridor;

/// Hardest braking for a yellow light and for a red one, m/s^2.
const YELLOW_MPS2: f64 = 2.5;
const RED_MPS2: f64 = 7.0;
/// Stop lines whose middle is nearer to the route than this are on it, meters.
pub(super) const ON_ROUTE_M: f64 = 1.5;
/// Cosine of the largest angle between the route and the direction of a stop line on it.
const ALONG: f64 = 0.8;
/// Place to stop before a line, meters. The car-following model keeps a gap besides.
pub(super) const GAP_M: f64 = 0.3;
/// Vehicles before a red light are expected to stop within this distance, meters.
const OTHERS_M: f64 = 60.0;

/// The stop line at which the ego stops, meters along the line of `corridor`: the nearest on its
/// route that is not green and before which it can stop. `held_m` is the one of the last plan.
pub(super) fn hold_m(corridor: &Corridor, known: &Privileged, held_m: Option<f64>) -> Option<f64> {
    let speed_mps = known.ego.speed_mps;
    let front_m = corridor.ego_arc_m + 0.5 * known.ego_size.length_m;
    let lines = known.stop_lines.iter().filter_map(|(line, color)| {
        let line_m = on_route_m(corridor, line, front_m)?;
        let place_m = line_m - GAP_M;
        let was_held = held_m.is_some_and(|held_m| (held_m - place_m).abs() < ON_ROUTE_M);
        let braking_mps2 = match color {
            LightColor::Green => return None,
            LightColor::Yellow if !was_held => YELLOW_MPS2,
            LightColor::Yellow | LightColor::Red => RED_MPS2,
        };
        let stop_m = front_m + speed_mps * speed_mps / (2.0 * braking_mps2);
        (stop_m <= line_m).then_some(place_m)
    });
    lines.min_by(f64::total_cmp)
}

/// Position of a line on the route ahead of `front_m`, meters along the line of `corridor`.
pub(super) fn on_route_m(corridor: &Corridor, line: &StopLineRecord, front_m: f64) -> Option<f64> {
    let foot = corridor.project(line.middle_m());
    let along = DVec2::from_angle(foot.heading_rad).dot(line.ahead());
    let is_on_route = foot.distance_m <= ON_ROUTE_M && along >= ALONG && foot.arc_m >= front_m;
    is_on_route.then_some(foot.arc_m)
}

/// True if a red light stops an agent that goes straight on.
pub(super) fn stops(known: &Privileged, agent: &VehicleState) -> bool {
    let braking_m = agent.speed_mps * agent.speed_mps / (2.0 * RED_MPS2);
    let ahead = agent.ahead();
    let is_before = |line: &StopLineRecord| {
        let along = ahead.dot(line.ahead());
        let (from_m, _) = line.locate(agent.position_m);
        let at_m = agent.position_m + ahead * (-from_m / along.max(ALONG));
        along > ALONG && (-OTHERS_M..-braking_m).contains(&from_m) && line.locate(at_m).1
    };
    let mut red = known
        .stop_lines
        .iter()
        .filter(|(_, color)| *color == LightColor::Red);
    red.any(|(line, _)| is_before(line))
}
