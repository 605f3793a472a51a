//! An episode from above.

use decouplegs::drive::OrientedBox;
use decouplegs::drive::obstacles::outline;
use decouplegs::scene::episode::{Episode, EpisodeEnd, EpisodeTick};
use decouplegs::scene::{Lane, VehicleSize, VehicleState};
use glam::DVec2;

use super::Scored;
use crate::lane_drawing::{Body, Way, drawing};

const EGO: usize = 0;
const AGENT: usize = 7;
const HIT: usize = 3;
const ROUTE: usize = 2;
/// Half the size of the mark of an infraction, meters.
const MARK_M: f64 = 0.9;
/// Agents farther than this from the ego's way are not drawn, meters: they would shrink what
/// matters.
const NEAR_M: f64 = 45.0;

/// Lanes, the route, what the ego drove, all vehicles at its end, and a diamond where the ego was
/// at each infraction.
pub fn svg(scored: &Scored, episode: &Episode, lanes: &[Lane]) -> String {
    let instants: Vec<&EpisodeTick> = episode.instants().collect();
    let ego_way: Vec<DVec2> = instants
        .iter()
        .map(|instant| instant.ego.position_m)
        .collect();
    let last = instants[instants.len() - 1];
    let hit = match episode.end {
        EpisodeEnd::Collision { agent } => Some(agent),
        _ => None,
    };
    let near = |state: &VehicleState| {
        ego_way
            .iter()
            .any(|at| at.distance(state.position_m) < NEAR_M)
    };
    let mut ways = vec![Way {
        name: "route",
        color: ROUTE,
        dashed: true,
        positions: episode.head.route_m.clone(),
    }];
    let is_near = |agent: &usize| last.agents[*agent].as_ref().is_some_and(near);
    for agent in (0..last.agents.len()).filter(is_near) {
        let positions = instants
            .iter()
            .filter_map(|instant| Some(instant.agents[agent].as_ref()?.position_m))
            .filter(|at| ego_way.iter().any(|ego| ego.distance(*at) < NEAR_M));
        ways.push(Way {
            name: "",
            color: if hit == Some(agent) { HIT } else { AGENT },
            dashed: false,
            positions: positions.collect(),
        });
    }
    ways.push(Way {
        name: "ego",
        color: EGO,
        dashed: false,
        positions: ego_way.clone(),
    });
    let body = |color: usize, state: &VehicleState, size: &VehicleSize| Body {
        color,
        corners: OrientedBox::for_vehicle(state, size).corners(),
    };
    let agents = last
        .agents
        .iter()
        .zip(&episode.head.agent_sizes)
        .enumerate();
    let mut bodies: Vec<Body> = agents
        .filter_map(|(agent, (state, size))| {
            let state = state.as_ref().filter(|state| near(state))?;
            let color = if hit == Some(agent) { HIT } else { AGENT };
            Some(body(color, state, size))
        })
        .collect();
    if let EpisodeEnd::Obstacle { obstacle } = &episode.end {
        bodies.push(Body {
            color: HIT,
            corners: outline(obstacle).corners(),
        });
    }
    bodies.push(body(EGO, &last.ego, &ego_size(episode)));
    bodies.extend(scored.score.infractions.iter().map(|infraction| {
        let at_m = scored.place_m(infraction.time_s);
        Body {
            color: HIT,
            corners: [DVec2::X, DVec2::Y, DVec2::NEG_X, DVec2::NEG_Y].map(|to| at_m + to * MARK_M),
        }
    }));
    drawing(
        &format!("{} after {:.1} s", scored.name(), last.time_s),
        lanes,
        &ways,
        &bodies,
    )
}

fn ego_size(episode: &Episode) -> VehicleSize {
    episode.head.scenario.ego.size
}
