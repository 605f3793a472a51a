//! A lane along the way of a vehicle, for recordings without a map.

use decouplegs::scene::{Lane, LaneKind, LaneMap, Trajectory};
use glam::{DVec2, DVec3};

/// Distance between points of the lane, meters.
const STEP_M: f64 = 2.0;
/// Half of the width of the lane, meters.
const HALF_WIDTH_M: f64 = 1.75;
/// The lane goes straight on before and after the way for so long, meters: other vehicles need room
/// there, and the ego never leaves the views.
const BEFORE_M: f64 = 15.0;
const AFTER_M: f64 = 40.0;
/// A vehicle that moved by less stood, meters.
const WAY_M_MIN: f64 = 5.0;
/// Points before and after whose mean slope across is that of the lane.
const SWAY_POINTS: usize = 3;
/// Upward part of the vehicle's z axis, at least: a vehicle does not drive on a wall.
const UP_MIN: f64 = 0.5;
/// Limits are whole tens of km/h, and not lower than this.
const LIMIT_KMH_MIN: f64 = 30.0;

/// The lane below `way`, whose poses are `height_m` above the road; `None` where the vehicle stood.
pub fn along(way: &Trajectory, height_m: f64) -> Option<LaneMap> {
    let mut line: Vec<DVec3> = Vec::new();
    let mut ups: Vec<DVec3> = Vec::new();
    let mut fastest_mps: f64 = 0.0;
    for timed in way.poses() {
        let up = timed.pose.rotation * DVec3::Z;
        let road = timed.pose.translation - height_m * up;
        let is_far = line
            .last()
            .is_none_or(|last| last.truncate().distance(road.truncate()) >= STEP_M);
        if is_far {
            line.push(road);
            ups.push(up);
        }
        fastest_mps = fastest_mps.max(way.motion_at(timed.time_s).velocity_mps.length());
    }
    let (first, last) = (*line.first()?, *line.last()?);
    if line.len() < 2 || first.distance(last) < WAY_M_MIN {
        return None;
    }
    let places = line.len();
    let (line, before) = extended(&line);
    // The vehicle stands as the road falls across, and a world may be tilted. A body sways: over
    // some meters.
    let up_at = |at: usize| {
        let place = at.saturating_sub(before).min(places - 1);
        let near = place.saturating_sub(SWAY_POINTS)..(place + SWAY_POINTS + 1).min(places);
        ups[near].iter().sum::<DVec3>().normalize_or(DVec3::Z)
    };
    let beside = |side_m: f64| {
        let point = |at: usize| {
            let (from, to) = (
                line[at.saturating_sub(1)],
                line[(at + 1).min(line.len() - 1)],
            );
            let across = (to - from).truncate().normalize_or(DVec2::X).perp();
            let up = up_at(at);
            let rise = -across.dot(up.truncate()) / up.z.max(UP_MIN);
            line[at] + side_m * across.extend(rise)
        };
        (0..line.len()).map(point).collect()
    };
    let limit_kmh = (fastest_mps * 3.6 / 10.0).ceil() * 10.0;
    let lane = Lane {
        id: "way".into(),
        kind: LaneKind::Driving,
        left: beside(HALF_WIDTH_M),
        right: beside(-HALF_WIDTH_M),
        has_height: true,
        successors: Vec::new(),
        predecessors: Vec::new(),
        left_neighbor: None,
        right_neighbor: None,
        speed_limit_mps: Some(limit_kmh.max(LIMIT_KMH_MIN) / 3.6),
        centerline: line,
    };
    Some(LaneMap {
        lanes: vec![lane],
        ..LaneMap::default()
    })
}

/// `line` with straight ends, as steep as they are, and the number of points before it.
fn extended(line: &[DVec3]) -> (Vec<DVec3>, usize) {
    let on = |from: DVec3, to: DVec3, length_m: f64| {
        let step = (to - from) / (to - from).truncate().length().max(1e-9);
        let steps = (length_m / STEP_M).round() as u32;
        (1..=steps).map(move |index| to + f64::from(index) * STEP_M * step)
    };
    // Over several points: the slope between two neighbors is mostly noise.
    let reach = 3.min(line.len() - 1);
    let mut points: Vec<DVec3> = on(line[reach], line[0], BEFORE_M).collect();
    points.reverse();
    let before = points.len();
    points.extend_from_slice(line);
    let last = line.len() - 1;
    points.extend(on(line[last - reach], line[last], AFTER_M));
    (points, before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use decouplegs::scene::{Pose, TimedPose};
    use glam::DQuat;

    #[test]
    fn a_lane_lies_below_the_way_and_goes_on() {
        let pose = |step: u32| TimedPose {
            time_s: 0.1 * f64::from(step),
            pose: Pose::from_yaw(0.0, DVec3::new(f64::from(step), 1.0, 0.75)),
        };
        let way = Trajectory::new((0..=20).map(pose).collect()).unwrap();
        let map = along(&way, 0.75).unwrap();
        map.check().unwrap();
        let lane = &map.lanes[0];
        let (first, last) = (
            lane.centerline[0],
            lane.centerline[lane.centerline.len() - 1],
        );
        assert!((first.x + 16.0).abs() < 1.1 && (last.x - 60.0).abs() < 1.1);
        assert!(lane.centerline.iter().all(|point| point.z.abs() < 1e-12));
        assert!(lane.left.iter().all(|point| (point.y - 2.75).abs() < 1e-12));
        // 10 m/s are 36 km/h: the limit is 40.
        assert!((lane.speed_limit_mps.unwrap() - 40.0 / 3.6).abs() < 1e-9);
    }

    #[test]
    fn a_lane_falls_across_as_the_vehicle_does() {
        let pose = |step: u32| TimedPose {
            time_s: 0.1 * f64::from(step),
            pose: Pose::new(
                DQuat::from_rotation_z(1.0) * DQuat::from_rotation_x(0.07),
                DQuat::from_rotation_z(1.0) * DVec3::X * f64::from(step),
            ),
        };
        let way = Trajectory::new((0..=20).map(pose).collect()).unwrap();
        let lane = &along(&way, 0.0).unwrap().lanes[0];
        for (left, right) in lane.left.iter().zip(&lane.right) {
            let across = *left - *right;
            let rise = across.z / across.truncate().length();
            assert!((rise - 0.07_f64.tan()).abs() < 1e-9, "{rise}");
        }
    }

    #[test]
    fn a_vehicle_that_stood_has_no_lane() {
        let pose = |step: u32| TimedPose {
            time_s: f64::from(step),
            pose: Pose::from_yaw(0.0, DVec3::X * 0.1 * f64::from(step)),
        };
        let way = Trajectory::new((0..=20).map(pose).collect()).unwrap();
        assert!(along(&way, 0.75).is_none());
    }
}
