//! Road users of generated scenarios: the mix of vehicles, and pedestrians who cross the route.

use std::sync::Arc;

use decouplegs_scene::scenario::Trigger;
use decouplegs_scene::{Pedestrian, RoadUser, VehicleSize};
use glam::DVec2;

use super::ego_start::EgoStart;
use super::random::Stream;
use super::roads::Roads;
use super::rules::LevelRequirements;
use super::{to_centimeter, to_tenth};
use crate::obstacles::Obstacles;
use crate::oriented_box::OrientedBox;

/// Shares of vehicles on lanes: cars, trucks, buses, cyclists.
const SHARES: [(RoadUser, f64); 4] = [
    (RoadUser::Car, 0.72),
    (RoadUser::Truck, 0.09),
    (RoadUser::Bus, 0.05),
    (RoadUser::Cyclist, 0.14),
];
/// Least distance ahead of the ego's start at which pedestrians cross the route, meters: the ego
/// can stop.
const AHEAD_M: f64 = 30.0;
/// Distance of a waiting pedestrian from the road, meters.
const BESIDE_M: f64 = 1.2;
/// Wider roads are not crossed, meters from the route to the edge.
const EDGE_M_MAX: f64 = 18.0;
/// The edge of the road is looked for in steps of this, meters.
const STRIDE_M: f64 = 0.25;
/// Distance between two pedestrians at the start, meters.
const APART_M: f64 = 4.0;
/// Walking speeds, m/s (most people on crossings: 1.0 to 1.8).
const WALK_MPS: (f64, f64) = (1.0, 1.8);
/// Distance of the ego at which pedestrians who wait for a gap set out, meters.
const SETS_OUT_M: (f64, f64) = (25.0, 60.0);
/// Expected reaction and braking of the ego for pedestrians who step out, seconds and m/s^2, and
/// room that is left.
const REACTION_S: f64 = 1.0;
const BRAKING_MPS2: f64 = 4.0;
const ROOM_M: (f64, f64) = (6.0, 12.0);
/// Number of places that are tried per pedestrian.
const DRAWS: usize = 24;

/// Asset that agents may show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoadUserAsset {
    /// Kind of road user.
    pub kind: RoadUser,
    /// Index among the assets of its kind.
    pub asset: usize,
    /// Size of the box.
    pub size: VehicleSize,
}

/// Assets of a place, of all kinds that its scenarios have.
pub(super) struct Assets {
    all: Vec<RoadUserAsset>,
    obstacles: Arc<Obstacles>,
}

impl Assets {
    /// Assets of cars alone.
    pub fn cars(sizes: &[VehicleSize]) -> Self {
        let kind = RoadUser::Car;
        let cars = sizes.iter().enumerate();
        Self {
            all: cars
                .map(|(asset, &size)| RoadUserAsset { kind, asset, size })
                .collect(),
            obstacles: Arc::default(),
        }
    }

    /// Adds `others`, among `obstacles`.
    pub fn mixed(&mut self, others: &[RoadUserAsset], obstacles: Arc<Obstacles>) {
        self.all.extend_from_slice(others);
        self.obstacles = obstacles;
    }

    /// Boxes of vehicles on lanes.
    pub fn vehicle_sizes(&self) -> impl Iterator<Item = VehicleSize> {
        let on_lanes = |asset: &&RoadUserAsset| asset.kind != RoadUser::Pedestrian;
        self.all.iter().filter(on_lanes).map(|asset| asset.size)
    }

    /// True if there are kinds of vehicles but cars.
    pub fn are_mixed(&self) -> bool {
        let mut others = RoadUser::ON_LANES[1..].iter();
        others.any(|&kind| !self.of_kind(kind).is_empty())
    }

    fn of_kind(&self, kind: RoadUser) -> Vec<RoadUserAsset> {
        let same = self.all.iter().filter(|asset| asset.kind == kind);
        same.copied().collect()
    }

    /// Draws a car at random.
    pub fn draw_car(&self, random: &mut Stream) -> RoadUserAsset {
        self.draw_of(RoadUser::Car, random)
    }

    fn draw_of(&self, kind: RoadUser, random: &mut Stream) -> RoadUserAsset {
        let assets = self.of_kind(kind);
        assets[random.whole((0, assets.len() - 1))]
    }

    /// A vehicle on lanes; `fast` leaves out cyclists.
    pub fn draw(&self, fast: bool, random: &mut Stream) -> RoadUserAsset {
        // Without other kinds no number is drawn: scenarios with cars alone stay what they were.
        if !self.are_mixed() {
            return self.draw_car(random);
        }
        let slow = |kind| fast && kind == RoadUser::Cyclist;
        let fits = |kind| !self.of_kind(kind).is_empty() && !slow(kind);
        let shares = || SHARES.into_iter().filter(|&(kind, _)| fits(kind));
        let mut rest = random.unit() * shares().map(|(_, share)| share).sum::<f64>();
        let drawn = shares().find(|(_, share)| {
            rest -= share;
            rest < 0.0
        });
        self.draw_of(drawn.map_or(RoadUser::Car, |(kind, _)| kind), random)
    }

    /// Pedestrians who cross the route; none where the place has none.
    pub fn pedestrians(
        &self,
        roads: &Roads,
        rules: &LevelRequirements,
        start: &EgoStart,
        random: &mut Stream,
    ) -> Vec<Pedestrian> {
        let assets = self.of_kind(RoadUser::Pedestrian);
        if assets.is_empty() {
            return Vec::new();
        }
        let wanted = random.whole(rules.pedestrians);
        let mut walkers: Vec<Pedestrian> = Vec::new();
        for _ in 0..wanted * DRAWS {
            if walkers.len() == wanted {
                break;
            }
            let asset = assets[random.whole((0, assets.len() - 1))];
            let Some(path_m) = self.path(roads, start, asset.size, random) else {
                continue;
            };
            let is_apart = |other: &Pedestrian| other.path_m[0].distance(path_m[0]) > APART_M;
            if !walkers.iter().all(is_apart) {
                continue;
            }
            let number = walkers.len();
            let waits_for_gap = number >= rules.stepping_out;
            let cruise_mps = start.task.cruise_mps;
            let distance_m = if waits_for_gap {
                random.between(SETS_OUT_M)
            } else {
                cruise_mps * REACTION_S
                    + cruise_mps * cruise_mps / (2.0 * BRAKING_MPS2)
                    + random.between(ROOM_M)
            };
            walkers.push(Pedestrian {
                name: format!("pedestrian_{:02}", number + 1),
                asset: asset.asset,
                size: asset.size,
                path_m,
                speed_mps: to_tenth(random.between(WALK_MPS)),
                start: Trigger::NearEgo {
                    distance_m: distance_m.round(),
                },
                waits_for_gap,
            });
        }
        walkers
    }

    /// A straight path over the road, at a right angle to the route.
    fn path(
        &self,
        roads: &Roads,
        start: &EgoStart,
        size: VehicleSize,
        random: &mut Stream,
    ) -> Option<Vec<DVec2>> {
        let last_m = start.route.length_m() - 5.0;
        let at_m = AHEAD_M + random.unit() * (last_m - AHEAD_M).max(0.0);
        let (position, yaw_rad) = start.route.pose_at(at_m.min(last_m));
        let (middle_m, left) = (position.truncate(), DVec2::from_angle(yaw_rad).perp());
        let side = if random.chance(0.5) { 1.0 } else { -1.0 };
        let edge = |toward: DVec2| {
            let strides = (1..).map(|stride| f64::from(stride) * STRIDE_M);
            let mut off_m = strides.take_while(|&off_m| off_m <= EDGE_M_MAX);
            // Off the road with a step of room, so not in a gap between two lanes.
            off_m.find(|&off_m| {
                (0..6).all(|more| {
                    let at_m = middle_m + toward * (off_m + f64::from(more) * STRIDE_M);
                    !roads.surface.contains(at_m)
                })
            })
        };
        let (from, to) = (left * side, left * -side);
        let ends = [from, to].map(|toward| {
            let end_m = middle_m + toward * (edge(toward)? + BESIDE_M);
            Some(DVec2::new(to_centimeter(end_m.x), to_centimeter(end_m.y)))
        });
        let [Some(from_m), Some(to_m)] = ends else {
            return None;
        };
        let way = OrientedBox {
            center_m: 0.5 * (from_m + to_m),
            yaw_rad: (to_m - from_m).to_angle(),
            half_length_m: 0.5 * (from_m.distance(to_m) + size.length_m),
            half_width_m: 0.5 * size.width_m,
        };
        self.obstacles
            .touched(&way)
            .is_none()
            .then(|| vec![from_m, to_m])
    }
}
