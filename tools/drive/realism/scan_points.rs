//! Points of scans in the world: the ground, and what stands on it.

use std::collections::BTreeMap;
use std::ops::Range;

use decouplegs::drive::OrientedBox;
use decouplegs::drive::polyline::wrapped;
use decouplegs::scene::{Pose, Track};
use glam::{DVec2, DVec3};

use crate::lidar::scan_comparison::ScanComparison;

/// Side of the cells that points are found by, meters.
const CELL_M: f64 = 1.0;
/// Points nearer to the sensor are of its own vehicle, meters.
const OWN_VEHICLE_M: f64 = 2.7;
/// Points farther away are too few to tell the ground, meters.
const FAR_M: f64 = 40.0;
/// Radius of the plane through points of the ground, meters.
const PLANE_M: f64 = 1.0;
/// Points of a plane, at least.
const PLANE_POINTS: usize = 8;
/// Least spread of the points of a plane along its shorter axis, meters: one ring of a LiDAR tells
/// no slope across.
const SPREAD_M: f64 = 0.2;
/// Points farther from the plane through all are left out of the plane, meters.
const OFF_PLANE_M: f64 = 0.06;
/// Points of the ground from which the height below a thing is taken are this near, cells.
const BELOW_CELLS: i64 = 2;
/// Least height of points of things, meters.
const THING_M: f64 = 0.2;

/// A road user that comes no farther from its first place stands, meters.
const MOVES_M: f64 = 1.0;
/// Room around the boxes of those that move, meters: they move on while a scan is taken.
const AROUND_BOX_M: f64 = 0.4;
/// A track that ended or begins within this is still there, seconds.
const NEAR_S: f64 = 0.2;

type Key = (i64, i64);

/// Points of some scans, by cells.
#[derive(Default)]
pub struct ScanPoints {
    ground: BTreeMap<Key, Vec<DVec3>>,
    others: BTreeMap<Key, Vec<DVec3>>,
}

fn key(at: DVec2) -> Key {
    let cell = (at / CELL_M).floor();
    (cell.x as i64, cell.y as i64)
}

impl ScanPoints {
    /// Adds the points of a scan that was taken at `world_from_lidar`, but for those inside the
    /// boxes `moving`.
    pub fn add(&mut self, scan: &ScanComparison, world_from_lidar: &Pose, moving: &[OrientedBox]) {
        let wide: Vec<OrientedBox> = moving.iter().map(|one| one.widened(AROUND_BOX_M)).collect();
        for met in &scan.met {
            if !(OWN_VEHICLE_M..=FAR_M).contains(&met.real_m) {
                continue;
            }
            let at_m = world_from_lidar.transform(met.real_m * met.direction);
            if wide.iter().any(|one| one.contains(at_m.truncate())) {
                continue;
            }
            let points = match met.is_ground {
                true => &mut self.ground,
                false => &mut self.others,
            };
            points.entry(key(at_m.truncate())).or_default().push(at_m);
        }
    }

    /// Middles of the points of the ground, one per cell that has enough of them.
    pub fn ground_cells(&self) -> impl Iterator<Item = DVec2> + '_ {
        let middle = |points: &Vec<DVec3>| {
            let sum: DVec3 = points.iter().sum();
            (sum / points.len() as f64).truncate()
        };
        let known = self.ground.values();
        known.filter(|points| points.len() >= FEW).map(middle)
    }

    /// Points of the ground in the cell of `at`.
    pub fn ground_points_at(&self, at: DVec2) -> usize {
        self.ground.get(&key(at)).map_or(0, Vec::len)
    }

    /// Height of the ground at `at`, meters: of the plane through the points around; `None` where
    /// they are too few, or on a line.
    pub fn ground_at(&self, at: DVec2) -> Option<f64> {
        let near: Vec<DVec3> = around(&self.ground, at, 1)
            .filter(|point| point.truncate().distance(at) <= PLANE_M)
            .copied()
            .collect();
        let first = plane_through(&near, at)?;
        let on: Vec<DVec3> = near
            .into_iter()
            .filter(|point| (first.height_at(point.truncate()) - point.z).abs() <= OFF_PLANE_M)
            .collect();
        Some(plane_through(&on, at)?.height_m)
    }

    /// Cells with points of things whose heights above the ground around are within `heights_m`:
    /// the corner of each with the least coordinates, and the points.
    pub fn standing_cells(
        &self,
        heights_m: &Range<f64>,
    ) -> impl Iterator<Item = (DVec2, Vec<DVec3>)> {
        self.others.iter().map(move |(&(x, y), points)| {
            let corner = CELL_M * DVec2::new(x as f64, y as f64);
            let ground_m = self.ground_below(corner + 0.5 * CELL_M);
            let is_within = |point: &&DVec3| {
                ground_m.is_some_and(|ground_m| heights_m.contains(&(point.z - ground_m)))
            };
            (corner, points.iter().filter(is_within).copied().collect())
        })
    }

    /// Points of things near `at`, from above.
    pub fn standing_near(&self, at: DVec2, radius_m: f64) -> impl Iterator<Item = DVec2> + '_ {
        let ground_m = self.ground_below(at);
        let cells = (radius_m / CELL_M).ceil() as i64;
        around(&self.others, at, cells)
            .filter(move |point| ground_m.is_none_or(|ground_m| point.z - ground_m > THING_M))
            .map(|point| point.truncate())
    }

    /// Median height of the points of the ground around `at`: things hide what is below them.
    fn ground_below(&self, at: DVec2) -> Option<f64> {
        let near = around(&self.ground, at, BELOW_CELLS);
        let mut heights_m: Vec<f64> = near.map(|point| point.z).collect();
        heights_m.sort_by(f64::total_cmp);
        heights_m.get(heights_m.len() / 2).copied()
    }
}

/// Boxes at `time_s` of the tracks that move.
pub fn moving_boxes(tracks: &[Track], time_s: f64) -> Vec<OrientedBox> {
    let moves = |track: &&Track| {
        let first = track.points.first().map(|point| point.position_m);
        let apart_m = track.points.iter().zip(first.into_iter().cycle());
        apart_m
            .into_iter()
            .any(|(point, first)| point.position_m.distance(first) > MOVES_M)
    };
    let box_of = |track: &Track| {
        let [length_m, width_m, _] = track.dims_m?;
        let after = track.points.partition_point(|point| point.time_s < time_s);
        let ends = [after.saturating_sub(1), after.min(track.points.len() - 1)];
        let [from, to] = ends.map(|index| &track.points[index]);
        let beyond_s = (from.time_s - time_s).max(time_s - to.time_s);
        let share = (time_s - from.time_s) / (to.time_s - from.time_s).max(1e-9);
        let share = share.clamp(0.0, 1.0);
        let turned_rad = wrapped(to.yaw_rad? - from.yaw_rad?);
        (beyond_s <= NEAR_S).then_some(OrientedBox {
            center_m: from.position_m.lerp(to.position_m, share),
            yaw_rad: from.yaw_rad? + share * turned_rad,
            half_length_m: 0.5 * length_m,
            half_width_m: 0.5 * width_m,
        })
    };
    tracks.iter().filter(moves).filter_map(box_of).collect()
}

/// Points of the ground in a cell whose middle is examined, at least.
const FEW: usize = 4;

/// Points in the cell of `at` and those around it.
fn around(
    points: &BTreeMap<Key, Vec<DVec3>>,
    at: DVec2,
    cells: i64,
) -> impl Iterator<Item = &DVec3> {
    let (x, y) = key(at);
    let columns = x.saturating_sub(cells)..=x.saturating_add(cells);
    columns.flat_map(move |column| {
        let rows = (column, y.saturating_sub(cells))..=(column, y.saturating_add(cells));
        points.range(rows).flat_map(|(_, points)| points)
    })
}

/// A plane by its height at a place and its slopes from there.
struct Plane {
    at: DVec2,
    height_m: f64,
    slope: DVec2,
}

impl Plane {
    fn height_at(&self, at: DVec2) -> f64 {
        self.height_m + self.slope.dot(at - self.at)
    }
}

/// The least-squares plane through `points`; `None` where they are too few, or on a line.
fn plane_through(points: &[DVec3], at: DVec2) -> Option<Plane> {
    if points.len() < PLANE_POINTS {
        return None;
    }
    let count = points.len() as f64;
    let middle = points.iter().sum::<DVec3>() / count;
    let [mut xx, mut xy, mut yy, mut xz, mut yz] = [0.0; 5];
    for point in points {
        let apart = *point - middle;
        xx += apart.x * apart.x / count;
        xy += apart.x * apart.y / count;
        yy += apart.y * apart.y / count;
        xz += apart.x * apart.z / count;
        yz += apart.y * apart.z / count;
    }
    let determinant = xx * yy - xy * xy;
    let least = 0.5 * (xx + yy) - (0.25 * (xx - yy).powi(2) + xy * xy).sqrt();
    if least < SPREAD_M * SPREAD_M {
        return None;
    }
    let slope = DVec2::new(yy * xz - xy * yz, xx * yz - xy * xz) / determinant;
    Some(Plane {
        at,
        height_m: middle.z + slope.dot(at - middle.truncate()),
        slope,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lidar::scan_comparison::Met;
    use decouplegs::scene::TrackPoint;

    fn scan(points: &[(DVec3, bool)]) -> ScanComparison {
        let met = |&(point, is_ground): &(DVec3, bool)| Met {
            direction: point.normalize(),
            real_m: point.length(),
            rendered_m: None,
            is_ground,
        };
        ScanComparison {
            met: points.iter().map(met).collect(),
            empty: None,
        }
    }

    #[test]
    fn the_ground_of_scans_is_a_plane_and_things_stand_on_it() {
        // A road that rises by 4 % and falls by 2 % to the left, 1.7 m below the sensor.
        let road = |x: f64, y: f64| DVec3::new(x, y, -1.7 + 0.04 * x - 0.02 * y);
        let grid = (0..40).flat_map(|x| (-10..10).map(move |y| (x, y)));
        let grid = grid.map(|(x, y)| (0.5 * f64::from(x), 0.5 * f64::from(y)));
        let mut points: Vec<(DVec3, bool)> = grid.map(|(x, y)| (road(x, y), true)).collect();
        // A stone that is taken for ground, and a post.
        points.push((road(10.0, 0.25) + 0.2 * DVec3::Z, true));
        points.extend((0..20).map(|at| {
            let up_m = 0.1 * f64::from(at);
            (road(8.2, 3.2) + up_m * DVec3::Z, false)
        }));
        let mut scans = ScanPoints::default();
        let pose = Pose::from_yaw(0.0, DVec3::new(100.0, 0.0, 1.7));
        scans.add(&scan(&points), &pose, &[]);
        let height_m = scans.ground_at(DVec2::new(110.0, 0.3)).unwrap();
        assert!((height_m - (0.4 - 0.006)).abs() < 1e-9, "{height_m}");
        assert_eq!(scans.ground_at(DVec2::new(140.0, 0.0)), None);
        let standing = scans.standing_cells(&(0.4..1.9));
        let standing: Vec<_> = standing.filter(|(_, points)| !points.is_empty()).collect();
        assert_eq!(standing.len(), 1);
        assert_eq!(standing[0].0, DVec2::new(108.0, 3.0));
        assert!((14..=16).contains(&standing[0].1.len()));
        let near = scans.standing_near(DVec2::new(107.0, 3.0), 1.5);
        assert!(near.count() > 10);
        assert!(scans.ground_points_at(DVec2::new(110.4, 0.4)) >= 4);
        assert!(scans.ground_cells().count() > 150);
    }

    #[test]
    fn what_moves_is_left_out() {
        let point = |time_s: f64, x: f64| TrackPoint {
            time_s,
            position_m: DVec2::new(x, 3.0),
            z_m: None,
            yaw_rad: Some(0.0),
        };
        let track = |id: &str, end_m: f64| Track {
            id: id.into(),
            class: "car".into(),
            dims_m: Some([4.0, 2.0, 1.5]),
            points: vec![point(1.0, 10.0), point(2.0, end_m)],
        };
        let tracks = [track("moves", 16.0), track("stands", 10.2)];
        let boxes = moving_boxes(&tracks, 1.5);
        assert_eq!(boxes.len(), 1);
        assert!(boxes[0].center_m.distance(DVec2::new(13.0, 3.0)) < 1e-9);
        assert!(moving_boxes(&tracks, 0.7).is_empty() && moving_boxes(&tracks, 2.3).is_empty());
        assert_eq!(moving_boxes(&tracks, 2.1)[0].center_m.x, 16.0);
        // A point on its side, and one beyond.
        let points = [
            (DVec3::new(13.0, 4.2, 0.3), false),
            (DVec3::new(16.0, 3.0, 0.3), false),
        ];
        let mut scans = ScanPoints::default();
        scans.add(&scan(&points), &Pose::IDENTITY, &boxes);
        assert_eq!(scans.others.values().flatten().count(), 1);
    }

    #[test]
    fn points_on_a_line_are_no_plane() {
        let ring: Vec<DVec3> = (0..30)
            .map(|at| DVec3::new(6.0, 0.05 * f64::from(at), -1.7))
            .collect();
        assert!(plane_through(&ring, DVec2::new(6.0, 0.5)).is_none());
    }
}
