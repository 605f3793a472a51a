//! Episodes that Python steps through.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use decouplegs::drive::score::{Conduct, ConductKind, EpisodeScore, ExtendedPdmScore, PdmScore};
use decouplegs::episode::{EpisodeMetadata, Rollout as EngineRollout, Site as EngineSite};
use decouplegs::logs::EpisodeLog;
use decouplegs::scene::episode::{EpisodeEnd, PlannerRecord};
use decouplegs::scene::{Motion, Plan, PlanPoint, RoadUser};
use glam::DVec2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{rows, shaped};
use crate::error::{Error, FileError, of_episode, of_session, sentence, value_error};
use crate::lidar::{MotionTuple, tuple_of};
use crate::pose::to_matrix;
use crate::site::Site;
use crate::world::World;

/// Duration of the plan that is made of controls, seconds: what the ego looks ahead, and more.
const CONTROL_HORIZON_S: f64 = 2.0;
/// Steps that a scenario may have, seconds.
const STEP_S: std::ops::RangeInclusive<f64> = 0.02..=5.0;

/// One episode, step by step.
///
/// Scenario ``index`` of a level, generated from ``seed``; with a site of a scenario file, that
/// scenario. ``name`` is the planner's, for logs.
#[pyclass(frozen, module = "decouplegs")]
pub struct Rollout {
    site: Arc<EngineSite>,
    inner: Mutex<EngineRollout>,
    /// Motion of the ego when it was shown last.
    shown: Mutex<Motion>,
}

impl Rollout {
    fn lock(&self) -> MutexGuard<'_, EngineRollout> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Drives `plan` for a step, and says what came of it.
    fn driven<'py>(&self, py: Python<'py>, plan: Plan) -> PyResult<Bound<'py, PyDict>> {
        let mut rollout = self.lock();
        if rollout.end().is_some() {
            return Err(Error::new_err("the episode is over: begin another"));
        }
        let before_m = rollout.progress_m().0;
        let instants = rollout.step(plan, Vec::new(), false).instants.clone();
        let off_road = instants.iter().filter(|instant| !instant.on_road).count();
        let dict = PyDict::new(py);
        dict.set_item("progress_m", rollout.progress_m().0 - before_m)?;
        dict.set_item(
            "off_road_share",
            off_road as f64 / instants.len().max(1) as f64,
        )?;
        dict.set_item("time_s", rollout.simulation().time_s())?;
        dict.set_item("end", rollout.end().map(name_of))?;
        Ok(dict)
    }
}

/// Name of the end in logs.
fn name_of(end: &EpisodeEnd) -> &'static str {
    match end {
        EpisodeEnd::RouteDone => "route_done",
        EpisodeEnd::Collision { .. } => "collision",
        EpisodeEnd::Obstacle { .. } => "obstacle",
        EpisodeEnd::OffRoad => "off_road",
        EpisodeEnd::OffRoute => "off_route",
        EpisodeEnd::Story => "story",
        EpisodeEnd::Time => "time",
        EpisodeEnd::Planner { .. } => "planner",
    }
}

#[pymethods]
impl Rollout {
    #[new]
    #[pyo3(signature = (site, level = "easy", seed = 0, index = 0, *, step_s = None, duration_s = None, name = "python"))]
    #[allow(clippy::too_many_arguments, reason = "they are keywords in Python")]
    fn new(
        py: Python<'_>,
        site: &Site,
        level: &str,
        seed: u64,
        index: u32,
        step_s: Option<f64>,
        duration_s: Option<f64>,
        name: &str,
    ) -> PyResult<Self> {
        let mut scenario = py.detach(|| site.scenario(level, seed, index))?;
        scenario.step_s = step_s.unwrap_or(scenario.step_s);
        scenario.duration_s = duration_s.unwrap_or(scenario.duration_s);
        if !STEP_S.contains(&scenario.step_s)
            || !(scenario.step_s..=3600.0).contains(&scenario.duration_s)
        {
            return Err(value_error(format!(
                "expected step_s from {} to {} and duration_s from that to 3600, found {} and {}",
                STEP_S.start(),
                STEP_S.end(),
                scenario.step_s,
                scenario.duration_s
            )));
        }
        let cameras = site
            .scene
            .rig()
            .cameras()
            .map(|camera| camera.name.clone())
            .collect();
        let planner = PlannerRecord {
            name: name.to_owned(),
            cameras,
            lidars: Vec::new(),
            localization: false,
            privileged: false,
        };
        let rollout = EngineRollout::new(
            &scenario,
            &site.site,
            EpisodeMetadata {
                planner,
                drawn_by: None,
                agent_driver: None,
            },
        );
        let inner = Mutex::new(rollout.map_err(|error| of_episode(&error))?);
        Ok(Self {
            site: site.site.clone(),
            inner,
            shown: Mutex::default(),
        })
    }

    /// Drives a step with the wheels turned towards steer_rad (left above zero, at most 0.6) and
    /// accelerating so (-8 to 3).
    ///
    /// The ego is given the trajectory that this would drive for 2 s, so that a log of it replays
    /// like any other.
    fn step_controls<'py>(
        &self,
        py: Python<'py>,
        steer_rad: f64,
        acceleration_mps2: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let plan = {
            let rollout = self.lock();
            let horizon_s = CONTROL_HORIZON_S.max(2.0 * rollout.simulation().scenario().step_s);
            rollout
                .simulation()
                .view(0)
                .ego()
                .plan_under(steer_rad, acceleration_mps2, horizon_s)
                .map_err(value_error)?
        };
        self.driven(py, plan)
    }

    /// Drives a step along a trajectory: float64 [N, 3] of time (seconds from now, rising), x
    /// (forward) and y (left) in the ego's frame, meters.
    fn step_plan<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let points = rows::<3>("points", points)?;
        let points = points.into_iter().map(|[time_s, x, y]| PlanPoint {
            time_s,
            position_m: DVec2::new(x, y),
        });
        let plan = Plan::new(points.collect()).map_err(value_error)?;
        self.driven(py, plan)
    }

    /// Puts all agents into a world over the site's scene; world_from_rig of the ego, float64 [4,
    /// 4], meters.
    fn show<'py>(&self, py: Python<'py>, world: &World) -> PyResult<Bound<'py, PyAny>> {
        let (ego, motion) = self
            .lock()
            .show(&mut world.lock())
            .map_err(|error| of_session(&error))?;
        *self.shown.lock().unwrap_or_else(PoisonError::into_inner) = motion;
        to_matrix(py, &ego)
    }

    /// Motion of the ego when show was called last: velocity, m/s along the axes of the world, and
    /// turn, rad/s about those of the vehicle.
    #[getter]
    fn ego_motion(&self) -> MotionTuple {
        tuple_of(&self.shown.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s: float64 [4].
    #[getter]
    fn ego_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let motion = self.lock().simulation().view(0).motion();
        shaped(
            py,
            vec![
                motion.speed_mps,
                motion.acceleration_mps2,
                motion.steer_rad,
                motion.yaw_rate_radps,
            ],
            &[4],
        )
    }

    /// Sizes of boxes: length, width, height, meters, float64 [N + 1, 3]. Row 0 is the ego, row i
    /// the vehicle or pedestrian whose instance is i.
    #[getter]
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rollout = self.lock();
        let simulation = rollout.simulation();
        let agents = simulation.agent_sizes().iter();
        let values: Vec<f64> = std::iter::once(&simulation.scenario().ego.size)
            .chain(agents)
            .flat_map(|size| [size.length_m, size.width_m, size.height_m])
            .collect();
        let count = values.len() / 3;
        shaped(py, values, &[count, 3])
    }

    /// Kinds of road users, a name for each row of ``sizes``: ``car``, ``truck``, ``bus``,
    /// ``cyclist`` or ``pedestrian``. The ego is a car.
    #[getter]
    fn kinds(&self) -> Vec<&'static str> {
        let rollout = self.lock();
        let scenario = rollout.simulation().scenario();
        let others = (0..scenario.agent_count()).map(|index| scenario.agent(index).1);
        std::iter::once(RoadUser::Car)
            .chain(others)
            .map(RoadUser::name)
            .collect()
    }

    /// Navigation instructions: turn (``left``, ``right``, ``straight``), distance_m, angle_rad,
    /// length_m, cruise_mps.
    #[getter]
    fn guidance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let guidance = self.lock().simulation().view(0).guidance();
        let dict = PyDict::new(py);
        dict.set_item("turn", guidance.turn.name())?;
        dict.set_item("distance_m", guidance.distance_m)?;
        dict.set_item("angle_rad", guidance.angle_rad)?;
        dict.set_item("length_m", guidance.length_m)?;
        dict.set_item("cruise_mps", guidance.cruise_mps)?;
        Ok(dict)
    }

    /// Places on the route ahead, in the ego's frame: float64 [points, 2], meters.
    #[pyo3(signature = (points = 10, spacing_m = 5.0))]
    fn route_ahead<'py>(
        &self,
        py: Python<'py>,
        points: usize,
        spacing_m: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        if !((1..=4096).contains(&points) && spacing_m > 0.0 && spacing_m.is_finite()) {
            return Err(value_error(format!(
                "expected 1 to 4096 points and a spacing above 0, found {points} and {spacing_m}"
            )));
        }
        let rollout = self.lock();
        let (ego, route) = (
            rollout.simulation().instant().ego,
            rollout.simulation().view(0).route(),
        );
        let (progress_m, length_m) = rollout.progress_m();
        let place = |number: usize| {
            let (at, _) = route.pose_at((progress_m + spacing_m * number as f64).min(length_m));
            ego.to_local(at.truncate()).to_array()
        };
        shaped(py, (1..=points).flat_map(place).collect(), &[points, 2])
    }

    /// Meters of the route that are behind the ego, and all of them.
    #[getter]
    fn progress_m(&self) -> (f64, f64) {
        self.lock().progress_m()
    }

    /// Reason of the end, if it has ended.
    #[getter]
    fn end(&self) -> Option<&'static str> {
        self.lock().end().map(name_of)
    }

    /// Steps that were driven.
    #[getter]
    fn steps(&self) -> u32 {
        self.lock().next_step()
    }

    /// Length of a step, seconds.
    #[getter]
    fn step_s(&self) -> f64 {
        self.lock().simulation().scenario().step_s
    }

    /// The scenario's name.
    #[getter]
    fn scenario(&self) -> String {
        self.lock().simulation().scenario().name.clone()
    }

    /// Score so far: driving_score, route_completion, success, collisions, pedestrian_collisions,
    /// obstacle_collisions, layout_infractions, wrong_ways, red_lights, stop_signs, min_ttc_s,
    /// ttc_short_share.
    fn score<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let score = self.lock().score();
        to_dict(py, &score)
    }

    /// Scores beside the driving score so far: all_rules_score, reference_progress, pdm_score,
    /// extended_pdm_score, lane_kept_share, speed_compliance, over_edge_s, on_crossing, blocking,
    /// wrong_turns. None where the map does not tell one.
    fn sub_scores<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let rollout = self.lock();
        let (episode, score) = (rollout.episode(), rollout.score());
        let (pdm, conduct) = (
            PdmScore::new(episode, &score),
            Conduct::new(episode, &score),
        );
        let extended = ExtendedPdmScore::new(episode, &score, &pdm, &conduct.reference);
        let keeping = conduct.lane_keeping;
        let dict = PyDict::new(py);
        dict.set_item("all_rules_score", conduct.all_rules_score)?;
        dict.set_item("reference_progress", conduct.reference.share)?;
        dict.set_item("pdm_score", pdm.pdm_score)?;
        dict.set_item("extended_pdm_score", extended.score)?;
        dict.set_item("lane_kept_share", keeping.map(|one| one.kept_share()))?;
        dict.set_item("over_edge_s", keeping.map(|one| one.over_edge_s))?;
        dict.set_item("speed_compliance", score.speed_compliance)?;
        dict.set_item("on_crossing", conduct.count(ConductKind::OnCrossing))?;
        dict.set_item("blocking", conduct.count(ConductKind::Blocking))?;
        dict.set_item("wrong_turns", conduct.count(ConductKind::WrongTurn))?;
        Ok(dict)
    }

    /// Writes its log, which ``decouplegs replay`` and ``decouplegs score`` read.
    fn write_log(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let episode = self.lock().episode().clone();
        let written = py.detach(|| {
            let mut log = EpisodeLog::create(&path, &episode.head, &episode.start)?;
            episode.steps.iter().try_for_each(|step| log.append(step))?;
            log.finish(&episode.end)
        });
        written.map_err(|error| FileError::new_err(sentence(&error)))
    }

    fn __repr__(&self) -> String {
        let rollout = self.lock();
        let (progress_m, length_m) = rollout.progress_m();
        let lanes = self.site.lanes.lanes.len();
        format!(
            "Rollout({}, {progress_m:.1} of {length_m:.1} m, {lanes} lanes)",
            rollout.simulation().scenario().name
        )
    }
}

fn to_dict<'py>(py: Python<'py>, score: &EpisodeScore) -> PyResult<Bound<'py, PyDict>> {
    let dict = PyDict::new(py);
    dict.set_item("driving_score", score.driving_score)?;
    dict.set_item("route_completion", score.route_completion)?;
    dict.set_item("success", score.success)?;
    dict.set_item("collisions", score.collisions())?;
    dict.set_item("pedestrian_collisions", score.pedestrian_collisions())?;
    dict.set_item("obstacle_collisions", score.obstacle_collisions())?;
    dict.set_item("layout_infractions", score.layout_infractions())?;
    dict.set_item("wrong_ways", score.wrong_ways())?;
    dict.set_item("red_lights", score.red_lights())?;
    dict.set_item("stop_signs", score.stop_signs())?;
    dict.set_item("min_ttc_s", score.min_ttc_s())?;
    dict.set_item("ttc_short_share", score.ttc_short_share)?;
    Ok(dict)
}
