//! Borders of the map: lanes over which vehicles enter it and leave it.

use super::RoadLane;

/// Length behind the end of a lane from which one beside it leads on, meters: where a map is cut
/// out, lanes of one road end a little apart.
const LEADS_ON_M: f64 = 100.0;
/// Least room for a vehicle at an entrance, meters.
const ENTRANCE_M: f64 = 20.0;
/// Least length that an entrance leads on, meters.
const ENTRANCE_ONWARD_M: f64 = 60.0;
/// Lanes beside each other that are looked through: more than any road has.
const BESIDE_MAX: usize = 16;

/// Marks the lanes that leave the map at their end, and returns those that enter it at their start.
///
/// A lane that ends beside one that goes on is no border: vehicles on it have to merge.
pub(super) fn find(lanes: &mut [Option<RoadLane>]) -> Vec<usize> {
    let road = |lane: usize| lanes[lane].as_ref();
    let leaves_map = |lane: &usize| {
        let leads_on = |beside: usize| {
            road(beside).is_some_and(|road| {
                let mut ahead = road
                    .successors
                    .iter()
                    .filter_map(|&next| lanes[next].as_ref());
                ahead.any(|next| next.onward_m > LEADS_ON_M)
            })
        };
        road(*lane).is_some_and(|road| road.successors.is_empty())
            && !beside(lanes, *lane).into_iter().any(leads_on)
    };
    let enters_map = |lane: &usize| {
        road(*lane).is_some_and(|road| {
            road.predecessors.is_empty()
                && road.line.length_m() >= ENTRANCE_M
                && road.onward_m >= ENTRANCE_ONWARD_M
        }) && beside(lanes, *lane)
            .into_iter()
            .all(|beside| road(beside).is_none_or(|road| road.predecessors.is_empty()))
    };
    let leaving: Vec<usize> = (0..lanes.len()).filter(leaves_map).collect();
    let entrances = (0..lanes.len()).filter(enters_map).collect();
    for lane in leaving {
        if let Some(lane) = &mut lanes[lane] {
            lane.leaves_map = true;
        }
    }
    entrances
}

/// The lanes beside a lane in its direction, without itself.
fn beside(lanes: &[Option<RoadLane>], lane: usize) -> Vec<usize> {
    let mut found = Vec::new();
    for step in [|road: &RoadLane| road.left, |road: &RoadLane| road.right] {
        let mut at = lane;
        while let Some(next) = lanes[at].as_ref().and_then(step)
            && next != lane
            && found.len() < BESIDE_MAX
        {
            found.push(next);
            at = next;
        }
    }
    found
}
