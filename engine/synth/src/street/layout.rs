//! Layout of the street: it runs along x and crosses another along y, with right-hand traffic.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::{Quat, Vec2, Vec3};

use super::random::Stream;

/// The detailed part of both streets ends this far from the origin, meters.
pub(super) const EXTENT_M: f32 = 100.0;
/// x of the crossing street's centerline, meters.
pub(super) const CROSSING_X_M: f32 = 40.0;
/// Width of a driving lane; two each way, meters.
pub(super) const LANE_M: f32 = 3.3;
/// Centerline to the outer edge of the driving lanes, meters.
pub(super) const LANES_HALF_M: f32 = 2.0 * LANE_M;
/// Centerline to kerb: two lanes and a parking lane, meters.
pub(super) const ROAD_HALF_M: f32 = 9.0;
/// Distance from the center of the intersection to the near edge of a stop line, meters.
pub(super) const STOP_LINE_M: f64 = 14.8;
/// Centerline to house fronts, meters.
pub(super) const FRONT_M: f32 = 13.0;
/// Height of the sidewalk over the asphalt, meters.
pub(super) const KERB_M: f32 = 0.14;
/// Depth of a lot, meters.
pub(super) const LOT_DEPTH_M: f32 = 14.0;
/// End of the coarse continuation of the streets, meters from the crossing or the origin.
pub(super) const FAR_M: f32 = 230.0;

/// A house: local x along the front, which is at y = 0 and faces -y; local z up from the sidewalk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lot {
    pub size: Vec3,
    pub corner: Vec2,
    pub yaw_rad: f32,
    /// True if each end (x = 0, x = width) stands free beside a street.
    pub free_ends: [bool; 2],
    /// True beyond the detailed extent.
    pub far: bool,
    pub seed: u64,
}

impl Lot {
    pub(super) fn rotation(&self) -> Quat {
        Quat::from_rotation_z(self.yaw_rad)
    }

    pub(super) fn translation(&self) -> Vec3 {
        self.corner.extend(0.0)
    }
}

/// A tree, a lamp or a parked car on its spot.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spot {
    pub position: Vec3,
    pub yaw_rad: f32,
    pub seed: u64,
}

/// Everything along the streets.
#[derive(Clone, Debug, Default)]
pub(super) struct Layout {
    pub lots: Vec<Lot>,
    pub trees: Vec<Spot>,
    /// Yaw points from the post to the road.
    pub lamps: Vec<Spot>,
    /// Yaw is the car's heading; z is the asphalt's.
    pub parked: Vec<Spot>,
}

/// One of the two streets, in coordinates s along it and t to its left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Axis {
    /// s = x, t = y.
    Main,
    /// s = y, t = crossing - x.
    Cross,
}

impl Axis {
    /// World x, y of a point of the street.
    pub(super) fn at(self, s: f32, t: f32) -> Vec2 {
        match self {
            Self::Main => Vec2::new(s, t),
            Self::Cross => Vec2::new(CROSSING_X_M - t, s),
        }
    }

    /// s of the other street's centerline.
    pub(super) fn crossing_s(self) -> f32 {
        match self {
            Self::Main => CROSSING_X_M,
            Self::Cross => 0.0,
        }
    }

    /// Heading of growing s.
    pub(super) fn yaw_rad(self) -> f32 {
        match self {
            Self::Main => 0.0,
            Self::Cross => FRAC_PI_2,
        }
    }

    /// The detailed stretches before and behind the crossing, which is `clear_m` wide on either
    /// side.
    pub(super) fn stretches(self, clear_m: f32) -> [(f32, f32); 2] {
        let crossing = self.crossing_s();
        [
            (-EXTENT_M, crossing - clear_m),
            (crossing + clear_m, EXTENT_M),
        ]
    }
}

impl Layout {
    pub(super) fn new(seed: u64) -> Self {
        let mut layout = Self::default();
        for axis in [Axis::Main, Axis::Cross] {
            let clear_m = if axis == Axis::Main {
                FRONT_M
            } else {
                FRONT_M + LOT_DEPTH_M
            };
            let crossing = axis.crossing_s();
            let stretches = axis.stretches(clear_m);
            for (number, (from, to)) in [
                stretches[0],
                stretches[1],
                (-FAR_M, -EXTENT_M),
                (EXTENT_M, FAR_M),
            ]
            .into_iter()
            .enumerate()
            {
                for side in [1.0f32, -1.0] {
                    let salt = number as u64 * 8
                        + u64::from(side > 0.0) * 4
                        + u64::from(axis == Axis::Main);
                    layout.row(
                        axis,
                        side,
                        (from, to),
                        (number > 1, crossing),
                        Stream::new(seed, 1 << 40, salt),
                    );
                }
            }
            layout.furnish(axis, seed);
        }
        layout
    }

    /// A row of houses on the left (`side` 1) or right (-1) of a street, from s `from` to `to`.
    fn row(
        &mut self,
        axis: Axis,
        side: f32,
        (from, to): (f32, f32),
        (far, crossing): (bool, f32),
        mut random: Stream,
    ) {
        let yaw_rad = axis.yaw_rad() + if side > 0.0 { 0.0 } else { PI };
        let mut s = from;
        let mut height_m = random.range(11.0, 18.0);
        while s < to - 1.0 {
            let mut width_m = random.range(10.0, 19.0);
            if to - s - width_m < 9.0 {
                width_m = to - s;
            }
            // Neighbors differ by a storey or three, rarely by a tower.
            height_m = (height_m + random.range(-5.0, 5.0)).clamp(9.5, 21.0)
                + if random.chance(0.06) { 6.0 } else { 0.0 };
            let first_m = if side > 0.0 { s } else { s + width_m };
            let at_crossing =
                |end: f32| axis == Axis::Main && (end - crossing).abs() < FRONT_M + 1.0;
            let (low, high) = (at_crossing(s), at_crossing(s + width_m));
            self.lots.push(Lot {
                size: Vec3::new(width_m, LOT_DEPTH_M, height_m),
                corner: axis.at(first_m, side * FRONT_M),
                yaw_rad,
                free_ends: if side > 0.0 { [low, high] } else { [high, low] },
                far,
                seed: random.bits(),
            });
            s += width_m;
        }
    }

    /// Trees, lamps and parked cars along both sides of a street.
    fn furnish(&mut self, axis: Axis, seed: u64) {
        for (stretch, (from, to)) in axis.stretches(ROAD_HALF_M + 8.0).into_iter().enumerate() {
            for side in [1.0f32, -1.0] {
                let salt =
                    stretch as u64 * 4 + u64::from(side > 0.0) * 2 + u64::from(axis == Axis::Main);
                let mut random = Stream::new(seed, 2 << 40, salt);
                let heading_rad = axis.yaw_rad() + if side > 0.0 { PI } else { 0.0 };
                let inward_rad = axis.yaw_rad() - side * FRAC_PI_2;
                let spot = |s: f32, t: f32, z: f32, yaw_rad: f32, random: &mut Stream| Spot {
                    position: axis.at(s, side * t).extend(z),
                    yaw_rad,
                    seed: random.bits(),
                };
                let mut s = from + random.range(0.0, 4.0);
                while s < to {
                    self.trees.push(spot(
                        s,
                        ROAD_HALF_M + 1.3,
                        KERB_M,
                        random.range(0.0, 6.0),
                        &mut random,
                    ));
                    s += random.range(10.0, 15.0);
                }
                let mut s = from + 6.0;
                while s < to {
                    self.lamps
                        .push(spot(s, ROAD_HALF_M + 0.5, KERB_M, inward_rad, &mut random));
                    s += 26.0;
                }
                let mut s = from + 3.0;
                while s < to - 3.0 {
                    if random.chance(0.66) {
                        let t = ROAD_HALF_M - 1.15 + random.range(-0.06, 0.06);
                        let skew_rad = 0.012 * random.normal();
                        self.parked
                            .push(spot(s, t, 0.0, heading_rad + skew_rad, &mut random));
                    }
                    s += random.range(6.0, 7.0);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn houses_keep_off_the_roads_and_face_them() {
        let layout = Layout::new(5);
        for lot in &layout.lots {
            for (x, y) in [
                (0.0, 0.0),
                (lot.size.x, 0.0),
                (0.0, lot.size.y),
                (lot.size.x, lot.size.y),
            ] {
                let corner = lot.rotation() * Vec3::new(x, y, 0.0) + lot.translation();
                let clear_main = corner.y.abs() > FRONT_M - 0.01;
                let clear_cross = (corner.x - CROSSING_X_M).abs() > FRONT_M - 0.01;
                assert!(clear_main && clear_cross, "{lot:?} reaches {corner}");
            }
            let middle = lot.rotation() * Vec3::new(0.5 * lot.size.x, 0.0, 0.0) + lot.translation();
            let front = lot.rotation() * Vec3::NEG_Y;
            let road = (middle + front * FRONT_M).truncate();
            assert!(
                road.y.abs() < 0.1 || (road.x - CROSSING_X_M).abs() < 0.1,
                "{lot:?} looks at {road}"
            );
        }
    }

    #[test]
    fn parked_cars_stand_in_the_parking_lane_in_driving_direction() {
        let layout = Layout::new(5);
        assert!(layout.parked.len() > 20);
        for spot in &layout.parked {
            let on_main = spot.position.y.abs() < ROAD_HALF_M;
            let t = if on_main {
                spot.position.y
            } else {
                CROSSING_X_M - spot.position.x
            };
            assert!(
                (LANES_HALF_M + 0.9..ROAD_HALF_M - 0.9).contains(&t.abs()),
                "{spot:?}"
            );
            let along = Quat::from_rotation_z(spot.yaw_rad) * Vec3::X;
            let s = if on_main { along.x } else { along.y };
            assert!(s * t < 0.0, "right-hand traffic: {spot:?}");
        }
    }
}
