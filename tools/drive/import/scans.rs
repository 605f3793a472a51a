//! Ground and obstacles from the scans of a recording's LiDAR.

use std::collections::HashMap;
use std::f64::consts::TAU;
use std::path::PathBuf;

use anyhow::Result;
use decouplegs::asset::read_scan;
use decouplegs::asset::tracks::PoseRow;
use decouplegs::drive::OrientedBox;
use decouplegs::drive::scans::{GroundScanner, ObstacleScanner};
use decouplegs::scene::{Obstacle, Pose, Trajectory, VehicleSize};
use glam::DVec3;
use rayon::prelude::*;

use super::recording::Recording;
use crate::progress;

/// Scans that are read at once, on all threads.
const AT_ONCE: usize = 16;
/// Parts of a turn within which the vehicle moves evenly.
const PARTS: usize = 64;
/// A labeled road user that is never farther from where it was first, meters, stands.
const STANDS_M: f64 = 1.0;
/// Largest time between a scan and the labels that are used for it, seconds.
const LABEL_S: f64 = 0.06;
/// Most places of the road below the way, which follow each other at this distance, meters.
const ROAD_STEP_M: f64 = 0.5;

/// Scans of a LiDAR on the vehicle.
pub struct Scans {
    /// Times, seconds, and files, in order. A time is that of the beams straight ahead.
    pub files: Vec<(f64, PathBuf)>,
    pub rig_from_lidar: Pose,
    /// `None` where the points are corrected for the motion of the vehicle.
    pub turn: Option<Turn>,
}

/// A turn of a LiDAR, clockwise from behind, straight ahead at half of it.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    pub period_s: f64,
}

/// A scan in world coordinates.
struct WorldScan {
    time_s: f64,
    sensor_m: DVec3,
    points_m: Vec<DVec3>,
}

/// Findings of all scans.
pub struct Surveyed {
    /// Points of the ground, world coordinates, meters.
    pub ground_m: Vec<DVec3>,
    pub obstacles: Vec<Obstacle>,
    /// Number of scans during the recorded way.
    pub scans: usize,
    /// Median height of the middle of the vehicle above the ground below it, meters.
    pub middle_m: Option<f64>,
}

/// Ground and obstacles beside the way of `recording`; `None` where no scan shows ground below it.
///
/// # Errors
/// An error of a file that is no scan.
pub fn survey(recording: &Recording) -> Result<Option<Surveyed>> {
    let Some(scans) = &recording.scans else {
        return Ok(None);
    };
    let ego = &recording.ego;
    let files = scans.within(ego);
    if files.is_empty() {
        return Ok(None);
    }
    let road_m = road_below(ego, recording.ego_height_m);
    let mut grounds = GroundScanner::new(&road_m);
    scans.each(&files, ego, "ground of the scans", |scan| {
        grounds.add(scan.sensor_m, &scan.points_m);
    })?;
    let ground = grounds.ground();
    let ground_m = ground.points_m();
    if ground_m.is_empty() {
        return Ok(None);
    }
    let moving = moving(&recording.tracks);
    let mut obstacles = ObstacleScanner::new(&ground);
    scans.each(&files, ego, "obstacles of the scans", |scan| {
        obstacles.add(
            scan.time_s,
            scan.sensor_m,
            &scan.points_m,
            &boxes_at(&moving, scan.time_s),
        );
    })?;
    let driven: Vec<OrientedBox> = ego
        .poses()
        .iter()
        .map(|timed| outline(&timed.pose, &recording.vehicle))
        .collect();
    let obstacles = obstacles.obstacles(&driven);
    let mut heights_m: Vec<f64> = ego
        .poses()
        .iter()
        .filter_map(|timed| {
            let at = timed.pose.translation;
            Some(at.z - ground.height_at(at.truncate())?)
        })
        .collect();
    heights_m.sort_by(f64::total_cmp);
    Ok(Some(Surveyed {
        middle_m: heights_m.get(heights_m.len() / 2).copied(),
        scans: files.len(),
        ground_m,
        obstacles,
    }))
}

impl Scans {
    /// Files of scans that were taken, from their first to their last beam, on the way `ego`.
    fn within(&self, ego: &Trajectory) -> Vec<(f64, PathBuf)> {
        let half_s = self.turn.map_or(0.0, |turn| 0.5 * turn.period_s);
        let known = ego.start_s() + half_s..=ego.end_s() - half_s;
        let files = self
            .files
            .iter()
            .filter(|(time_s, _)| known.contains(time_s));
        files.cloned().collect()
    }

    /// Gives the scans in `files` to `take`, in their order.
    fn each(
        &self,
        files: &[(f64, PathBuf)],
        ego: &Trajectory,
        work: &'static str,
        mut take: impl FnMut(WorldScan),
    ) -> Result<()> {
        let bar = progress::bar(work, files.len());
        for some in files.chunks(AT_ONCE) {
            let read = some.par_iter().map(|(time_s, path)| {
                let points_m = read_scan(path)?.points_m;
                Ok(self.in_world(*time_s, &points_m, ego))
            });
            for scan in read.collect::<Result<Vec<WorldScan>>>()? {
                take(scan);
                bar.inc(1);
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// Points at the places where they were measured.
    fn in_world(&self, time_s: f64, points_m: &[DVec3], ego: &Trajectory) -> WorldScan {
        let at = |time_s: f64| ego.at(time_s).then(&self.rig_from_lidar);
        let period_s = self.turn.map_or(0.0, |turn| turn.period_s);
        let share = |part: usize| (part as f64 + 0.5) / PARTS as f64;
        let poses: Vec<Pose> = (0..PARTS)
            .map(|part| at(time_s + (share(part) - 0.5) * period_s))
            .collect();
        let place = |point: &DVec3| {
            // Clockwise from behind: a beam to the left comes before those ahead.
            let turned = 0.5 - point.y.atan2(point.x) / TAU;
            let part = ((turned * PARTS as f64) as usize).min(PARTS - 1);
            poses[part].transform(*point)
        };
        WorldScan {
            time_s,
            sensor_m: at(time_s).translation,
            points_m: points_m.iter().map(place).collect(),
        }
    }
}

/// Places of the road below the way `ego`, whose poses are `height_m` above it.
fn road_below(ego: &Trajectory, height_m: f64) -> Vec<DVec3> {
    let mut road_m: Vec<DVec3> = Vec::new();
    for timed in ego.poses() {
        let at = timed.pose.translation - height_m * (timed.pose.rotation * DVec3::Z);
        let Some(last) = road_m.last().copied() else {
            road_m.push(at);
            continue;
        };
        let steps = (last.distance(at) / ROAD_STEP_M).floor();
        let steps = steps.clamp(0.0, 1000.0) as u32;
        road_m.extend((1..=steps).map(|step| last.lerp(at, f64::from(step) / f64::from(steps))));
    }
    road_m
}

/// Labels of road users that move, by road user.
fn moving(tracks: &[PoseRow]) -> Vec<Vec<&PoseRow>> {
    let mut by_id: HashMap<&str, Vec<&PoseRow>> = HashMap::new();
    for row in tracks {
        by_id.entry(&row.id).or_default().push(row);
    }
    let moves = |rows: &Vec<&PoseRow>| {
        let first = rows[0].position;
        rows.iter()
            .any(|row| row.position.distance(first) > STANDS_M)
    };
    by_id.into_values().filter(moves).collect()
}

/// Outlines of road users at the labels nearest to `time_s`.
fn boxes_at(moving: &[Vec<&PoseRow>], time_s: f64) -> Vec<OrientedBox> {
    let off_s = |row: &&&PoseRow| (row.time_s - time_s).abs();
    let nearest = moving.iter().filter_map(|rows| {
        let nearest = rows.iter().min_by(|a, b| off_s(a).total_cmp(&off_s(b)))?;
        let dims_m = nearest.dims_m.filter(|_| off_s(&nearest) <= LABEL_S)?;
        let pose = Pose::new(nearest.rotation, nearest.position);
        Some(outline(&pose, &VehicleSize::from_array(dims_m)))
    });
    nearest.collect()
}

fn outline(middle: &Pose, size: &VehicleSize) -> OrientedBox {
    let ahead: DVec3 = middle.rotation * DVec3::X;
    OrientedBox {
        center_m: middle.translation.truncate(),
        yaw_rad: ahead.y.atan2(ahead.x),
        half_length_m: 0.5 * size.length_m,
        half_width_m: 0.5 * size.width_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::TimedPose;
    use glam::DQuat;

    #[test]
    fn points_are_put_where_the_vehicle_was() {
        // 10 m/s along x: 1 m in a turn of 0.1 s.
        let poses = (0..=10).map(|step| TimedPose {
            time_s: 0.1 * f64::from(step),
            pose: Pose::new(DQuat::IDENTITY, DVec3::X * f64::from(step)),
        });
        let ego = Trajectory::new(poses.collect()).unwrap();
        let scans = Scans {
            files: vec![(0.0, "a".into()), (0.5, "b".into()), (1.0, "c".into())],
            rig_from_lidar: Pose::new(DQuat::IDENTITY, DVec3::Z),
            turn: Some(Turn { period_s: 0.1 }),
        };
        // The first and the last were begun or ended outside of the way.
        assert_eq!(scans.within(&ego), [(0.5, PathBuf::from("b"))]);
        let points = [
            DVec3::new(20.0, 0.0, 0.0),
            DVec3::new(0.0, 20.0, 0.0),
            DVec3::new(0.0, -20.0, 0.0),
            DVec3::new(-20.0, 0.1, 0.0),
        ];
        let scan = scans.in_world(0.5, &points, &ego);
        assert_eq!(scan.sensor_m, DVec3::new(5.0, 0.0, 1.0));
        // Ahead at 0.5 s, left a quarter of a turn before, right a quarter after.
        for (found, x_m) in scan.points_m.iter().zip([25.0, 4.75, 5.25, -15.5]) {
            assert!((found.x - x_m).abs() < 0.02 && found.z == 1.0, "{found}");
        }
        let standing = Scans {
            turn: None,
            ..scans
        };
        assert_eq!(standing.within(&ego).len(), 3);
        assert_eq!(standing.in_world(0.5, &points, &ego).points_m[1].x, 5.0);
    }

    #[test]
    fn what_moves_is_told_from_what_stands_by_its_labels() {
        let row = |id: &str, time_s: f64, x_m: f64| PoseRow {
            id: id.into(),
            class: "car".into(),
            time_s,
            position: DVec3::X * x_m,
            rotation: DQuat::IDENTITY,
            dims_m: Some([4.0, 2.0, 1.5]),
            note: String::new(),
        };
        let tracks = [
            row("moves", 0.0, 0.0),
            row("moves", 0.1, 1.5),
            row("stands", 0.0, 9.0),
            row("stands", 0.1, 9.1),
        ];
        let moving = moving(&tracks);
        assert_eq!(moving.len(), 1);
        let boxes = boxes_at(&moving, 0.09);
        assert_eq!(boxes[0].center_m.x, 1.5);
        assert_eq!((boxes[0].half_length_m, boxes[0].half_width_m), (2.0, 1.0));
        assert!(boxes_at(&moving, 0.3).is_empty());
    }
}
