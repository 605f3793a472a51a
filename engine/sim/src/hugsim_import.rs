//! Scenarios from files of HUGSIM, in a captured scene.
//!
//! The ego takes the lanes below the way on which the scene was recorded, as HUGSIM measures its
//! route. Others are actors of a story: straight on, along a recorded way, or after the ego. Those
//! of its driver model drive by ours, on the lane where they stand; without a lane they stand
//! there, as they do in HUGSIM.

use decouplegs_drive::LaneIndex;
use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::route::LaneSpot;
use decouplegs_logs::hugsim_scenario::{HugsimAgent, HugsimPlanner, HugsimScenario, HugsimState};
use decouplegs_scene::scenario::{DriverKind, EgoTask, Level, Place, TrafficAgent};
use decouplegs_scene::story::{Act, Action, Actor, Event, Limits, Priority, Task, Who};
use decouplegs_scene::{Invalid, RoadUser, Scenario, TimedPose, Trajectory, VehicleSize};
use glam::{DVec2, DVec3};

use crate::episode::Site;
use crate::names::scenario_name;
use crate::recorded::{lane_along, recorded_scenario};

/// Step of HUGSIM's simulation, seconds (`configs/sim/kinematic.yaml`), and its steps at most
/// (`closed_loop.py`).
const STEP_S: f64 = 0.25;
const STEPS_MAX: f64 = 400.0;
/// Interval of the poses that its attacks plan, seconds.
const PLAN_STEP_S: f64 = 0.1;
/// Distance from the middle of a lane within which a vehicle is on it, meters.
const ON_LANE_M: f64 = 3.0;
/// A lane that leads farther aside is not a vehicle's own, radians.
const ALONG_RAD: f64 = 0.8;
/// Difference of the ego's heading from its lane's above which a sentence says so, radians.
const TURNED_RAD: f64 = 0.1;

/// The scenario of `file` at `place`, made ready as `site`, and sentences on what differs from it.
/// `tracks` are the recorded vehicles of the scene by name.
///
/// # Errors
/// A sentence where the scene has no recorded way on lanes, or not the vehicle that is to drive as
/// it was recorded.
pub fn import_hugsim_scenario(
    file: &HugsimScenario,
    site: &Site,
    place: Place,
    tracks: &[(String, Trajectory)],
) -> Result<(Scenario, Vec<String>), Invalid> {
    let recorded = recorded_scenario(site, place)?;
    let mut import = Import {
        site,
        index: LaneIndex::new(&site.lanes),
        camera: first_camera(site),
        tracks,
        notes: Vec::new(),
        scenario: Scenario {
            name: scenario_name(&format!("{}-{}", file.scene, file.mode)),
            level: file.mode.split('_').next().and_then(Level::by_name),
            duration_s: STEP_S * STEPS_MAX,
            step_s: STEP_S,
            ..recorded
        },
    };
    import.start(&file.ego);
    for (index, agent) in file.agents.iter().enumerate() {
        import.add(index, agent, file.has_map)?;
    }
    let Import {
        mut scenario,
        notes,
        ..
    } = import;
    if !scenario.story.events.is_empty() {
        scenario.story.acts.push(Act::default());
    }
    Ok((scenario, notes))
}

/// Place of the front camera at the start of the recording, seen from above, and its heading.
fn first_camera(site: &Site) -> (DVec2, f64) {
    let ego = &site.loaded.ego;
    let rig = ego.at(ego.start_s());
    let cameras = || site.loaded.rig.cameras();
    let front = cameras().find(|camera| camera.name.to_lowercase().contains("front"));
    match front.or(cameras().next()) {
        Some(camera) => {
            let pose = rig.then(&camera.rig_from_camera);
            let ahead = (pose.rotation * DVec3::Z).truncate();
            (pose.translation.truncate(), ahead.to_angle())
        }
        None => {
            let ahead = (rig.rotation * DVec3::X).truncate();
            (rig.translation.truncate(), ahead.to_angle())
        }
    }
}

/// Action of a vehicle that goes `way` at `rate` times its speed, from the start on.
fn followed(way: &Trajectory, rate: f64) -> Action {
    let poses = way.poses().iter();
    let place = |timed: &TimedPose| timed.pose.translation.truncate().to_array();
    Action::Follow {
        points_m: poses.clone().map(place).collect(),
        seen_from: None,
        on_lanes: false,
        places: Vec::new(),
        times_s: poses
            .map(|timed| (timed.time_s - way.start_s()) / rate)
            .collect(),
        is_absolute: true,
    }
}

struct Import<'a> {
    site: &'a Site,
    index: LaneIndex,
    camera: (DVec2, f64),
    tracks: &'a [(String, Trajectory)],
    notes: Vec<String>,
    scenario: Scenario,
}

impl Import<'_> {
    /// Position in the world and heading of a vehicle.
    fn placed(&self, state: &HugsimState) -> (DVec2, f64) {
        let (camera_m, heading_rad) = self.camera;
        let seen_m = DVec2::new(state.ahead_m, -state.right_m);
        let at_m = camera_m + DVec2::from_angle(heading_rad).rotate(seen_m);
        (at_m, wrapped(heading_rad + state.yaw_rad))
    }

    /// The driving lane of a vehicle, and how far along it is.
    fn lane_at(&self, placed: (DVec2, f64)) -> Option<LaneSpot> {
        lane_along(
            &self.site.lanes,
            &self.index,
            placed,
            (ON_LANE_M, ALONG_RAD),
        )
    }

    /// Sets the ego where the file has it, on its route.
    fn start(&mut self, state: &HugsimState) {
        let placed = self.placed(state);
        let found = self.lane_at(placed).and_then(|LaneSpot { lane, at_m }| {
            let id = &self.site.lanes.lanes[lane].id;
            let on_route = self.scenario.ego.route.iter().position(|own| own == id)?;
            let is_last = on_route + 1 == self.scenario.ego.route.len();
            (!is_last || at_m < self.scenario.ego.end_m).then_some((on_route, at_m))
        });
        let task = &mut self.scenario.ego;
        *task = EgoTask {
            follows_recording: false,
            speed_mps: state.speed_mps.max(0.0),
            ..task.clone()
        };
        match found {
            Some((on_route, at_m)) => {
                task.route.drain(..on_route);
                task.start_m = at_m;
            }
            None => self.notes.push(
                "the ego starts where the recording starts: start_ab is not on its route".into(),
            ),
        }
        if state.yaw_rad.abs() > TURNED_RAD {
            let degrees = state.yaw_rad.to_degrees();
            self.notes.push(format!(
                "the ego starts along its lane: its heading of {degrees:.1} degrees is left out"
            ));
        }
    }

    /// Adds the vehicle `index` of the file.
    fn add(&mut self, index: usize, agent: &HugsimAgent, has_map: bool) -> Result<(), Invalid> {
        let name = format!("agent_{index}");
        let sizes = &self.site.asset_sizes;
        let size = sizes.get(index % sizes.len().max(1)).copied();
        let size = size.unwrap_or(VehicleSize::CAR);
        self.notes.push(format!(
            "{name}: the model {:?} is not there; a vehicle of the scene, {:.2} m long, stands for it",
            agent.model, size.length_m
        ));
        let (at_m, heading_rad) = self.placed(&agent.state);
        let mut actor = Actor {
            name: name.clone(),
            kind: RoadUser::Car,
            asset: index,
            size_m: [size.length_m, size.width_m, size.height_m],
            center_m: 0.0,
            point_m: at_m.to_array(),
            heading_rad,
            lane: None,
            speed_mps: agent.state.speed_mps,
            is_hidden: false,
            limits: Limits::default(),
        };
        let action = match &agent.planner {
            HugsimPlanner::Constant => None,
            HugsimPlanner::Attack { steps, every, best } => {
                let ahead_s = (PLAN_STEP_S * f64::from(*steps)).clamp(PLAN_STEP_S, 60.0);
                self.notes.push(format!(
                    "{name}: it drives its plans as they are timed; HUGSIM takes {STEP_S} s for each {PLAN_STEP_S} s of them"
                ));
                Some(Action::Attack {
                    ahead_s,
                    every_s: (STEP_S * f64::from(*every)).min(ahead_s),
                    best: *best,
                })
            }
            HugsimPlanner::Recorded { track, rate } => {
                let way = self.track(&name, track)?;
                let first = way.at(way.start_s());
                actor.point_m = first.translation.truncate().to_array();
                let ahead = (first.rotation * DVec3::X).truncate();
                actor.heading_rad = ahead.to_angle();
                Some(followed(way, *rate))
            }
            HugsimPlanner::Idm { speed_mps } => {
                let lane = self.lane_at((at_m, heading_rad)).filter(|_| has_map);
                if let Some(LaneSpot { lane, at_m: lane_m }) = lane {
                    self.scenario.agents.push(TrafficAgent {
                        name,
                        kind: RoadUser::Car,
                        asset: index,
                        size,
                        lane: self.site.lanes.lanes[lane].id.clone(),
                        at_m: lane_m,
                        speed_mps: agent.state.speed_mps.max(0.0),
                        cruise_mps: Some(speed_mps.max(1.0)),
                        driver: DriverKind::Normal,
                        changes_lanes: false,
                        behaviors: Vec::new(),
                    });
                    return Ok(());
                }
                actor.speed_mps = 0.0;
                self.notes
                    .push(format!("{name}: it stands, as no lane leads on from there"));
                None
            }
        };
        let story = &mut self.scenario.story;
        story.actors.push(actor);
        if let Some(action) = action {
            let of = Who(story.actors.len());
            story.events.push(Event {
                name,
                act: 0,
                maneuver: index,
                priority: Priority::Parallel,
                executions: 1,
                start: Vec::new(),
                actions: vec![Task { of, action }],
            });
        }
        Ok(())
    }

    /// The way of the recorded vehicle `track`.
    fn track(&self, name: &str, track: &str) -> Result<&Trajectory, Invalid> {
        let found = self.tracks.iter().find(|(own, _)| own.contains(track));
        let found = found.filter(|(_, way)| way.poses().len() > 1);
        found.map(|(_, way)| way).ok_or_else(|| {
            let names: Vec<&str> = self.tracks.iter().map(|(own, _)| own.as_str()).collect();
            Invalid::new(format!(
                "{name} is to drive as the recorded vehicle {track:?} did, which the scene does not have; it has {names:?}"
            ))
        })
    }
}
