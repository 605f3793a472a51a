//! Episodes that Python steps through.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard};

use decouplegs::asset::write_atomically;
use decouplegs::episode::{Answer, EpisodeMetadata, Rollout as EngineRollout, Site as EngineSite};
use decouplegs::logs::episode_log::encode;
use decouplegs::scene::episode::PlannerRecord;
use decouplegs::scene::{Plan, PlanPoint, RoadUser};
use glam::DVec2;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{rows, shaped};
use crate::error::{Error, FileError, of_episode, sentence, value_error};
use crate::lidar::MotionTuple;
use crate::rollout_ego::{RolloutEgo, SharedRollout, lock, name_of};
use crate::site::Site;
use crate::world::World;

/// Steps that a scenario may have, seconds.
const STEP_S: std::ops::RangeInclusive<f64> = 0.02..=5.0;

/// One episode, step by step.
///
/// Scenario ``index`` of a level, generated from ``seed``; with a site of a scenario file, that
/// scenario. ``name`` is the planner's, for logs. With ``egos``, cars of the generated traffic
/// become egos. What is asked of the rollout itself is that of the first ego.
#[pyclass(frozen, module = "decouplegs")]
pub struct Rollout {
    site: Arc<EngineSite>,
    inner: SharedRollout,
    egos: Vec<Py<RolloutEgo>>,
}

impl Rollout {
    fn lock(&self) -> MutexGuard<'_, EngineRollout> {
        lock(&self.inner)
    }

    /// The first ego, which drives the scenario's own route.
    fn first(&self) -> &RolloutEgo {
        self.egos[0].get()
    }

    /// Drives `plan` of the only ego for a step, and says what came of it.
    fn driven<'py>(&self, py: Python<'py>, plan: Plan) -> PyResult<Bound<'py, PyDict>> {
        let count = self.egos.len();
        if count > 1 {
            return Err(value_error(format!(
                "the rollout has {count} egos: give step the plan of each"
            )));
        }
        let mut outcomes = self.driven_together(py, vec![Some(plan)])?;
        Ok(outcomes.swap_remove(0).1)
    }

    /// Drives the plans of all egos for a step, `None` for those that have ended. Of each that was
    /// driven its index, and what came of it.
    fn driven_together<'py>(
        &self,
        py: Python<'py>,
        plans: Vec<Option<Plan>>,
    ) -> PyResult<Vec<(usize, Bound<'py, PyDict>)>> {
        let mut rollout = self.lock();
        if rollout.is_over() {
            return Err(Error::new_err("the episode is over: begin another"));
        }
        let progress_m = |rollout: &EngineRollout, ego| rollout.simulation().view(ego).progress_m();
        let before_m: Vec<f64> = (0..plans.len())
            .map(|ego| progress_m(&rollout, ego))
            .collect();
        let driven: Vec<usize> = (0..plans.len())
            .filter(|&ego| plans[ego].is_some())
            .collect();
        let answer = |plan| Answer {
            plan,
            readings: Vec::new(),
            warm_up: false,
        };
        rollout.step_egos(plans.into_iter().map(|plan| plan.map(answer)).collect());
        let outcome = |ego: usize| {
            let view = rollout.simulation().view(ego);
            let step = rollout.episode().ego(ego).steps.last();
            let instants = step.map_or(&[][..], |step| &step.instants);
            let off_road = instants.iter().filter(|instant| !instant.on_road).count();
            let dict = PyDict::new(py);
            dict.set_item("progress_m", progress_m(&rollout, ego) - before_m[ego])?;
            dict.set_item(
                "off_road_share",
                off_road as f64 / instants.len().max(1) as f64,
            )?;
            dict.set_item("time_s", rollout.simulation().time_s())?;
            dict.set_item("end", view.end().map(name_of))?;
            Ok((ego, dict))
        };
        driven.into_iter().map(outcome).collect()
    }
}

/// The plan of `points`: float64 [N, 3] of time, x and y.
fn plan_of(points: &Bound<'_, PyAny>) -> PyResult<Plan> {
    let points = rows::<3>("points", points)?;
    let points = points.into_iter().map(|[time_s, x, y]| PlanPoint {
        time_s,
        position_m: DVec2::new(x, y),
    });
    Plan::new(points.collect()).map_err(value_error)
}

#[pymethods]
impl Rollout {
    #[new]
    #[pyo3(signature = (site, level = "easy", seed = 0, index = 0, *, step_s = None, duration_s = None, name = "python", egos = None))]
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
        egos: Option<usize>,
    ) -> PyResult<Self> {
        let mut scenario = py.detach(|| site.scenario(level, seed, index, egos))?;
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
        let metadata = EpisodeMetadata {
            planner,
            drawn_by: None,
            agent_driver: None,
        };
        let count = scenario.egos.count();
        let rollout = EngineRollout::with_egos(&scenario, &site.site, vec![metadata; count])
            .map_err(|error| of_episode(&error))?;
        let inner = Arc::new(Mutex::new(rollout));
        let ego = |index| Py::new(py, RolloutEgo::new(inner.clone(), index));
        Ok(Self {
            site: site.site.clone(),
            egos: (0..count).map(ego).collect::<PyResult<_>>()?,
            inner,
        })
    }

    /// All egos, in the order of the scenario.
    #[getter]
    fn egos(&self, py: Python<'_>) -> Vec<Py<RolloutEgo>> {
        self.egos.iter().map(|ego| ego.clone_ref(py)).collect()
    }

    /// Drives a step of all egos, along a trajectory for each that has not ended: float64 [N, 3]
    /// by its name, as ``step_plan`` takes it. What came of the step, by name.
    fn step<'py>(
        &self,
        py: Python<'py>,
        plans: BTreeMap<String, Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let names: Vec<String> = self.egos.iter().map(|ego| ego.get().name()).collect();
        let drives: Vec<bool> = self
            .egos
            .iter()
            .map(|ego| ego.get().end().is_none())
            .collect();
        let expected: Vec<&str> = names
            .iter()
            .zip(&drives)
            .filter_map(|(name, &drives)| drives.then_some(name.as_str()))
            .collect();
        let mut sorted = expected.clone();
        sorted.sort_unstable();
        if !plans.keys().eq(sorted) {
            let found: Vec<&String> = plans.keys().collect();
            return Err(value_error(format!(
                "plans: expected one for each ego that has not ended, {expected:?}, found {found:?}"
            )));
        }
        let plan = |name: &String| plans.get(name).map(plan_of).transpose();
        let plans = names.iter().map(plan).collect::<PyResult<Vec<_>>>()?;
        let outcomes = PyDict::new(py);
        for (ego, outcome) in self.driven_together(py, plans)? {
            outcomes.set_item(&names[ego], outcome)?;
        }
        Ok(outcomes)
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
        let plan = self
            .first()
            .plan_of_controls(steer_rad, acceleration_mps2)?;
        self.driven(py, plan)
    }

    /// Drives a step along a trajectory: float64 [N, 3] of time (seconds from now, rising), x
    /// (forward) and y (left) in the ego's frame, meters.
    fn step_plan<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.driven(py, plan_of(points)?)
    }

    /// Puts all agents into a world over the site's scene; world_from_rig of the ego, float64 [4,
    /// 4], meters.
    fn show<'py>(&self, py: Python<'py>, world: &World) -> PyResult<Bound<'py, PyAny>> {
        self.first().show(py, world)
    }

    /// Motion of the ego when show was called last: velocity, m/s along the axes of the world, and
    /// turn, rad/s about those of the vehicle.
    #[getter]
    fn ego_motion(&self) -> MotionTuple {
        self.first().motion()
    }

    /// Speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s: float64 [4].
    #[getter]
    fn ego_state<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        self.first().state(py)
    }

    /// Sizes of boxes: length, width, height, meters, float64 [N + 1, 3]. Row 0 is the ego, row i
    /// the vehicle or pedestrian whose instance is i.
    #[getter]
    fn sizes<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let rollout = self.lock();
        let simulation = rollout.simulation();
        let agents = simulation.view(0).agent_sizes();
        let values: Vec<f64> = std::iter::once(&simulation.scenario().ego.size)
            .chain(&agents)
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
        self.first().guidance(py)
    }

    /// Places on the route ahead, in the ego's frame: float64 [points, 2], meters.
    #[pyo3(signature = (points = 10, spacing_m = 5.0))]
    fn route_ahead<'py>(
        &self,
        py: Python<'py>,
        points: usize,
        spacing_m: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        self.first().route_ahead(py, points, spacing_m)
    }

    /// Meters of the route that are behind the ego, and all of them.
    #[getter]
    fn progress_m(&self) -> (f64, f64) {
        self.first().progress_m()
    }

    /// Reason of the end, if it has ended.
    #[getter]
    fn end(&self) -> Option<&'static str> {
        self.first().end()
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
        self.first().score(py)
    }

    /// Scores beside the driving score so far: all_rules_score, reference_progress, pdm_score,
    /// extended_pdm_score, lane_kept_share, speed_compliance, over_edge_s, on_crossing, blocking,
    /// wrong_turns. None where the map does not tell one.
    fn sub_scores<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.first().sub_scores(py)
    }

    /// Writes its log, which ``decouplegs replay`` and ``decouplegs score`` read.
    fn write_log(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let episode = self.lock().episode().clone();
        let written = py.detach(|| {
            let bytes = encode(&episode).map_err(|error| sentence(&error))?;
            let written = write_atomically(&path, |file| file.write_all(&bytes));
            written.map_err(|error| sentence(&error))
        });
        written.map_err(FileError::new_err)
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
