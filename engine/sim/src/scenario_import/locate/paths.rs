//! Places along routes and trajectories.

use decouplegs_drive::polyline::Polyline;
use decouplegs_drive::route::{LaneSpot, lanes_between};
use decouplegs_logs::open_scenario::{Heading, Position};
use glam::DVec2;

use super::{Locator, Place, turned};

impl Locator<'_> {
    /// The place `path_m` along a trajectory and `offset_m` to its left.
    pub(super) fn on_trajectory(
        &self,
        points: &[Position],
        [path_m, offset_m]: [f64; 2],
        heading: Option<Heading>,
        located: &[Place],
    ) -> Place {
        let mut line = Vec::new();
        for point in points {
            line.push(self.locate(point, located)?.point_m.extend(0.0));
        }
        let line = Polyline::new(line).ok_or("its trajectory has no length")?;
        let heading_rad = line.heading_at(path_m);
        let left = DVec2::from_angle(heading_rad).perp();
        let point_m = line.at(path_m).truncate() + offset_m * left;
        let heading_rad = match heading {
            Some(heading) if !heading.is_relative => heading.rad,
            Some(heading) => heading_rad + heading.rad,
            None => heading_rad,
        };
        Ok(self.at(point_m, Some(heading_rad)))
    }

    /// The place `path_m` along the route through `waypoints`.
    pub(super) fn on_route(
        &self,
        waypoints: &[Position],
        path_m: f64,
        lane: Option<i64>,
        offset_m: f64,
        heading: Option<Heading>,
        located: &[Place],
    ) -> Place {
        let spot_of = |waypoint: &Position| -> Result<LaneSpot, String> {
            let place = self.locate(waypoint, located)?;
            place
                .spot
                .ok_or_else(|| "a waypoint of its route is on no driving lane".into())
        };
        let mut waypoints = waypoints.iter();
        let first = spot_of(waypoints.next().ok_or("its route has no waypoint")?)?;
        let (mut lanes, mut end) = (vec![first.lane], first);
        for waypoint in waypoints {
            let spot = spot_of(waypoint)?;
            if let Some(onward) = lanes_between(self.map, end, spot) {
                lanes.extend(onward.into_iter().skip(1));
                end = spot;
            } else if end.lane != spot.lane {
                return Err("no way leads along the waypoints of its route".into());
            }
        }
        let mut left_m = first.at_m + path_m;
        let mut spot = first;
        for (at, &lane) in lanes.iter().enumerate() {
            let length_m = self.length_m(lane);
            let is_change =
                at + 1 < lanes.len() && !self.map.lanes[lane].successors.contains(&lanes[at + 1]);
            spot = LaneSpot {
                lane,
                at_m: left_m.clamp(0.0, length_m),
            };
            if left_m <= length_m && !is_change {
                break;
            }
            if is_change {
                continue;
            }
            left_m -= length_m;
        }
        let Some(roads) = self.roads else {
            return self
                .on_lane(spot, offset_m)
                .ok_or_else(|| "its lane has no length".into());
        };
        let place = roads
            .place_of(self.map, spot.lane, spot.at_m)
            .ok_or("its route is on no road")?;
        match lane {
            Some(lane) => self.on_road_lane(&place.road, lane, place.s_m, offset_m, heading),
            None => {
                let point_m = self.beside_line(&place.road, place.s_m, offset_m)?;
                Ok(turned(self.at(point_m, None), heading))
            }
        }
    }
}
