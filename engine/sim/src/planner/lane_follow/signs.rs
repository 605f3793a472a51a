//! Stop signs as the lane-following planner obeys them. It gives way to what its prediction shows.

use decouplegs_scene::SignKind;

use super::super::Privileged;
use super::corridor::Corridor;
use super::lights::{GAP_M, ON_ROUTE_M, on_route_m};

/// The ego stands at a line where it is slower than this and its front nearer than this, m/s and
/// meters.
const STANDING_MPS: f64 = 0.1;
const AT_LINE_M: f64 = 4.0;
/// Hardest braking for a stop sign, m/s^2.
const BRAKING_MPS2: f64 = 7.0;

/// The line of a stop sign at which the ego stops, meters along the line of `corridor`. `stood_m`
/// is the one at which it has stood.
pub(super) fn hold_m(
    corridor: &Corridor,
    known: &Privileged,
    stood_m: &mut Option<f64>,
) -> Option<f64> {
    let speed_mps = known.ego.speed_mps;
    let front_m = corridor.ego_arc_m + 0.5 * known.ego_size.length_m;
    let stop_m = front_m + speed_mps * speed_mps / (2.0 * BRAKING_MPS2);
    let stop_signs = known
        .signs
        .iter()
        .filter(|(_, kind)| *kind == SignKind::Stop);
    let lines = stop_signs.filter_map(|(line, _)| on_route_m(corridor, line, front_m));
    let is_new = |line_m: &f64| stood_m.is_none_or(|stood_m| (stood_m - line_m).abs() > ON_ROUTE_M);
    let next_m = lines
        .filter(|&line_m| stop_m <= line_m)
        .filter(is_new)
        .min_by(f64::total_cmp)?;
    if speed_mps < STANDING_MPS && next_m - front_m < AT_LINE_M {
        *stood_m = Some(next_m);
        return None;
    }
    Some(next_m - GAP_M)
}
