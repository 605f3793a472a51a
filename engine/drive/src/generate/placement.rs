//! Initial placement: the ego, the vehicle ahead of it, the one that will cut in, the one that
//! waits at the crossing, and all others.

use decouplegs_scene::{RoadUser, VehicleSize};
use glam::DVec2;

use super::ego_start::{EGO, EgoStart};
use super::random::Stream;
use super::road_users::{Assets, RoadUserAsset};
use super::roads::{Roads, Spot};
use super::rules::{LevelRequirements, NEAR_M};
use super::{down_to_tenth, safe_speed, to_centimeter};
use crate::oriented_box::OrientedBox;

/// Agents that come along from farther away are not farther than this, meters from the ego.
const FAR_M: f64 = 100.0;
/// Distance from the ego's front to the rear of the vehicle ahead, meters.
const LEAD_GAP_M: (f64, f64) = (15.0, 40.0);
/// Initial distance of the vehicle that cuts in, ahead of the ego along the next lane, center to
/// center, meters.
const CUT_IN_AHEAD_M: (f64, f64) = (6.0, 14.0);
/// A lane beside the ego's is not farther off than this, meters.
const BESIDE_M: f64 = 6.0;
/// Distance from bumper to stop line of a vehicle that waits at a crossing, meters.
const WAITING_M: (f64, f64) = (1.0, 5.0);
/// Speed of vehicles that arrive at a full crossing.
const WAITING_MPS: (f64, f64) = (0.0, 3.0);
/// Least distance between boxes beside each other, meters.
const CLEARANCE_M: f64 = 0.5;
/// Least distance from the ego's start of vehicles on lanes that merge with its own, meters.
const MERGE_APART_M: f64 = 25.0;
/// Least distance from bumper to bumper, meters.
const GAP_M_MIN: f64 = 3.0;
/// Two that are as near as [`GAP_M_MIN`] are not farther apart along their lanes than two long
/// vehicles are, meters from middle to middle.
const FOLLOWING_M: f64 = 45.0;
/// Places are examined in steps of this along lanes, meters.
const STRIDE_M: f64 = 3.0;
/// Distance ahead within which others matter, meters.
const LOOK_AHEAD_M: f64 = 120.0;
/// A lead vehicle slower than the ego is so by at least this share of the ego's speed.
const SLOWER_SHARE: f64 = 0.8;
/// An ego that others force below this share of its cruise speed has nothing to do.
const EGO_SPEED_SHARE_MIN: f64 = 0.25;
/// Number of draws of a position ahead of the ego.
const LEAD_DRAWS: usize = 16;

/// Role of a vehicle in the scenario.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Role {
    Ego,
    Lead,
    CutIn,
    Other,
}

/// A vehicle at the start.
#[derive(Clone, Debug)]
pub(super) struct Vehicle {
    pub role: Role,
    pub spot: Spot,
    pub kind: RoadUser,
    pub asset: usize,
    pub size: VehicleSize,
    pub outline: OrientedBox,
    pub speed_mps: f64,
}

/// Too few agents found room near the start; zero if they left the ego no room to drive.
pub(super) struct TooFew(pub usize);

/// The vehicles of a scenario as they are put on the road; the ego is the first.
pub(super) struct Placement<'a> {
    roads: &'a Roads<'a>,
    rules: &'a LevelRequirements,
    start: &'a EgoStart,
    assets: &'a Assets,
    vehicles: Vec<Vehicle>,
    random: Stream,
}

impl<'a> Placement<'a> {
    /// Placement of the ego alone.
    pub fn new(
        roads: &'a Roads<'a>,
        rules: &'a LevelRequirements,
        start: &'a EgoStart,
        assets: &'a Assets,
        random: Stream,
    ) -> Self {
        let (position, yaw_rad) = start.route.pose_at(0.0);
        let outline = OrientedBox {
            center_m: position.truncate(),
            yaw_rad,
            ..roads.outline(start.spot, &EGO)
        };
        let ego = Vehicle {
            role: Role::Ego,
            spot: start.spot,
            kind: RoadUser::Car,
            asset: 0,
            size: EGO,
            outline,
            speed_mps: start.task.speed_mps,
        };
        Self {
            roads,
            rules,
            start,
            assets,
            vehicles: vec![ego],
            random,
        }
    }

    /// Places all vehicles, the ego first, with `least` to `most` agents within [`NEAR_M`] of it.
    pub fn fill(mut self, (least, most): (usize, usize)) -> Result<Vec<Vehicle>, TooFew> {
        let wanted = self.random.whole((least, most));
        let has_lead = self.random.chance(self.rules.lead_share);
        if has_lead && !self.put_lead() {
            return Err(TooFew(0));
        }
        for _ in 0..self.rules.cut_ins {
            self.put_cut_in();
        }
        let far = self.random.whole(self.rules.far);
        if self.rules.congested {
            self.fill_crossing(wanted, far);
        }
        self.fill_lanes(wanted, far);
        let near = self.near();
        if near < least {
            return Err(TooFew(near));
        }
        if self.settle_speeds() {
            Ok(self.vehicles)
        } else {
            Err(TooFew(0))
        }
    }

    fn is_near(&self, position_m: DVec2) -> bool {
        self.vehicles[0].outline.center_m.distance(position_m) <= NEAR_M
    }

    /// Agents that the level counts.
    fn near(&self) -> usize {
        self.vehicles[1..]
            .iter()
            .filter(|agent| self.is_near(agent.outline.center_m))
            .count()
    }

    /// Puts a vehicle there if it has room.
    fn put(&mut self, spot: Spot, asset: RoadUserAsset, role: Role, wish_mps: f64) -> bool {
        let Some(spot) = self.roads.on_its_lane(spot) else {
            return false;
        };
        let (size, spot) = (
            asset.size,
            Spot {
                at_m: to_centimeter(spot.at_m),
                ..spot
            },
        );
        if !self.roads.has_room(spot, &size) {
            return false;
        }
        let outline = self.roads.outline(spot, &size);
        if self.merges_beside_ego(spot, &outline) {
            return false;
        }
        let fits = self.vehicles.iter().all(|other| {
            let apart_m = other.outline.distance_m(&outline);
            apart_m >= GAP_M_MIN
                || (apart_m >= CLEARANCE_M && !self.follow_each_other(spot, other.spot))
        });
        if fits {
            let speed_mps = down_to_tenth(wish_mps.min(self.roads.speed_limit_mps(spot.lane)));
            self.vehicles.push(Vehicle {
                role,
                spot,
                kind: asset.kind,
                asset: asset.asset,
                size,
                outline,
                speed_mps,
            });
        }
        fits
    }

    /// True if a vehicle at `spot` starts beside the ego, on another lane that leads to the same
    /// next lane: too near to yield.
    fn merges_beside_ego(&self, spot: Spot, outline: &OrientedBox) -> bool {
        let ego = &self.vehicles[0];
        let onward = |lane: usize| {
            self.roads
                .graph
                .lane(lane)
                .map_or(&[][..], |lane| lane.successors.as_slice())
        };
        let merges = onward(spot.lane)
            .iter()
            .any(|next| onward(ego.spot.lane).contains(next));
        spot.lane != ego.spot.lane && merges && ego.outline.distance_m(outline) < MERGE_APART_M
    }

    /// True if one of two that are near each other is ahead of the other.
    fn follow_each_other(&self, a: Spot, b: Spot) -> bool {
        let follows = |behind, front| self.roads.between_m(behind, front, FOLLOWING_M).is_some();
        follows(a, b) || follows(b, a)
    }

    fn draw_asset(&mut self) -> RoadUserAsset {
        self.assets.draw(false, &mut self.random)
    }

    fn put_lead(&mut self) -> bool {
        for _ in 0..LEAD_DRAWS {
            let asset = self.assets.draw(true, &mut self.random);
            // Rounding to centimeters stays within.
            let gap_m = self
                .random
                .between((LEAD_GAP_M.0 + 0.1, LEAD_GAP_M.1 - 0.1));
            let ahead_m = gap_m + 0.5 * (EGO.length_m + asset.size.length_m);
            let wish_mps =
                self.random.between(self.rules.lead_speed_share) * self.start.task.speed_mps;
            if self
                .start
                .along(self.roads, ahead_m)
                .is_some_and(|spot| self.put(spot, asset, Role::Lead, wish_mps))
            {
                return true;
            }
        }
        false
    }

    /// Places a vehicle on a lane beside the ego's, a little ahead of it, where there is such a
    /// lane.
    fn put_cut_in(&mut self) {
        let Some(road) = self.roads.graph.lane(self.start.spot.lane) else {
            return;
        };
        let mut beside: Vec<usize> = road.left.into_iter().chain(road.right).collect();
        self.random.shuffle(&mut beside);
        let ego_m = self.vehicles[0].outline.center_m;
        for lane in beside {
            let Some(line) = self.roads.index.line(lane) else {
                continue;
            };
            let foot = line.project(ego_m);
            if foot.distance_m > BESIDE_M {
                continue;
            }
            for _ in 0..LEAD_DRAWS {
                let asset = self.assets.draw_car(&mut self.random);
                let ahead_m = self.random.between(CUT_IN_AHEAD_M);
                let wish_mps = self.random.between((0.85, 1.0)) * self.start.task.speed_mps;
                if self.put(
                    Spot {
                        lane,
                        at_m: foot.arc_m + ahead_m,
                    },
                    asset,
                    Role::CutIn,
                    wish_mps,
                ) {
                    return;
                }
            }
        }
    }

    /// Places a vehicle before each stop line of the ego's crossing.
    fn fill_crossing(&mut self, wanted: usize, far: usize) {
        let Some(crossing) = self.start.crossing else {
            return;
        };
        let mut lines = self.roads.stop_lines(crossing);
        self.random.shuffle(&mut lines);
        for line in lines {
            let asset = self.draw_asset();
            let before_m = self.random.between(WAITING_M) + 0.5 * asset.size.length_m;
            let wish_mps = self.random.between(WAITING_MPS);
            self.put_where_wanted(
                Spot {
                    at_m: line.at_m - before_m,
                    ..line
                },
                asset,
                wish_mps,
                (wanted, far),
            );
        }
    }

    /// Puts others on all lanes around: those near crossings first where the level has them full.
    fn fill_lanes(&mut self, wanted: usize, far: usize) {
        let ego_m = self.vehicles[0].outline.center_m;
        let crossing = self.start.crossing.filter(|_| self.rules.congested);
        let crossing_m = crossing.map(|lane| {
            self.roads.position_m(Spot {
                lane,
                at_m: 0.5 * self.roads.length_m(lane),
            })
        });
        let mut spots: Vec<(f64, Spot)> = Vec::new();
        for point in self.roads.index.lanes_near(ego_m, FAR_M) {
            let length_m = self.roads.length_m(point.lane);
            // Lanes may be kilometers long; what is near lies around the foot.
            let (from_m, to_m) = (
                (point.foot.arc_m - 2.0 * FAR_M).max(0.0),
                (point.foot.arc_m + 2.0 * FAR_M).min(length_m),
            );
            let mut at_m = from_m + STRIDE_M * self.random.unit();
            while at_m < to_m {
                let spot = Spot {
                    lane: point.lane,
                    at_m,
                };
                let off_m = crossing_m.map_or(0.0, |crossing_m| {
                    crossing_m.distance(self.roads.position_m(spot))
                });
                spots.push((self.random.unit() + off_m / FAR_M, spot));
                at_m += STRIDE_M;
            }
        }
        spots.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, spot) in spots {
            let asset = self.draw_asset();
            let limit_mps = self
                .roads
                .speed_limit_mps(spot.lane)
                .min(self.start.task.cruise_mps);
            let wish_mps = self.random.between(self.rules.flow_speed_share) * limit_mps;
            self.put_where_wanted(spot, asset, wish_mps, (wanted, far));
        }
    }

    /// Puts another vehicle there unless there are enough as near or far as it is, or it came
    /// between the ego and the vehicle ahead.
    fn put_where_wanted(
        &mut self,
        spot: Spot,
        asset: RoadUserAsset,
        wish_mps: f64,
        (wanted, far): (usize, usize),
    ) {
        // Near or far is told by the place that it will have.
        let Some(spot) = self.roads.on_its_lane(spot) else {
            return;
        };
        let spot = Spot {
            at_m: to_centimeter(spot.at_m),
            ..spot
        };
        let position_m = self.roads.position_m(spot);
        let near = self.near();
        let enough = if self.is_near(position_m) {
            near >= wanted
        } else {
            self.vehicles.len() - 1 - near >= far
        };
        let beyond = position_m.distance(self.vehicles[0].outline.center_m) > FAR_M;
        let lead = self
            .vehicles
            .iter()
            .find(|vehicle| vehicle.role == Role::Lead);
        let lead_m = lead
            .and_then(|lead| self.start.ahead_m(self.roads, lead.spot))
            .unwrap_or(0.0);
        let between = self
            .start
            .ahead_m(self.roads, spot)
            .is_some_and(|ahead_m| (0.0..lead_m).contains(&ahead_m));
        if !enough && !beyond && !between {
            self.put(spot, asset, Role::Other, wish_mps);
        }
    }

    /// Slows all vehicles down until each can stop in time. False where that leaves the ego nothing
    /// to do.
    fn settle_speeds(&mut self) -> bool {
        self.lower_speeds();
        let ego_mps = self.vehicles[0].speed_mps;
        if let Some(lead) = self
            .vehicles
            .iter_mut()
            .find(|vehicle| vehicle.role == Role::Lead)
        {
            lead.speed_mps = lead
                .speed_mps
                .min(down_to_tenth(self.rules.lead_speed_share.1 * ego_mps));
            self.lower_speeds();
        }
        let ego_mps = self.vehicles[0].speed_mps;
        let slower = |lead: &Vehicle| {
            lead.speed_mps <= SLOWER_SHARE * ego_mps || self.rules.lead_speed_share.1 > SLOWER_SHARE
        };
        let lead_is_right = self
            .vehicles
            .iter()
            .filter(|vehicle| vehicle.role == Role::Lead)
            .all(slower);
        lead_is_right && ego_mps >= EGO_SPEED_SHARE_MIN * self.start.task.cruise_mps
    }

    /// Lowers speeds until each is safe behind all that is ahead. Each round lowers one by a tenth
    /// at least, so there is an end.
    fn lower_speeds(&mut self) {
        let limits: Vec<Limits> = self
            .vehicles
            .iter()
            .map(|vehicle| self.limits(vehicle))
            .collect();
        loop {
            let mut lowered = false;
            for (at, limits) in limits.iter().enumerate() {
                let behind = limits.leaders.iter().map(|&(other, gap_m)| {
                    safe_speed::behind(gap_m, self.vehicles[other].speed_mps)
                });
                let safe_mps = down_to_tenth(behind.fold(limits.stop_mps, f64::min));
                if self.vehicles[at].speed_mps > safe_mps {
                    self.vehicles[at].speed_mps = safe_mps;
                    lowered = true;
                }
            }
            if !lowered {
                return;
            }
        }
    }

    fn limits(&self, vehicle: &Vehicle) -> Limits {
        let half_m = 0.5 * vehicle.size.length_m;
        let stop_m = self.roads.until_stop_m(vehicle.spot, LOOK_AHEAD_M) - half_m;
        let mut leaders = Vec::new();
        for ahead in self.roads.ahead(vehicle.spot, LOOK_AHEAD_M) {
            for (at, other) in self
                .vehicles
                .iter()
                .enumerate()
                .filter(|(_, other)| other.spot.lane == ahead.lane)
            {
                let middles_m = ahead.begin_m + other.spot.at_m;
                if middles_m > 0.0 {
                    leaders.push((at, middles_m - half_m - 0.5 * other.size.length_m));
                }
            }
        }
        Limits {
            stop_mps: safe_speed::behind(stop_m, 0.0),
            leaders,
        }
    }
}

/// Limits on the speed of a vehicle.
struct Limits {
    /// Speed at which it can stop before the next crossing or the end of its lane.
    stop_mps: f64,
    /// Indices of the vehicles ahead, with the gap in meters.
    leaders: Vec<(usize, f64)>,
}
