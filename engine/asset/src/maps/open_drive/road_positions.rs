//! Positions on roads by road, lane and length along the reference line, as OpenSCENARIO gives
//! them.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneMap};
use glam::DVec2;

use super::super::polyline::plan_length_m;
use super::Road;
use super::junctions::RoadLanes;

/// Roads of a map, to find positions on them.
pub struct RoadPositions {
    roads: Vec<Road>,
    indices: Vec<RoadLanes>,
    by_id: HashMap<String, usize>,
}

impl RoadPositions {
    pub(super) fn new(
        roads: Vec<Road>,
        indices: Vec<RoadLanes>,
        by_id: HashMap<String, usize>,
    ) -> Self {
        Self {
            roads,
            indices,
            by_id,
        }
    }

    /// Index of a lane in `map`, meters along it in driving direction, and true if it runs along
    /// the reference line, of the position `s_m` along the reference line of `road`. `None` if
    /// there is no such road or lane.
    #[must_use]
    pub fn on_lane(
        &self,
        map: &LaneMap,
        road: &str,
        lane: i64,
        s_m: f64,
    ) -> Option<(usize, f64, bool)> {
        let index = *self.by_id.get(road)?;
        let (section, share) = self.roads[index].section_at(s_m);
        let by_id = self.indices[index].sections.get(section)?;
        let &(lane, is_forward) = by_id.get(&lane)?;
        let at_m = along_m(&map.lanes[lane], share, is_forward);
        Some((lane, at_m, is_forward))
    }

    /// Point `t_m` to the left of the reference line of `road`, `s_m` along it. `None` if there is
    /// no such road.
    #[must_use]
    pub fn beside_line(&self, road: &str, s_m: f64, t_m: f64) -> Option<DVec2> {
        let plan_view = &self.roads[*self.by_id.get(road)?].plan_view;
        let after = plan_view.partition_point(|piece| piece.start_m <= s_m);
        let piece = plan_view.get(after.saturating_sub(1))?;
        let at = piece.at(s_m.clamp(piece.start_m, piece.start_m + piece.length_m));
        Some(at.position + t_m * DVec2::from_angle(at.heading_rad).perp())
    }
}

/// Meters along `lane` in driving direction after a share of the reference line beside it.
pub(super) fn along_m(lane: &Lane, share: f64, is_forward: bool) -> f64 {
    plan_length_m(&lane.centerline) * if is_forward { share } else { 1.0 - share }
}
