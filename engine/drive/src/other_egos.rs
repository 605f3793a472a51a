//! Vehicles of a scenario's traffic that become egos.

use decouplegs_scene::scenario::{EgoTask, TrafficAgent};
use decouplegs_scene::{EgoIdentity, Invalid, LaneMap, OtherEgo, RoadUser, Scenario};

use crate::route::{LaneSpot, Route, straight_on};

/// Shortest route of an ego, meters.
const ROUTE_M_MIN: f64 = 30.0;

/// `scenario` with `count` egos: cars of its traffic become egos, where they start and as fast.
/// Each is to go straight on as far as the ego is to go, or to where its lanes end, or to where the
/// place is no longer seen: `seen_m` tells how far a route leads where it is, meters. Cars without
/// injected behaviors come first.
///
/// # Errors
/// A sentence, if the scenario has too few cars with a way ahead, or its route is not on `map`.
pub fn with_egos(
    scenario: &Scenario,
    map: &LaneMap,
    count: usize,
    seen_m: &dyn Fn(&Route) -> f64,
) -> Result<Scenario, Invalid> {
    let length_m = Route::new(map, &scenario.ego)?.length_m();
    let agents = &scenario.agents;
    let mut order: Vec<usize> = (0..agents.len()).collect();
    order.sort_by_key(|&index| !agents[index].behaviors.is_empty());
    let ego = |index: usize| {
        let agent = &agents[index];
        let cruise_mps = scenario.ego.cruise_mps;
        let task = task_of(agent, map, length_m, cruise_mps)?;
        let seen_m = seen_m(&Route::new(map, &task).ok()?);
        let task = match seen_m < length_m {
            true => task_of(agent, map, seen_m, cruise_mps)?,
            false => task,
        };
        Some((index, task))
    };
    let wanted = count.saturating_sub(scenario.egos.count());
    let taken: Vec<(usize, EgoTask)> = order.into_iter().filter_map(ego).take(wanted).collect();
    if taken.len() < wanted {
        return Err(Invalid::new(format!(
            "scenario {}: {} of its {} vehicles are cars with {ROUTE_M_MIN} m of lanes ahead where the place is seen; {wanted} are to be egos: expected fewer egos or more traffic",
            scenario.name,
            taken.len(),
            agents.len()
        )));
    }
    let mut scenario = scenario.clone();
    let (removed, others): (Vec<usize>, Vec<OtherEgo>) = taken
        .into_iter()
        .map(|(index, task)| {
            let agent = &agents[index];
            let identity = EgoIdentity {
                name: agent.name.clone(),
                asset: agent.asset,
                planner: None,
            };
            (index, OtherEgo { identity, task })
        })
        .unzip();
    let mut index = 0;
    scenario.agents.retain(|_| {
        index += 1;
        !removed.contains(&(index - 1))
    });
    scenario.egos.others.extend(others);
    Ok(scenario)
}

/// Task of a car that becomes an ego; `None` where it is no car or its lanes end before.
fn task_of(agent: &TrafficAgent, map: &LaneMap, length_m: f64, cruise_mps: f64) -> Option<EgoTask> {
    if agent.kind != RoadUser::Car {
        return None;
    }
    let lane = map.lanes.iter().position(|lane| lane.id == agent.lane)?;
    let start = LaneSpot {
        lane,
        at_m: agent.at_m,
    };
    let (lanes, end) = straight_on(map, start, length_m);
    let id = |lane: &usize| map.lanes[*lane].id.clone();
    let task = EgoTask {
        route: lanes.iter().map(id).collect(),
        start_m: agent.at_m,
        end_m: end.at_m,
        speed_mps: agent.speed_mps,
        cruise_mps: agent.cruise_mps.unwrap_or(cruise_mps),
        size: agent.size,
        follows_recording: false,
        start_pose: None,
    };
    let route = Route::new(map, &task).ok()?;
    (route.length_m() >= ROUTE_M_MIN).then_some(task)
}
