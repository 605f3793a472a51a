//! Small roads on which planners drive the real ego among agents that go their way whatever it
//! does.

use decouplegs::drive::{Ego, EgoOptions, OrientedBox, Polyline};
use decouplegs::planner::{
    EgoMotion, EpisodeInfo, KnownAgent, Navigation, Observation, Planner, Privileged,
};
use decouplegs::scene::{RoadUser, VehicleSize, VehicleState};
use glam::DVec2;

/// Interval between plans, seconds, and the parts of it in which the ego moves.
const STEP_S: f64 = 0.5;
const SUBSTEPS: u32 = 5;

/// Record of a drive.
pub struct Course {
    pub route_m: Vec<DVec2>,
    pub start_mps: f64,
    pub cruise_mps: f64,
    pub steps: u32,
}

/// The ego among the others at the end of a sub-step.
pub struct Moment {
    pub ego: VehicleState,
    pub lateral_mps2: f64,
    /// Distance to the nearest agent, 0 where they overlap, infinite where there is none.
    pub gap_m: f64,
    /// Distance from the route.
    pub off_m: f64,
    /// Position along the route, meters.
    pub arc_m: f64,
}

pub fn state(position_m: DVec2, yaw_rad: f64, speed_mps: f64) -> VehicleState {
    VehicleState {
        position_m,
        yaw_rad,
        speed_mps,
        acceleration_mps2: 0.0,
    }
}

/// A straight road along x of `length_m`.
pub fn straight(length_m: f64) -> Vec<DVec2> {
    vec![DVec2::ZERO, DVec2::new(length_m, 0.0)]
}

/// 60 m along x, a quarter of a circle to the left with `radius_m`, and 100 m along y.
pub fn bend(radius_m: f64) -> Vec<DVec2> {
    let middle = DVec2::new(60.0, radius_m);
    let arc = (0..=30).map(|at| {
        middle
            + DVec2::from_angle((f64::from(at) / 30.0 - 1.0) * std::f64::consts::FRAC_PI_2)
                * radius_m
    });
    let end = DVec2::new(60.0 + radius_m, radius_m + 100.0);
    std::iter::once(DVec2::ZERO)
        .chain(arc)
        .chain([end])
        .collect()
}

impl Course {
    pub fn new(route_m: Vec<DVec2>, start_mps: f64, cruise_mps: f64, duration_s: f64) -> Self {
        Self {
            route_m,
            start_mps,
            cruise_mps,
            steps: (duration_s / STEP_S) as u32,
        }
    }

    /// Drives it with `planner` among `agents`, which are told for each time in seconds.
    pub fn drive(
        &self,
        planner: &mut dyn Planner,
        agents: impl Fn(f64) -> Vec<(VehicleState, VehicleSize)>,
    ) -> Vec<Moment> {
        let line = Polyline::new(self.route_m.iter().map(|place| place.extend(0.0))).unwrap();
        let begin = state(self.route_m[0], line.heading_at(0.0), self.start_mps);
        let mut ego = Ego::new(begin, VehicleSize::CAR, EgoOptions::default());
        let briefing = EpisodeInfo {
            scenario: "course".into(),
            seed: 1,
            step_s: STEP_S,
            ego_size: VehicleSize::CAR,
            rear_axle_to_middle_m: 1.35,
            sensors: vec![],
        };
        planner.begin(&briefing).unwrap();
        let mut moments = Vec::new();
        for step in 0..self.steps {
            let time_s = STEP_S * f64::from(step);
            let plan = planner
                .plan(&self.observation(step, &ego, &self.known(&ego, agents(time_s))))
                .unwrap();
            ego.follow(&plan);
            for substep in 1..=SUBSTEPS {
                ego.step(STEP_S / f64::from(SUBSTEPS));
                let now_s = time_s + STEP_S * f64::from(substep) / f64::from(SUBSTEPS);
                moments.push(moment(&ego, &line, &agents(now_s)));
            }
        }
        moments
    }

    fn known(&self, ego: &Ego, agents: Vec<(VehicleState, VehicleSize)>) -> Privileged {
        Privileged {
            ego: ego.state(),
            ego_size: VehicleSize::CAR,
            route_m: self.route_m.clone(),
            agents: agents
                .into_iter()
                .map(|(state, size)| KnownAgent {
                    kind: RoadUser::Car,
                    state,
                    size,
                })
                .collect(),
            stop_lines: vec![],
            signs: vec![],
        }
    }

    fn observation<'a>(&self, step: u32, ego: &Ego, known: &'a Privileged) -> Observation<'a> {
        let motion = EgoMotion {
            speed_mps: ego.state().speed_mps,
            ..EgoMotion::default()
        };
        let guidance = Navigation {
            cruise_mps: self.cruise_mps,
            ..Navigation::default()
        };
        let time_s = STEP_S * f64::from(step);
        Observation {
            step,
            time_s,
            readings: &[],
            ego: motion,
            guidance,
            localization: None,
            privileged: Some(known),
        }
    }
}

fn moment(ego: &Ego, line: &Polyline, agents: &[(VehicleState, VehicleSize)]) -> Moment {
    let outline = OrientedBox::for_vehicle(&ego.state(), &VehicleSize::CAR);
    let gaps = agents
        .iter()
        .map(|(agent, size)| outline.distance_m(&OrientedBox::for_vehicle(agent, size)));
    let foot = line.project(ego.state().position_m);
    Moment {
        ego: ego.state(),
        lateral_mps2: ego.lateral_acceleration_mps2().abs(),
        gap_m: gaps.fold(f64::INFINITY, f64::min),
        off_m: foot.distance_m,
        arc_m: foot.arc_m,
    }
}

/// Smallest distance to any agent, meters.
pub fn nearest_m(moments: &[Moment]) -> f64 {
    moments
        .iter()
        .map(|moment| moment.gap_m)
        .fold(f64::INFINITY, f64::min)
}

/// The moment at the end.
pub fn last(moments: &[Moment]) -> &Moment {
    moments.last().expect("a course has steps")
}
