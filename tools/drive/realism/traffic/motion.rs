//! Recorded motion in parts, and simulations of each part from its beginning.

use decouplegs::drive::{LanePoint, Traffic, TrafficError};
use decouplegs::planner::PlannerError;
use decouplegs::planner::agents::{AgentDriver, AgentsInfo, AgentsObservation};
use decouplegs::scene::scenario::{DriverKind, TrafficAgent};
use decouplegs::scene::story::{Handover, TrackedAgent, Tracks};
use decouplegs::scene::{Drivers, Invalid, RoadUser, Story, Track, TrackPoint, VehicleSize};
use decouplegs::track_import::tracked_agent;
use glam::DVec2;

use super::roads::Roads;

/// Time between moments, seconds, as in the challenge whose measure this is.
pub const STEP_S: f64 = 0.1;
/// Shortest part, seconds.
const PART_S_MIN: f64 = 1.0;
/// Time over which top speeds are measured, seconds, and the speed from which a vehicle moves, m/s.
const SPEED_S: f64 = 0.5;
const MOVES_MPS: f64 = 1.0;

/// Model of traffic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Model {
    /// Drivers on the lanes of the map: the traffic of generated scenarios. Who cannot start there
    /// drives on the recorded line.
    Lanes,
    /// Drivers on their recorded lines, handed over at the start.
    Tracks,
    /// Constant velocity of all, for comparison.
    Constant,
    /// A driver of agents, which drives all vehicles from the start.
    Agents,
}

impl Model {
    /// Models of this program.
    pub const OWN: [Self; 3] = [Self::Lanes, Self::Tracks, Self::Constant];

    /// Name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lanes => "lanes",
            Self::Tracks => "tracks",
            Self::Constant => "constant velocity",
            Self::Agents => "agents",
        }
    }
}

/// Position and heading.
pub type Place = (DVec2, f64);

/// Motion of road users: boxes, and their places by road user and moment, [`STEP_S`] apart; `None`
/// while one is not there.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    pub sizes: Vec<VehicleSize>,
    pub places: Vec<Vec<Option<Place>>>,
    /// Time of the recording at the first moment, seconds.
    pub start_s: f64,
}

/// All tracks of a file.
#[derive(Clone, Copy)]
pub struct Recording<'a> {
    tracks: &'a [Track],
    /// Time before which nothing is compared, seconds.
    from_s: f64,
}

/// A part of a recording.
pub struct Part {
    pub motion: Motion,
    /// Vehicles that are compared, on lanes at the beginning: indices in the motion.
    pub vehicles: Vec<usize>,
    /// Lanes of all at the beginning, and speeds, m/s.
    lanes: Vec<Option<LanePoint>>,
    speeds_mps: Vec<f64>,
    agents: Vec<TrackedAgent>,
}

/// Simulations of a part: motions of those of the part, and who could be placed.
pub struct Simulated {
    pub motions: Vec<Motion>,
    pub placed: Vec<usize>,
}

impl<'a> Recording<'a> {
    pub fn new(tracks: &'a [Track]) -> Self {
        Self {
            tracks,
            from_s: f64::NEG_INFINITY,
        }
    }

    /// Times of the first and of the last moment, seconds.
    pub fn span_s(&self) -> (f64, f64) {
        let times = self.tracks.iter().flat_map(|track| &track.points);
        let span = (f64::INFINITY, f64::NEG_INFINITY);
        times.fold(span, |(first_s, last_s), point| {
            (first_s.min(point.time_s), last_s.max(point.time_s))
        })
    }

    /// The second half of the recording, and the median of the top speeds of vehicles in the first
    /// half, m/s; `None` where none moves there. Speeds are those over [`SPEED_S`].
    pub fn halved(self) -> Option<(Self, f64)> {
        let (first_s, last_s) = self.span_s();
        let from_s = first_s + 0.5 * (last_s - first_s);
        let top_mps = |track: &Track| {
            let points = &track.points[..track.points.partition_point(|one| one.time_s <= from_s)];
            let speed = |(at, point): (usize, &TrackPoint)| {
                let later = points[at..]
                    .iter()
                    .find(|one| one.time_s >= point.time_s + SPEED_S)?;
                let way_m = point.position_m.distance(later.position_m);
                Some(way_m / (later.time_s - point.time_s))
            };
            points
                .iter()
                .enumerate()
                .filter_map(speed)
                .max_by(f64::total_cmp)
        };
        let tops = self.tracks.iter().filter_map(top_mps);
        let mut tops: Vec<f64> = tops.filter(|top_mps| *top_mps > MOVES_MPS).collect();
        tops.sort_by(f64::total_cmp);
        let median_mps = tops.get(tops.len() / 2)?;
        Some((Self { from_s, ..self }, *median_mps))
    }

    /// Beginnings of parts of `part_s` seconds, the last of which may be shorter.
    pub fn starts_s(&self, part_s: f64) -> Vec<f64> {
        let (first_s, last_s) = self.span_s();
        let first_s = first_s.max(self.from_s);
        let parts = ((last_s - first_s - PART_S_MIN) / part_s + 1e-9).floor();
        if parts < 0.0 || !parts.is_finite() {
            return Vec::new();
        }
        (0..=parts.min(1e4) as u32)
            .map(|part| first_s + f64::from(part) * part_s)
            .collect()
    }

    /// The part of `part_s` seconds from `start_s` on.
    pub fn part(&self, roads: &Roads, start_s: f64, part_s: f64) -> Part {
        let last_s = |track: &Track| track.points.last().map_or(start_s, |point| point.time_s);
        let there = self.tracks.iter().filter(|track| last_s(track) > start_s);
        let agents: Vec<TrackedAgent> = there
            .enumerate()
            .filter_map(|(at, track)| tracked_agent(track, start_s, at))
            .collect();
        let steps = (part_s / STEP_S).round() as usize + 1;
        let places: Vec<Vec<Option<Place>>> = agents
            .iter()
            .map(|agent| (0..steps).map(|step| place_at(agent, step)).collect())
            .collect();
        let lanes: Vec<Option<LanePoint>> = places
            .iter()
            .map(|places| places[0].and_then(|(at_m, yaw_rad)| roads.lane_at(at_m, yaw_rad)))
            .collect();
        let is_driven = |kind: RoadUser| !matches!(kind, RoadUser::Pedestrian | RoadUser::Cyclist);
        let vehicles = (0..agents.len())
            .filter(|&at| is_driven(agents[at].kind) && lanes[at].is_some())
            .collect();
        let speed =
            |places: &Vec<Option<Place>>| match (places[0], places.get(1).copied().flatten()) {
                (Some((from_m, _)), Some((to_m, _))) => from_m.distance(to_m) / STEP_S,
                _ => 0.0,
            };
        Part {
            speeds_mps: places.iter().map(speed).collect(),
            motion: Motion {
                sizes: agents.iter().map(TrackedAgent::size).collect(),
                places,
                start_s,
            },
            vehicles,
            lanes,
            agents,
        }
    }
}

/// A failure of a driver of agents.
fn failed(error: PlannerError) -> Invalid {
    Invalid::new(error.to_string())
}

/// Place of an agent at a moment, between poses of its track interpolated.
fn place_at(agent: &TrackedAgent, step: usize) -> Option<Place> {
    let time_s = step as f64 * STEP_S;
    let next = agent.times_s.partition_point(|&at_s| at_s < time_s - 1e-6);
    let (to_s, [x, y, yaw_rad]) = (*agent.times_s.get(next)?, *agent.poses.get(next)?);
    if to_s <= time_s + 1e-6 {
        return Some((DVec2::new(x, y), yaw_rad));
    }
    let before = next.checked_sub(1)?;
    let (from_s, from) = (agent.times_s[before], agent.poses[before]);
    let share = (time_s - from_s) / (to_s - from_s);
    let turn = decouplegs::drive::polyline::wrapped(yaw_rad - from[2]);
    let at_m = DVec2::new(from[0], from[1]).lerp(DVec2::new(x, y), share);
    Some((at_m, from[2] + share * turn))
}

impl Part {
    /// Number of moments.
    fn steps(&self) -> usize {
        self.motion.places.first().map_or(0, Vec::len)
    }

    /// Simulations by a model of this program. `chance` is their number, where chance plays a part,
    /// the seed of the first, and the source of drivers.
    ///
    /// # Errors
    /// A sentence where the traffic cannot be made.
    pub fn simulated(
        &self,
        roads: &Roads,
        model: Model,
        chance: (u32, u64, Drivers),
    ) -> Result<Simulated, Invalid> {
        match model {
            Model::Lanes => self.on_lanes(roads, chance),
            Model::Tracks => self.on_tracks(roads, chance),
            Model::Constant | Model::Agents => Ok(Simulated {
                motions: vec![self.straight_on()],
                placed: self.vehicles.clone(),
            }),
        }
    }

    /// Simulations by a driver of agents, which is told the recorded lines of all vehicles as their
    /// ways. `chance` is as in [`Part::simulated`].
    ///
    /// # Errors
    /// A sentence where the traffic cannot be made, or the driver fails.
    pub fn commanded(
        &self,
        roads: &Roads,
        driver: &mut dyn AgentDriver,
        (rollouts, seed, drivers): (u32, u64, Drivers),
    ) -> Result<Simulated, Invalid> {
        let all: Vec<usize> = (0..self.agents.len()).collect();
        let story = self.story(&all);
        let mut info = self.told(roads);
        let mut motions = Vec::new();
        for rollout in 0..rollouts {
            info.seed = seed + u64::from(rollout);
            let mut traffic = Traffic::new(roads.graph.clone(), &[], info.seed)
                .map_err(|error| Invalid::new(error.to_string()))?
                .with_drivers(drivers, &[])
                .with_story(&story, &roads.map)?;
            driver.begin(&info).map_err(failed)?;
            let command = |traffic: &mut Traffic, step: usize| {
                let observation = self.observed(roads, traffic, step);
                let commands = driver.commands(&observation).map_err(failed)?;
                traffic.steer(&commands)
            };
            motions.push(self.run_commanded(&mut traffic, &all, command)?);
        }
        Ok(Simulated {
            motions,
            placed: self.vehicles.clone(),
        })
    }

    /// Shows a driver of agents what was recorded, moment by moment. Nobody takes its commands. The
    /// number of moments.
    ///
    /// # Errors
    /// A sentence where the traffic cannot be made, or the driver fails.
    pub fn shown(&self, roads: &Roads, driver: &mut dyn AgentDriver) -> Result<usize, Invalid> {
        let all: Vec<usize> = (0..self.agents.len()).collect();
        let mut story = self.story(&all);
        story.tracks.handover = Handover::Never;
        let mut traffic = Traffic::new(roads.graph.clone(), &[], 0)
            .map_err(|error| Invalid::new(error.to_string()))?
            .with_story(&story, &roads.map)?;
        driver.begin(&self.told(roads)).map_err(failed)?;
        self.run_commanded(&mut traffic, &all, |traffic, step| {
            let observation = self.observed(roads, traffic, step);
            driver.commands(&observation).map(drop).map_err(failed)
        })?;
        Ok(self.steps().saturating_sub(1))
    }

    /// Facts that a driver of agents is told before it begins.
    fn told<'b>(&'b self, roads: &'b Roads) -> AgentsInfo<'b> {
        let agents = self.agents.iter();
        let agents = agents.map(|agent| (agent.name.as_str(), agent.kind, agent.size()));
        AgentsInfo {
            scenario: "recording",
            seed: 0,
            step_s: STEP_S,
            lanes: &roads.map,
            agents: agents.collect(),
        }
    }

    /// The traffic of a simulation as a driver of agents sees it after `step` moments.
    fn observed(&self, roads: &Roads, traffic: &Traffic, step: usize) -> AgentsObservation {
        let agents = traffic.steerable(&[]);
        let takes = |index: &usize| {
            agents
                .binary_search_by_key(index, |agent| agent.agent)
                .is_ok()
        };
        let states = traffic.states().iter().enumerate();
        let others = states.filter_map(|(index, state)| Some((index, (*state)?)));
        let time_s = step as f64 * STEP_S;
        let at_s = self.motion.start_s + time_s;
        let lines = roads.lights.lines().iter();
        AgentsObservation {
            step: step as u32,
            time_s,
            ego: None,
            others: others.filter(|(index, _)| !takes(index)).collect(),
            stop_lines: lines
                .map(|line| (line.record, roads.lights.color_at(line.record.index, at_s)))
                .collect(),
            agents,
        }
    }

    fn motion_of(&self, places: Vec<Vec<Option<Place>>>) -> Motion {
        Motion {
            places,
            ..self.motion.clone()
        }
    }

    fn straight_on(&self) -> Motion {
        let places = (0..self.agents.len()).map(|at| {
            let start = self.motion.places[at][0];
            let moved = |step: usize| {
                let (at_m, yaw_rad) = start?;
                let way_m = self.speeds_mps[at] * STEP_S * step as f64;
                Some((at_m + way_m * DVec2::from_angle(yaw_rad), yaw_rad))
            };
            (0..self.steps()).map(moved).collect()
        });
        self.motion_of(places.collect())
    }

    /// Road users at `chosen`, who drive on their recorded lines.
    fn story(&self, chosen: &[usize]) -> Story {
        let agents = chosen.iter().map(|&at| self.agents[at].clone());
        Story {
            tracks: Tracks {
                handover: Handover::All,
                agents: agents.collect(),
            },
            ..Story::default()
        }
    }

    fn on_tracks(
        &self,
        roads: &Roads,
        (rollouts, seed, drivers): (u32, u64, Drivers),
    ) -> Result<Simulated, Invalid> {
        let all: Vec<usize> = (0..self.agents.len()).collect();
        let story = self.story(&all);
        // Without drawn drivers there is no chance on tracks.
        let count = match drivers {
            Drivers::Kinds => 1,
            Drivers::Drawn => rollouts,
        };
        let mut motions = Vec::new();
        for rollout in 0..count {
            let traffic = Traffic::new(roads.graph.clone(), &[], seed + u64::from(rollout))
                .map_err(|error| Invalid::new(error.to_string()))?
                .with_drivers(drivers, &[])
                .with_story(&story, &roads.map)?;
            motions.push(self.run(traffic, &all));
        }
        Ok(Simulated {
            motions,
            placed: self.vehicles.clone(),
        })
    }

    fn on_lanes(
        &self,
        roads: &Roads,
        (rollouts, seed, drivers): (u32, u64, Drivers),
    ) -> Result<Simulated, Invalid> {
        let mut placed = self.vehicles.clone();
        let mut motions = Vec::new();
        for rollout in 0..rollouts {
            let chance = (seed + u64::from(rollout), drivers);
            let traffic = self.placed_on_lanes(roads, &mut placed, chance)?;
            // The others are there too: drivers follow them and give way to them.
            let is_other = |at: &usize| !placed.contains(at);
            let others: Vec<usize> = (0..self.agents.len()).filter(is_other).collect();
            let traffic = traffic
                .with_lights(roads.lights.clone())
                .with_story(&self.story(&others), &roads.map)?;
            let all = [&placed[..], &others].concat();
            motions.push(self.run(traffic, &all));
        }
        Ok(Simulated { motions, placed })
    }

    /// Traffic of those `placed`, less those that stand too near to others for its rules.
    fn placed_on_lanes(
        &self,
        roads: &Roads,
        placed: &mut Vec<usize>,
        (seed, drivers): (u64, Drivers),
    ) -> Result<Traffic, Invalid> {
        loop {
            let agents: Vec<TrafficAgent> = placed
                .iter()
                .filter_map(|&at| self.on_lane(roads, at))
                .collect();
            let out = match Traffic::new(roads.graph.clone(), &agents, seed) {
                Ok(traffic) => return Ok(traffic.with_drivers(drivers, &agents)),
                Err(
                    TrafficError::Overlap { second: agent, .. }
                    | TrafficError::BeyondLane { agent, .. }
                    | TrafficError::NotAVehicle { agent, .. }
                    | TrafficError::UnknownLane { agent, .. },
                ) => agent,
                Err(TrafficError::Roads(error)) => return Err(error),
            };
            placed.retain(|at| at.to_string() != out);
        }
    }

    fn on_lane(&self, roads: &Roads, at: usize) -> Option<TrafficAgent> {
        let (spot, agent) = (self.lanes[at]?, &self.agents[at]);
        Some(TrafficAgent {
            name: at.to_string(),
            kind: agent.kind,
            asset: 0,
            size: agent.size(),
            lane: roads.map.lanes[spot.lane].id.clone(),
            at_m: spot.foot.arc_m,
            speed_mps: self.speeds_mps[at],
            cruise_mps: None,
            driver: DriverKind::Normal,
            changes_lanes: true,
            behaviors: Vec::new(),
        })
    }

    /// Motion of `traffic`, whose agents are those of the part at `all`. Who leaves the map and
    /// enters again elsewhere counts as gone.
    fn run(&self, mut traffic: Traffic, all: &[usize]) -> Motion {
        let run = self.run_commanded(&mut traffic, all, |_, _| Ok(()));
        run.expect("nothing fails where nobody is asked")
    }

    /// Motion of `traffic` as in [`Part::run`]; `command` is called before each step with its
    /// number.
    fn run_commanded(
        &self,
        traffic: &mut Traffic,
        all: &[usize],
        mut command: impl FnMut(&mut Traffic, usize) -> Result<(), Invalid>,
    ) -> Result<Motion, Invalid> {
        let mut places = vec![vec![None; self.steps()]; self.agents.len()];
        let mut gone = vec![false; all.len()];
        for step in 0..self.steps() {
            if step > 0 {
                command(traffic, step - 1)?;
                traffic.step(STEP_S, None);
            }
            for ((&at, state), gone) in all.iter().zip(traffic.states()).zip(&mut gone) {
                let had_been = step > 0 && places[at][step - 1].is_some();
                *gone |= state.is_none() && had_been;
                places[at][step] = state
                    .filter(|_| !*gone)
                    .map(|state| (state.position_m, state.yaw_rad));
            }
        }
        Ok(self.motion_of(places))
    }
}
