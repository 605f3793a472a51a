//! An ego in motion: its route, how far it is, and why it ended.

use decouplegs_drive::score::RouteProgress;
use decouplegs_drive::{Ego, EgoOptions, OrientedBox, RoadSurface, Route, TurnWatch};
use decouplegs_scene::episode::{EpisodeEnd, EpisodeTick, RoadRecord};
use decouplegs_scene::scenario::EgoTask;
use decouplegs_scene::{Trajectory, VehicleSize, VehicleState};
use glam::DVec2;

use super::boxes;
use super::recorded::recorded_state;
use crate::episode::site::Site;

/// Time off the road after which the ego has left it for good, seconds, if it also drove
/// [`OFF_ROAD_M`].
const OFF_ROAD_S: f64 = 4.0;
/// Distance driven off the road after which the ego has left it for good, meters.
const OFF_ROAD_M: f64 = 20.0;
/// Distance from its route at which the ego has left it, meters, as in CARLA's leaderboard.
const OFF_ROUTE_M: f64 = 30.0;

/// One of the egos of an episode.
pub(super) struct DrivenEgo {
    pub(super) task: EgoTask,
    pub(super) route: Route,
    pub(super) progress: RouteProgress,
    pub(super) ego: Ego,
    /// Position of the ego on the road.
    road: RoadRecord,
    turns: TurnWatch,
    /// The way that the ego takes instead of its plans.
    pub(super) recorded: Option<Trajectory>,
    /// Time and way since the ego was on the road last, seconds and meters.
    off_road: (f64, f64),
    /// Reason of its end, and the number of the sub-step at whose end that was.
    pub(super) end: Option<(EpisodeEnd, u32)>,
}

impl DrivenEgo {
    /// An ego at the start of `task`.
    ///
    /// # Errors
    /// A sentence, if the task does not fit `site`.
    pub(super) fn new(task: &EgoTask, site: &Site) -> Result<Self, String> {
        let route = Route::new(&site.lanes, task).map_err(String::from)?;
        let (start, heading_rad) = route.pose_at(0.0);
        let recorded = match (task.follows_recording, site.recorded_way()) {
            (false, _) => None,
            (true, Some(way)) => Some(way.clone()),
            (true, None) => {
                return Err("its ego follows the recording, and the place has none: expected [[ego]] poses in its scene file".into());
            }
        };
        let state = match &recorded {
            Some(way) => recorded_state(way, 0.0).0,
            None => {
                let [x_m, y_m, yaw_rad] =
                    task.start_pose.unwrap_or([start.x, start.y, heading_rad]);
                VehicleState {
                    position_m: DVec2::new(x_m, y_m),
                    yaw_rad,
                    speed_mps: task.speed_mps,
                    acceleration_mps2: 0.0,
                }
            }
        };
        let progress =
            RouteProgress::new(&line_of(&route), state.position_m).ok_or("the route is no line")?;
        let mut turns = TurnWatch::default();
        let road = road_at(site, &mut turns, &state);
        Ok(Self {
            ego: Ego::new(state, task.size, EgoOptions::default()),
            task: task.clone(),
            route,
            progress,
            road,
            turns,
            recorded,
            off_road: (0.0, 0.0),
            end: None,
        })
    }

    /// Box of the ego now.
    pub(super) fn outline(&self) -> OrientedBox {
        OrientedBox::for_vehicle(&self.ego.state(), &self.task.size)
    }

    /// Height of its route at its start, meters.
    pub(super) fn start_z_m(&self) -> f64 {
        self.route.pose_at(0.0).0.z
    }

    /// Moves it to `time_s`, by `dt_s` seconds.
    pub(super) fn advance(&mut self, time_s: f64, dt_s: f64) {
        match &self.recorded {
            None => self.ego.step(dt_s),
            Some(way) => {
                let (state, yaw_rate_radps) = recorded_state(way, time_s);
                self.ego.move_to(state, yaw_rate_radps);
            }
        }
    }

    /// Finds its place on `site` after it moved by `dt_s` seconds.
    pub(super) fn arrive(&mut self, site: &Site, dt_s: f64) {
        let state = self.ego.state();
        self.progress.advance(state.position_m);
        self.road = road_at(site, &mut self.turns, &state);
        self.off_road = if self.is_on_road(site) {
            (0.0, 0.0)
        } else {
            let (time_s, way_m) = self.off_road;
            (time_s + dt_s, way_m + state.speed_mps * dt_s)
        };
    }

    fn is_on_road(&self, site: &Site) -> bool {
        site.surface.holds_box(&self.outline(), RoadSurface::EDGE_M)
    }

    /// State of all vehicles at `time_s`, the `agents` as this ego sees them.
    pub(super) fn tick(
        &self,
        site: &Site,
        time_s: f64,
        agents: Vec<Option<VehicleState>>,
    ) -> EpisodeTick {
        let ego = self.ego.state();
        EpisodeTick {
            time_s,
            on_road: self.is_on_road(site),
            lanes: site.surface.lanes_below(&ego),
            road: Some(self.road),
            ego,
            steer_rad: self.ego.steer_rad(),
            agents,
        }
    }

    /// Reason for which it ends at `instant`, at which agents have `sizes`, if there is one of its
    /// own.
    pub(super) fn end_at(
        &self,
        instant: &EpisodeTick,
        sizes: &[VehicleSize],
        site: &Site,
    ) -> Option<EpisodeEnd> {
        let ego = OrientedBox::for_vehicle(&instant.ego, &self.task.size);
        let mut others = boxes(&instant.agents, sizes);
        if let Some((agent, _)) = others.find(|(_, other)| other.overlaps(&ego)) {
            return Some(EpisodeEnd::Collision { agent });
        }
        // Where the recording went, nothing was in the way, whatever splats look like.
        let is_free = self.recorded.is_some();
        if let Some(&obstacle) = site.obstacles.touched(&ego)
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
        (foot.distance_m > OFF_ROUTE_M).then_some(EpisodeEnd::OffRoute)
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

/// A route as a line on the plane, meters.
pub(super) fn line_of(route: &Route) -> Vec<DVec2> {
    let points = route.line().points().iter();
    points.map(|point| point.truncate()).collect()
}
