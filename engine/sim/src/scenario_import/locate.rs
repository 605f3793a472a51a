//! Places of positions on the lanes of a map.

mod paths;

use std::collections::HashMap;

use decouplegs_asset::maps::open_drive::RoadPositions;
use decouplegs_drive::LaneIndex;
use decouplegs_drive::polyline::{Polyline, wrapped};
use decouplegs_drive::route::{LaneSpot, straight_on};
use decouplegs_logs::open_scenario::{Along, Entity, Heading, Position};
use decouplegs_scene::{LaneKind, LaneMap};
use glam::DVec2;

/// Distance from the middle of a lane within which a vehicle drives on it, meters.
const ON_LANE_M: f64 = 2.0;

/// Place of an entity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Located {
    /// World coordinates, meters.
    pub point_m: DVec2,
    /// Heading, radians from x towards y.
    pub heading_rad: f64,
    /// Position on a driving lane; `None` beside the road.
    pub spot: Option<LaneSpot>,
    /// Position on a lane of any kind, as other positions are relative to it.
    pub lane: Option<LaneSpot>,
}

impl Located {
    /// True if it heads against the direction of its lane.
    pub(super) fn is_against(&self, lanes: &LaneIndex) -> bool {
        let line = self
            .lane
            .and_then(|spot| Some((lanes.line(spot.lane)?, spot.at_m)));
        line.is_some_and(|(line, at_m)| {
            let turn_rad = wrapped(line.heading_at(at_m) - self.heading_rad);
            turn_rad.abs() > std::f64::consts::FRAC_PI_2
        })
    }
}

/// A place, or a sentence that says why a position is none.
pub(super) type Place = Result<Located, String>;

/// Finds places on a map.
pub(super) struct Locator<'a> {
    map: &'a LaneMap,
    roads: Option<&'a RoadPositions>,
    pub(super) index: LaneIndex,
    entities: &'a [Entity],
    by_name: HashMap<&'a str, usize>,
}

impl<'a> Locator<'a> {
    pub(super) fn new(
        map: &'a LaneMap,
        roads: Option<&'a RoadPositions>,
        entities: &'a [Entity],
    ) -> Self {
        let numbered = entities.iter().enumerate();
        Self {
            map,
            roads,
            index: LaneIndex::new(map),
            entities,
            by_name: numbered
                .map(|(index, entity)| (entity.name.as_str(), index))
                .collect(),
        }
    }

    /// 1 if the left of a place is left of its road's reference line, otherwise -1.
    pub(super) fn sign(&self, located: &Located) -> f64 {
        let place = located
            .lane
            .and_then(|spot| self.roads?.place_of(self.map, spot.lane, spot.at_m));
        let is_forward = place.is_none_or(|place| place.is_forward);
        if is_forward == located.is_against(&self.index) {
            -1.0
        } else {
            1.0
        }
    }

    /// Index of the entity with a name.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    /// Places of all entities at the start, with reasons where a file gives none or it is off the
    /// map.
    pub(super) fn all(&self) -> Vec<Place> {
        let none = "the file gives it no position that is read";
        let mut located: Vec<Place> = vec![Err(none.into()); self.entities.len()];
        let mut is_done = vec![false; self.entities.len()];
        for index in 0..self.entities.len() {
            // Positions may be relative to other entities: those at the end of the chain first.
            let mut chain = vec![];
            let mut next = Some(index);
            while let Some(index) = next.filter(|&index| !is_done[index]) {
                is_done[index] = true;
                chain.push(index);
                let position = match &self.entities[index].position {
                    Some(Position::After { before, .. }) => Some(&**before),
                    position => position.as_ref(),
                };
                next = position
                    .and_then(Position::other)
                    .and_then(|name| self.find(name));
            }
            for index in chain.into_iter().rev() {
                if let Some(position) = &self.entities[index].position {
                    located[index] = self.locate(position, &located);
                }
            }
        }
        located
    }

    /// Place of a position.
    ///
    /// # Errors
    /// A sentence that says what of it is not on the map.
    pub(super) fn locate(&self, position: &Position, located: &[Place]) -> Place {
        self.locate_after(position, located, None)
    }

    /// Like [`Self::locate`], an entity being where it has moved to.
    fn locate_after(
        &self,
        position: &Position,
        located: &[Place],
        moved: Option<(usize, Located)>,
    ) -> Place {
        let other = |entity: &str| -> Place {
            let found = self
                .find(entity)
                .ok_or_else(|| format!("there is no entity {entity}"))?;
            if let Some((_, place)) = moved.filter(|(own, _)| *own == found) {
                return Ok(place);
            }
            located[found]
                .clone()
                .map_err(|reason| format!("it counts from {entity}, and {reason}"))
        };
        match position {
            Position::World { at_m, heading_rad } => Ok(self.at(*at_m, Some(*heading_rad))),
            Position::Geo { .. } => {
                Err("positions by latitude and longitude are not placed on maps".into())
            }
            Position::Road {
                road,
                s_m,
                t_m,
                heading,
            } => {
                let point_m = self.beside_line(road, *s_m, *t_m)?;
                Ok(turned(self.at(point_m, None), *heading))
            }
            Position::Lane {
                road,
                lane,
                s_m,
                offset_m,
                heading,
            } => self.on_road_lane(road, *lane, *s_m, *offset_m, *heading),
            Position::RelativeLane {
                entity,
                lanes,
                along,
                offset_m,
                heading,
            } => self.beside_entity(other(entity)?, *lanes, *along, *offset_m, *heading),
            Position::RelativeRoad {
                entity,
                ds_m,
                dt_m,
                heading,
            } => self.along_road(other(entity)?, *ds_m, *dt_m, *heading),
            Position::RelativeEntity {
                entity,
                offset_m,
                is_in_its_frame,
                heading,
            } => Ok(self.seen_from(&other(entity)?, *offset_m, *is_in_its_frame, *heading)),
            Position::After { before, by } => {
                let before = self.locate(before, located)?;
                let own = by.other().and_then(|name| self.find(name));
                self.locate_after(by, located, own.map(|own| (own, before)))
            }
            Position::Beside { of, offset_m } => {
                let of = self.locate_after(of, located, moved)?;
                Ok(self.seen_from(&of, *offset_m, true, None))
            }
            Position::Between { of, shares } => {
                let mut mean_m = DVec2::ZERO;
                for (place, share) in of.iter().zip(shares) {
                    mean_m += *share * self.locate_after(place, located, moved)?.point_m;
                }
                Ok(self.at(mean_m, None))
            }
            Position::Route {
                waypoints,
                path_m,
                lane,
                offset_m,
                heading,
            } => self.on_route(waypoints, *path_m, *lane, *offset_m, *heading, located),
            Position::Trajectory {
                points,
                path_m,
                offset_m,
                heading,
            } => self.on_trajectory(points, [*path_m, *offset_m], *heading, located),
        }
    }

    /// The place at an offset from an entity: ahead and to its left, or in coordinates of the map.
    fn seen_from(
        &self,
        from: &Located,
        offset_m: DVec2,
        is_in_its_frame: bool,
        heading: Option<Heading>,
    ) -> Located {
        let offset_m = match is_in_its_frame {
            true => DVec2::from_angle(from.heading_rad).rotate(offset_m),
            false => offset_m,
        };
        let heading_rad = match heading {
            Some(heading) if !heading.is_relative => heading.rad,
            Some(heading) => from.heading_rad + heading.rad,
            None => from.heading_rad,
        };
        self.at(from.point_m + offset_m, Some(heading_rad))
    }

    fn roads(&self) -> Result<&RoadPositions, String> {
        self.roads
            .ok_or_else(|| "positions by road need an OpenDRIVE map".into())
    }

    fn beside_line(&self, road: &str, s_m: f64, t_m: f64) -> Result<DVec2, String> {
        self.roads()?
            .beside_line(road, s_m, t_m)
            .ok_or_else(|| format!("the map has no road {road}"))
    }

    /// The place on a lane of a road, `offset_m` to the left of the reference line's direction.
    fn on_road_lane(
        &self,
        road: &str,
        lane: i64,
        s_m: f64,
        offset_m: f64,
        heading: Option<Heading>,
    ) -> Place {
        let roads = self.roads()?;
        let Some((index, at_m, is_forward)) = roads.on_lane(self.map, road, lane, s_m) else {
            return Err(match roads.lanes_at(road, s_m) {
                None => format!("the map has no road {road}"),
                Some(lanes) => format!(
                    "road {road} has no lane {lane} at {s_m} m, only {}",
                    listed(&lanes)
                ),
            });
        };
        let left_m = if is_forward { offset_m } else { -offset_m };
        let spot = LaneSpot { lane: index, at_m };
        self.on_lane(spot, left_m)
            .map(|located| turned(located, heading))
            .ok_or_else(|| format!("lane {lane} of road {road} has no length"))
    }

    /// The place `lanes` beside an entity and `along` from it.
    fn beside_entity(
        &self,
        from: Located,
        lanes: i64,
        along: Along,
        offset_m: f64,
        heading: Option<Heading>,
    ) -> Place {
        let spot = from.lane.ok_or("what it counts from is on no lane")?;
        let Some(roads) = self.roads else {
            // Without roads all lanes count in driving direction.
            let (Along::Road(ahead_m) | Along::Lane(ahead_m)) = along;
            let mut spot = spot;
            for _ in 0..lanes.unsigned_abs() {
                spot = self
                    .beside(spot, lanes > 0)
                    .ok_or("there are not that many lanes")?;
            }
            let moved = self.moved(spot, ahead_m);
            return self
                .on_lane(moved.ok_or("its lane begins before")?, offset_m)
                .map(|located| turned(located, heading))
                .ok_or_else(|| "its lane has no length".into());
        };
        let unknown = || "what it counts from is on no road".to_owned();
        let is_forward = roads
            .place_of(self.map, spot.lane, spot.at_m)
            .ok_or_else(unknown)?
            .is_forward;
        let ahead_m = match along {
            Along::Road(ds_m) if is_forward => ds_m,
            Along::Road(ds_m) => -ds_m,
            Along::Lane(ds_m) => ds_m,
        };
        let moved = self
            .moved(spot, ahead_m)
            .ok_or("the lane of what it counts from begins before")?;
        let place = roads
            .place_of(self.map, moved.lane, moved.at_m)
            .ok_or_else(unknown)?;
        // Along the lane, left is that of its driver; along the road, that of the reference line.
        let is_turned = matches!(along, Along::Lane(_)) && !place.is_forward;
        let (lanes, offset_m) = if is_turned {
            (-lanes, -offset_m)
        } else {
            (lanes, offset_m)
        };
        let mut id = place.lane.saturating_add(lanes);
        // There is no driving on lane 0, so it is not counted.
        if place.lane < 0 && id >= 0 {
            id += 1;
        } else if place.lane > 0 && id <= 0 {
            id -= 1;
        }
        self.on_road_lane(&place.road, id, place.s_m, offset_m, heading)
    }

    /// The place `ds_m` along the road of an entity and `dt_m` to its left.
    fn along_road(&self, from: Located, ds_m: f64, dt_m: f64, heading: Option<Heading>) -> Place {
        let roads = self.roads()?;
        let unknown = || "what it counts from is on no road".to_owned();
        let spot = from.lane.ok_or_else(unknown)?;
        let place = roads
            .place_of(self.map, spot.lane, spot.at_m)
            .ok_or_else(unknown)?;
        let t_m = roads
            .left_of_line_m(&place.road, place.s_m, from.point_m)
            .ok_or_else(unknown)?;
        let s_m = place.s_m + ds_m;
        let length_m = roads.length_m(&place.road).ok_or_else(unknown)?;
        let point_m = if (0.0..=length_m).contains(&s_m) {
            self.beside_line(&place.road, s_m, t_m + dt_m)?
        } else {
            // Beyond the road it goes on along the lanes.
            let ahead_m = if place.is_forward { ds_m } else { -ds_m };
            let moved = self.moved(spot, ahead_m).ok_or_else(unknown)?;
            let on = roads
                .place_of(self.map, moved.lane, moved.at_m)
                .ok_or_else(unknown)?;
            let is_turned = on.is_forward != place.is_forward;
            let beside_m = if is_turned { -(t_m + dt_m) } else { t_m + dt_m };
            self.beside_line(&on.road, on.s_m, beside_m)?
        };
        Ok(turned(self.at(point_m, None), heading))
    }

    /// Places on the other driving lanes of the road at `spot`, of either direction.
    pub(super) fn lanes_beside(&self, spot: LaneSpot) -> Vec<LaneSpot> {
        let Some((roads, place)) = self
            .roads
            .and_then(|roads| Some((roads, roads.place_of(self.map, spot.lane, spot.at_m)?)))
        else {
            return Vec::new();
        };
        let ids = roads.lanes_at(&place.road, place.s_m).unwrap_or_default();
        ids.into_iter()
            .filter_map(|id| roads.on_lane(self.map, &place.road, id, place.s_m))
            .filter(|(lane, ..)| self.map.lanes[*lane].kind == LaneKind::Driving)
            .map(|(lane, at_m, _)| LaneSpot { lane, at_m })
            .filter(|beside| beside.lane != spot.lane)
            .collect()
    }

    /// Length of a lane, meters.
    pub(super) fn length_m(&self, lane: usize) -> f64 {
        self.index.line(lane).map_or(0.0, Polyline::length_m)
    }

    /// The place on the neighboring lane, in the same direction of travel.
    pub(super) fn beside(&self, spot: LaneSpot, is_left: bool) -> Option<LaneSpot> {
        let listed = &self.map.lanes[spot.lane];
        let lane = if is_left {
            listed.left_neighbor
        } else {
            listed.right_neighbor
        }?;
        let point_m = self.index.line(spot.lane)?.at(spot.at_m).truncate();
        let at_m = self.index.line(lane)?.project(point_m).arc_m;
        Some(LaneSpot { lane, at_m })
    }

    /// The place `ahead_m` after `spot`, before it if negative; `None` if its lanes begin later.
    fn moved(&self, spot: LaneSpot, ahead_m: f64) -> Option<LaneSpot> {
        if ahead_m < 0.0 {
            self.behind(spot, -ahead_m)
        } else {
            Some(straight_on(self.map, spot, ahead_m).1)
        }
    }

    /// The place `distance_m` before `spot`.
    fn behind(&self, spot: LaneSpot, distance_m: f64) -> Option<LaneSpot> {
        let mut spot = LaneSpot {
            at_m: spot.at_m - distance_m,
            ..spot
        };
        // No lane is shorter than nothing; loops of lanes end with the distance.
        let mut lanes = self.map.lanes.len();
        while spot.at_m < 0.0 {
            let before = self.map.lanes[spot.lane].predecessors.iter().copied();
            let mut driving = before.filter(|&lane| self.map.lanes[lane].kind == LaneKind::Driving);
            let lane = driving.next()?;
            spot = LaneSpot {
                lane,
                at_m: spot.at_m + self.index.line(lane)?.length_m(),
            };
            lanes = lanes.checked_sub(1)?;
        }
        Some(spot)
    }

    fn on_lane(&self, spot: LaneSpot, left_m: f64) -> Option<Located> {
        let line = self.index.line(spot.lane)?;
        let heading_rad = line.heading_at(spot.at_m);
        let left = DVec2::from_angle(heading_rad).perp();
        let point_m = line.at(spot.at_m).truncate() + left_m * left;
        let is_driving = self.map.lanes[spot.lane].kind == LaneKind::Driving;
        if is_driving && left_m.abs() <= ON_LANE_M {
            return Some(Located {
                point_m,
                heading_rad,
                spot: Some(spot),
                lane: Some(spot),
            });
        }
        // So far beside its lane it may stand on another.
        let beside = self.at(point_m, Some(heading_rad));
        Some(Located {
            lane: beside.lane.or(Some(spot)),
            ..beside
        })
    }

    /// The place at `point_m`, on the nearest lane if one is there that leads the same way.
    pub(super) fn at(&self, point_m: DVec2, heading_rad: Option<f64>) -> Located {
        let found = self.index.nearest(point_m, |near| {
            let turn_rad = heading_rad.map(|rad| wrapped(near.foot.heading_rad - rad).abs());
            self.map.lanes[near.lane].kind == LaneKind::Driving
                && turn_rad.is_none_or(|rad| rad < std::f64::consts::FRAC_PI_2)
        });
        let near = found.filter(|near| near.foot.distance_m <= ON_LANE_M);
        let spot = near.map(|near| LaneSpot {
            lane: near.lane,
            at_m: near.foot.arc_m,
        });
        Located {
            point_m,
            heading_rad: heading_rad
                .or(near.map(|near| near.foot.heading_rad))
                .unwrap_or(0.0),
            spot,
            lane: spot,
        }
    }
}

/// `located` with a heading, if the file gives one.
fn turned(located: Located, heading: Option<Heading>) -> Located {
    let heading_rad = match heading {
        Some(heading) if heading.is_relative => located.heading_rad + heading.rad,
        Some(heading) => heading.rad,
        None => located.heading_rad,
    };
    Located {
        heading_rad,
        ..located
    }
}

/// Ids of lanes in a sentence.
fn listed(lanes: &[i64]) -> String {
    const LISTED_MAX: usize = 12;
    let shown: Vec<String> = lanes.iter().take(LISTED_MAX).map(i64::to_string).collect();
    if shown.is_empty() {
        "none".into()
    } else {
        shown.join(", ")
    }
}
