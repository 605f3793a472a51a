//! Obstacles from scans: what stands on the ground and was not seen to leave.

use std::collections::HashMap;

use decouplegs_scene::{Obstacle, ObstacleKind};
use glam::{DVec2, DVec3, IVec2};

use super::{OWN_M, ScannedGround, cell_of, middle_of};
use crate::oriented_box::OrientedBox;

/// Side of the squares that a box is made of, in cells: as large as those of obstacles from splats.
const BOX_CELLS: i32 = 4;
/// Largest distance of obstacles from the way, meters.
const BESIDE_M: f64 = 15.0;
/// Heights above the ground at which points count, meters: above kerbs and grass, below crowns and
/// signs.
const HEIGHTS_M: std::ops::Range<f64> = 0.4..1.9;
/// Largest height of points that show the ground of a cell, meters.
const GROUND_M: f64 = 0.12;
/// Fewest points of something.
const POINTS_MIN: u32 = 4;
/// Fewest scans that must have seen something, where there are three times as many.
const SCANS_MIN: u32 = 3;
/// Ratio of scans that saw the ground of a cell to those that saw something in it, from which on
/// that has left.
const LEFT: u32 = 3;
/// Time for which anything that stands is seen, seconds, and as a share of the time of all scans. A
/// vehicle that drives behind the LiDAR, where nothing is labeled, is gone before.
const SEEN_S_MIN: f64 = 1.2;
const SEEN_SHARE: f64 = 0.3;
/// Margin around boxes of what moves, meters.
const MARGIN_M: f64 = 0.4;

/// Observations of one cell.
#[derive(Clone, Copy, Debug, Default)]
struct Cell {
    points: u32,
    /// Scans with points of something, and with points of its ground.
    seen: u32,
    free: u32,
    /// Last scan that was counted in each, from one.
    last_seen: u32,
    last_free: u32,
    /// Times of the first and the last scan with points of something, seconds.
    seen_s: [f64; 2],
}

/// Gathers obstacles beside a recorded way from scans.
#[derive(Clone, Debug)]
pub struct ObstacleScanner<'a> {
    ground: &'a ScannedGround,
    cells: HashMap<IVec2, Cell>,
    scans: u32,
    /// Times of the first and the last scan, seconds.
    span_s: [f64; 2],
}

impl<'a> ObstacleScanner<'a> {
    /// A scanner of what stands on `ground`.
    #[must_use]
    pub fn new(ground: &'a ScannedGround) -> Self {
        Self {
            ground,
            cells: HashMap::new(),
            scans: 0,
            span_s: [f64::INFINITY, f64::NEG_INFINITY],
        }
    }

    /// Adds `points_m` that were measured from `sensor_m` about `time_s`, all in world coordinates,
    /// meters. Points within the boxes `moving`, what moves at that time, do not count.
    pub fn add(
        &mut self,
        time_s: f64,
        sensor_m: DVec3,
        points_m: &[DVec3],
        moving: &[OrientedBox],
    ) {
        self.scans += 1;
        self.span_s = [self.span_s[0].min(time_s), self.span_s[1].max(time_s)];
        let wide: Vec<OrientedBox> = moving.iter().map(|one| one.widened(MARGIN_M)).collect();
        for point in points_m.iter().filter(|point| point.is_finite()) {
            let at = point.truncate();
            let near = self.ground.way.nearest(at);
            if near.is_none_or(|road| road.truncate().distance(at) > BESIDE_M)
                || point.distance(sensor_m) < OWN_M
                || wide.iter().any(|one| one.contains(at))
            {
                continue;
            }
            let Some(ground_m) = self.ground.height_at(at) else {
                continue;
            };
            let above_m = point.z - ground_m;
            let cell = self.cells.entry(cell_of(at)).or_default();
            if above_m.abs() <= GROUND_M && cell.last_free != self.scans {
                (cell.free, cell.last_free) = (cell.free + 1, self.scans);
            } else if HEIGHTS_M.contains(&above_m) {
                cell.points += 1;
                if cell.last_seen != self.scans {
                    let first_s = if cell.seen == 0 {
                        time_s
                    } else {
                        cell.seen_s[0]
                    };
                    cell.seen_s = [first_s, time_s];
                    (cell.seen, cell.last_seen) = (cell.seen + 1, self.scans);
                }
            }
        }
    }

    /// Boxes of at most a meter of all that stood and is not touched by `driven`, the boxes of the
    /// vehicle on its way. Their order is always the same.
    #[must_use]
    pub fn obstacles(self, driven: &[OrientedBox]) -> Vec<Obstacle> {
        let scans_min = SCANS_MIN.min(self.scans.div_ceil(3)).max(1);
        let seen_s_min = SEEN_S_MIN.min(SEEN_SHARE * (self.span_s[1] - self.span_s[0]).max(0.0));
        let stands = |cell: &Cell| {
            cell.points >= POINTS_MIN
                && cell.seen >= scans_min
                && cell.free < LEFT * cell.seen
                && cell.seen_s[1] - cell.seen_s[0] >= seen_s_min
        };
        let mut boxes: HashMap<IVec2, [DVec2; 2]> = HashMap::new();
        for (cell, _) in self.cells.iter().filter(|(_, cell)| stands(cell)) {
            let middle = middle_of(*cell);
            let half = 0.5 * super::CELL_M;
            let key = cell.div_euclid(IVec2::splat(BOX_CELLS));
            let [low, high] = boxes
                .entry(key)
                .or_insert([DVec2::INFINITY, DVec2::NEG_INFINITY]);
            *low = low.min(middle - half);
            *high = high.max(middle + half);
        }
        let mut boxes: Vec<(IVec2, [DVec2; 2])> = boxes.into_iter().collect();
        boxes.sort_unstable_by_key(|(key, _)| key.to_array());
        let obstacles = boxes.into_iter().map(|(_, [low, high])| Obstacle {
            kind: ObstacleKind::Captured,
            center_m: 0.5 * (low + high),
            yaw_rad: 0.0,
            length_m: high.x - low.x,
            width_m: high.y - low.y,
        });
        obstacles
            .filter(|one| {
                let outline = crate::obstacles::outline(one);
                !driven.iter().any(|way| way.overlaps(&outline))
            })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::GroundScanner;
    use super::*;

    const SENSOR_M: DVec3 = DVec3::new(0.0, 0.0, 50.0);

    /// Flat ground around a way along x.
    fn ground() -> (ScannedGround, Vec<DVec3>) {
        let road: Vec<DVec3> = (0..30).map(|x| DVec3::X * f64::from(x)).collect();
        let points: Vec<DVec3> = (0..300)
            .flat_map(|x| (-80..80).map(move |y| (x, y)))
            .map(|(x, y)| DVec3::new(0.1 * f64::from(x), 0.1 * f64::from(y), 0.0))
            .collect();
        let mut scanner = GroundScanner::new(&road);
        scanner.add(SENSOR_M, &points);
        (scanner.ground(), points)
    }

    /// Points of a post of 0.2 m at `at`.
    fn post(at: [f64; 2]) -> Vec<DVec3> {
        (0..20)
            .map(|z| DVec3::new(at[0] + 0.01 * f64::from(z), at[1], 0.1 * f64::from(z)))
            .collect()
    }

    #[test]
    fn what_stands_is_found_and_what_left_or_moves_is_not() {
        let (ground, flat) = ground();
        let mut scanner = ObstacleScanner::new(&ground);
        let moving = OrientedBox {
            center_m: DVec2::new(20.0, 4.0),
            yaw_rad: 0.0,
            half_length_m: 1.0,
            half_width_m: 1.0,
        };
        for scan in 0..12 {
            let mut points = flat.clone();
            points.extend(post([10.1, 3.1])); // stands
            points.extend(post([10.1, -0.4])); // on the way itself
            points.extend(post([20.3, 4.2])); // labeled as moving
            if scan < 2 {
                points.extend(post([15.1, 3.1])); // left
            }
            // Drove by, where the ground was not seen.
            points.retain(|point| point.truncate().distance(DVec2::new(22.0, -4.0)) > 1.0);
            if (3..6).contains(&scan) {
                points.extend(post([22.1, -3.9]));
            }
            points.push(DVec3::new(25.1, 3.1, 1.0)); // one point a scan is none of four
            points.extend((0..40).map(|at| DVec3::new(5.0, 4.0, 2.0 + 0.1 * f64::from(at))));
            scanner.add(0.2 * f64::from(scan), SENSOR_M, &points, &[moving]);
        }
        let driven = OrientedBox {
            center_m: DVec2::new(10.0, 0.0),
            yaw_rad: 0.0,
            half_length_m: 2.4,
            half_width_m: 0.9,
        };
        let found = scanner.clone().obstacles(&[driven]);
        let places: Vec<[i64; 2]> = found
            .iter()
            .map(|one| one.center_m.floor().as_i64vec2().to_array())
            .collect();
        assert_eq!(places, [[10, 3], [25, 3]], "{found:?}");
        assert!(
            found[0].length_m <= 0.51 && found[0].width_m <= 0.26,
            "{:?}",
            found[0]
        );
        // Without the way it stood on, the post on the way counts too.
        assert_eq!(scanner.obstacles(&[]).len(), 3);
    }

    #[test]
    fn few_scans_are_enough_where_there_are_no_more() {
        let (ground, flat) = ground();
        let mut scanner = ObstacleScanner::new(&ground);
        scanner.add(0.0, SENSOR_M, &[flat, post([10.1, 3.1])].concat(), &[]);
        assert_eq!(scanner.obstacles(&[]).len(), 1);
    }
}
