//! Episodes that are made by hand: all vehicles move as told.

use decouplegs_scene::episode::{EpisodeHead, EpisodeTick, LOG_VERSION, PlannerRecord, RoadRecord};
use decouplegs_scene::scenario::{DriverKind, Drivers, EgoTask, Place, TrafficAgent};
use decouplegs_scene::{
    Egos, Episode, EpisodeEnd, EpisodeStep, Level, Plan, PlanPoint, RoadUser, Scenario,
    VehicleSize, VehicleState, Weather,
};
use glam::DVec2;

pub(crate) const SIZE: VehicleSize = VehicleSize::CAR;
const STEP_S: f64 = 0.5;
const SUBSTEPS: usize = 5;

/// Motion of a vehicle: its state at a moment, seconds.
pub(crate) type Motion<'a> = Box<dyn Fn(f64) -> VehicleState + 'a>;

pub(crate) fn state(x: f64, y: f64, yaw_rad: f64, speed_mps: f64) -> VehicleState {
    VehicleState {
        position_m: DVec2::new(x, y),
        yaw_rad,
        speed_mps,
        acceleration_mps2: 0.0,
    }
}

/// Motion straight on from `x`, `y` at the start.
pub(crate) fn straight<'a>(x: f64, y: f64, yaw_rad: f64, speed_mps: f64) -> Motion<'a> {
    Box::new(move |time_s| {
        let start = state(x, y, yaw_rad, speed_mps);
        VehicleState {
            position_m: start.position_m + start.velocity() * time_s,
            ..start
        }
    })
}

/// Motion along x from `x`, and from `y` to `to_y` between two moments.
pub(crate) fn aside<'a>(
    x: f64,
    speed_mps: f64,
    [y, to_y]: [f64; 2],
    [from_s, to_s]: [f64; 2],
) -> Motion<'a> {
    Box::new(move |time_s| {
        let (share, going) = (
            ((time_s - from_s) / (to_s - from_s)).clamp(0.0, 1.0),
            (from_s..to_s).contains(&time_s),
        );
        let across_mps = if going {
            (to_y - y) / (to_s - from_s)
        } else {
            0.0
        };
        state(
            x + speed_mps * time_s,
            y + share * (to_y - y),
            across_mps.atan2(speed_mps),
            speed_mps.hypot(across_mps),
        )
    })
}

fn scenario(agents: usize) -> Scenario {
    let agent = |at: usize| TrafficAgent {
        name: format!("agent {at}"),
        kind: RoadUser::Car,
        asset: 0,
        size: SIZE,
        lane: "lane".into(),
        at_m: 0.0,
        speed_mps: 0.0,
        driver: DriverKind::Normal,
        changes_lanes: false,
        cruise_mps: None,
        behaviors: vec![],
    };
    let ego = EgoTask {
        route: vec!["lane".into()],
        start_m: 0.0,
        end_m: 100.0,
        speed_mps: 10.0,
        cruise_mps: 10.0,
        size: SIZE,
        follows_recording: false,
        start_pose: None,
    };
    Scenario {
        name: "made".into(),
        level: Some(Level::Easy),
        seed: 0,
        drivers: Drivers::default(),
        duration_s: Scenario::DURATION_S,
        step_s: STEP_S,
        place: Place::Street {
            weather: Weather::Clear,
            background: 0,
            agent_splats: 0,
            seed: 0,
        },
        ego,
        egos: Egos::default(),
        agents: (0..agents).map(agent).collect(),
        lights: vec![],
        pedestrians: vec![],
        signs: vec![],
        story: Default::default(),
    }
}

/// Episode of `steps` steps, in which all vehicles move as told; the route leads 100 m along x.
pub(crate) fn episode(steps: usize, ego: &Motion, agents: &[Motion], end: EpisodeEnd) -> Episode {
    let instant = |time_s: f64| EpisodeTick {
        time_s,
        ego: ego(time_s),
        steer_rad: 0.0,
        on_road: true,
        lanes: None,
        road: Some(RoadRecord::default()),
        agents: agents.iter().map(|agent| Some(agent(time_s))).collect(),
    };
    let head = EpisodeHead {
        log_version: LOG_VERSION,
        version: "0".into(),
        scenario: scenario(agents.len()),
        planner: PlannerRecord::default(),
        drawn_by: None,
        route_m: vec![DVec2::ZERO, DVec2::new(100.0, 0.0)],
        agent_sizes: vec![SIZE; agents.len()],
        stop_lines: vec![],
        sign_lines: vec![],
        agent_driver: None,
    };
    let step = |step: usize| {
        let begin_s = step as f64 * STEP_S;
        let at = |time_s: f64| PlanPoint {
            time_s,
            position_m: ego(begin_s).to_local(ego(begin_s + time_s).position_m),
        };
        EpisodeStep {
            step: step as u32,
            readings: vec![],
            plan: Plan::new((1..=6).map(|point| at(0.5 * f64::from(point))).collect()).unwrap(),
            warm_up: false,
            instants: (1..=SUBSTEPS)
                .map(|sub| instant(begin_s + sub as f64 * STEP_S / SUBSTEPS as f64))
                .collect(),
            handovers: vec![],
            commands: Vec::new(),
            lights: Vec::new(),
        }
    };
    Episode {
        head,
        start: instant(0.0),
        steps: (0..steps).map(step).collect(),
        end,
        others: Vec::new(),
    }
}
