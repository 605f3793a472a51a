//! Collisions that the ego could have avoided by braking, and those that nobody could.

use decouplegs_scene::episode::EpisodeTick;
use decouplegs_scene::{VehicleSize, VehicleState};
use glam::DVec2;

use super::TTC_HORIZON_S;
use crate::oriented_box::{OrientedBox, time_to_collision};

/// Deceleration of the ego that brakes as hard as it can, m/s^2.
const BRAKING_MPS2: f64 = 8.0;
/// A road user is in the ego's way where they would touch within this time at the velocities of the
/// moment, seconds.
const IN_THE_WAY_S: f64 = 2.5;
/// Step after the record ends, seconds, and most steps: a record may claim any speed.
const STEP_S: f64 = 0.1;
const STEPS_MAX: f64 = 100.0;
/// Most moments before the contact that are examined.
const MOMENTS_MAX: usize = 200;

/// True if the ego would not have touched `agent` at the moment `at` of `instants`, had it braked
/// with [`BRAKING_MPS2`] along its way at one of the moments from which on the agent was in its way
/// ([`IN_THE_WAY_S`]). The agent moves as recorded, and after the contact at the same velocity.
pub(super) fn is_avoidable(
    instants: &[&EpisodeTick],
    at: usize,
    agent: usize,
    sizes: [&VehicleSize; 2],
) -> bool {
    let in_the_way = |moment: &usize| is_in_the_way(instants[*moment], agent, sizes);
    let mut moments = (at.saturating_sub(MOMENTS_MAX)..at)
        .rev()
        .take_while(in_the_way);
    moments.any(|from| !touches_braking(&instants[from..=at], agent, sizes))
}

fn is_in_the_way(
    instant: &EpisodeTick,
    agent: usize,
    [ego_size, agent_size]: [&VehicleSize; 2],
) -> bool {
    let Some(Some(state)) = instant.agents.get(agent) else {
        return false;
    };
    let time_s = time_to_collision(
        &OrientedBox::for_vehicle(&instant.ego, ego_size),
        instant.ego.velocity(),
        &OrientedBox::for_vehicle(state, agent_size),
        state.velocity(),
        TTC_HORIZON_S,
    );
    time_s.is_some_and(|time_s| time_s <= IN_THE_WAY_S)
}

/// True if the ego touches `agent` although it brakes from the first of `instants` on, or is
/// touched when it stands.
fn touches_braking(
    instants: &[&EpisodeTick],
    agent: usize,
    [ego_size, agent_size]: [&VehicleSize; 2],
) -> bool {
    let (first, last) = (instants[0], instants[instants.len() - 1]);
    let speed_mps = first.ego.speed_mps.max(0.0);
    let stands_s = speed_mps / BRAKING_MPS2;
    let touches = |elapsed_s: f64, state: &VehicleState| {
        let braked_s = elapsed_s.min(stands_s);
        let driven_m = (speed_mps - 0.5 * BRAKING_MPS2 * braked_s) * braked_s;
        let ego = along(instants, driven_m);
        OrientedBox::for_vehicle(&ego, ego_size)
            .overlaps(&OrientedBox::for_vehicle(state, agent_size))
    };
    let recorded = instants.iter().any(|instant| {
        let elapsed_s = instant.time_s - first.time_s;
        let state = instant.agents.get(agent).and_then(Option::as_ref);
        state.is_some_and(|state| touches(elapsed_s, state))
    });
    let Some(Some(end)) = last.agents.get(agent) else {
        return recorded;
    };
    let recorded_s = last.time_s - first.time_s;
    let until_s = stands_s.max(recorded_s + IN_THE_WAY_S);
    let more = ((until_s - recorded_s) / STEP_S)
        .ceil()
        .clamp(0.0, STEPS_MAX) as u32;
    recorded
        || (1..=more).any(|step| {
            let later_s = f64::from(step) * STEP_S;
            let state = VehicleState {
                position_m: end.position_m + end.velocity() * later_s,
                ..*end
            };
            touches(recorded_s + later_s, &state)
        })
}

/// State of the ego `driven_m` meters along its recorded way, and straight on behind its end.
fn along(instants: &[&EpisodeTick], driven_m: f64) -> VehicleState {
    let mut left_m = driven_m;
    for pair in instants.windows(2) {
        let [from, to] = [pair[0].ego, pair[1].ego];
        let length_m = from.position_m.distance(to.position_m);
        if left_m < length_m {
            return VehicleState {
                position_m: from.position_m.lerp(to.position_m, left_m / length_m),
                ..from
            };
        }
        left_m -= length_m;
    }
    let end = instants[instants.len() - 1].ego;
    VehicleState {
        position_m: end.position_m + DVec2::from_angle(end.yaw_rad) * left_m,
        ..end
    }
}
