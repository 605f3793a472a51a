//! The scenario of a recorded drive: the ego takes the way that a scene was recorded on.

use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::route::{LaneSpot, lanes_between};
use decouplegs_drive::{LaneIndex, Route};
use decouplegs_scene::scenario::{Drivers, EgoTask, Place};
use decouplegs_scene::{
    Egos, Invalid, LaneKind, LaneMap, Scenario, Story, Trajectory, VehicleSize,
};
use glam::{DVec2, DVec3};

use crate::episode::Site;

/// Distance between places of the way whose lanes are looked for, meters.
pub(crate) const STRIDE_M: f64 = 5.0;
/// Distance from the middle of a lane within which a vehicle drives on it, meters.
const ON_LANE_M: f64 = 2.5;
/// A lane that leads farther aside than this is not the one that was driven on, radians.
const ALONG_RAD: f64 = 0.7;
/// Least cruise speed of a scenario, m/s.
const CRUISE_MPS_MIN: f64 = 1.0;

/// The scenario in which the ego takes the way that `place`, made ready as `site`, was recorded on,
/// pose by pose, among no other vehicles. Its route is that of the lanes below the way.
///
/// # Errors
/// A sentence where nothing was recorded, or no lane lies below the way.
pub fn recorded_scenario(site: &Site, place: Place) -> Result<Scenario, Invalid> {
    let way = site.recorded_way().ok_or(
        "nothing can be followed: expected [[ego]] poses with rising times in the scene file",
    )?;
    let duration_s = way.end_s() - way.start_s();
    let length_m: f64 = places(way)
        .windows(2)
        .map(|pair| pair[0].0.distance(pair[1].0))
        .sum();
    let size = site.loaded.recording.vehicle_size;
    let task = EgoTask {
        route: Vec::new(),
        start_m: 0.0,
        end_m: 0.0,
        speed_mps: way.motion_at(way.start_s()).velocity_mps.length(),
        cruise_mps: (length_m / duration_s).max(CRUISE_MPS_MIN),
        size: size.unwrap_or(VehicleSize::CAR),
        follows_recording: true,
        start_pose: None,
    };
    let ego = routed(&site.lanes, &places(way), &task).ok_or(
        "no route leads along the recorded way: expected driving lanes of the map within 2.5 m of its poses",
    )?;
    Ok(Scenario {
        name: "recording".into(),
        level: None,
        seed: 0,
        drivers: Drivers::default(),
        duration_s,
        step_s: Scenario::STEP_S,
        place,
        ego,
        egos: Egos::default(),
        agents: Vec::new(),
        pedestrians: Vec::new(),
        lights: Vec::new(),
        signs: Vec::new(),
        story: Story::default(),
    })
}

/// Places along the way with their headings, [`STRIDE_M`] apart and at both ends.
fn places(way: &Trajectory) -> Vec<(DVec3, f64)> {
    let mut places: Vec<(DVec3, f64)> = Vec::new();
    let last = way.poses().len() - 1;
    for (index, timed) in way.poses().iter().enumerate() {
        let at = timed.pose.translation;
        let is_far = places
            .last()
            .is_none_or(|(before, _)| before.distance(at) >= STRIDE_M);
        if is_far || index == last {
            let ahead = timed.pose.rotation * DVec3::X;
            places.push((at, ahead.truncate().to_angle()));
        }
    }
    places
}

/// The nearest driving lane within `within_m` of a place that leads no more than `along_rad` aside
/// of its heading.
pub(crate) fn lane_along(
    lanes: &LaneMap,
    index: &LaneIndex,
    (at_m, heading_rad): (DVec2, f64),
    (within_m, along_rad): (f64, f64),
) -> Option<LaneSpot> {
    let near = index.lanes_near(at_m, within_m);
    let along = near.into_iter().find(|point| {
        let is_driven = lanes.lanes[point.lane].kind == LaneKind::Driving;
        let line = index.line(point.lane);
        let lane_rad = line.map(|line| line.heading_at(point.foot.arc_m));
        is_driven && lane_rad.is_some_and(|rad| wrapped(rad - heading_rad).abs() <= along_rad)
    })?;
    Some(LaneSpot {
        lane: along.lane,
        at_m: along.foot.arc_m,
    })
}

/// `task` with the lanes of `map` below the way through `places`: over all of them, otherwise
/// between the first and the last.
pub(crate) fn routed(map: &LaneMap, places: &[(DVec3, f64)], task: &EgoTask) -> Option<EgoTask> {
    let index = LaneIndex::new(map);
    let spot_at = |&(at, yaw_rad): &(DVec3, f64)| {
        let place = (at.truncate(), yaw_rad);
        lane_along(map, &index, place, (ON_LANE_M, ALONG_RAD))
    };
    let spots: Vec<LaneSpot> = places.iter().filter_map(spot_at).collect();
    let (&first, &last) = (spots.first()?, spots.last()?);
    let ways = [spots.as_slice(), &[first, last]];
    ways.into_iter().find_map(|spots| {
        let mut lanes = vec![first.lane];
        for pair in spots.windows(2) {
            if pair[0].lane != pair[1].lane {
                lanes.extend(lanes_between(map, pair[0], pair[1])?.into_iter().skip(1));
            }
        }
        let id = |&lane: &usize| map.lanes[lane].id.clone();
        let task = EgoTask {
            route: lanes.iter().map(id).collect(),
            start_m: first.at_m,
            end_m: last.at_m,
            ..task.clone()
        };
        Route::new(map, &task).is_ok().then_some(task)
    })
}
