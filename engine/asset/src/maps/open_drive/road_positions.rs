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

/// Position on a lane, counted along its road.
#[derive(Clone, Debug, PartialEq)]
pub struct RoadPlace {
    /// Id of the road.
    pub road: String,
    /// Id of the lane.
    pub lane: i64,
    /// Position along the road's reference line, meters.
    pub s_m: f64,
    /// True if traffic on the lane runs along the reference line.
    pub is_forward: bool,
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

    /// The place `at_m` meters along a lane of `map` in driving direction; `None` if the lane is
    /// none of these roads.
    #[must_use]
    pub fn place_of(&self, map: &LaneMap, lane: usize, at_m: f64) -> Option<RoadPlace> {
        let listed = map.lanes.get(lane)?;
        let mut parts = listed.id.rsplitn(3, '/');
        let id = parts.next()?.parse().ok()?;
        let label = parts.next()?;
        let road = parts.next()?;
        let index = *self.by_id.get(road)?;
        let mut sections = self.roads[index].sections.iter();
        let section = sections.position(|section| section.label == label)?;
        let &(_, is_forward) = self.indices[index].sections.get(section)?.get(&id)?;
        let section = self.roads[index].sections.get(section)?;
        let share = (at_m / plan_length_m(&listed.centerline)).clamp(0.0, 1.0);
        let share = if is_forward { share } else { 1.0 - share };
        Some(RoadPlace {
            road: road.to_owned(),
            lane: id,
            s_m: section.start_m + share * (section.end_m - section.start_m),
            is_forward,
        })
    }

    /// Ids of the lanes beside `s_m` along the reference line of `road`, from the right; `None` if
    /// there is no such road.
    #[must_use]
    pub fn lanes_at(&self, road: &str, s_m: f64) -> Option<Vec<i64>> {
        let index = *self.by_id.get(road)?;
        let (section, _) = self.roads[index].section_at(s_m);
        let by_id = self.indices[index].sections.get(section)?;
        let mut ids: Vec<i64> = by_id.keys().copied().collect();
        ids.sort_unstable();
        Some(ids)
    }

    /// Length of the reference line of `road`, meters.
    #[must_use]
    pub fn length_m(&self, road: &str) -> Option<f64> {
        let last = self.roads[*self.by_id.get(road)?].plan_view.last()?;
        Some(last.start_m + last.length_m)
    }

    /// Distance of `point_m` to the left of the reference line of `road` at `s_m`, meters.
    #[must_use]
    pub fn left_of_line_m(&self, road: &str, s_m: f64, point_m: DVec2) -> Option<f64> {
        let on_line = self.beside_line(road, s_m, 0.0)?;
        let left = self.beside_line(road, s_m, 1.0)? - on_line;
        Some((point_m - on_line).dot(left))
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
