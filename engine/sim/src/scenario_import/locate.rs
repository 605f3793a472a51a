//! Places of positions on the lanes of a map.

use std::collections::HashMap;

use decouplegs_asset::maps::open_drive::RoadPositions;
use decouplegs_drive::LaneIndex;
use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::route::{LaneSpot, straight_on};
use decouplegs_logs::open_scenario::{Entity, Position};
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
}

/// Finds places on a map.
pub(super) struct Locator<'a> {
    map: &'a LaneMap,
    roads: Option<&'a RoadPositions>,
    index: LaneIndex,
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

    /// Index of the entity with a name.
    pub(super) fn find(&self, name: &str) -> Option<usize> {
        self.by_name.get(name).copied()
    }

    /// Places of all entities at the start, `None` where a file gives none or it is off the map.
    pub(super) fn all(&self) -> Vec<Option<Located>> {
        let mut located = vec![None; self.entities.len()];
        let mut is_done = vec![false; self.entities.len()];
        for index in 0..self.entities.len() {
            // Positions may be relative to other entities: those at the end of the chain first.
            let mut chain = vec![];
            let mut next = Some(index);
            while let Some(index) = next.filter(|&index| !is_done[index]) {
                is_done[index] = true;
                chain.push(index);
                next = match &self.entities[index].position {
                    Some(Position::RelativeLane { entity, .. }) => self.find(entity),
                    _ => None,
                };
            }
            for index in chain.into_iter().rev() {
                let position = self.entities[index].position.as_ref();
                located[index] = position.and_then(|position| self.locate(position, &located));
            }
        }
        located
    }

    /// Place of a position; `None` if it is not on the map.
    pub(super) fn locate(
        &self,
        position: &Position,
        located: &[Option<Located>],
    ) -> Option<Located> {
        match position {
            Position::World { at_m, heading_rad } => Some(self.at(*at_m, Some(*heading_rad))),
            Position::Road { road, s_m, t_m } => {
                Some(self.at(self.roads?.beside_line(road, *s_m, *t_m)?, None))
            }
            Position::Lane {
                road,
                lane,
                s_m,
                offset_m,
            } => {
                let (lane, at_m, is_forward) = self.roads?.on_lane(self.map, road, *lane, *s_m)?;
                let left_m = if is_forward { *offset_m } else { -offset_m };
                self.on_lane(LaneSpot { lane, at_m }, left_m)
            }
            Position::RelativeLane {
                entity,
                lanes,
                ahead_m,
            } => {
                let mut spot = located[self.find(entity)?]?.spot?;
                for _ in 0..lanes.unsigned_abs() {
                    spot = self.beside(spot, *lanes > 0)?;
                }
                if *ahead_m < 0.0 {
                    return self.on_lane(self.behind(spot, -ahead_m)?, 0.0);
                }
                self.on_lane(straight_on(self.map, spot, *ahead_m).1, 0.0)
            }
        }
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
        let is_driving = self.map.lanes[spot.lane].kind == LaneKind::Driving;
        Some(Located {
            point_m: line.at(spot.at_m).truncate() + left_m * left,
            heading_rad,
            spot: (is_driving && left_m.abs() <= ON_LANE_M).then_some(spot),
        })
    }

    /// The place at `point_m`, on the nearest lane if one is there that leads the same way.
    fn at(&self, point_m: DVec2, heading_rad: Option<f64>) -> Located {
        let found = self.index.nearest(point_m, |near| {
            let turn_rad = heading_rad.map(|rad| wrapped(near.foot.heading_rad - rad).abs());
            self.map.lanes[near.lane].kind == LaneKind::Driving
                && turn_rad.is_none_or(|rad| rad < std::f64::consts::FRAC_PI_2)
        });
        let near = found.filter(|near| near.foot.distance_m <= ON_LANE_M);
        Located {
            point_m,
            heading_rad: heading_rad
                .or(near.map(|near| near.foot.heading_rad))
                .unwrap_or(0.0),
            spot: near.map(|near| LaneSpot {
                lane: near.lane,
                at_m: near.foot.arc_m,
            }),
        }
    }
}
