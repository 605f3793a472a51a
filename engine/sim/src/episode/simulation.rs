//! The world of one episode in motion: the egos, the traffic and the clock.

mod commanded;
mod driven_ego;
mod recorded;
mod shown;
mod told;
mod view;

use std::sync::Arc;

use decouplegs_drive::lights::TrafficLights;
use decouplegs_drive::polyline::wrapped;
use decouplegs_drive::signs::TrafficSigns;
use decouplegs_drive::traffic::EgoBox;
use decouplegs_drive::{OrientedBox, Traffic};
use decouplegs_scene::episode::{EpisodeEnd, EpisodeTick, HandoverRecord, LightChangeRecord};
use decouplegs_scene::{Motion, Plan, Pose, Scenario, SignKind, VehicleSize, VehicleState};
use glam::DVec3;

use self::driven_ego::DrivenEgo;
pub use self::view::EgoView;
use super::EpisodeError;
use super::site::Site;

/// One episode in motion. [`Simulation::advance`] is all that moves it: the same plans give the
/// same bits.
///
/// Vehicles have numbers: 0 is the first ego, the agents of the traffic follow, and the other egos
/// come last.
pub struct Simulation {
    scenario: Scenario,
    site: Arc<Site>,
    /// Egos, in the order of the scenario; those that have ended too.
    egos: Vec<DrivenEgo>,
    traffic: Traffic,
    /// Boxes of the agents as the first ego sees them.
    agent_sizes: Vec<VehicleSize>,
    signs: Arc<TrafficSigns>,
    /// Assets that show the lights, by the index of the light.
    signals: Vec<(usize, Pose)>,
    /// Signs that stand beside their lines.
    sign_posts: Vec<(SignKind, Pose)>,
    /// Height of the ground below vehicles at the end of the last step, meters, which tells decks
    /// apart; `None` for agents that came onto the map since.
    ground_z_m: Vec<Option<f64>>,
    /// Duration of the last sub-step, and the headings of vehicles before it.
    before: (f64, Vec<Option<f64>>),
    substep: u32,
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
        let egos = 0..scenario.egos.count();
        let egos: Vec<DrivenEgo> = egos
            .map(|ego| driven_ego(scenario, ego, site).map_err(unfit))
            .collect::<Result<_, _>>()?;
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
        let mut ground_z_m = vec![None; 1 + scenario.agent_count()];
        let others = ground_z_m.len() - egos.len();
        for (ego, driven) in egos.iter().enumerate() {
            let vehicle = if ego == 0 { 0 } else { others + ego };
            ground_z_m[vehicle] = Some(driven.start_z_m());
        }
        let mut simulation = Self {
            egos,
            signals: site.signal_poses(traffic.lights()),
            traffic,
            agent_sizes: scenario.agent_sizes(),
            sign_posts: site.sign_poses(&signs),
            signs,
            ground_z_m,
            scenario: scenario.clone(),
            site: site.clone(),
            before: (0.0, Vec::new()),
            substep: 0,
        };
        simulation.check_starts().map_err(unfit)?;
        simulation.settle();
        Ok(simulation)
    }

    /// Checks that no ego starts in another vehicle or an obstacle. Otherwise a sentence.
    fn check_starts(&self) -> Result<(), String> {
        for (index, ego) in self.egos.iter().enumerate() {
            let who = match self.egos.len() {
                1 => "the ego".to_owned(),
                _ => format!("ego {}", self.scenario.ego_identity(index).name),
            };
            let outline = ego.outline();
            let (agents, sizes) = (self.agents_for(index), self.sizes_for(index));
            let touched = boxes(&agents, &sizes).find(|(_, other)| other.overlaps(&outline));
            if let Some((agent, _)) = touched {
                let scenario = self.scenario.for_ego(index);
                let name = scenario.agent(agent).0;
                return Err(match agent < self.traffic.states().len() {
                    true => format!("{who} starts where agent {name} stands"),
                    false => format!(
                        "{who} starts where ego {name} stands: expected starts that are farther apart"
                    ),
                });
            }
            let hit = self.site.obstacles.touched(&outline);
            if let Some(obstacle) = hit.filter(|_| ego.recorded.is_none()) {
                return Err(format!(
                    "{who} starts in a {} at ({:.1}, {:.1}) m",
                    obstacle.kind.name(),
                    obstacle.center_m.x,
                    obstacle.center_m.y
                ));
            }
        }
        Ok(())
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

    /// Traffic lights on the lanes of the site, as they are now.
    #[must_use]
    pub fn lights(&self) -> &TrafficLights {
        self.traffic.lights()
    }

    /// Stop and yield signs on the lanes of the site.
    #[must_use]
    pub fn signs(&self) -> &TrafficSigns {
        &self.signs
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

    /// Reason of the end of the first ego, if it has ended.
    #[must_use]
    pub fn end(&self) -> Option<&EpisodeEnd> {
        self.view(0).end()
    }

    /// True if all egos have ended.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.egos.iter().all(|ego| ego.end.is_some())
    }

    /// Ends ego `ego` because its planner failed.
    pub fn fail(&mut self, ego: usize, reason: String) {
        let end = (EpisodeEnd::Planner { reason }, self.substep);
        self.egos[ego].end.get_or_insert(end);
    }

    /// The world as ego `ego` knows it, from 0 in the order of the scenario.
    ///
    /// # Panics
    /// The view panics if there is no such ego.
    #[must_use]
    pub fn view(&self, ego: usize) -> EgoView<'_> {
        EgoView {
            simulation: self,
            index: ego,
        }
    }

    /// Number of egos, those that have ended too.
    #[must_use]
    pub fn ego_count(&self) -> usize {
        self.egos.len()
    }

    /// State of all vehicles now, as the first ego sees them.
    #[must_use]
    pub fn instant(&self) -> EpisodeTick {
        self.view(0).instant()
    }

    /// Drives `plan` of the only ego for a step. The moments after each sub-step, the last of them
    /// that at which the episode ended, if it did.
    pub fn advance(&mut self, plan: &Plan) -> Vec<EpisodeTick> {
        let mut all = self.advance_with(&[Some(plan)], |_| {});
        all.swap_remove(0)
    }

    /// Drives the plans of all egos for a step, in the order of the scenario, and calls `after` at
    /// the end of each sub-step. The moments after each sub-step as each ego sees them, the last of
    /// them that at which it ended, if it did; none for an ego that had ended before.
    ///
    /// An ego without a plan keeps the one that it had.
    pub fn advance_with(
        &mut self,
        plans: &[Option<&Plan>],
        mut after: impl FnMut(&Self),
    ) -> Vec<Vec<EpisodeTick>> {
        let (substeps, substep_s) = self.scenario.substeps();
        for (ego, plan) in self.egos.iter_mut().zip(plans) {
            if let Some(plan) = plan {
                ego.ego.follow(plan);
            }
        }
        let mut instants = vec![Vec::new(); self.egos.len()];
        for substep in 1..=substeps {
            if self.is_over() {
                break;
            }
            self.advance_substep(substep_s, &mut instants);
            if substep == substeps || self.is_over() {
                self.settle();
            }
            after(self);
        }
        instants
    }

    /// Moves all by a sub-step of `substep_s` seconds, and adds the moment at its end as each ego
    /// sees it.
    fn advance_substep(&mut self, substep_s: f64, instants: &mut [Vec<EpisodeTick>]) {
        // All act on the previous state: none sees another's step before its own.
        let drives = |ego: &DrivenEgo| ego.end.is_none();
        let seen: Vec<EgoBox> = self
            .egos
            .iter()
            .map(|ego| drives(ego).then(|| (ego.ego.state(), ego.task.size)))
            .collect();
        self.before = (substep_s, self.yaws_rad());
        let time_s = self.time_at(self.substep + 1);
        for ego in self.egos.iter_mut().filter(|ego| drives(ego)) {
            ego.advance(time_s, substep_s);
        }
        self.traffic.step_among(substep_s, &seen);
        self.substep += 1;
        let is_here: Vec<bool> = self.states().map(|state| state.is_some()).collect();
        for (z_m, is_here) in self.ground_z_m.iter_mut().zip(is_here) {
            *z_m = z_m.filter(|_| is_here);
        }
        for ego in self.egos.iter_mut().filter(|ego| drives(ego)) {
            ego.arrive(&self.site, substep_s);
        }
        let mut ends = Vec::new();
        for (index, ego) in self.egos.iter().enumerate().filter(|(_, ego)| drives(ego)) {
            let instant = self.view(index).instant();
            let own = ego.end_at(&instant, &self.sizes_for(index), &self.site);
            ends.extend(own.or_else(|| self.common_end()).map(|end| (index, end)));
            instants[index].push(instant);
        }
        for (index, end) in ends {
            self.egos[index].end = Some((end, self.substep));
        }
    }

    /// Reason for which all egos end now, if there is one.
    fn common_end(&self) -> Option<EpisodeEnd> {
        if self.traffic.story_is_over() {
            return Some(EpisodeEnd::Story);
        }
        let (per_step, _) = self.scenario.substeps();
        (self.substep >= self.scenario.steps() * per_step).then_some(EpisodeEnd::Time)
    }

    /// Recorded agents that were handed over since this was asked last.
    pub fn take_handovers(&mut self) -> Vec<HandoverRecord> {
        self.traffic.take_handovers()
    }

    /// Changes of traffic lights since this was asked last.
    pub fn take_light_changes(&mut self) -> Vec<LightChangeRecord> {
        self.traffic.take_light_changes()
    }

    /// State of ego `ego`; `None` where it has ended before this moment, and left.
    fn ego_state(&self, ego: usize) -> Option<VehicleState> {
        let driven = &self.egos[ego];
        let ended = driven.end.as_ref().map(|(_, substep)| *substep);
        ended
            .is_none_or(|substep| substep == self.substep)
            .then(|| driven.ego.state())
    }

    /// States of all vehicles, by their numbers.
    fn states(&self) -> impl Iterator<Item = Option<VehicleState>> {
        let others = (1..self.egos.len()).map(|ego| self.ego_state(ego));
        std::iter::once(self.ego_state(0))
            .chain(self.traffic.states().iter().copied())
            .chain(others)
    }

    /// States of the agents as ego `ego` sees them: the first ego has its place among the others.
    fn agents_for(&self, ego: usize) -> Vec<Option<VehicleState>> {
        let others = (1..self.egos.len()).map(|other| match other == ego {
            true => self.ego_state(0),
            false => self.ego_state(other),
        });
        let agents = self.traffic.states().iter().copied();
        agents.chain(others).collect()
    }

    /// Boxes of the agents as ego `ego` sees them.
    fn sizes_for(&self, ego: usize) -> Vec<VehicleSize> {
        let mut sizes = self.agent_sizes.clone();
        if ego > 0 {
            sizes[self.traffic.states().len() + ego - 1] = self.egos[0].task.size;
        }
        sizes
    }

    /// Number of ego `ego` among all vehicles.
    fn vehicle_of(&self, ego: usize) -> usize {
        match ego {
            0 => 0,
            _ => self.traffic.states().len() + ego,
        }
    }

    /// Headings of all vehicles, radians.
    fn yaws_rad(&self) -> Vec<Option<f64>> {
        self.states().map(|state| Some(state?.yaw_rad)).collect()
    }

    /// Motion of vehicle `vehicle` with the pose `pose`: its speed along its
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

    /// Height of the lane below an agent, meters: vehicles that enter the map were nowhere before.
    /// For a pedestrian, the height of the nearest route; for an actor, that of the lane nearby.
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
            let feet = self.egos.iter().map(|ego| {
                let line = ego.route.line();
                (line, line.project(state.position_m))
            });
            let nearest = feet.min_by(|(_, a), (_, b)| a.distance_m.total_cmp(&b.distance_m));
            return nearest.map_or(0.0, |(line, foot)| line.at(foot.arc_m).z);
        }
        let place = self.traffic.lane_positions().nth(agent).flatten();
        place
            .and_then(|place| self.site.lanes.lanes[place.lane].centerline.first())
            .map_or(0.0, |point| point.z)
    }

    /// Finds the ground below all vehicles.
    fn settle(&mut self) {
        let below_m = |(vehicle, state): (usize, Option<VehicleState>)| {
            let at = state?.position_m;
            let near_z_m = self.near_z_m(vehicle);
            Some(self.site.height_at(at, near_z_m).unwrap_or(near_z_m))
        };
        self.ground_z_m = self.states().enumerate().map(below_m).collect();
    }

    /// Height near which vehicle `vehicle` stands, meters.
    fn near_z_m(&self, vehicle: usize) -> f64 {
        self.ground_z_m[vehicle].unwrap_or_else(|| self.lane_z_m(vehicle - 1))
    }

    /// Pose of vehicle `vehicle` on the ground.
    fn pose(&self, vehicle: usize, state: &VehicleState, size: &VehicleSize) -> Pose {
        self.site.pose_of(state, size, self.near_z_m(vehicle))
    }
}

/// Ego `ego` of `scenario` at its start.
///
/// # Errors
/// A sentence, if its task does not fit `site`.
fn driven_ego(scenario: &Scenario, ego: usize, site: &Site) -> Result<DrivenEgo, String> {
    DrivenEgo::new(scenario.ego_task(ego), site).map_err(|reason| match scenario.egos.count() {
        1 => reason,
        _ => format!("ego {}: {reason}", scenario.ego_identity(ego).name),
    })
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
