//! Scenarios from recorded tracks: the ego starts as one of the recorded vehicles did, and all
//! others follow their tracks until they are handed over to the driver model.

use decouplegs_asset::tracks::nominal_height_m;
use decouplegs_drive::polyline::wrapped;
use decouplegs_scene::scenario::{Drivers, EgoTask, Place};
use decouplegs_scene::story::{Handover, Story, TrackedAgent, Tracks};
use decouplegs_scene::{Egos, Invalid, LaneMap, RoadUser, Scenario, Track, VehicleSize};
use glam::{DVec2, DVec3};

use crate::names::{UniqueNames, scenario_name};
use crate::recorded::{STRIDE_M, routed};

/// Shortest way of a vehicle whose place the ego takes, meters.
const EGO_WAY_M: f64 = 10.0;
/// Least cruise speed of a scenario, m/s.
const CRUISE_MPS_MIN: f64 = 1.0;
/// Longest scenario, seconds.
const DURATION_S_MAX: f64 = 3600.0;
/// Movement from which a heading is told where a track has none, meters.
const HEADING_M: f64 = 0.5;

/// Scenario of recorded tracks.
#[derive(Clone, Debug)]
pub struct TrackScenario {
    /// Scenario with all other road users on their tracks.
    pub scenario: Scenario,
    /// Id of the track whose vehicle the ego is.
    pub ego: String,
    /// Sentences on what was left out.
    pub notes: Vec<String>,
}

/// The scenario `name` in which the ego starts at `place`, whose lanes are `lanes`, with the pose,
/// speed and route of the vehicle of the track `ego`, at its first moment. `None`: of the vehicle
/// on lanes that has the longest way.
///
/// # Errors
/// A sentence where there is no such track, or no route on driving lanes leads along it.
pub fn import_tracks(
    tracks: &[Track],
    lanes: &LaneMap,
    place: Place,
    name: &str,
    (ego, handover): (Option<&str>, Handover),
) -> Result<TrackScenario, Invalid> {
    let (ego, task) = match ego {
        Some(id) => {
            let track = tracks.iter().find(|track| track.id == id);
            let track = track.ok_or_else(|| unknown_track(id, tracks))?;
            (track, ego_task(track, lanes)?)
        }
        None => longest(tracks, lanes)?,
    };
    let from_s = ego.points[0].time_s;
    let mut names = UniqueNames::default();
    let mut notes = Vec::new();
    let mut agents = Vec::new();
    let mut end_s = ego.points[ego.points.len() - 1].time_s;
    for track in tracks.iter().filter(|track| track.id != ego.id) {
        let last_s = track.points[track.points.len() - 1].time_s;
        if last_s < from_s {
            continue;
        }
        end_s = end_s.max(last_s);
        match tracked_agent(track, from_s, agents.len()) {
            Some(agent) => agents.push(TrackedAgent {
                name: names.give(scenario_name(&track.id)),
                ..agent
            }),
            None => notes.push(format!(
                "track {} is left out: there is no road user like '{}' here",
                track.id, track.class
            )),
        }
    }
    let scenario = Scenario {
        name: scenario_name(&format!("{name}-{}", ego.id)),
        level: None,
        seed: 0,
        drivers: Drivers::default(),
        duration_s: rounded(end_s - from_s).min(DURATION_S_MAX),
        step_s: Scenario::STEP_S,
        place,
        ego: task,
        egos: Egos::default(),
        agents: Vec::new(),
        pedestrians: Vec::new(),
        lights: Vec::new(),
        signs: Vec::new(),
        story: Story {
            tracks: Tracks { handover, agents },
            ..Story::default()
        },
    };
    Ok(TrackScenario {
        scenario,
        ego: ego.id.clone(),
        notes,
    })
}

fn unknown_track(id: &str, tracks: &[Track]) -> Invalid {
    let some: Vec<&str> = tracks
        .iter()
        .take(8)
        .map(|track| track.id.as_str())
        .collect();
    Invalid::new(format!(
        "there is no track '{id}'; of {} tracks the first are {}",
        tracks.len(),
        some.join(", ")
    ))
}

/// The vehicle with the longest way among those on driving lanes, and its task.
fn longest<'a>(tracks: &'a [Track], lanes: &LaneMap) -> Result<(&'a Track, EgoTask), Invalid> {
    let mut vehicles: Vec<(f64, &Track)> = tracks
        .iter()
        .filter(|track| kind_of(&track.class).is_some_and(is_driven))
        .map(|track| (way_m(track), track))
        .collect();
    vehicles.sort_by(|a, b| b.0.total_cmp(&a.0));
    let found = vehicles
        .iter()
        .find_map(|(_, track)| Some((*track, ego_task(track, lanes).ok()?)));
    found.ok_or_else(|| {
        let reason = "no track is that of a vehicle on driving lanes of the map for 10 m or more: expected tracks in the coordinates of the map";
        reason.into()
    })
}

fn is_driven(kind: RoadUser) -> bool {
    matches!(kind, RoadUser::Car | RoadUser::Truck | RoadUser::Bus)
}

/// Task of an ego that starts as the vehicle of `track`.
fn ego_task(track: &Track, lanes: &LaneMap) -> Result<EgoTask, Invalid> {
    let poses = poses(track);
    let way_m = way_m(track);
    if way_m < EGO_WAY_M {
        return Err(Invalid::new(format!(
            "track {} is {way_m:.1} m long; expected {EGO_WAY_M} m or more where the ego is to drive",
            track.id
        )));
    }
    let speeds_mps = speeds_mps(track);
    let task = EgoTask {
        route: Vec::new(),
        start_m: 0.0,
        end_m: 0.0,
        speed_mps: speeds_mps[0],
        cruise_mps: speeds_mps.iter().copied().fold(CRUISE_MPS_MIN, f64::max),
        size: size_of(track),
        follows_recording: false,
        start_pose: Some(poses[0]),
    };
    let mut places: Vec<(DVec3, f64)> = Vec::new();
    for (index, [x_m, y_m, yaw_rad]) in poses.iter().enumerate() {
        let at = DVec3::new(*x_m, *y_m, 0.0);
        let is_far = places
            .last()
            .is_none_or(|(before, _)| before.distance(at) >= STRIDE_M);
        if is_far || index + 1 == poses.len() {
            places.push((at, *yaw_rad));
        }
    }
    routed(lanes, &places, &task).ok_or_else(|| {
        Invalid::new(format!(
            "no route leads along track {}: expected driving lanes of the map within 2.5 m of it",
            track.id
        ))
    })
}

/// Meters from the first to the last point, over those in between.
fn way_m(track: &Track) -> f64 {
    let pairs = track.points.windows(2);
    pairs
        .map(|pair| pair[0].position_m.distance(pair[1].position_m))
        .sum()
}

/// Speeds at the points, m/s.
fn speeds_mps(track: &Track) -> Vec<f64> {
    let last = track.points.len() - 1;
    let speed = |at: usize| {
        let (from, to) = (
            &track.points[at.saturating_sub(1)],
            &track.points[(at + 1).min(last)],
        );
        let passed_s = to.time_s - from.time_s;
        let way_m = to.position_m.distance(from.position_m);
        if passed_s > 0.0 {
            way_m / passed_s
        } else {
            0.0
        }
    };
    (0..=last).map(speed).collect()
}

/// Road user of a track whose times count from `from_s`, with the asset `asset`; `None` where no
/// kind of road user is like its class. Its name is the id of the track.
#[must_use]
pub fn tracked_agent(track: &Track, from_s: f64, asset: usize) -> Option<TrackedAgent> {
    let kind = kind_of(&track.class)?;
    // Those before the start are kept as far as they tell the motion at it.
    let begun = track.points.partition_point(|point| point.time_s <= from_s);
    let first = begun.saturating_sub(2);
    let times = track.points[first..].iter();
    Some(TrackedAgent {
        name: scenario_name(&track.id),
        kind,
        asset,
        size_m: size_of(track).to_array(),
        times_s: times.map(|point| rounded(point.time_s - from_s)).collect(),
        poses: poses(track).split_off(first),
    })
}

/// Time without what a difference of decimal numbers adds, seconds.
fn rounded(time_s: f64) -> f64 {
    (time_s * 1e9).round() / 1e9
}

/// Kind of road user that is like a class of a file.
fn kind_of(class: &str) -> Option<RoadUser> {
    match class {
        "car" | "van" | "taxi" | "vehicle" | "priorityvehicle" | "parkedvehicle" | "unknown" => {
            Some(RoadUser::Car)
        }
        "truck" | "trailer" | "construction" => Some(RoadUser::Truck),
        "bus" => Some(RoadUser::Bus),
        "bicycle" | "cyclist" | "motorcycle" | "motorcyclist" | "riderless_bicycle" => {
            Some(RoadUser::Cyclist)
        }
        "pedestrian" | "person" | "human" => Some(RoadUser::Pedestrian),
        _ => None,
    }
}

/// Size of the box: the one that the file tells, or that of its kind.
fn size_of(track: &Track) -> VehicleSize {
    if let Some(dims_m) = track.dims_m {
        return VehicleSize::from_array(dims_m);
    }
    let sized = |length_m: f64, width_m: f64| VehicleSize {
        length_m,
        width_m,
        height_m: nominal_height_m(&track.class),
    };
    match kind_of(&track.class) {
        Some(RoadUser::Truck) => sized(8.0, 2.4),
        Some(RoadUser::Bus) => sized(12.0, 2.5),
        Some(RoadUser::Cyclist) => sized(1.8, 0.6),
        Some(RoadUser::Pedestrian) => VehicleSize::PEDESTRIAN,
        _ => VehicleSize::CAR,
    }
}

/// Poses of a track. Headings that the file does not tell are those of the motion.
fn poses(track: &Track) -> Vec<[f64; 3]> {
    let places: Vec<DVec2> = track.points.iter().map(|point| point.position_m).collect();
    let mut last_rad = None;
    let mut poses = Vec::with_capacity(places.len());
    for (at, point) in track.points.iter().enumerate() {
        let moved = || {
            let far = |to: &&DVec2| to.distance(places[at]) >= HEADING_M;
            let ahead = places[at..].iter().find(far).map(|to| *to - places[at]);
            ahead.map(DVec2::to_angle)
        };
        let yaw_rad = point.yaw_rad.or_else(moved).or(last_rad).unwrap_or(0.0);
        last_rad = Some(yaw_rad);
        poses.push([places[at].x, places[at].y, wrapped(yaw_rad)]);
    }
    poses
}

#[cfg(test)]
mod tests {
    use decouplegs_scene::{Lane, TrackPoint};

    use super::*;
    use decouplegs_scene::Air;

    /// A straight lane of 200 m to the east.
    fn road() -> LaneMap {
        let lane = Lane {
            id: "a".into(),
            centerline: vec![DVec3::ZERO, DVec3::new(200.0, 0.0, 0.0)],
            ..Lane::default()
        };
        LaneMap {
            lanes: vec![lane],
            ..LaneMap::default()
        }
    }

    /// A track from `x_m` on at 10 m/s, a tenth of a second apart, for 5 s from `from_s` on.
    fn track(id: &str, class: &str, x_m: f64, from_s: f64) -> Track {
        let points = (0..=50).map(|step| TrackPoint {
            time_s: from_s + 0.1 * f64::from(step),
            position_m: DVec2::new(x_m + f64::from(step), 0.5),
            z_m: None,
            yaw_rad: None,
        });
        Track {
            id: id.into(),
            class: class.into(),
            dims_m: None,
            points: points.collect(),
        }
    }

    fn place() -> Place {
        Place::Roads {
            map: "road.xml".into(),
            probe: None,
            exposure_ev: 0.0,
            air: Air::default(),
            obstacles: None,
            background: 1,
            agent_splats: 1,
        }
    }

    #[test]
    fn the_ego_starts_as_its_track_does_and_others_keep_theirs() {
        let tracks = [
            track("1", "car", 10.0, 2.0),
            track("2", "truck", 40.0, 1.0),
            track("3", "train", 80.0, 1.0),
        ];
        let chosen = (Some("1"), Handover::Near);
        let found = import_tracks(&tracks, &road(), place(), "us 101", chosen).unwrap();
        let scenario = &found.scenario;
        assert_eq!(
            (scenario.name.as_str(), found.ego.as_str()),
            ("us_101-1", "1")
        );
        assert_eq!(scenario.ego.start_pose, Some([10.0, 0.5, 0.0]));
        assert_eq!(scenario.ego.route, ["a"]);
        assert_eq!((scenario.ego.start_m, scenario.ego.end_m), (10.0, 60.0));
        assert!((scenario.ego.speed_mps - 10.0).abs() < 1e-9);
        assert!((scenario.duration_s - 5.0).abs() < 1e-12);
        let [other] = scenario.story.tracks.agents.as_slice() else {
            panic!("{:?}", scenario.story.tracks);
        };
        assert_eq!((other.kind, other.name.as_str()), (RoadUser::Truck, "2"));
        let now = other.times_s.iter().position(|time_s| *time_s == 0.0);
        assert_eq!(other.poses[now.unwrap()], [50.0, 0.5, 0.0]);
        assert!(found.notes[0].contains("'train'"), "{:?}", found.notes);
    }

    #[test]
    fn an_ego_without_a_track_on_the_lanes_is_refused() {
        let mut far = track("1", "car", 10.0, 0.0);
        for point in &mut far.points {
            point.position_m.y += 100.0;
        }
        let reason = |ego: Option<&str>| {
            let chosen = (ego, Handover::Near);
            let found = import_tracks(std::slice::from_ref(&far), &road(), place(), "a", chosen);
            String::from(found.unwrap_err())
        };
        assert!(reason(Some("7")).contains("no track '7'"));
        assert!(reason(Some("1")).contains("no route leads along track 1"));
        assert!(reason(None).contains("coordinates of the map"));
    }
}
