//! The world of one episode in motion: the ego, the traffic and the clock.

mod commanded;
mod recorded;
mod told;

use std::sync::Arc;

use decouplegs_drive::lights::TrafficLights;
use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::score::RouteProgress;
use decouplegs_drive::signs::TrafficSigns;
use decouplegs_drive::{Ego, EgoOptions, OrientedBox, RoadSurface, Route, Traffic, TurnWatch};
use decouplegs_scene::episode::{
    EpisodeEnd, EpisodeTick, HandoverRecord, LightChangeRecord, RoadRecord, StopLineRecord,
};
use decouplegs_scene::{
    Motion, Plan, Pose, Scenario, SignKind, Trajectory, VehicleSize, VehicleState,
};
use glam::{DVec2, DVec3};

use self::recorded::recorded_state;
use super::EpisodeError;
use super::site::Site;
use decouplegs_session::{AgentInstance, SessionError, World};

/// Time off the road after which the ego has left it for good, seconds, if it also drove
/// [`OFF_ROAD_M`].
const OFF_ROAD_S: f64 = 4.0;
/// Distance driven off the road after which the ego has left it for good, meters.
const OFF_ROAD_M: f64 = 20.0;
/// Distance from its route at which the ego has left it, meters, as in CARLA's leaderboard.
const OFF_ROUTE_M: f64 = 30.0;

/// One episode in motion. [`Simulation::advance`] is all that moves it: the same plans give the
/// same bits.
pub struct Simulation {
    scenario: Scenario,
    site: Arc<Site>,
    route: Route,
    progress: RouteProgress,
    ego: Ego,
    /// Position of the ego on the road.
    road: RoadRecord,
    turns: TurnWatch,
    /// The way that the ego takes instead of its plans.
    recorded: Option<Trajectory>,
    traffic: Traffic,
    agent_sizes: Vec<VehicleSize>,
    signs: Arc<TrafficSigns>,
    /// Assets that show the lights, by the index of the light.
    signals: Vec<(usize, Pose)>,
    /// Signs that stand beside their lines.
    sign_posts: Vec<(SignKind, Pose)>,
    /// Height of the ground below the ego and then the agents at the end of the last step, meters,
    /// which tells decks apart; `None` for agents that came onto the map since.
    ground_z_m: Vec<Option<f64>>,
    /// Duration of the last sub-step and headings before it, of the ego and then of the agents.
    before: (f64, Vec<Option<f64>>),
    substep: u32,
    /// Time and way since the ego was on the road last, seconds and meters.
    off_road: (f64, f64),
    end: Option<EpisodeEnd>,
}

/// Largest yaw rate that rolling shutters show, rad/s: pedestrians turn about within a sub-step.
const YAW_RATE_MAX_RADPS: f64 = 4.0;

impl Simulation {
    /// `scenario` at its start.
    ///
    /// # Errors
    /// Returns an error if its lanes are not those of `site`, or vehicles stand in one another.
    pub fn new(scenario: &Scenario, site: &Arc<Site>) -> Result<Self, EpisodeError> {
        let unfit = |reason: String| EpisodeError::Unfit {
            scenario: scenario.name.clone(),
            reason,
        };
        let route = Route::new(&site.lanes, &scenario.ego).map_err(|error| unfit(error.into()))?;
        let lights = TrafficLights::new(&site.lanes, &site.graph, &scenario.lights)
            .map(Arc::new)
            .map_err(|error| unfit(error.into()))?;
        let signs = TrafficSigns::new(&site.lanes, &site.graph, &scenario.signs)
            .map(Arc::new)
            .map_err(|error| unfit(error.into()))?;
        let traffic = Traffic::new(site.graph.clone(), &scenario.agents, scenario.seed)
            .map_err(|error| unfit(error.to_string()))?
            .with_drivers(scenario.drivers, &scenario.agents)
            .among(site.obstacles.clone())
            .with_lights(lights)
            .with_signs(signs.clone())
            .with_pedestrians(&scenario.pedestrians)
            .and_then(|traffic| traffic.with_story(&scenario.story, &site.lanes))
            .map_err(|error| unfit(error.into()))?;
        let (start, heading_rad) = route.pose_at(0.0);
        let recorded = match (scenario.ego.follows_recording, site.recorded_way()) {
            (false, _) => None,
            (true, Some(way)) => Some(way.clone()),
            (true, None) => {
                let reason = "its ego follows the recording, and the place has none: expected [[ego]] poses in its scene file";
                return Err(unfit(reason.into()));
            }
        };
        let state = match &recorded {
            Some(way) => recorded_state(way, 0.0).0,
            None => {
                let pose = scenario.ego.start_pose;
                let [x_m, y_m, yaw_rad] = pose.unwrap_or([start.x, start.y, heading_rad]);
                VehicleState {
                    position_m: DVec2::new(x_m, y_m),
                    yaw_rad,
                    speed_mps: scenario.ego.speed_mps,
                    acceleration_mps2: 0.0,
                }
            }
        };
        let progress = RouteProgress::new(&line_of(&route), state.position_m)
            .ok_or_else(|| unfit("the route is no line".into()))?;
        let agent_sizes = scenario.agent_sizes();
        let ego_box = OrientedBox::for_vehicle(&state, &scenario.ego.size);
        let touched = boxes(traffic.states(), &agent_sizes)
            .find(|(_, other)| other.overlaps(&ego_box))
            .map(|(agent, _)| agent);
        if let Some(agent) = touched {
            return Err(unfit(format!(
                "the ego starts where agent {} stands",
                scenario.agent(agent).0
            )));
        }
        let hit = site.obstacles.touched(&ego_box);
        if let Some(obstacle) = hit.filter(|_| recorded.is_none()) {
            return Err(unfit(format!(
                "the ego starts in a {} at ({:.1}, {:.1}) m",
                obstacle.kind.name(),
                obstacle.center_m.x,
                obstacle.center_m.y
            )));
        }
        let mut turns = TurnWatch::default();
        let road = road_at(site, &mut turns, &state);
        let mut simulation = Self {
            progress,
            road,
            turns,
            route,
            recorded,
            ego: Ego::new(state, scenario.ego.size, EgoOptions::default()),
            signals: site.signal_poses(traffic.lights()),
            traffic,
            agent_sizes,
            sign_posts: site.sign_poses(&signs),
            signs,
            ground_z_m: std::iter::once(Some(start.z))
                .chain((0..scenario.agent_count()).map(|_| None))
                .collect(),
            scenario: scenario.clone(),
            site: site.clone(),
            before: (0.0, Vec::new()),
            substep: 0,
            off_road: (0.0, 0.0),
            end: None,
        };
        simulation.settle();
        Ok(simulation)
    }

    /// Scenario that is driven.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }

    /// Site of the scenario.
    #[must_use]
    pub fn site(&self) -> &Arc<Site> {
        &self.site
    }

    /// Ego vehicle.
    #[must_use]
    pub fn ego(&self) -> &Ego {
        &self.ego
    }

    /// Traffic lights on the lanes of the site, as they are now.
    #[must_use]
    pub fn lights(&self) -> &TrafficLights {
        self.traffic.lights()
    }

    /// Stop lines of the lights that are for the ego's way, among all: not those towards
    /// successors that its route does not take.
    pub fn stop_lines(&self) -> impl Iterator<Item = &StopLineRecord> {
        let lanes: Vec<usize> = self.route.lanes().iter().map(|&(_, lane)| lane).collect();
        let lines = self.lights().lines().iter();
        lines
            .filter(move |line| line.concerns(&lanes))
            .map(|line| &line.record)
    }

    /// Stop and yield signs on the lanes of the site.
    #[must_use]
    pub fn signs(&self) -> &TrafficSigns {
        &self.signs
    }

    /// Meters along the route where the ego had come farthest.
    #[must_use]
    pub fn progress_m(&self) -> f64 {
        self.progress.progress_m()
    }

    /// The ego's way.
    #[must_use]
    pub fn route(&self) -> &Route {
        &self.route
    }

    /// Boxes of the agents.
    #[must_use]
    pub fn agent_sizes(&self) -> &[VehicleSize] {
        &self.agent_sizes
    }

    /// Time since the start, seconds. Counted, not summed up: steps of a tenth do not add up to
    /// one.
    #[must_use]
    pub fn time_s(&self) -> f64 {
        self.time_at(self.substep)
    }

    /// Time of the end of a sub-step, seconds.
    fn time_at(&self, substep: u32) -> f64 {
        let (per_step, _) = self.scenario.substeps();
        f64::from(substep) * self.scenario.step_s / f64::from(per_step)
    }

    /// Reason of the end, if it has ended.
    #[must_use]
    pub fn end(&self) -> Option<&EpisodeEnd> {
        self.end.as_ref()
    }

    /// Ends it because the planner failed.
    pub fn fail(&mut self, reason: String) {
        self.end.get_or_insert(EpisodeEnd::Planner { reason });
    }

    /// State of all vehicles now.
    #[must_use]
    pub fn instant(&self) -> EpisodeTick {
        let ego = self.ego.state();
        EpisodeTick {
            time_s: self.time_s(),
            on_road: self.site.surface.holds_box(
                &OrientedBox::for_vehicle(&ego, &self.scenario.ego.size),
                RoadSurface::EDGE_M,
            ),
            lanes: self.site.surface.lanes_below(&ego),
            road: Some(self.road),
            ego,
            steer_rad: self.ego.steer_rad(),
            agents: self.traffic.states().to_vec(),
        }
    }

    /// Drives `plan` for a step. The moments after each sub-step, the last of them that at which
    /// the episode ended, if it did.
    pub fn advance(&mut self, plan: &Plan) -> Vec<EpisodeTick> {
        self.advance_with(plan, |_| {})
    }

    /// Drives `plan` for a step like [`Self::advance`], and calls `after` at the end of each
    /// sub-step.
    pub fn advance_with(&mut self, plan: &Plan, mut after: impl FnMut(&Self)) -> Vec<EpisodeTick> {
        let (substeps, substep_s) = self.scenario.substeps();
        self.ego.follow(plan);
        let mut instants = Vec::with_capacity(substeps as usize);
        for substep in 1..=substeps {
            if self.end.is_some() {
                break;
            }
            // All act on the previous state: none sees another's step before its own.
            let seen = self.ego.state();
            self.before = (substep_s, self.yaws_rad());
            match &self.recorded {
                None => self.ego.step(substep_s),
                Some(way) => {
                    let (state, yaw_rate_radps) =
                        recorded_state(way, self.time_at(self.substep + 1));
                    self.ego.move_to(state, yaw_rate_radps);
                }
            }
            self.traffic
                .step(substep_s, Some((&seen, &self.scenario.ego.size)));
            let heights = self.ground_z_m[1..].iter_mut();
            for (z_m, state) in heights.zip(self.traffic.states()) {
                *z_m = z_m.filter(|_| state.is_some());
            }
            self.substep += 1;
            self.progress.advance(self.ego.state().position_m);
            self.road = road_at(&self.site, &mut self.turns, &self.ego.state());
            let instant = self.instant();
            self.off_road = if instant.on_road {
                (0.0, 0.0)
            } else {
                let (time_s, way_m) = self.off_road;
                (
                    time_s + substep_s,
                    way_m + instant.ego.speed_mps * substep_s,
                )
            };
            self.end = self.end_at(&instant);
            if substep == substeps || self.end.is_some() {
                self.settle();
            }
            instants.push(instant);
            after(self);
        }
        instants
    }

    /// Recorded agents that were handed over since this was asked last.
    pub fn take_handovers(&mut self) -> Vec<HandoverRecord> {
        self.traffic.take_handovers()
    }

    /// Changes of traffic lights since this was asked last.
    pub fn take_light_changes(&mut self) -> Vec<LightChangeRecord> {
        self.traffic.take_light_changes()
    }

    /// Headings of the ego and then of the agents, radians.
    fn yaws_rad(&self) -> Vec<Option<f64>> {
        let ego = std::iter::once(Some(self.ego.state()));
        let states = ego.chain(self.traffic.states().iter().copied());
        states.map(|state| Some(state?.yaw_rad)).collect()
    }

    /// Motion of vehicle `vehicle` (0 is the ego) with the pose `pose`: its speed along its
    /// heading, and the yaw rate of the last sub-step.
    fn motion_of(&self, vehicle: usize, state: VehicleState, pose: &Pose) -> Motion {
        let (substep_s, yaws_rad) = &self.before;
        let yaw_rate = match yaws_rad.get(vehicle) {
            Some(&Some(yaw_rad)) => {
                let rate = wrapped(state.yaw_rad - yaw_rad) / substep_s;
                rate.clamp(-YAW_RATE_MAX_RADPS, YAW_RATE_MAX_RADPS)
            }
            _ => 0.0,
        };
        Motion {
            velocity_mps: pose.rotation * DVec3::X * state.speed_mps,
            turn_rad_per_s: DVec3::Z * yaw_rate,
        }
    }

    fn end_at(&self, instant: &EpisodeTick) -> Option<EpisodeEnd> {
        let ego = OrientedBox::for_vehicle(&instant.ego, &self.scenario.ego.size);
        let mut others = boxes(&instant.agents, &self.agent_sizes);
        if let Some((agent, _)) = others.find(|(_, other)| other.overlaps(&ego)) {
            return Some(EpisodeEnd::Collision { agent });
        }
        // Where the recording went, nothing was in the way, whatever splats look like.
        let is_free = self.recorded.is_some();
        if let Some(&obstacle) = self.site.obstacles.touched(&ego)
            && !is_free
        {
            return Some(EpisodeEnd::Obstacle { obstacle });
        }
        if self.progress.is_done() {
            return Some(EpisodeEnd::RouteDone);
        }
        if self.off_road.0 > OFF_ROAD_S && self.off_road.1 > OFF_ROAD_M && !is_free {
            return Some(EpisodeEnd::OffRoad);
        }
        let last_m = self.progress.progress_m();
        let foot = self.route.project(instant.ego.position_m, last_m);
        if foot.distance_m > OFF_ROUTE_M {
            return Some(EpisodeEnd::OffRoute);
        }
        if self.traffic.story_is_over() {
            return Some(EpisodeEnd::Story);
        }
        let (per_step, _) = self.scenario.substeps();
        (self.substep >= self.scenario.steps() * per_step).then_some(EpisodeEnd::Time)
    }

    /// Puts the agents, the lamps of traffic lights and the signs into `world` as they are now, and
    /// takes out all others. Returns the ego's pose, world coordinates, and its motion.
    ///
    /// # Errors
    /// Returns an error if the scene of `world` has not the assets.
    pub fn show(&self, world: &mut World) -> Result<(Pose, Motion), SessionError> {
        let recorded = self.recorded_pose(self.time_s());
        let ego =
            recorded.unwrap_or_else(|| self.pose(0, &self.ego.state(), &self.scenario.ego.size));
        let mut placed = Vec::with_capacity(self.agent_sizes.len());
        for index in 0..self.agent_sizes.len() {
            let Some(state) = self.traffic.states()[index] else {
                continue;
            };
            let (name, kind, asset) = self.scenario.agent(index);
            let (name, asset) = (name.to_owned(), self.site.asset_of(kind, asset));
            let pose = self.pose(index + 1, &state, &self.agent_sizes[index]);
            let instance = AgentInstance {
                asset,
                pose,
                motion: self.motion_of(index + 1, state, &pose),
                sh_frame: None,
                instance: u16::try_from(index + 1).unwrap_or(u16::MAX),
                shines: false,
            };
            placed.push((name, instance));
        }
        // No agent has such names.
        let lamps = self
            .signals
            .iter()
            .enumerate()
            .map(|(index, &(light, pose))| {
                let color = self.lights().color_at(light, self.time_s());
                let asset = self.site.signal_asset(color);
                (format!("signal/{index}"), asset, pose, true)
            });
        let signs = self.sign_posts.iter().enumerate();
        let signs = signs.map(|(index, &(kind, pose))| {
            (
                format!("sign/{index}"),
                self.site.sign_asset(kind),
                pose,
                false,
            )
        });
        let first = self.agent_sizes.len() + 1;
        for (number, (name, asset, pose, shines)) in lamps.chain(signs).enumerate() {
            let instance = AgentInstance {
                asset,
                pose,
                motion: Motion::REST,
                sh_frame: None,
                instance: u16::try_from(first + number).unwrap_or(u16::MAX),
                shines,
            };
            placed.push((name, instance));
        }
        world.set_agents(placed)?;
        let motion = match &self.recorded {
            None => self.motion_of(0, self.ego.state(), &ego),
            Some(way) => way.motion_at(way.start_s() + self.time_s()),
        };
        Ok((ego, motion))
    }

    /// Height of the lane below an agent, meters: vehicles that enter the map were nowhere before.
    /// For a pedestrian, the height of the route nearby; for an actor, that of the lane nearby.
    fn lane_z_m(&self, agent: usize) -> f64 {
        if let Some(Some(state)) = self.traffic.states().get(agent)
            && agent >= self.scenario.agents.len() + self.scenario.pedestrians.len()
        {
            let points = self
                .site
                .lanes
                .lanes
                .iter()
                .flat_map(|lane| &lane.centerline);
            let apart_m = |point: &&DVec3| point.truncate().distance_squared(state.position_m);
            let nearest = points.min_by(|a, b| apart_m(a).total_cmp(&apart_m(b)));
            return nearest.map_or(0.0, |point| point.z);
        }
        if let Some(Some(state)) = self.traffic.states().get(agent)
            && agent >= self.scenario.agents.len()
        {
            let line = self.route.line();
            return line.at(line.project(state.position_m).arc_m).z;
        }
        let place = self.traffic.lane_positions().nth(agent).flatten();
        place
            .and_then(|place| self.site.lanes.lanes[place.lane].centerline.first())
            .map_or(0.0, |point| point.z)
    }

    /// Finds the ground below all vehicles.
    fn settle(&mut self) {
        let ego = std::iter::once(Some(self.ego.state()));
        let states = ego.chain(self.traffic.states().iter().copied());
        let below_m = |(vehicle, state): (usize, Option<VehicleState>)| {
            let at = state?.position_m;
            let near_z_m = self.near_z_m(vehicle);
            Some(self.site.height_at(at, near_z_m).unwrap_or(near_z_m))
        };
        self.ground_z_m = states.enumerate().map(below_m).collect();
    }

    /// Height near which vehicle `vehicle` (0 is the ego) stands, meters.
    fn near_z_m(&self, vehicle: usize) -> f64 {
        self.ground_z_m[vehicle].unwrap_or_else(|| self.lane_z_m(vehicle - 1))
    }

    /// Pose of vehicle `vehicle` on the ground.
    fn pose(&self, vehicle: usize, state: &VehicleState, size: &VehicleSize) -> Pose {
        self.site.pose_of(state, size, self.near_z_m(vehicle))
    }

    /// The route as a line on the plane, meters.
    #[must_use]
    pub fn route_m(&self) -> Vec<DVec2> {
        line_of(&self.route)
    }
}

/// Position of an ego on the road, which `turns` has followed until now.
fn road_at(site: &Site, turns: &mut TurnWatch, ego: &VehicleState) -> RoadRecord {
    let road = site.parts.record(ego);
    RoadRecord {
        wrong_turn: turns.advance(&site.parts, ego, road.in_junction),
        ..road
    }
}

/// Boxes of the agents that are on the map, with their places in the scenario.
fn boxes(
    states: &[Option<VehicleState>],
    sizes: &[VehicleSize],
) -> impl Iterator<Item = (usize, OrientedBox)> {
    let all = states.iter().zip(sizes).enumerate();
    all.filter_map(|(agent, (state, size))| {
        Some((agent, OrientedBox::for_vehicle(state.as_ref()?, size)))
    })
}

fn line_of(route: &Route) -> Vec<DVec2> {
    route
        .line()
        .points()
        .iter()
        .map(|point| point.truncate())
        .collect()
}
