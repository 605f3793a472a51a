//! Positions on roads by road, lane and length along the reference line, as OpenSCENARIO gives
//! them.

use std::collections::HashMap;

use decouplegs_scene::{Lane, LaneMap};
use glam::{DVec2, DVec3};

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
        let own = &map.lanes[lane];
        let guess_m = along_m(own, share, is_forward);
        let at_m = self
            .tangent_at(index, s_m)
            .and_then(|(point_m, ahead)| crossing_m(&own.centerline, point_m, ahead, guess_m));
        Some((lane, at_m.unwrap_or(guess_m), is_forward))
    }

    /// Point and direction of the reference line of the road of an index.
    fn tangent_at(&self, road: usize, s_m: f64) -> Option<(DVec2, DVec2)> {
        let plan_view = &self.roads[road].plan_view;
        let after = plan_view.partition_point(|piece| piece.start_m <= s_m);
        let piece = plan_view.get(after.saturating_sub(1))?;
        let at = piece.at(s_m.clamp(piece.start_m, piece.start_m + piece.length_m));
        Some((at.position, DVec2::from_angle(at.heading_rad)))
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
        let mut s_m = section.start_m + share * (section.end_m - section.start_m);
        if let Some(place_m) = at_plan_m(&listed.centerline, at_m) {
            // Each step leaves the share of the error by which the lane is nearer to the bend.
            for _ in 0..FOOT_STEPS {
                let (point_m, ahead) = self.tangent_at(index, s_m)?;
                let more_m = (place_m - point_m).dot(ahead);
                s_m = (s_m + more_m).clamp(section.start_m, section.end_m);
            }
        }
        Some(RoadPlace {
            road: road.to_owned(),
            lane: id,
            s_m,
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
        let (point_m, ahead) = self.tangent_at(*self.by_id.get(road)?, s_m)?;
        Some(point_m + t_m * ahead.perp())
    }
}

/// Meters along `lane` in driving direction after a share of the reference line beside it.
pub(super) fn along_m(lane: &Lane, share: f64, is_forward: bool) -> f64 {
    plan_length_m(&lane.centerline) * if is_forward { share } else { 1.0 - share }
}

/// Steps in which the foot of a point on a reference line is found.
const FOOT_STEPS: usize = 16;
/// Distance along a lane within which the normal of its reference line crosses it, meters: that to
/// the place by its share.
const CROSSING_M: f64 = 30.0;

/// Place along `line`, on the plane, at which it crosses the normal of the direction `ahead`
/// through `point_m`: the one nearest to `guess_m`. `None` if it is far from there.
fn crossing_m(line: &[DVec3], point_m: DVec2, ahead: DVec2, guess_m: f64) -> Option<f64> {
    let (mut along_m, mut best): (f64, Option<f64>) = (0.0, None);
    for pair in line.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(DVec3::truncate);
        let length_m = from.distance(to);
        let (before_m, after_m) = ((from - point_m).dot(ahead), (to - point_m).dot(ahead));
        if before_m * after_m <= 0.0 && before_m != after_m {
            let at_m = along_m + length_m * before_m / (before_m - after_m);
            let is_nearer =
                best.is_none_or(|known| (at_m - guess_m).abs() < (known - guess_m).abs());
            if is_nearer {
                best = Some(at_m);
            }
        }
        along_m += length_m;
    }
    best.filter(|at_m| (at_m - guess_m).abs() < CROSSING_M)
}

/// Point of `line` after a way on the plane; `None` for a line without one.
fn at_plan_m(line: &[DVec3], at_m: f64) -> Option<DVec2> {
    let mut left_m = at_m.max(0.0);
    for pair in line.windows(2) {
        let [from, to] = [pair[0], pair[1]].map(DVec3::truncate);
        let length_m = from.distance(to);
        if left_m <= length_m && length_m > 0.0 {
            return Some(from.lerp(to, left_m / length_m));
        }
        left_m -= length_m;
    }
    line.last().map(|end| end.truncate())
}

#[cfg(test)]
mod tests {
    use super::super::decode_with_positions;
    use super::*;

    /// 100 m straight to the east, then a bend of 50 m radius to the left, with three lanes on its
    /// outside.
    const BEND: &str = "<OpenDRIVE><road id='1' length='160' junction='-1'><planView>
        <geometry s='0' x='0' y='0' hdg='0' length='100'><line/></geometry>
        <geometry s='100' x='100' y='0' hdg='0' length='60'><arc curvature='0.02'/></geometry></planView>
        <lanes><laneSection s='0'><right><lane id='-1' type='driving'><width sOffset='0' a='3.5'/></lane>
        <lane id='-2' type='driving'><width sOffset='0' a='3.5'/></lane>
        <lane id='-3' type='driving'><width sOffset='0' a='3.5'/></lane></right></laneSection></lanes></road></OpenDRIVE>";

    #[test]
    fn places_on_lanes_are_beside_their_place_on_the_reference_line() {
        let (map, roads) = decode_with_positions(BEND.as_bytes()).unwrap();
        for s_m in [0.0, 40.0, 99.0, 110.0, 131.4, 160.0] {
            let (lane, at_m, is_forward) = roads.on_lane(&map, "1", -3, s_m).unwrap();
            assert!(is_forward);
            // The middle of the lane is 8.75 m outside.
            let turn_rad = (s_m - 100.0f64).max(0.0) / 50.0;
            let exact_m = match s_m <= 100.0 {
                true => DVec2::new(s_m, -8.75),
                false => {
                    DVec2::new(100.0, 50.0) + 58.75 * DVec2::new(turn_rad.sin(), -turn_rad.cos())
                }
            };
            let found_m = at_plan_m(&map.lanes[lane].centerline, at_m).unwrap();
            assert!(
                found_m.distance(exact_m) < 0.02,
                "{s_m}: {found_m} {exact_m}"
            );
            let place = roads.place_of(&map, lane, at_m).unwrap();
            assert_eq!((&*place.road, place.lane), ("1", -3));
            assert!((place.s_m - s_m).abs() < 0.01, "{s_m}: {place:?}");
        }
        // By shares of the lengths it would be off by more than a meter.
        let (lane, at_m, _) = roads.on_lane(&map, "1", -3, 100.0).unwrap();
        let length_m = plan_length_m(&map.lanes[lane].centerline);
        assert!((at_m - length_m * 100.0 / 160.0).abs() > 1.0);
    }
}
